"""The linear part of a verification; reports, tables and JSON show its results beside those of the nonlinear claims."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle import Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.linearise import can_hold
from surctl.marine.verification.cascade import Cascade, build_cascade, build_cascades
from surctl.marine.verification.linear.corners import Corners
from surctl.marine.verification.linear.places import DISK_PLACES, open_loop
from surctl.marine.verification.linear.sampled import SampledLimits, sampled_limits
from surctl.verification.linear.disk import DiskMargin, screened_peaks, stored_disk_margin

__all__ = ["LinearSide", "Pole", "alike_in_states", "built", "can_cruise", "linear_side", "worst_linear_side"]


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
    able = [v for v, can in zip(tried.vehicles, can_cruise(tried.vehicles, cruise), strict=True) if can]
    unable = len(tried.vehicles) - len(able)
    if not able:
        raise InputError(
            "needs more thrust than any of the vehicles has", key="cruise", value=cruise, remedy="lower it"
        )
    groups = alike_in_states(able)
    delayed, plain = ([built(g, gains, cruise, dt, believed, d) for g in groups] for d in (None, 0.0))
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


def alike_in_states(vehicles: Sequence[Vehicle]) -> list[list[Vehicle]]:
    """Return the vehicles in two groups, with and without thrust lag; the group of the first vehicle comes first."""
    lagged = vehicles[0]["thrust_lag"] > 0
    parts = [[v for v in vehicles if (v["thrust_lag"] > 0) is kind] for kind in (lagged, not lagged)]
    return [part for part in parts if part]


def built(
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


def can_cruise(vehicles: Sequence[Vehicle], cruise: float) -> list[bool]:
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
