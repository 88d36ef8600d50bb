"""The filters of the paper on NumPy arrays, for recorded readings and many runs at once.

The results equal those of the CasADi expressions in the module `filters`.

Arrays may have any leading axes, for example runs and sensors. The functions return the next state and change no array
in place. In windows and histories, the newest value is first. Ranges are in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.marine.sensing.ranging.filters import ERROR_FLOOR, FILTER_GAINS, POWER_FLOOR, SensorFilter, StepRule

__all__ = ["PlainLmsStep", "PlainUpdate", "plain_average", "plain_filter", "plain_gate", "plain_lms_step"]

Array = NDArray[np.float64]


def plain_average(samples: Array) -> Array:
    """Return the weighted mean (...) of samples (..., k) [m], oldest first, with the weights of `weighted_average`.

    Example:
        >>> import numpy as np
        >>> from tests.oracles.range_filters import plain_average
        >>> plain_average(np.array([1.0, 1.0, 1.0, 1.0, 1.3])).round(3).tolist()
        1.1
    """
    weights = np.arange(1.0, samples.shape[-1] + 1.0)
    mean: Array = samples @ weights / weights.sum()
    return mean


def plain_gate(window: Array, value: Array, *, lambda1: ArrayLike, resolution: float) -> tuple[Array, Array, Array]:
    """Apply the gate, equations (4)–(5) of the paper, to NumPy arrays, as `gate` does to CasADi symbols.

    Args:
        window: (..., n) the last n values of the weighted mean, before the gate [m], newest first.
        value: (...) the new weighted mean [m].
        lambda1: factor λ1 ≥ 0 on the standard deviation, see `gate`.
        resolution: one conversion step [m].

    Returns:
        three results: gated value (...) [m]; 1 if `value` was accepted, else 0 (...); next window (..., n) [m].

    Example:
        >>> import numpy as np
        >>> from tests.oracles.range_filters import plain_gate
        >>> window = np.array([2.0, 2.02, 1.98, 2.0])
        >>> for value in (2.03, 3.5):
        ...     print([float(x) for x in plain_gate(window, np.array(value), lambda1=3.0, resolution=0.0176)[:2]])
        [2.03, 1.0]
        [2.0, 0.0]
    """
    mean = window.mean(axis=-1)
    variance = np.mean(window * window, axis=-1) - mean * mean
    spread = np.maximum(np.sqrt(np.maximum(variance, 0.0)), resolution)
    accepted = np.abs(value - window[..., 0]) < np.asarray(lambda1) * spread
    return np.where(accepted, value, mean), accepted.astype(float), _pushed(window, value)


class PlainLmsStep(NamedTuple):
    """The result of one step of Algorithm 1 as arrays, see `LmsStep`."""

    theta: Array
    """(..., m) next weights θ_{n+1}."""
    errors: Array
    """(..., N) last absolute residuals |ℜ| [m], newest first."""
    mean_error: Array
    """(...) exponential mean ē of the corrected error [m]."""
    residual: Array
    """(...) residual ℜ_n of the prediction [m]."""
    corrected_error: Array
    """(...) corrected error e_n of equation (7) of the paper [m]."""


def plain_lms_step(
    theta: Array,
    theta_prev: Array,
    *,
    X: Array,
    x_n: Array,
    errors: Array,
    mean_error: Array,
    relaxation: ArrayLike,
    beta_max: ArrayLike,
    step: StepRule = "corrected",
) -> PlainLmsStep:
    """Return the result of one step of Algorithm 1 of the paper, as `lms_step` does.

    Args:
        theta: weights θ_n (..., m).
        theta_prev: previous weights θ_{n−1} (..., m).
        X: (..., m) the m values before x_n [m], newest first.
        x_n: (...) the value to be predicted [m].
        errors: (..., N) last absolute residuals |ℜ| before this step [m], newest first.
        mean_error: (...) exponential mean ē of the corrected error before this step [m].
        relaxation: relaxation ρ, limited to [0, 1].
        beta_max: largest momentum β_max, limited to [0, 0.5].
        step: rule for the step size μ, "corrected" or "printed".

    Raises:
        InputError: if `step` is unknown.

    Example:
        >>> import numpy as np
        >>> from tests.oracles.range_filters import plain_lms_step
        >>> x, half, zero = np.array([1.98, 2.0]), np.full(2, 0.5), np.array(0.0)  # 2 cm less per firing
        >>> now = {"X": x, "x_n": np.array(1.96), "errors": np.zeros(4), "mean_error": zero}
        >>> step = plain_lms_step(half, half, relaxation=1.0, beta_max=0.0, **now)
        >>> round(float(step.residual), 3), round(float(step.theta @ x), 3)
        (-0.03, 1.96)
    """
    if step not in get_args(StepRule):
        raise InputError("unknown LMS step", key="step", value=step, remedy=nearest(step, get_args(StepRule)))
    n = errors.shape[-1]
    residual = np.asarray(x_n - np.sum(theta * X, axis=-1))
    history = _pushed(errors, np.abs(residual))
    corrected = history @ ((n - np.arange(n)) / n) / n
    rho = np.asarray(2.0) if step == "printed" else np.clip(relaxation, 0.0, 1.0)
    beta = np.clip(beta_max, 0.0, 0.5) * np.minimum(1.0, corrected / np.maximum(mean_error, ERROR_FLOOR))
    power = np.maximum(np.sum(X * X, axis=-1), POWER_FLOOR)
    moved = theta + (rho * residual / power)[..., None] * X + beta[..., None] * (theta - theta_prev)
    return PlainLmsStep(
        theta=np.where((corrected >= mean_error)[..., None], moved, theta),
        errors=history,
        mean_error=mean_error + (corrected - mean_error) / n,
        residual=residual,
        corrected_error=corrected,
    )


class PlainUpdate(NamedTuple):
    """The result of `plain_filter` as arrays, see `FilterUpdate`."""

    state: dict[str, Array]
    """Next state: value of each entry, by name."""
    range_hat: Array
    """(..., n) filtered range from each apex [m]."""
    healthy: Array
    """(..., n) 1 if the range is reliable, else 0."""


def plain_filter(
    filter_: SensorFilter,
    state: Mapping[str, Array],
    samples: Array,
    *,
    fresh: Array,
    gains: Mapping[str, ArrayLike],
    prefix: str = "",
) -> PlainUpdate:
    """Return the ranges after one control step, as `SensorFilter.update` does.

    Args:
        filter_: the filter.
        state: value of each entry of the filter's `ports`, by name, as an array with any leading axes.
        samples: (..., n, k) raw samples [m].
        fresh: (..., n) 1 for a sensor that fired since the last step, else 0.
        gains: scalar value of each gain, by name.
        prefix: prefix of the names of the entries of state and gains.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing import SensorFilter
        >>> from tests.oracles.range_filters import plain_filter
        >>> sonar = SensorFilter()
        >>> layouts = Layout(sonar.ports()), Layout(sonar.gain_ports())
        >>> state, gains = (layout.unpack(layout.pack()) for layout in layouts)
        >>> for _ in range(20):
        ...     filtered = plain_filter(sonar, state, np.full((4, 5), 2.0), fresh=np.array([1, 0, 0, 0]), gains=gains)
        ...     state = filtered.state
        >>> filtered.range_hat.round(3).tolist(), filtered.healthy.tolist()  # only the first sensor fired
        ([2.0, 4.5, 4.5, 4.5], [1.0, 0.0, 0.0, 0.0])
    """
    old = {port.name.removeprefix(prefix): state[port.name] for port in filter_.ports(prefix)}
    new = _fired(filter_, old, samples, {name: float(np.asarray(gains[prefix + name]).item()) for name in FILTER_GAINS})
    fired = fresh > 0.5
    after = {
        name: np.where(fired if value.ndim == fired.ndim else fired[..., None], new[name], value)
        for name, value in old.items()
    }
    predicted = np.sum(after["theta"] * after["history"], axis=-1)
    ahead = np.minimum(after["history"][..., 0], predicted)
    return PlainUpdate(
        {prefix + name: value for name, value in after.items()},
        np.clip(ahead, filter_.array.minimum, filter_.array.maximum),
        (after["refused"] < filter_.refusals).astype(float),
    )


def _fired(
    filter_: SensorFilter, old: Mapping[str, Array], samples: Array, gains: Mapping[str, float]
) -> dict[str, Array]:
    # next state of the sensors that fired, by port name without prefix
    lambda1 = gains["lambda1"]
    gated, accepted, window = plain_gate(
        old["window"], plain_average(samples), lambda1=lambda1, resolution=filter_.array.resolution
    )
    lms = plain_lms_step(
        old["theta"],
        old["theta_prev"],
        X=old["history"],
        x_n=gated,
        errors=old["errors"],
        mean_error=old["mean_error"],
        relaxation=gains["relaxation"],
        beta_max=gains["beta_max"],
        step=filter_.step,
    )
    anew = (accepted > 0.5) & (np.abs(gated - old["history"][..., 0]) > filter_.jump)
    wide, uniform = anew[..., None], 1.0 / filter_.taps
    refused = np.minimum(old["refused"] + 1.0, float(filter_.refusals))
    return {
        "window": window,
        "history": np.where(wide, gated[..., None], _pushed(old["history"], gated)),
        "theta": np.where(wide, uniform, lms.theta),
        "theta_prev": np.where(wide, uniform, old["theta"]),
        "errors": np.where(wide, old["errors"], lms.errors),
        "mean_error": np.where(anew, old["mean_error"], lms.mean_error),
        "refused": np.where((accepted > 0.5) | (not lambda1 > 0), 0.0, refused),
    }


def _pushed(window: Array, value: Array) -> Array:
    return np.concatenate([np.asarray(value)[..., None], window[..., :-1]], axis=-1)
