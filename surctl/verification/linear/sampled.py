"""The loop as it runs: a continuous plant, thrust held over a control period, and whole periods of delay.

Exact, no Padé approximation: x⁺ = Φ x + Γ f, f = −K y one period after another, d periods late. What is integrated
inside the controller (ξ) is not delayed: it is the controller's own.
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
_GROWTH = 1.06  # from one period that is tried to the next
_HALVINGS = 24
_MOST = 400  # periods of delay
_EDGE = 1e-9  # a pole this near to the unit circle counts as on it
DELAYS = (0, 1, 2)

_Held = tuple[Array, Array]


@dataclass(frozen=True)
class SampledLimits:
    """What sampling and delay the loop bears.

    Attributes:
        period_s: control period [s].
        radius: largest |z| of a pole at that period with one period of delay.
        largest_period_s: by whole periods of delay 0, 1, 2: every control period up to this one [s] that was tried is
            stable (in steps of 6 %, the last halved); inf where 20 s is stable too, 0 where none is.
        delay_periods: most whole periods of delay that are borne at `period_s`, all fewer too; −1 where none is.
    """

    period_s: float
    radius: float
    largest_period_s: tuple[float, float, float]
    delay_periods: int

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
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
    """Poles z (n,) of the sampled loop, the largest first; stable where all lie inside the unit circle.

    Args:
        vehicle: the plant.
        gains: as `build_cascade`.
        cruise: U [m/s].
        period: T [s], > 0.
        delay: whole periods from measurement to thrust, at least 0.
        model: what the controller believes the vehicle to be; default the vehicle itself.

    Raises:
        InputError: as `build_cascade`, or a delay that is no whole number of at least 0.
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
    """The end of the periods T [s] for which the sampled loop is stable, from the shortest up.

    Periods grow from 1 ms by 6 % until one is unstable, and the last step is halved; inf where 20 s is stable too,
    0 where 1 ms is not. Longer ones that are stable again do not count.

    Raises:
        InputError: as `sampled_poles`.
    """
    check_delay(delay)
    undelayed = build_cascade(vehicle, gains, cruise=cruise, dt=_SHORTEST, model=model, delay=0.0)
    return _largest(undelayed, delay, partial(_held, undelayed))


def sampled_limits(undelayed: Cascade, period: float) -> SampledLimits:
    """The limits of a cascade that was built with `delay=0`; period [s] is the one it runs at.

    Of many cascades behind one axis, the worst of each.
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
    """Largest |z| of the sampled loop."""
    return float(_radius(undelayed, delay, _held(undelayed, period)))


def _radius(undelayed: Cascade, delay: int, held: _Held) -> Array:
    """Largest |z| (…,) of each sampled loop."""
    radius: Array = np.max(np.abs(np.linalg.eigvals(_transition(undelayed, delay, held))), axis=-1)
    return radius


def _largest(undelayed: Cascade, delay: int, held: Callable[[float], _Held]) -> float:
    """The least over the cascades: the first period that one of them does not bear, halved for those that do not."""
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
    """The matrix of one period, of plant, ξ and the thrusts that are on their way."""
    rest, enter, thrust = _open_transition(cascade, delay, held)
    transition: Array = rest + enter @ thrust
    return transition


def _held(cascade: Cascade, period: float | Array) -> _Held:
    """(Φ, Γ) of a period in which the inputs are held; of many cascades, a period each or one for all."""
    from scipy.linalg import expm

    n, m = cascade.B.shape[-2:]
    both = np.zeros((*cascade.B.shape[:-2], n + m, n + m))
    both[..., :n, :n], both[..., :n, n:] = cascade.A, cascade.B
    grown = expm(both * np.asarray(period)[..., None, None])
    return grown[..., :n, :n], grown[..., :n, n:]


def open_transition(cascade: Cascade, period: float, delay: int) -> tuple[Array, Array, Array]:
    """(M, E, F) of a cascade built with `delay=0`: x⁺ = M x + E f with f = F x what the law commands, closed.

    x is the plant and ξ, (n,), then for each period of delay the thrusts (4,) that are on their way, the next to act
    first. What is integrated in the controller is closed in M.
    """
    return _open_transition(cascade, delay, _held(cascade, period))


def _open_transition(cascade: Cascade, delay: int, held: _Held) -> tuple[Array, Array, Array]:
    phi, gamma = held
    many, n = phi.shape[:-2], phi.shape[-1]
    law = -cascade.K @ cascade.C
    # ξ̇ is written behind the thrusts, and comes at once
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
    """InputError for a delay that is no whole number of at least 0."""
    if not isinstance(delay, int | np.integer) or isinstance(delay, bool) or delay < 0:
        raise InputError("must be a whole number of at least 0", key="delay", value=delay, remedy="such as 1")
