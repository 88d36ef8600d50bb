"""The disk margin: all loops at once, the lesser of commands and measurements, at the worst of several vehicles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from surctl.errors import InputError
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.cascade import Cascade
from surctl.marine.verification.linear.corners import corners
from surctl.marine.verification.linear.places import DISK_PLACES, open_loop
from surctl.marine.verification.linear.sampled import radii_of
from surctl.marine.verification.linear.side import alike_in_states, built, can_cruise
from surctl.verification.linear.disk import quick_disk_margin, screened_peaks, stored_disk_margin
from surctl.verification.linear.open_loop import OpenLoop

__all__ = ["CornerMargin", "corner_margin", "least_disk"]


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
        [0.51, 0.0]
    """
    tried = corners(vehicle, uncertainty, spread=spread)
    able = [v for v, can in zip(tried.vehicles, can_cruise(tried.vehicles, cruise), strict=True) if can]
    if not able or able[0] is not vehicle:
        problem = "needs more thrust than the vehicle has"
        raise InputError(problem, key="cruise", value=cruise, remedy="lower it")
    groups = alike_in_states(able)
    delayed, plain = ([built(g, gains, cruise, dt, model or vehicle, d) for g in groups] for d in (None, 0.0))
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
