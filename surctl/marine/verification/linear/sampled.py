"""The sampled loop: a continuous plant whose thrust is constant over each control period and delayed by whole periods.

The state after one control period is x⁺ = Φ x + Γ f, where the command f = −K y acts d periods late. The model is exact
and needs no Padé approximation. The integral state ξ is computed inside the controller and is not delayed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.ir.cache import stored_numbers
from surctl.marine.verification.cascade import Cascade
from surctl.system.linear_loop import expm
from surctl.verification.linear import blockwise, eigenvalues

__all__ = [
    "SampledLimits",
    "radii_of",
    "sampled_limits",
]

Array = NDArray[np.float64]

_AXES = 4
_SHORTEST, _LONGEST = 1e-3, 20.0  # [s]
_GROWTH = 1.06  # ratio of a tried period to the previous period
_HALVINGS = 24
_MOST = 400  # largest delay that is tried, in periods
_EDGE = 1e-9  # a pole this close to the unit circle counts as lying on the circle
_DELAYS = (0, 1, 2)

_Held = tuple[Array, Array]


@dataclass(frozen=True)
class SampledLimits:
    """Limits of the control period and of the delay up to which the sampled loop is stable.

    Attributes:
        period_s: control period [s].
        radius: largest |z| of the poles at the control period `period_s` with one period of delay.
        largest_period_s: largest control periods [s] up to which the loop is stable, for a delay of 0, 1 and 2 periods.
            Periods are tried in steps of 6 % and refined by bisection; inf if the loop is stable up to 20 s, 0 if it is
            unstable at all periods.
        delay_periods: largest delay, in whole periods, up to which the loop is stable at the period `period_s`; −1 if
            the loop is unstable without delay.
    """

    period_s: float
    radius: float
    largest_period_s: tuple[float, float, float]
    delay_periods: int

    def to_dict(self) -> dict[str, Any]:
        """The limits as plain data for JSON."""
        return {**asdict(self), "largest_period_s": dict(zip(map(str, _DELAYS), self.largest_period_s, strict=True))}


def sampled_limits(undelayed: Cascade, period: float) -> SampledLimits:
    """Return the sampling limits of a cascade that was built with `delay=0`, for the control period `period` [s].

    If the cascade has a leading axis with several cascades, each limit is the worst over these cascades, and the result
    is cached on disk: for the corners of a vehicle's ranges it takes seconds.
    """
    if undelayed.A.ndim == 2:
        return _sampled_limits(undelayed, period)
    matrices = [np.asarray(getattr(undelayed, name), dtype=float) for name in ("A", "B", "C", "K")]
    values = stored_numbers(
        ("surctl.marine.verification.linear.sampled", "surctl.system.linear_loop", "surctl.verification.linear"),
        (period, *((matrix.shape, matrix.tobytes()) for matrix in matrices)),
        lambda: asdict(_sampled_limits(undelayed, period)),
        suffix=".sampled",
    )
    return SampledLimits(**{**values, "largest_period_s": tuple(values["largest_period_s"])})


def _sampled_limits(undelayed: Cascade, period: float) -> SampledLimits:
    held = cache(partial(_held, undelayed))  # each delay tries the same periods
    borne = -1
    for delay in range(_MOST + 1):
        if np.max(_radius(undelayed, delay, held(period))) >= 1 - _EDGE:
            break
        borne = delay
    one, two, three = (_largest(undelayed, delay, held) for delay in _DELAYS)
    return SampledLimits(period, float(np.max(_radius(undelayed, 1, held(period)))), (one, two, three), borne)


def radii_of(undelayed: Cascade, period: float, delay: int) -> Array:
    """Return the spectral radius (k,) of the sampled loop of each of k cascades."""
    return _radius(undelayed, delay, _held(undelayed, period))


def _radius(undelayed: Cascade, delay: int, held: _Held) -> Array:
    transition = _transition(undelayed, delay, held)
    poles = np.linalg.eigvals(transition) if transition.ndim == 2 else eigenvalues(transition)
    radius: Array = np.max(np.abs(poles), axis=-1)
    return radius


def _largest(undelayed: Cascade, delay: int, held: Callable[[float], _Held]) -> float:
    """Return the largest period up to which all cascades are stable; bisection refines the first unstable step."""
    good, bad = 0.0, _SHORTEST
    while True:
        lost = _radius(undelayed, delay, held(bad)) >= 1 - _EDGE * bad
        if np.any(lost):
            break
        good, bad = bad, bad * _GROWTH
        if good >= _LONGEST:
            return float("inf")
    if good == 0.0:
        return 0.0
    first = undelayed if lost.ndim == 0 else Cascade(*(getattr(undelayed, m)[lost] for m in ("A", "B", "C", "K")))
    low, high = np.full(first.A.shape[:-2], good), np.full(first.A.shape[:-2], bad)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        stable = _radius(first, delay, _held(first, middle)) < 1 - _EDGE * middle
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return float(np.min(low))


def _transition(cascade: Cascade, delay: int, held: _Held) -> Array:
    """Return the transition matrix over one period of the states of the plant, of ξ, and of the delayed thrusts."""
    rest, enter, thrust = _open_transition(cascade, delay, held)
    transition: Array = rest + enter @ thrust
    return transition


def _held(cascade: Cascade, period: float | Array) -> _Held:
    """Return the transition matrix Φ and the input matrix Γ over one period with constant inputs.

    Several cascades have one period each or a common period.
    """
    n, m = cascade.B.shape[-2:]
    both = np.zeros((*cascade.B.shape[:-2], n + m, n + m))
    both[..., :n, :n], both[..., :n, n:] = cascade.A, cascade.B
    scaled = both * np.asarray(period)[..., None, None]
    grown = expm(scaled) if scaled.ndim == 2 else blockwise(expm, scaled)
    return grown[..., :n, :n], grown[..., :n, n:]


def _open_transition(cascade: Cascade, delay: int, held: _Held) -> tuple[Array, Array, Array]:
    phi, gamma = held
    many, n = phi.shape[:-2], phi.shape[-1]
    law = -cascade.K @ cascade.C
    # the inputs ξ̇ follow the thrusts and act without delay
    now = phi + gamma[..., _AXES:] @ law[..., _AXES:, :]
    thrust, enter = law[..., :_AXES, :], gamma[..., :_AXES]
    if delay == 0:
        return now, enter, thrust
    size = n + _AXES * delay
    rest, late, law_of_all = (np.zeros((*many, *shape)) for shape in ((size, size), (size, _AXES), (_AXES, size)))
    rest[..., :n, :n], rest[..., :n, n : n + _AXES] = now, enter
    rest[..., n : size - _AXES, n + _AXES :] = np.eye(_AXES * (delay - 1))
    late[..., size - _AXES :, :] = np.eye(_AXES)
    law_of_all[..., :n] = thrust
    return rest, late, law_of_all
