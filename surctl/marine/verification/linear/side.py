"""The linear part of a verification; reports, tables and JSON show its results beside those of the nonlinear claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.vehicle import Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.linearise import can_hold
from surctl.marine.verification.cascade import Cascade, build_cascade, build_cascades
from surctl.marine.verification.linear.corners import Corners, corners
from surctl.marine.verification.linear.sampled import SampledLimits, radii_of, sampled_limits
from surctl.verification.linear import (
    LEAST_DISK_MARGIN,
    DiskMargin,
    OpenLoop,
    quick_disk_margin,
    screened_peaks,
    stored_disk_margin,
)

__all__ = [
    "DISK_PLACES",
    "CornerMargin",
    "LinearSide",
    "Pole",
    "corner_margin",
    "least_disk",
    "linear_side",
    "margin_speed",
    "open_loop",
    "worst_linear_side",
]

DISK_PLACES = ("thrust", "measurement", "both")
"""The places where all loops are opened at once: the four thrust commands, the measured x_e, y_e, z_e, ψ, or both."""

_AXES = 4


def open_loop(cascade: Cascade, place: str) -> OpenLoop:
    """Open the loops of one or several cascades at `place`, one of `DISK_PLACES`; all other connections stay closed.

    Raises:
        InputError: `place` is not one of `DISK_PLACES`.
    """
    A, B, C, K = cascade.A, cascade.B, cascade.C, cascade.K
    thrust, pose = np.arange(K.shape[-2]) < _AXES, np.arange(K.shape[-1]) < _AXES
    nothing = np.zeros((*K.shape[:-2], _AXES, _AXES))
    if place == "thrust":
        # the rows of K for the integral action stay closed
        inner = A - B[..., ~thrust] @ K[..., ~thrust, :] @ C
        return OpenLoop(inner, B[..., thrust], K[..., thrust, :] @ C, nothing)
    if place == "measurement":
        inner = A - B @ K[..., ~pose] @ C[..., ~pose, :]
        return OpenLoop(inner, B @ K[..., pose], C[..., pose, :], nothing)
    if place != "both":
        raise InputError("no such place", key="place", value=place, remedy=nearest(place, DISK_PLACES))
    # the second input u2 is the negative of the measured pose that the law receives
    own, acting = K[..., ~thrust, :], K[..., thrust, :]
    inner = A - B[..., ~thrust] @ own[..., ~pose] @ C[..., ~pose, :]
    enter = np.concatenate([B[..., thrust], B[..., ~thrust] @ own[..., pose]], axis=-1)
    leave = np.concatenate([acting[..., ~pose] @ C[..., ~pose, :], C[..., pose, :]], axis=-2)
    through = np.block([[nothing, -acting[..., pose]], [nothing, nothing]])
    return OpenLoop(inner, enter, leave, through)


@dataclass(frozen=True)
class Pole:
    """One pole s of the closed loop with delay; a complex pair is represented by the pole in the upper half-plane.

    Attributes:
        real, imaginary: real and imaginary part of s [rad/s].
        natural_rad_s: natural frequency |s| [rad/s].
        damping: damping ratio −real/|s|.
    """

    real: float
    imaginary: float
    natural_rad_s: float
    damping: float


@dataclass(frozen=True)
class LinearSide:
    """Results of the linear analysis about straight cruise: disk margins of all loops, poles, and sampling limits.

    Attributes:
        of: description of the analysed vehicles: the nominal vehicle, or the worst of several corners of its parameter
            ranges.
        disks: disk margins with the loops opened at `DISK_PLACES`; for several corners, the least margin over the
            corners.
        poles: closed-loop poles of the nominal vehicle, slowest first, including the poles of the approximated delay.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        least_damping: least damping ratio of the poles, over all corners.
        sampled: limits of the sampled loop; for several corners, the least value of every limit and the largest radius.
        corner: for several corners, the parameters of the worst corner as text. The worst corner has the least disk
            margin or, if the loop is unstable, the fastest growing pole.
        at: the vehicle of that corner.
    """

    of: str
    disks: tuple[DiskMargin, ...]
    poles: tuple[Pole, ...]
    slowest_per_s: float
    least_damping: float
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
        """Whether the loop is stable for all vehicles.

        The loop must be stable in two models: continuous with approximated delay, and sampled with one period of delay.
        """
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
            f"  sampled: stable up to a control period of {none} without delay, {one} with one period of delay, {two} "
            f"with two; at a period of {self.sampled.period_s:g} s stable with up to {self.sampled.delay_periods} "
            "periods of delay",
        ]


def linear_side(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> LinearSide:
    """Return the linear analysis of one vehicle; for the arguments see `loop_margins`.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.
    """
    delayed, plain = (build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=d) for d in (None, 0.0))
    poles = _poles(delayed.poles)
    return LinearSide(
        of=f"{vehicle.name}, nominal",
        disks=tuple(stored_disk_margin(open_loop(delayed, place), place) for place in DISK_PLACES),
        poles=poles,
        slowest_per_s=float(delayed.poles[0].real),
        least_damping=min(p.damping for p in poles),
        sampled=sampled_limits(plain, dt),
    )


def worst_linear_side(
    tried: Corners, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> LinearSide:
    """Return the linear analysis with the worst results over several vehicles; `model` defaults to the first vehicle.

    A coarse grid of frequencies selects the vehicle with the least disk margin. Vehicles that cannot hold the cruise
    speed have no straight cruise to linearise about; they are omitted, and `of` states their number.

    Raises:
        InputError: `linear_side` rejects its arguments, or none of the vehicles can hold the cruise speed.
    """
    believed = model or tried.vehicles[0]
    able = [v for v, can in zip(tried.vehicles, _can_cruise(tried.vehicles, cruise), strict=True) if can]
    unable = len(tried.vehicles) - len(able)
    if not able:
        raise InputError(
            "needs more thrust than any of the vehicles has", key="cruise", value=cruise, remedy="lower it"
        )
    groups = _alike_in_states(able)
    delayed, plain = ([_built(g, gains, cruise, dt, believed, d) for g in groups] for d in (None, 0.0))
    disks, lowest = [], list[Vehicle]()
    for place in DISK_PLACES:
        loops = [open_loop(group, place) for group in delayed]
        peaks = [screened_peaks(loop) for loop in loops]
        worst = int(np.argmax([each.max() for each in peaks]))
        at = int(np.argmax(peaks[worst]))
        disks.append(stored_disk_margin(loops[worst][np.asarray(at)], place))
        lowest.append(groups[worst][at])
    slowest = [group.poles[:, 0].real for group in delayed]
    fastest = int(np.argmax([each.max() for each in slowest]))
    if slowest[fastest].max() >= 0:
        bad = groups[fastest][int(np.argmax(slowest[fastest]))]
    else:
        bad = lowest[int(np.argmin([d.guaranteed for d in disks[:2]]))]
    every = [_poles(poles) for group in delayed for poles in group.poles]
    beyond = f"; {unable} of them cannot hold {cruise:g} m/s with their thrust" if unable else ""
    return LinearSide(
        of=f"{believed.name}, worst of {tried.text}{beyond}",
        disks=tuple(disks),
        poles=every[0],
        slowest_per_s=max(float(group.poles[:, 0].real.max()) for group in delayed),
        least_damping=min(p.damping for poles in every for p in poles),
        sampled=_least_sampled([sampled_limits(group, dt) for group in plain]),
        corner=tried.label(bad) if len(tried.vehicles) > 1 else "",
        at=bad,
    )


def _alike_in_states(vehicles: Sequence[Vehicle]) -> list[list[Vehicle]]:
    """Return the vehicles in two groups, with and without thrust lag; the group of the first vehicle comes first."""
    lagged = vehicles[0]["thrust_lag"] > 0
    parts = [[v for v in vehicles if (v["thrust_lag"] > 0) is kind] for kind in (lagged, not lagged)]
    return [part for part in parts if part]


def _built(
    vehicles: Sequence[Vehicle],
    gains: Mapping[str, float],
    cruise: float,
    dt: float,
    model: Vehicle,
    delay: float | None,
) -> Cascade:
    """Return the cascades of vehicles that have equal states."""
    count = len(vehicles)
    return build_cascades(
        np.array([plant_parameters(v) for v in vehicles]),
        {name: np.full(count, float(value)) for name, value in gains.items()},
        cruise=np.full(count, cruise),
        dt=dt,
        model=np.tile(plant_parameters(model), (count, 1)),
        delay=delay,
        form=vehicles[0].form,
        model_form=model.form,
    )


def _can_cruise(vehicles: Sequence[Vehicle], cruise: float) -> list[bool]:
    """Return, for each vehicle, whether its thrust can hold the cruise speed [m/s]."""
    nu = np.tile([[cruise], [0.0], [0.0], [0.0]], len(vehicles))
    tau = np.asarray(trim_function(vehicles[0].form)(nu, np.array([plant_parameters(v) for v in vehicles]).T)).T
    return [bool(can_hold(t, *v.thrust_range)) for t, v in zip(tau, vehicles, strict=True)]


def _least_sampled(limits: Sequence[SampledLimits]) -> SampledLimits:
    one, two, three = (min(s.largest_period_s[k] for s in limits) for k in range(3))
    return SampledLimits(
        limits[0].period_s,
        max(s.radius for s in limits),
        (one, two, three),
        min(s.delay_periods for s in limits),
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
    tried: Corners, gains: Mapping[str, float], *, dt: float, highest: float, least: float = LEAST_DISK_MARGIN
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

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import corners, margin_speed
        >>> tried, gains = corners(load_vehicle("bluerov2-wu")), load_gains("default").values
        >>> [round(margin_speed(tried, gains, dt=0.05, highest=0.5, least=least), 2) for least in (0.0, 0.3)]
        [0.2, 0.17]
    """
    model, speed, searched = tried.vehicles[0], highest, list[int]()
    while speed > 0:
        peaks = _peaks(tried.vehicles, gains, [speed], dt=dt, model=model, least=least)[:, 0]
        worst = int(np.argmax(peaks))
        if peaks[worst] <= _level(least) or worst in searched:
            return speed
        searched.append(worst)
        speed = _search(tried.vehicles[worst], gains, speed, dt=dt, model=model, least=least)
    return 0.0


def _level(least: float) -> float:
    return 1 / least if least > 0 else 0.0


def _search(
    vehicle: Vehicle, gains: Mapping[str, float], highest: float, *, dt: float, model: Vehicle, least: float
) -> float:
    speeds = np.linspace(0.0, highest, _STEPS + 1)
    good = _peaks([vehicle], gains, speeds[1:].tolist(), dt=dt, model=model, least=least)[0] <= _level(least)
    if good.all():
        return highest
    first = int(np.argmin(good))
    low, high = float(speeds[first]), float(speeds[first + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        enough = _peaks([vehicle], gains, [middle], dt=dt, model=model, least=least)[0, 0] <= _level(least)
        low, high = (middle, high) if enough else (low, middle)
    return low


def _peaks(
    vehicles: Sequence[Vehicle],
    gains: Mapping[str, float],
    speeds: Sequence[float],
    *,
    dt: float,
    model: Vehicle,
    least: float,
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the peak (n, k) of the structured singular value over frequency for n vehicles at k speeds.

    The value is inf if the vehicle cannot hold the speed. If `least` is 0, the value is the real part of the slowest
    pole instead.
    """
    peaks = np.full((len(vehicles), len(speeds)), np.inf)
    for k, speed in enumerate(speeds):
        able = [v for v, can in zip(vehicles, _can_cruise(vehicles, speed), strict=True) if can]
        for group in _alike_in_states(able) if able else []:
            cascades = _built(group, gains, speed, dt, model, None)
            if least > 0:
                values = np.max([screened_peaks(open_loop(cascades, place)) for place in DISK_PLACES[:2]], axis=0)
            else:
                values = cascades.poles[:, 0].real + 1e-9
            for vehicle, value in zip(group, values.tolist(), strict=True):
                peaks[next(i for i, one in enumerate(vehicles) if one is vehicle), k] = value
    return peaks


class CornerMargin(NamedTuple):
    """The disk margin at the worst corner of a vehicle's ranges, 0 if it is unstable; the corner, and its label."""

    margin: float
    vehicle: Vehicle
    corner: str


def corner_margin(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    proved: bool = False,
    uncertainty: float | None = None,
    spread: float = 1.0,
) -> CornerMargin:
    """Return the disk margin at the worst corner of the vehicle's ranges, or of `uncertainty` (see `corners`).

    It is the margin of `worst_linear_side`; unless `proved`, without the proof between frequencies.

    Raises:
        InputError: a gain is missing or not positive, or the nominal vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import corner_margin
        >>> rov, gains = load_vehicle("bluerov2-wu"), load_gains("default").values
        >>> [round(corner_margin(rov, gains, cruise=u, dt=0.05).margin, 2) for u in (0.1, 0.47)]
        [0.75, 0.0]
    """
    tried = corners(vehicle, uncertainty, spread=spread)
    able = [v for v, can in zip(tried.vehicles, _can_cruise(tried.vehicles, cruise), strict=True) if can]
    if not able or able[0] is not vehicle:
        problem = "needs more thrust than the vehicle has"
        raise InputError(problem, key="cruise", value=cruise, remedy="lower it")
    groups = _alike_in_states(able)
    delayed, plain = ([_built(g, gains, cruise, dt, model or vehicle, d) for g in groups] for d in (None, 0.0))
    margin, (group, at) = least_disk(delayed, plain, dt=dt, margin_of=_proved if proved else quick_disk_margin)
    worst = groups[group][at]
    return CornerMargin(margin, worst, tried.label(worst))


def _proved(loop: OpenLoop) -> float:
    return stored_disk_margin(loop, "").guaranteed


def least_disk(
    delayed: Sequence[Cascade],
    plain: Sequence[Cascade],
    *,
    dt: float,
    margin_of: Callable[[OpenLoop], float] = quick_disk_margin,
) -> tuple[float, tuple[int, int]]:
    """Return the least disk margin of several vehicles, in groups of cascades with equal states, and where it is.

    The second result is the index of the group and the index in it.

    Args:
        delayed: cascades (k, …) with the approximated delay.
        plain: the same cascades built with `delay=0`.
        dt: control period [s].
        margin_of: returns the disk margin of one stable loop.
    """
    for grown in (
        [group.poles[:, 0].real + 1e-9 for group in delayed],
        [radii_of(group, dt, 1) - 1 for group in plain],
    ):
        worst = int(np.argmax([each.max() for each in grown]))
        if grown[worst].max() >= 0:
            return 0.0, (worst, int(np.argmax(grown[worst])))
    margins = []
    for place in DISK_PLACES[:2]:
        loops = [open_loop(group, place) for group in delayed]
        peaks = [screened_peaks(loop) for loop in loops]
        worst = int(np.argmax([each.max() for each in peaks]))
        at = int(np.argmax(peaks[worst]))
        margins.append((margin_of(loops[worst][np.asarray(at)]), (worst, at)))
    return min(margins)
