"""The sampled loop: a continuous plant, thrust that is constant over each control period, and whole periods of delay.

The model is exact and uses no Padé approximation: x⁺ = Φ x + Γ f, where f = −K y acts d periods late. The integral
state ξ is computed inside the controller and is not delayed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle import Vehicle
from surctl.verification.cascade import Cascade, build_cascade

__all__ = [
    "SampledLimits",
    "check_delay",
    "largest_period",
    "open_transition",
    "radius_of",
    "sampled_limits",
    "sampled_poles",
]

Array = NDArray[np.float64]

_AXES = 4
_SHORTEST, _LONGEST = 1e-3, 20.0  # [s]
_GROWTH = 1.06  # ratio of one tried period to the one before
_HALVINGS = 24
_MOST = 400  # largest delay that is tried, in periods
_EDGE = 1e-9  # a pole this close to the unit circle counts as on it
DELAYS = (0, 1, 2)

_Held = tuple[Array, Array]


@dataclass(frozen=True)
class SampledLimits:
    """The control periods and delays for which the sampled loop is stable.

    Attributes:
        period_s: control period [s].
        radius: largest |z| of a pole at this period with one period of delay.
        largest_period_s: largest control period [s] up to which the loop is stable, with 0, 1 and 2 periods of delay.
            Periods are tried in steps of 6 % and refined by bisection; inf if 20 s is stable, 0 if no period is.
        delay_periods: largest delay in whole periods up to which the loop is stable at `period_s`; −1 if it is unstable
            without delay.
    """

    period_s: float
    radius: float
    largest_period_s: tuple[float, float, float]
    delay_periods: int

    def to_dict(self) -> dict[str, Any]:
        """The limits as plain data."""
        return {**asdict(self), "largest_period_s": dict(zip(map(str, DELAYS), self.largest_period_s, strict=True))}


def sampled_poles(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    period: float,
    delay: int = 0,
    model: Vehicle | None = None,
) -> NDArray[np.complex128]:
    """Return the poles z (n,) of the sampled loop, the largest first; it is stable if all lie inside the unit circle.

    Args:
        vehicle: the plant.
        gains: as in `build_cascade`.
        cruise: cruise speed U [m/s].
        period: control period T [s], > 0.
        delay: delay from measurement to thrust in whole periods, at least 0.
        model: the controller's model of the vehicle; default the vehicle itself.

    Raises:
        InputError: as in `build_cascade`, or the delay is not a whole number of at least 0.
    """
    check_delay(delay)
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=period, model=model, delay=0.0)
    poles = np.linalg.eigvals(_transition(cascade, delay, _held(cascade, period))).astype(complex)
    return poles[np.argsort(-np.abs(poles), kind="stable")]


def largest_period(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    delay: int = 0,
    model: Vehicle | None = None,
) -> float:
    """Return the largest control period T [s] up to which the sampled loop is stable.

    Periods grow from 1 ms in steps of 6 % until the loop is unstable, and bisection refines the last step. The result
    is inf if 20 s is stable, and 0 if 1 ms is unstable. Longer periods at which the loop is stable again do not count.

    Raises:
        InputError: as in `sampled_poles`.
    """
    check_delay(delay)
    undelayed = build_cascade(vehicle, gains, cruise=cruise, dt=_SHORTEST, model=model, delay=0.0)
    return _largest(undelayed, delay, partial(_held, undelayed))


def sampled_limits(undelayed: Cascade, period: float) -> SampledLimits:
    """Return the limits of a cascade that was built with `delay=0` and runs at the given control period [s].

    If a leading axis holds several cascades, each limit is the worst of them.
    """
    held = cache(partial(_held, undelayed))  # each delay tries the same periods
    borne = -1
    for delay in range(_MOST + 1):
        if np.max(_radius(undelayed, delay, held(period))) >= 1 - _EDGE:
            break
        borne = delay
    one, two, three = (_largest(undelayed, delay, held) for delay in DELAYS)
    return SampledLimits(period, float(np.max(_radius(undelayed, 1, held(period)))), (one, two, three), borne)


def radius_of(undelayed: Cascade, period: float, delay: int) -> float:
    """Return the largest |z| of a pole of the sampled loop."""
    return float(_radius(undelayed, delay, _held(undelayed, period)))


def _radius(undelayed: Cascade, delay: int, held: _Held) -> Array:
    """The largest |z| (…,) of the poles of each sampled loop."""
    radius: Array = np.max(np.abs(np.linalg.eigvals(_transition(undelayed, delay, held))), axis=-1)
    return radius


def _largest(undelayed: Cascade, delay: int, held: Callable[[float], _Held]) -> float:
    """The least stable period over the cascades: the first unstable step, refined for the cascades unstable there."""
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
    """The transition matrix over one period, for the plant, ξ and the delayed thrusts."""
    rest, enter, thrust = _open_transition(cascade, delay, held)
    transition: Array = rest + enter @ thrust
    return transition


def _held(cascade: Cascade, period: float | Array) -> _Held:
    """The matrices (Φ, Γ) of a period with constant inputs; several cascades have one period each or a common one."""
    from scipy.linalg import expm

    n, m = cascade.B.shape[-2:]
    both = np.zeros((*cascade.B.shape[:-2], n + m, n + m))
    both[..., :n, :n], both[..., :n, n:] = cascade.A, cascade.B
    grown = expm(both * np.asarray(period)[..., None, None])
    return grown[..., :n, :n], grown[..., :n, n:]


def open_transition(cascade: Cascade, period: float, delay: int) -> tuple[Array, Array, Array]:
    """Return (M, E, F) of a cascade built with `delay=0`: x⁺ = M x + E f, where the law commands f = F x.

    x holds the states of the plant and ξ (n,), then the delayed thrusts (4,) of each period of delay, the next to act
    first. M includes the integral action of the controller.
    """
    return _open_transition(cascade, delay, _held(cascade, period))


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


def check_delay(delay: int) -> None:
    """Raise InputError for a delay that is not a whole number of at least 0."""
    if not isinstance(delay, int | np.integer) or isinstance(delay, bool) or delay < 0:
        raise InputError("must be a whole number of at least 0", key="delay", value=delay, remedy="give e.g. 1")
