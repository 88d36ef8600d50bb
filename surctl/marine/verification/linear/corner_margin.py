"""Disk and delay margin at the worst corner of a vehicle's ranges, and over the speeds from rest to the cruise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from surctl.errors import InputError
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import TRACKING_LAW, CruiseLoop, least_delay
from surctl.marine.verification.linear.side import DISK_PLACES, corner_loops, largest, weakest
from surctl.verification.linear import (
    LEAST_DISK_MARGIN,
    OpenLoop,
    quick_disk_margin,
    short_margins,
    stored_disk_margin,
)
from surctl.verification.loops import LEAST_DELAY_MARGIN, LeastDelay


class CornerMargin(NamedTuple):
    """Margins at the worst corners of a vehicle's ranges.

    Attributes:
        margin: disk margin, 0 if a corner is unstable.
        vehicle, corner: the corner with the least disk margin, and its label.
        delay: least delay margin of one loop alone, 0 if a corner is unstable.
        latest: the corner with the least delay margin.
    """

    margin: float
    vehicle: Vehicle
    corner: str
    delay: LeastDelay
    latest: Vehicle

    @property
    def shares(self) -> tuple[float, float]:
        """Disk margin and delay margin over the least sufficient ones; 0 for a margin that is not determined."""
        disk, delay = self.margin / LEAST_DISK_MARGIN, self.delay.delay_s / LEAST_DELAY_MARGIN
        return float(np.nan_to_num(disk)), delay

    @property
    def enough(self) -> bool:
        """Whether both margins suffice."""
        return min(self.shares) >= 1.0

    @property
    def short(self) -> str:
        """The margins that do not suffice, with their corners, as text; empty if both do."""
        return short_margins((self.margin, f"at {self.corner}"), (self.delay.delay_s, f"in {self.delay.where}"))

    @property
    def weakest(self) -> Vehicle:
        """The corner at which the smaller of the shares is."""
        disk, delay = self.shares
        return self.vehicle if disk <= delay else self.latest


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
    law: str = TRACKING_LAW,
) -> CornerMargin:
    """Return the margins at the worst corners of the vehicle's ranges, or of `uncertainty` (see `corners`).

    They are those of `worst_linear_side`; unless `proved`, the disk margin without the proof between frequencies.

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
    groups, built = corner_loops(tried.vehicles, gains, cruise=cruise, dt=dt, model=model or vehicle, law=law)
    if not groups or groups[0][0] is not vehicle:
        problem = "needs more thrust than the vehicle has"
        raise InputError(problem, key="cruise", value=cruise, remedy="lower it")
    margin, (group, at) = least_disk(built, margin_of=_proved if proved else quick_disk_margin)
    worst = groups[group][at]
    delay, loop, (group, at) = least_delay(built)
    latest = groups[group][at]
    return CornerMargin(margin, worst, tried.label(worst), LeastDelay(delay, loop, tried.label(latest)), latest)


_SLOWER = (0.05, 0.35, 0.7)
"""Speeds between rest and the cruise speed at which margins are examined, as shares of the cruise speed."""


class SlowMargins(NamedTuple):
    """The least margins at the worst corners over the speeds from rest to the cruise speed.

    Attributes:
        cruise: that cruise speed [m/s].
        disk, delay: disk margin and delay margin [s], each with the place where it is, as "at 0.1 m/s, mass +5%".
    """

    cruise: float
    disk: tuple[float, str]
    delay: tuple[float, str]

    @property
    def short(self) -> str:
        """The margins that do not suffice, as text; empty if both do."""
        return short_margins(self.disk, self.delay)

    @property
    def sentence(self) -> str:
        """The margins that do not suffice, as a sentence of gains that have both margins at the cruise speed."""
        return f"margins below {self.cruise:g} m/s, where the vehicle starts and turns: {self.short}"


def slow_margins(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    uncertainty: float | None = None,
    law: str = TRACKING_LAW,
) -> SlowMargins:
    """Return the least margins at the cruise speed [m/s] and three slower ones; for the arguments see `corner_margin`.

    The Munk moment falls with the square of the speed, so that some gains fit a fast vehicle better than a slow one.

    Example:
        >>> from surctl.marine.tuning import derive_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.linear import slow_margins
        >>> rov = load_vehicle("bluerov2-wu")
        >>> gains = derive_gains(rov, cruise=0.33).gains.values
        >>> slow_margins(rov, gains, cruise=0.33, dt=0.05).short
        'a disk margin of 0.27 at 0.0165 m/s, ...'
    """
    judged = [
        (u, corner_margin(vehicle, gains, cruise=u, dt=dt, uncertainty=uncertainty, law=law))
        for u in (*(share * cruise for share in _SLOWER), cruise)
    ]
    at, disk = min(judged, key=lambda one: float(np.nan_to_num(one[1].margin, nan=np.inf)))
    late, delay = min(judged, key=lambda one: one[1].delay.delay_s)
    return SlowMargins(
        cruise,
        (disk.margin, f"at {at:.3g} m/s, {disk.corner}"),
        (delay.delay.delay_s, f"at {late:.3g} m/s in {delay.delay.where}"),
    )


def _proved(loop: OpenLoop) -> float:
    return stored_disk_margin(loop, "").guaranteed


def least_disk(
    groups: Sequence[CruiseLoop], *, margin_of: Callable[[OpenLoop], float] = quick_disk_margin
) -> tuple[float, tuple[int, int]]:
    """Return the least disk margin of several vehicles, in groups (k, …) of loops with equal states, and where it is.

    The second result is the index of the group and the index in it; `margin_of` returns the margin of a stable loop.
    """
    if not all(group.stable for group in groups):
        return 0.0, largest([group.rates[:, 0].real for group in groups])
    return min((margin_of(loop), at) for loop, at in (weakest(groups, place) for place in DISK_PLACES[:2]))
