"""Disk margins of all loops, poles, longest period and delay; the speed up to which corners keep a disk margin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.ir.cache import stored_numbers
from surctl.marine.vehicle import Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.linearise import can_hold
from surctl.marine.verification.corners import Corners
from surctl.marine.verification.cruise_loop import (
    POSE,
    THRUSTS,
    TRACKING_LAW,
    CruiseLoop,
    cruise_loop,
    cruise_loops,
    least_delay,
)
from surctl.system.linear_loop import eigenvalues
from surctl.verification.linear import (
    LEAST_DISK_MARGIN,
    DiskMargin,
    OpenLoop,
    screened_peaks,
    stored_disk_margin,
)
from surctl.verification.loops import LeastDelay

DISK_PLACES = ("thrust", "measurement", "both")
"""The places where all loops are opened at once: the four thrust commands, the measured x_e, y_e, z_e, ψ, or both."""

Array = NDArray[np.float64]


def open_loop(loop: CruiseLoop, place: str) -> OpenLoop:
    """Open one or several loops at `place`, one of `DISK_PLACES`; all other connections stay closed.

    Raises:
        InputError: `place` is not one of `DISK_PLACES`.
    """
    if place not in DISK_PLACES:
        raise InputError("no such place", key="place", value=place, remedy=nearest(place, DISK_PLACES))
    signals = {"thrust": THRUSTS, "measurement": POSE}.get(place, (*THRUSTS, *POSE))
    return OpenLoop.of_sampled(*loop.opened(*signals), float(np.max(loop.dt)))


@dataclass(frozen=True)
class Pole:
    """One pole z of the sampled loop as s = ln(z)/dt; a complex pair is represented by the pole with imaginary > 0.

    Attributes:
        real, imaginary: real and imaginary part of s [rad/s].
        natural_rad_s: natural frequency |s| [rad/s].
        damping: damping ratio −real/|s|.
    """

    real: float
    imaginary: float
    natural_rad_s: float
    damping: float


# The control periods and the delays up to which the loop is stable

_SHORTEST, _LONGEST = 1e-3, 20.0  # [s]
_GROWTH = 1.06  # ratio of a tried period to the previous period
_BISECTIONS = 24
_MOST = 400  # largest delay that is tried, in periods
_ON_CIRCLE = 1e-9  # a pole this close to the unit circle counts as lying on the circle
_DELAYS = (0, 1, 2)


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


def sampled_limits(loop: CruiseLoop) -> SampledLimits:
    """Return the sampling limits of a loop.

    If it has a leading axis with several loops, each limit is the worst over these loops, and the result is cached on
    disk: for the corners of a vehicle's ranges it takes seconds.
    """
    if loop.transition.ndim == 2:
        return _sampled_limits(loop)
    matrices = [np.asarray(matrix, dtype=float) for matrix in (*loop.plant, *loop.law)]
    values = stored_numbers(
        ("surctl.marine.verification.linear.side", "surctl.marine.verification.cruise_loop"),
        (loop.dt, loop.states(), *((matrix.shape, matrix.tobytes()) for matrix in matrices)),
        lambda: asdict(_sampled_limits(loop)),
        suffix=".sampled",
    )
    return SampledLimits(**{**values, "largest_period_s": tuple(values["largest_period_s"])})


def _sampled_limits(loop: CruiseLoop) -> SampledLimits:
    period, borne = float(np.max(loop.dt)), -1
    for delay in range(_MOST + 1):
        if np.max(_radius(loop.resampled(period, delay))) >= 1 - _ON_CIRCLE:
            break
        borne = delay
    one, two, three = (_largest(loop, delay) for delay in _DELAYS)
    return SampledLimits(period, float(np.max(_radius(loop.resampled(period)))), (one, two, three), borne)


def _radius(loop: CruiseLoop) -> Array:
    closed = loop.transition
    poles = np.linalg.eigvals(closed) if closed.ndim == 2 else eigenvalues(closed)
    return np.asarray(np.abs(poles).max(axis=-1))


def _largest(loop: CruiseLoop, delay: int) -> float:
    """Return the largest period up to which all loops are stable; bisection refines the first unstable step."""
    good, bad = 0.0, _SHORTEST
    while True:
        lost = _radius(loop.resampled(bad, delay)) >= 1 - _ON_CIRCLE * bad
        if np.any(lost):
            break
        good, bad = bad, bad * _GROWTH
        if good >= _LONGEST:
            return float("inf")
    if good == 0.0:
        return 0.0
    first = loop if lost.ndim == 0 else loop[lost]
    low, high = (np.full(first.transition.shape[:-2], end) for end in (good, bad))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        stable = _radius(first.resampled(middle, delay)) < 1 - _ON_CIRCLE * middle
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return float(np.min(low))


@dataclass(frozen=True)
class LinearSide:
    """Results of the linear analysis about straight cruise: disk margins of all loops, poles, and sampling limits.

    Attributes:
        of: description of the analysed vehicles: the nominal vehicle, or the worst of several corners of its parameter
            ranges.
        disks: disk margins with the loops opened at `DISK_PLACES`; for several corners, the least margin over the
            corners.
        poles: closed-loop poles of the nominal vehicle, slowest first, including those of the delay.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        least_damping: least damping ratio of the poles, over all corners.
        delay: least delay margin of one loop alone, over all corners.
        sampled: limits of the sampled loop; for several corners, the least value of every limit and the largest radius.
        corner: for several corners, the parameters of the worst corner as text. The worst corner has the least disk
            margin or, if the loop is unstable, the fastest growing pole.
        at: the vehicle of that corner; None for the nominal vehicle alone.
    """

    of: str
    disks: tuple[DiskMargin, ...]
    poles: tuple[Pole, ...]
    slowest_per_s: float
    least_damping: float
    delay: LeastDelay
    sampled: SampledLimits
    corner: str = ""
    at: Vehicle | None = None

    @property
    def disk(self) -> float:
        """The disk margin: all loops at once, the lesser of commands and measurements; 0 if unstable, NaN if unknown.

        For a margin at both places together, see the last of `disks`.
        """
        return float(np.min([d.guaranteed for d in self.disks[:2]])) if self.stable else 0.0

    @property
    def stable(self) -> bool:
        """Whether the sampled loop, with one period of delay, is stable for all vehicles."""
        return all(d.stable for d in self.disks) and self.sampled.radius < 1

    def to_dict(self) -> dict[str, Any]:
        """The analysis as plain data for JSON; infinite periods stay inf."""
        return {
            "of": self.of,
            "stable": self.stable,
            "disk_margin": self.disk,
            "disk_margins": [d.to_dict() for d in self.disks],
            "poles": [vars(p) for p in self.poles],
            "slowest_per_s": self.slowest_per_s,
            "least_damping": self.least_damping,
            "delay_margin": self.delay._asdict(),
            "sampled": self.sampled.to_dict(),
            "corner": self.corner,
        }

    def lines(self) -> list[str]:
        """The analysis as lines of text."""
        if not self.stable:
            where = f" at the corner {self.corner}: pole {self.slowest_per_s:.3g} 1/s" if self.corner else ""
            return [f"linear loop of {self.of}: UNSTABLE{where}"]
        disks = ", ".join(f"{_number(d.guaranteed)} ({d.place})" for d in self.disks)
        none, one, two = (_seconds(t) for t in self.sampled.largest_period_s)
        return [
            f"linear loop of {self.of}:",
            f"  disk margin {_number(self.disk)}; all loops at once: {disks}; slowest pole {self.slowest_per_s:.3g} "
            f"1/s, least damping {self.least_damping:.2f}",
            *([f"  least disk margin at the corner {self.corner}"] if self.corner else []),
            f"  least delay margin of one loop alone: {self.delay.delay_s:.2f} s ({self.delay.where})",
            f"  sampled: stable up to a control period of {none} without delay, {one} with one period of delay, {two} "
            f"with two; at a period of {self.sampled.period_s:g} s stable with up to {self.sampled.delay_periods} "
            "periods of delay",
        ]


def linear_side(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> LinearSide:
    """Return the linear analysis of one vehicle; for the arguments see `loop_margins`.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.
    """
    loop = cruise_loop(vehicle, gains, cruise=cruise, dt=dt, model=model, law=law)
    return replace(
        _side(f"{vehicle.name}, nominal", Corners((vehicle,), "", ("nominal",)), [[vehicle]], [loop[None]]), at=None
    )


def worst_linear_side(
    tried: Corners,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> LinearSide:
    """Return the linear analysis with the worst results over several vehicles; `model` defaults to the first vehicle.

    A coarse grid of frequencies selects the vehicle with the least disk margin. Vehicles that cannot hold the cruise
    speed have no straight cruise to linearise about; they are omitted, and `of` states their number.

    Raises:
        InputError: `linear_side` rejects its arguments, or none of the vehicles can hold the cruise speed.
    """
    believed = model or tried.vehicles[0]
    groups, built = corner_loops(tried.vehicles, gains, cruise=cruise, dt=dt, model=believed, law=law)
    unable = len(tried.vehicles) - sum(len(group) for group in groups)
    if not groups:
        raise InputError(
            "needs more thrust than any of the vehicles has", key="cruise", value=cruise, remedy="lower it"
        )
    beyond = f"; {unable} of them cannot hold {cruise:g} m/s with their thrust" if unable else ""
    return _side(f"{believed.name}, worst of {tried.text}{beyond}", tried, groups, built)


def _side(of: str, tried: Corners, groups: Sequence[Sequence[Vehicle]], built: Sequence[CruiseLoop]) -> LinearSide:
    # the worst of several loops, in groups
    weak = [weakest(built, place) for place in DISK_PLACES]
    disks = [stored_disk_margin(loop, place) for (loop, _), place in zip(weak, DISK_PLACES, strict=True)]
    slowest = [group.rates[:, 0].real for group in built]
    fastest, at = largest(slowest)
    if slowest[fastest][at] < 0:
        _, (fastest, at) = weak[int(np.argmin([d.guaranteed for d in disks[:2]]))]
    bad = groups[fastest][at]
    every = [_poles(each) for group in built for each in group.rates]
    delay, loop, (group, place) = least_delay(built)
    return LinearSide(
        of=of,
        disks=tuple(disks),
        poles=every[0],
        slowest_per_s=max(float(each.max()) for each in slowest),
        least_damping=min(p.damping for each in every for p in each),
        delay=LeastDelay(delay, loop, tried.label(groups[group][place])),
        sampled=_least_sampled([sampled_limits(group) for group in built]),
        corner=tried.label(bad) if len(tried.vehicles) > 1 else "",
        at=bad,
    )


def corner_loops(
    vehicles: Sequence[Vehicle], gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle, law: str
) -> tuple[list[list[Vehicle]], list[CruiseLoop]]:
    """Return the vehicles whose thrust can hold the cruise speed [m/s], and their loops, in groups with equal states.

    There is a group with and one without thrust lag; that of the first vehicle comes first.
    """
    nu = np.tile([[cruise], [0.0], [0.0], [0.0]], len(vehicles))
    tau = np.asarray(trim_function(vehicles[0].form)(nu, np.array([plant_parameters(v) for v in vehicles]).T)).T
    able = [v for t, v in zip(tau, vehicles, strict=True) if can_hold(t, *v.thrust_range)]
    lags = dict.fromkeys(v["thrust_lag"] > 0 for v in able)
    groups = [[v for v in able if (v["thrust_lag"] > 0) is lagged] for lagged in lags]
    return groups, [cruise_loops(group, gains, cruise=cruise, dt=dt, model=model, law=law) for group in groups]


def largest(values: Sequence[Array]) -> tuple[int, int]:
    """Return the place of the largest value: the group, and the index in it."""
    group = int(np.argmax([each.max() for each in values]))
    return group, int(np.argmax(values[group]))


def weakest(groups: Sequence[CruiseLoop], place: str) -> tuple[OpenLoop, tuple[int, int]]:
    """Return the loop with the least disk margin on a coarse grid, opened at a place, and where it is (`largest`)."""
    loops = [open_loop(group, place) for group in groups]
    group, at = largest([screened_peaks(loop) for loop in loops])
    return loops[group][np.asarray(at)], (group, at)


def _least_sampled(limits: Sequence[SampledLimits]) -> SampledLimits:
    one, two, three = (min(s.largest_period_s[k] for s in limits) for k in range(3))
    return SampledLimits(
        limits[0].period_s, max(s.radius for s in limits), (one, two, three), min(s.delay_periods for s in limits)
    )


def _poles(poles: NDArray[np.complex128]) -> tuple[Pole, ...]:
    # one pole of each complex pair
    return tuple(
        Pole(float(s.real), float(s.imag), float(abs(s)), float(-s.real / abs(s)) if s != 0 else 1.0)
        for s in poles
        if s.imag >= 0
    )


def _number(margin: float) -> str:
    return "not determined" if np.isnan(margin) else f"{margin:.2f}"


def _seconds(period: float) -> str:
    return f"{period:.2f} s" if np.isfinite(period) else "at least 20 s"


_STEPS, _HALVINGS = 12, 6


def margin_speed(
    tried: Corners,
    gains: Mapping[str, float],
    *,
    dt: float,
    highest: float,
    least: float = LEAST_DISK_MARGIN,
    law: str = TRACKING_LAW,
) -> float:
    """Return the largest cruise speed [m/s] up to which every vehicle keeps a disk margin of all loops; 0 if none.

    All loops are opened at the thrust commands or at the measurements. The margins are estimated on a coarse grid of
    frequencies. The search over the speeds goes in steps of a twelfth of the range, followed by bisection. The search
    uses only the vehicles that are worst at the last result; all vehicles are compared at the new result.

    Args:
        tried: the vehicles; the law's model is the first one.
        gains: the gains by name, as in `loop_margins`.
        dt: control period [s].
        highest: largest speed that is tried [m/s].
        least: required disk margin, in (0, 2]; 0 requires stability alone.
        law: a law that tracks, as in `loop_margins`.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import corners, margin_speed
        >>> tried, gains = corners(load_vehicle("bluerov2-wu")), load_gains("default").values
        >>> [round(margin_speed(tried, gains, dt=0.05, highest=0.5, least=least), 2) for least in (0.0, 0.3)]
        [0.2, 0.17]
    """
    peaks = partial(_peaks, gains=gains, dt=dt, model=tried.vehicles[0], least=least, law=law)
    level, speed, searched = 1 / least if least > 0 else 0.0, highest, list[int]()
    while speed > 0:
        reached = peaks(tried.vehicles, [speed])[:, 0]
        worst = int(np.argmax(reached))
        if reached[worst] <= level or worst in searched:
            return speed
        searched.append(worst)
        speed = _search(partial(peaks, [tried.vehicles[worst]]), speed, level)
    return 0.0


def _search(peaks: Callable[[Sequence[float]], Array], highest: float, level: float) -> float:
    speeds = np.linspace(0.0, highest, _STEPS + 1)
    good = peaks(speeds[1:].tolist())[0] <= level
    if good.all():
        return highest
    first = int(np.argmin(good))
    low, high = float(speeds[first]), float(speeds[first + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if peaks([middle])[0, 0] <= level else (low, middle)
    return low


def _peaks(
    vehicles: Sequence[Vehicle],
    speeds: Sequence[float],
    *,
    gains: Mapping[str, float],
    dt: float,
    model: Vehicle,
    least: float,
    law: str,
) -> Array:
    """Return the peak (n, k) of the structured singular value over frequency for n vehicles at k speeds.

    The value is inf if the vehicle cannot hold the speed. If `least` is 0, the value is the real part of the slowest
    pole instead.
    """
    peaks = np.full((len(vehicles), len(speeds)), np.inf)
    for k, speed in enumerate(speeds):
        for group, loops in zip(*corner_loops(vehicles, gains, cruise=speed, dt=dt, model=model, law=law), strict=True):
            if least > 0:
                values = np.max([screened_peaks(open_loop(loops, place)) for place in DISK_PLACES[:2]], axis=0)
            else:
                values = loops.rates[:, 0].real + 1e-9
            for vehicle, value in zip(group, values.tolist(), strict=True):
                peaks[next(i for i, one in enumerate(vehicles) if one is vehicle), k] = value
    return peaks
