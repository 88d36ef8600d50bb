"""The largest cruise speed at which the loops keep a disk margin, for a vehicle and the corners of its ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.linear.corners import Corners
from surctl.marine.verification.linear.places import DISK_PLACES, open_loop
from surctl.marine.verification.linear.side import alike_in_states, built, can_cruise
from surctl.verification.linear.disk import LEAST_DISK_MARGIN, screened_peaks

__all__ = ["margin_speed"]

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
        able = [v for v, can in zip(vehicles, can_cruise(vehicles, speed), strict=True) if can]
        for group in alike_in_states(able) if able else []:
            cascades = built(group, gains, speed, dt, model, None)
            if least > 0:
                values = np.max([screened_peaks(open_loop(cascades, place)) for place in DISK_PLACES[:2]], axis=0)
            else:
                values = cascades.poles[:, 0].real + 1e-9
            for vehicle, value in zip(group, values.tolist(), strict=True):
                peaks[next(i for i, one in enumerate(vehicles) if one is vehicle), k] = value
    return peaks
