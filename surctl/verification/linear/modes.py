"""The slowest mode of the linear loop: which states make it, which physical term, which gain or speed changes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.vehicle import Vehicle, plant_parameters
from surctl.vehicle.linearise import STATE_NAMES
from surctl.verification.cascade import CASCADE_GAINS, Cascade, build_cascade, build_cascades

__all__ = ["Mode", "bearable_speed", "slowest_mode"]

Array = NDArray[np.float64]

_SPEEDS, _ROUNDS = 60, 3  # of the search for the bearable speed; each round divides the interval
_HIGHEST = 10.0  # [m/s] beyond it no speed is looked at
_FACTORS = np.array([1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0])  # by which a gain is changed
_NAMED = 0.1  # least participation that is named
_COUNTED = 1e-3  # least participation that is kept
_EDGE = 1e-9
_BROUGHT = 0.02  # least share of |s| by which a term must move a pole to be named

_SURGE, _SWAY, _YAW = (STATE_NAMES.index(name) for name in ("u", "v", "r"))


@dataclass(frozen=True)
class Mode:
    """The slowest pole of the closed loop with its delay, or the one that grows fastest.

    Attributes:
        cruise: U [m/s] that the loop is linearised about.
        real, imaginary: of the pole [rad/s]; of a pair, the one above.
        participation: share of each state in the mode, largest first, those above 0.001; the delay's states together,
            as those of the integral action.
        without: real part of the slowest pole [1/s] without one physical term, by the term's name.
        remedies: the value of each gain, the nearest one tried, at which the loop is stable; empty where it is stable.
        bearable: largest U [m/s] up to which the loop is stable, see `bearable_speed`.
    """

    cruise: float
    real: float
    imaginary: float
    participation: Mapping[str, float]
    without: Mapping[str, float]
    remedies: Mapping[str, float]
    bearable: float

    @property
    def stable(self) -> bool:
        """Whether it decays."""
        return self.real < -_EDGE

    @property
    def cause(self) -> str | None:
        """The physical term without which the slowest pole lies farthest to the left; None where none counts."""
        if not self.without:
            return None
        term = min(self.without, key=lambda name: self.without[name])
        moved = self.real - self.without[term]
        return term if moved > _BROUGHT * float(np.hypot(self.real, self.imaginary)) else None

    def lines(self) -> list[str]:
        """The mode in words, and for an unstable loop what makes it stable."""
        pole = f"{self.real:.3g}" + (f" ± {self.imaginary:.3g}j" if self.imaginary else "")
        states = ", ".join(f"{name} {share:.0%}" for name, share in self.participation.items() if share >= _NAMED)
        head = f"slowest mode at {self.cruise:g} m/s: pole {pole} 1/s, made by {states}"
        if not self.stable:
            head = f"UNSTABLE at {self.cruise:g} m/s: pole {pole} 1/s, made by {states}"
        lines = [head]
        if self.cause is not None:
            alone = self.without[self.cause]
            how = "slowed" if self.stable else "caused"
            lines.append(f"  {how} by the {self.cause}: without it the slowest pole is {alone:.3g} 1/s")
        if not self.stable:
            lines.append(f"  stable {self.remedy}")
        lines.append(f"  bearable speed: the linear loop is stable up to {self.bearable:.3g} m/s")
        return lines

    @property
    def remedy(self) -> str:
        """What makes an unstable loop stable: "with k_r = 4.5 (one gain changed, …), or at 0.2 m/s or less"."""
        slower = f"at {self.bearable:.3g} m/s or less" if self.bearable > 0 else "at no speed with these gains"
        if not self.remedies:
            return f"{slower}; no single gain changed by up to a factor of {_FACTORS[-1]:g} makes it so"
        gains = ", or ".join(f"{name} = {value:.3g}" for name, value in self.remedies.items())
        return f"with {gains} (one gain changed, the others kept), or {slower}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "cruise_m_per_s": self.cruise,
            "stable": self.stable,
            "real": self.real,
            "imaginary": self.imaginary,
            "participation": dict(self.participation),
            "without": dict(self.without),
            "cause": self.cause,
            "remedies": dict(self.remedies),
            "bearable_m_per_s": self.bearable,
        }


def slowest_mode(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> Mode:
    """The mode of the slowest pole; the arguments of `loop_margins`.

    Participation of state k in mode i is |w_ki v_ki| of its left and right eigenvector, as a share of the sum
    (Pérez-Arriaga, Verghese and Schweppe 1982).

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification.linear import slowest_mode
        >>> mode = slowest_mode(load_vehicle("bluerov2-wu"), load_gains("default").values, cruise=0.47, dt=0.05)
        >>> mode.stable, mode.cause, next(iter(mode.participation))
        (False, 'Munk moment (m22 - m11) u v', 'v')
    """
    from scipy.linalg import eig

    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model)
    values, left, right = eig(cascade.closed, left=True, right=True)
    at = int(np.lexsort((-values.imag, -values.real))[0])
    share = np.abs(left[:, at] * right[:, at])
    grouped: dict[str, float] = {}
    for name, part in zip(_names(cascade, vehicle, gains), share / share.sum(), strict=True):
        grouped[name] = grouped.get(name, 0.0) + float(part)
    real = float(values[at].real)
    return Mode(
        cruise,
        real,
        float(abs(values[at].imag)),
        {k: v for k, v in sorted(grouped.items(), key=lambda item: -item[1]) if v >= _COUNTED},
        _without(cascade, vehicle, gains, cruise=cruise, dt=dt, model=model or vehicle),
        {} if real < -_EDGE else _remedies(vehicle, gains, cruise=cruise, dt=dt, model=model or vehicle),
        bearable_speed(vehicle, gains, dt=dt, model=model),
    )


def bearable_speed(vehicle: Vehicle, gains: Mapping[str, float], *, dt: float, model: Vehicle | None = None) -> float:
    """Largest cruise speed [m/s] up to which the linear loop is stable and the thrust holds it; 0 where there is none.

    Speeds are looked at in 60 steps up to what the thrust holds (10 m/s at most), and the step in which the loop is
    lost is divided further: the first loss counts, whatever comes beyond.

    Raises:
        InputError: a gain is missing or not positive.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification.linear import bearable_speed
        >>> gains = load_gains("default").values
        >>> [round(bearable_speed(load_vehicle(name), gains, dt=0.05), 2) for name in ("sur400", "bluerov2-wu")]
        [0.38, 0.2]
    """
    low, high = 0.0, min(_fastest(vehicle), _HIGHEST)
    for _ in range(_ROUNDS):
        speeds = np.linspace(low, high, _SPEEDS + 1)[1:]
        lost = np.flatnonzero(~_stable(vehicle, gains, speeds, dt=dt, model=model or vehicle))
        if not lost.size:
            return float(high)
        low, high = float(speeds[lost[0] - 1]) if lost[0] else low, float(speeds[lost[0]])
    return low


def _fastest(vehicle: Vehicle) -> float:
    """Surge speed [m/s] at which the drag is the thrust limit, a little less."""
    linear, quadratic, limit = vehicle["Xu"], vehicle["Xuu"], vehicle["Fu_max"]
    root = linear + np.sqrt(linear**2 + 4 * quadratic * limit)
    return float(2 * limit / root * (1 - _EDGE)) if root > 0 else np.inf


def _stable(
    vehicle: Vehicle, gains: Mapping[str, float], speeds: Array, *, dt: float, model: Vehicle
) -> NDArray[np.bool_]:
    count = len(speeds)
    many = build_cascades(
        np.tile(plant_parameters(vehicle), (count, 1)),
        {name: np.full(count, float(value)) for name, value in gains.items()},
        cruise=speeds,
        dt=dt,
        model=np.tile(plant_parameters(model), (count, 1)),
    )
    stable: NDArray[np.bool_] = many.poles[:, 0].real < -_EDGE
    return stable


def _names(cascade: Cascade, vehicle: Vehicle, gains: Mapping[str, float]) -> list[str]:
    plant = STATE_NAMES[: 12 if vehicle["thrust_lag"] > 0 else 8]
    integral = 4 if gains.get("k_i", 0.0) > 0 else 0
    delay = len(cascade.A) - len(plant) - integral
    return [*plant, *["delay"] * delay, *["integral"] * integral]


def _without(
    cascade: Cascade, vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle
) -> dict[str, float]:
    """Real part of the slowest pole without each term."""
    closed, slowest = cascade.closed, {}
    munk, coriolis = closed.copy(), closed.copy()
    munk[_YAW, [_SURGE, _SWAY]] -= cascade.A[_YAW, [_SURGE, _SWAY]]
    coriolis[[_SURGE, _SWAY], _YAW] -= cascade.A[[_SURGE, _SWAY], _YAW]
    slowest["Munk moment (m22 - m11) u v"] = _slowest(munk)
    slowest["Coriolis force m11 u r"] = _slowest(coriolis)
    slowest["loop delay"] = _slowest(build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=0.0).closed)
    if vehicle["thrust_lag"] > 0:
        instant = vehicle.with_values({"thrust_lag": 0.0})
        slowest["thrust lag"] = _slowest(build_cascade(instant, gains, cruise=cruise, dt=dt, model=model).closed)
    return slowest


def _slowest(closed: Array) -> float:
    return float(np.linalg.eigvals(closed).real.max())


def _remedies(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle
) -> dict[str, float]:
    """Of each gain the value nearest to its own, of those tried, at which the loop is stable."""
    factors = np.concatenate([_FACTORS, 1 / _FACTORS])
    names = np.repeat(CASCADE_GAINS, len(factors))
    tried = np.tile(factors, len(CASCADE_GAINS))
    count = len(tried)
    many = build_cascades(
        np.tile(plant_parameters(vehicle), (count, 1)),
        {name: np.where(names == name, value * tried, value) for name, value in gains.items()},
        cruise=np.full(count, cruise),
        dt=dt,
        model=np.tile(plant_parameters(model), (count, 1)),
    )
    good = many.poles[:, 0].real < -_EDGE
    remedies: dict[str, tuple[float, float]] = {}
    for name, factor in zip(names[good].tolist(), tried[good].tolist(), strict=True):
        far = abs(float(np.log(factor)))
        if name not in remedies or far < remedies[name][0]:
            remedies[name] = far, gains[name] * factor
    return {name: value for name, (_, value) in sorted(remedies.items(), key=lambda item: item[1][0])}
