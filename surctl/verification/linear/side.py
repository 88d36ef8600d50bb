"""The linear side of a verification in one object: what a report, a table and JSON show beside the nonlinear claims."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle import Vehicle, plant_parameters
from surctl.vehicle.dynamics import trim_function
from surctl.verification.cascade import Cascade, build_cascade, build_cascades
from surctl.verification.linear.corners import Corners
from surctl.verification.linear.disk import DiskMargin, disk_margin, screened_peaks
from surctl.verification.linear.places import DISK_PLACES, open_loop
from surctl.verification.linear.sampled import SampledLimits, sampled_limits

__all__ = ["LinearSide", "Pole", "linear_side", "worst_linear_side"]


@dataclass(frozen=True)
class Pole:
    """One closed-loop pole of the loop with its delay; of a pair, the one above.

    Attributes:
        real, imaginary: [rad/s].
        natural_rad_s: |s|.
        damping: −real/|s|.
    """

    real: float
    imaginary: float
    natural_rad_s: float
    damping: float


@dataclass(frozen=True)
class LinearSide:
    """Loops together, poles and sampling about straight cruise.

    Attributes:
        of: which vehicles: the nominal one, or the worst of corners.
        disks: disk margins at `DISK_PLACES`; over corners, the least of each.
        poles: of the nominal vehicle, slowest first; poles of the approximated delay are among them.
        slowest_per_s: largest real part of a pole [1/s]; over corners, the largest.
        least_damping: least damping ratio of the poles; over corners, the least.
        sampled: the loop as it is sampled; over corners, the least of each entry and the largest radius.
    """

    of: str
    disks: tuple[DiskMargin, ...]
    poles: tuple[Pole, ...]
    slowest_per_s: float
    least_damping: float
    sampled: SampledLimits

    @property
    def stable(self) -> bool:
        """Whether all vehicles are, with the approximated delay and as sampled with one period of delay."""
        return all(d.stable for d in self.disks) and self.sampled.radius < 1

    def to_dict(self) -> dict[str, Any]:
        """Plain data; infinite periods stay inf."""
        return {
            "of": self.of,
            "stable": self.stable,
            "disk_margins": [d.to_dict() for d in self.disks],
            "poles": [vars(p) for p in self.poles],
            "slowest_per_s": self.slowest_per_s,
            "least_damping": self.least_damping,
            "sampled": self.sampled.to_dict(),
        }

    def lines(self) -> list[str]:
        """What to print."""
        if not self.stable:
            return [f"linear, {self.of}: UNSTABLE"]
        disks = ", ".join(f"{_margin(d)} ({d.place})" for d in self.disks)
        none, one, two = (_seconds(t) for t in self.sampled.largest_period_s)
        return [
            f"linear, {self.of}:",
            f"  disk margin of all loops at once: {disks}; slowest pole {self.slowest_per_s:.3g} 1/s, least damping "
            f"{self.least_damping:.2f}",
            f"  sampled: stable up to a period of {none}, {one} with one period of delay, {two} with two; "
            f"{self.sampled.delay_periods} periods of delay are borne at {self.sampled.period_s:g} s",
        ]


def linear_side(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> LinearSide:
    """The linear side of one vehicle; the arguments of `loop_margins`.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed.
    """
    delayed, plain = (build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=d) for d in (None, 0.0))
    poles = _poles(delayed.poles)
    return LinearSide(
        of=f"{vehicle.name} as stated",
        disks=tuple(disk_margin(open_loop(delayed, place), place) for place in DISK_PLACES),
        poles=poles,
        slowest_per_s=float(delayed.poles[0].real),
        least_damping=min(p.damping for p in poles),
        sampled=sampled_limits(plain, dt),
    )


def worst_linear_side(
    tried: Corners, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> LinearSide:
    """The worst of each figure over several vehicles, while the controller believes the first one (or `model`).

    Which one has the least disk margin is judged on a coarse grid of frequencies. Vehicles that cannot hold the
    cruise speed have no straight cruise to linearise about: they are counted in `of` and left out.

    Raises:
        InputError: as `linear_side`, or none of the vehicles can cruise at that speed.
    """
    believed = model or tried.vehicles[0]
    able = [v for v, can in zip(tried.vehicles, _can_cruise(tried.vehicles, cruise), strict=True) if can]
    unable = len(tried.vehicles) - len(able)
    if not able:
        raise InputError("is beyond the thrust of every one", key="cruise", value=cruise, remedy="go slower")
    groups = _alike_in_states(able)
    delayed, plain = ([_built(g, gains, cruise, dt, believed, d) for g in groups] for d in (None, 0.0))
    disks = []
    for place in DISK_PLACES:
        loops = [open_loop(group, place) for group in delayed]
        peaks = [screened_peaks(loop) for loop in loops]
        worst = int(np.argmax([each.max() for each in peaks]))
        disks.append(disk_margin(loops[worst][np.asarray(np.argmax(peaks[worst]))], place))
    every = [_poles(poles) for group in delayed for poles in group.poles]
    beyond = f"; {unable} of them cannot hold {cruise:g} m/s with their thrust" if unable else ""
    return LinearSide(
        of=f"{believed.name}, worst of {tried.text}{beyond}",
        disks=tuple(disks),
        poles=every[0],
        slowest_per_s=max(float(group.poles[:, 0].real.max()) for group in delayed),
        least_damping=min(p.damping for poles in every for p in poles),
        sampled=_least_sampled([sampled_limits(group, dt) for group in plain]),
    )


def _alike_in_states(vehicles: Sequence[Vehicle]) -> list[list[Vehicle]]:
    """Those with thrust lag and those without, the first vehicle's group first: their cascades have other states."""
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
    """The cascades of vehicles that have the same states, behind one axis."""
    count = len(vehicles)
    return build_cascades(
        np.array([plant_parameters(v) for v in vehicles]),
        {name: np.full(count, float(value)) for name, value in gains.items()},
        cruise=np.full(count, cruise),
        dt=dt,
        model=np.tile(plant_parameters(model), (count, 1)),
        delay=delay,
    )


def _can_cruise(vehicles: Sequence[Vehicle], cruise: float) -> list[bool]:
    nu = np.tile([[cruise], [0.0], [0.0], [0.0]], len(vehicles))
    tau = np.asarray(trim_function()(nu, np.array([plant_parameters(v) for v in vehicles]).T)).T
    return [bool(np.all(np.abs(t) < v.thrust_limit)) for t, v in zip(tau, vehicles, strict=True)]


def _least_sampled(limits: Sequence[SampledLimits]) -> SampledLimits:
    one, two, three = (min(s.largest_period_s[k] for s in limits) for k in range(3))
    return SampledLimits(
        limits[0].period_s,
        max(s.radius for s in limits),
        (one, two, three),
        min(s.delay_periods for s in limits),
    )


def _poles(poles: NDArray[np.complex128]) -> tuple[Pole, ...]:
    """One of each pair."""
    return tuple(
        Pole(float(s.real), float(s.imag), float(abs(s)), float(-s.real / abs(s)) if s != 0 else 1.0)
        for s in poles
        if s.imag >= 0
    )


def _margin(disk: DiskMargin) -> str:
    return "not judged" if np.isnan(disk.guaranteed) else f"{disk.guaranteed:.2f}"


def _seconds(period: float) -> str:
    return f"{period:.2f} s" if np.isfinite(period) else "20 s and more"
