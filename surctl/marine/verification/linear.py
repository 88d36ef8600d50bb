"""The linear loop of a mission's vehicle about its cruise: the slowest mode, and the speeds it bears."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control.gains import setting
from surctl.marine.vehicle import Vehicle, steady_speed
from surctl.marine.verification.corners import NOMINAL, Corners
from surctl.marine.verification.cruise_loop import (
    LINEAR_GAINS,
    TRACKING_LAW,
    CruisePoint,
    cruise_groups,
    cruise_loop,
    each_loop,
)
from surctl.system import LinearLoop
from surctl.verification.linear import screened_peaks
from surctl.verification.sampled_margins import open_loop

Array = NDArray[np.float64]


_HIGHEST = 10.0  # [m/s] largest speed that is tried
_SPEEDS, _ROUNDS = 30, 3  # speeds and rounds of the search for a speed; each round divides the interval


def bearable_speed(
    tried: Corners,
    gains: Mapping[str, float],
    *,
    dt: float,
    least: float = 0.0,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> float:
    """Return the largest cruise speed [m/s] up to which every vehicle holds it and its loop is stable; 0 if none.

    The search divides the range up to the largest speed that the thrust can hold (10 m/s at most) into 30 steps, and
    refines the first step in which a loop is lost. Higher speeds at which it is good again are ignored. The search uses
    only the vehicles that are worst at the last result; all vehicles are compared at the new result.

    Args:
        tried: the vehicles.
        gains: the gains by name, as for `cruise_loop`.
        dt: control period [s].
        least: disk margin of all loops that is required too, in (0, 2], estimated on a coarse grid; 0: stability alone.
        model: the controller's model; default the first vehicle.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: a gain is missing or not positive.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.corners import corners
        >>> from surctl.marine.verification.linear import bearable_speed
        >>> tried, gains = corners(load_vehicle("bluerov2-wu")), load_gains("default").values
        >>> [round(bearable_speed(tried, gains, dt=0.05, least=least), 2) for least in (0.0, 0.3)]
        [0.2, 0.17]
    """
    vehicles, believed = tried.vehicles, model or tried.vehicles[0]

    def lacking(plants: Sequence[Vehicle], speeds: Iterable[float]) -> Array:
        points = [CruisePoint(plant, believed, gains, speed) for plant, speed in zip(plants, speeds, strict=False)]
        return _lacking(points, dt=dt, law=law, least=least)

    speed, searched = min(min(map(_fastest, vehicles)), _HIGHEST), list[int]()
    while speed > 0:
        ill = lacking(vehicles, repeat(speed))
        worst = int(np.argmax(ill))
        if ill[worst] <= 0 or worst in searched:
            return speed
        searched.append(worst)
        low, high = 0.0, speed
        for _ in range(_ROUNDS):
            speeds = np.linspace(low, high, _SPEEDS + 1)[1:]
            lost = np.flatnonzero(lacking([vehicles[worst]] * _SPEEDS, speeds.tolist()) > 0)
            first = int(lost[0]) if lost.size else _SPEEDS - 1  # the end itself is lost
            low, high = float(speeds[first - 1]) if first else low, float(speeds[first])
        speed = low
    return 0.0


def _lacking(points: Sequence[CruisePoint], *, dt: float, law: str, least: float) -> Array:
    """Return what each point lacks, (n,), greater than 0 if it lacks something; inf without a loop.

    It is the real part of the slowest pole, or how far the structured singular value exceeds that of the margin.
    """
    lacking = np.full(len(points), np.inf)
    for at, loops in cruise_groups(points, dt=dt, law=law):
        lacking[at] = np.where(loops.decays, -1.0, 1.0) * np.abs(loops.slowest_per_s)
        if least > 0:
            peaks = [screened_peaks(open_loop(loops, *signals)) for signals in loops.places.values()]
            lacking[at] = np.max(peaks, axis=0) - 1 / least
    return lacking


def cap_above(vehicle: Vehicle, bearable: float, *, cap: float) -> str | None:
    """Return a line of text if the linear loop becomes unstable below the speed cap `cap` [m/s]; otherwise None.

    `bearable` is the speed [m/s] up to which the loop is stable (`bearable_speed`). The result is also None if the loop
    is stable at all speeds that the thrust can hold, even if the cap is higher.

    Example:
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import cap_above
        >>> cap_above(load_vehicle("bluerov2-wu"), 0.2, cap=0.47)
        'the cap of 0.47 m/s is above the bearable speed of 0.2 m/s, up to which the linear loop ... is stable'
    """
    if bearable >= min(cap, _fastest(vehicle), _HIGHEST):
        return None
    if bearable == 0:
        return f"the linear loop of {vehicle.name} is unstable at every speed with these gains, so no cap helps"
    stable = f"up to which the linear loop of {vehicle.name} is stable"
    return f"the cap of {cap:g} m/s is above the bearable speed of {bearable:.3g} m/s, {stable}"


def _fastest(vehicle: Vehicle) -> float:
    # slightly below the speed [m/s] at which the drag equals the thrust limit
    return steady_speed(vehicle["Fu_max"], vehicle["Xu"], vehicle["Xuu"]) * (1 - _EDGE)


_FACTORS = np.array([1.1, 1.25, 1.5, 2.0, 3.0, 5.0, 10.0])  # factors by which a gain is changed
_NAMED = 0.1  # least participation of a state that is printed
_COUNTED = 1e-3  # least participation of a state that is stored
_EDGE = 1e-9
_BROUGHT = 0.02  # a term is named as the cause if it moves the pole by more than this share of |s|
_AT_ONCE = 1e-2  # share of the control period: held for so short a time, a thrust is not delayed


@dataclass(frozen=True)
class Mode:
    """The mode of the slowest pole of the sampled loop; for an unstable loop, of the fastest growing pole.

    Attributes:
        cruise: cruise speed U [m/s] about which the loop is linearised.
        real, imaginary: real and imaginary part of the pole [rad/s]; of a complex pair, the pole in the upper
            half-plane.
        participation: participation factor of each state in the mode, largest first; values below 0.001 are omitted.
            All waiting thrusts together are the entry `delay`; each state of the law has an entry.
        without: mapping from the name of a physical term to the real part [1/s] that the slowest pole has without this
            term.
        remedies: mapping from the name of a gain to the value, among those tried, that is nearest to the present value
            and stabilises the loop; empty if the loop is stable.
        bearable: largest cruise speed [m/s] up to which the loop is stable; see `bearable_speed`.
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
        """Whether the mode decays."""
        return self.real < -_EDGE

    @property
    def loop(self) -> str:
        """The loop with the largest participation: surge (x, u), sway (y, v), heave (z, w) or yaw (psi, r)."""
        share = {
            loop: sum(self.participation.get(name, 0.0) for name in names)
            for loop, names in (
                ("surge", ("x", "u", "Fu")), ("sway", ("y", "v", "Fv")),
                ("heave", ("z", "w", "Fw")), ("yaw", ("psi", "r", "Fr")),
            )
        }  # fmt: skip
        return max(share, key=lambda loop: share[loop])

    @property
    def cause(self) -> str | None:
        """The physical term whose omission moves the slowest pole farthest to the left; None if no term matters."""
        if not self.without:
            return None
        term = min(self.without, key=lambda name: self.without[name])
        moved = self.real - self.without[term]
        return term if moved > _BROUGHT * float(np.hypot(self.real, self.imaginary)) else None

    def lines(self) -> list[str]:
        """Describe the mode in lines of text; for an unstable loop, also the changes that stabilise it."""
        pole = f"{self.real:.3g}" + (f" ± {self.imaginary:.3g}j" if self.imaginary else "")
        states = ", ".join(f"{name} {share:.0%}" for name, share in self.participation.items() if share >= _NAMED)
        head = f"slowest mode at {self.cruise:g} m/s: pole {pole} 1/s, dominant states {states}"
        if not self.stable:
            head = f"UNSTABLE at {self.cruise:g} m/s: pole {pole} 1/s, dominant states {states}"
        lines = [head]
        if self.cause is not None:
            alone = self.without[self.cause]
            how = "slowed" if self.stable else "caused"
            lines.append(f"  {how} by the {self.cause}: without it the slowest pole is {alone:.3g} 1/s")
        if not self.stable:
            lines.append(f"  stable {self.remedy}")
        lines.append(
            f"  bearable speed: the linear loop is stable up to {self.bearable:.3g} m/s (stability limit, no margin)"
        )
        return lines

    def remedy_lines(self) -> list[str]:
        """Describe the unstable loop of a corner vehicle: loop, pole, states, remedy and largest stable speed."""
        return [f"  loop {self.loop}; {self.lines()[0]}", *self.lines()[1:]]

    @property
    def remedy(self) -> str:
        """Return a text that names the changes that stabilise an unstable loop.

        An example is 'with k_r = "4.5 1/s" (one gain changed, …), or at 0.2 m/s'.
        """
        slower = f"at {self.bearable:.3g} m/s or less" if self.bearable > 0 else "at no speed with these gains"
        if not self.remedies:
            return f"{slower}; changing a single gain by up to a factor of {_FACTORS[-1]:g} does not stabilise it"
        gains = ", or ".join(setting(name, value) for name, value in self.remedies.items())
        return f"with {gains} (one gain changed, the others unchanged), or {slower}"

    def to_dict(self) -> dict[str, Any]:
        """The mode as plain data for JSON."""
        return {
            "cruise_m_per_s": self.cruise,
            "stable": self.stable,
            "real": self.real,
            "imaginary": self.imaginary,
            "participation": dict(self.participation),
            "loop": self.loop,
            "without": dict(self.without),
            "cause": self.cause,
            "remedies": dict(self.remedies),
            "bearable_m_per_s": self.bearable,
        }


def slowest_mode(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> Mode:
    """Return the mode of the slowest pole; for the arguments see `cruise_loop`.

    The participation of state k in mode i is |w_ki v_ki|, the product of the entries of the left and the right
    eigenvector, divided by the sum of these products over all k (Pérez-Arriaga, Verghese and Schweppe 1982).

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import slowest_mode
        >>> mode = slowest_mode(load_vehicle("bluerov2-wu"), load_gains("default").values, cruise=0.47, dt=0.05)
        >>> mode.stable, mode.cause, next(iter(mode.participation))
        (False, 'Munk moment (m22 - m11) u v', 'v')
    """
    from scipy.linalg import eig

    loop = cruise_loop(vehicle, gains, cruise=cruise, dt=dt, model=model, law=law)
    point = CruisePoint(vehicle, model or vehicle, gains, cruise)
    z, left, right = eig(loop.transition, left=True, right=True)
    at = int(np.lexsort((-z.imag, -np.abs(z)))[0])
    share = np.abs(left[:, at] * right[:, at])
    grouped: dict[str, float] = {}
    names = (*loop.names.states, *loop.names.controller_states)
    for name, part in zip(names, share / share.sum(), strict=True):
        whole = "delay" if name.startswith("late_") else name.partition("[")[0]
        grouped[whole] = grouped.get(whole, 0.0) + float(part)
    pole = np.log(complex(z[at])) / dt
    real = float(pole.real)
    return Mode(
        cruise,
        real,
        float(abs(pole.imag)),
        {k: v for k, v in sorted(grouped.items(), key=lambda item: -item[1]) if v >= _COUNTED},
        _without(loop, point, law),
        {} if real < -_EDGE else _remedies(point, dt, law),
        bearable_speed(Corners((vehicle,), "", (NOMINAL,)), gains, dt=dt, model=model, law=law),
    )


def _without(loop: LinearLoop, point: CruisePoint, law: str) -> dict[str, float]:
    """Return, for each physical term, the real part [1/s] of the slowest pole of the loop without this term."""
    A, *inputs = loop.plant
    surge, sway, yaw = (loop.names.states.index(name) for name in ("u", "v", "r"))
    munk, coriolis, vehicle = A.copy(), A.copy(), point.plant
    munk[yaw, [surge, sway]] = 0.0
    coriolis[[surge, sway], yaw] = 0.0
    coupled = bool(vehicle.form.terms)  # the slopes then include coupled inertia and drag
    without = {
        "yaw moment by surge and sway" if coupled else "Munk moment (m22 - m11) u v": replace(
            loop, plant=(munk, *inputs)
        ),
        "surge and sway force by yaw" if coupled else "Coriolis force m11 u r": replace(
            loop, plant=(coriolis, *inputs)
        ),
        "loop delay": each_loop([point], dt=_AT_ONCE * loop.dt, law=law)[0],
    }
    if vehicle["thrust_lag"] > 0:
        prompt = point._replace(plant=vehicle.with_values({"thrust_lag": 0.0}))
        without["thrust lag"] = each_loop([prompt], dt=loop.dt, law=law)[0]
    return {name: float(one.slowest_per_s) for name, one in without.items() if one is not None}


def _remedies(point: CruisePoint, dt: float, law: str) -> dict[str, float]:
    """For each gain, return the tried value nearest to the present value that makes the loop stable."""
    factors = np.concatenate([_FACTORS, 1 / _FACTORS])
    names, gains = np.repeat(LINEAR_GAINS, len(factors)), point.gains
    # with the digits that are printed
    tried = np.array([float(f"{gains[name] * factor:.3g}") for name in LINEAR_GAINS for factor in factors])
    changed = [{**gains, name: value} for name, value in zip(names.tolist(), tried.tolist(), strict=True)]
    good = np.zeros(len(tried), dtype=bool)
    for at, loops in cruise_groups([point._replace(gains=one) for one in changed], dt=dt, law=law):
        good[at] = loops.decays
    remedies: dict[str, tuple[float, float]] = {}
    for name, value in zip(names[good].tolist(), tried[good].tolist(), strict=True):
        far = abs(float(np.log(value / gains[name])))
        if name not in remedies or far < remedies[name][0]:
            remedies[name] = far, value
    return {name: value for name, (_, value) in sorted(remedies.items(), key=lambda item: item[1][0])}
