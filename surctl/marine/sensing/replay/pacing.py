"""The cycle time of a recording, and the assignment of its readings to steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["on_steps", "usual_cycle"]

Array = NDArray[np.float64]
_SILENCE = 5.0  # s, at least; after a longer gap of all sensors a new segment begins
_SLOWEST, _FASTEST = 10.0, 1e-3  # s, from one reading of a sensor to its next
_SURE = 20  # longest gap, in readings, whose number of missing readings is certain
_MOST_STEPS = 5_000_000


def usual_cycle(time: Array, sensor: NDArray[np.int64], *, file: str) -> float:
    """Return the usual time between two successive readings of a sensor [s].

    Args:
        time: (rows,) times [s], ascending.
        sensor: (rows,) index of the sensor of each reading.
        file: name of the file, for error messages.

    Raises:
        InputError: no sensor has readings at two different times, or the cycle time is outside the filter's limits.
    """
    waits = np.concatenate([np.diff(time[sensor == i]) for i in np.unique(sensor)])
    waits = waits[waits > 0]
    if not len(waits):
        raise InputError("no sensor has readings at two different times", file=file, remedy="give a longer recording")
    cycle = _pace(time, sensor, float(np.median(waits)))
    if not _FASTEST <= cycle <= _SLOWEST:
        raise InputError(
            f"a sensor's readings are {cycle:.3g} s apart", file=file, key="time_s",
            remedy=f"give seconds; the filter needs readings {_FASTEST:g} to {_SLOWEST:g} s apart",
        )  # fmt: skip
    return cycle


def _pace(time: Array, sensor: NDArray[np.int64], median: float) -> float:
    """Return the mean time between two readings of a sensor [s].

    This time is the slope of a line fitted to the times of the readings over their number, which averages out jitter.

    A gap with an unknown number of missing readings ends a series of readings; each series has its own start time in
    the fit.
    """
    over, under = 0.0, 0.0
    for i in np.unique(sensor):
        own = time[sensor == i]
        counts = np.round(np.diff(own) / median)
        for run in np.split(np.arange(len(own)), np.flatnonzero(counts > _SURE) + 1):
            number = np.concatenate([[0.0], np.cumsum(counts[run[:-1]])])
            number -= number.mean()
            over += float(number @ (own[run] - own[run].mean()))
            under += float(number @ number)
    pace = over / under if under > 0 else median
    return pace if 0.5 * median < pace < 2.0 * median else median  # else the intervals are too uneven


def on_steps(time: Array, dt: float, *, file: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the step of each reading, and the first step and start time [s] of each segment between long gaps.

    The step boundaries are placed so that jitter rarely moves a reading into a neighbouring step. The first reading of
    a segment lies in the segment's first step. `InputError` is raised if the recording would have too many steps.

    Args:
        time: (rows,) times [s], ascending.
        dt: duration of a step [s].
        file: name of the file, for error messages.
    """
    silence = max(_SILENCE, 20.0 * dt)
    breaks = np.flatnonzero(np.diff(time) > silence) + 1
    step = np.empty(len(time), dtype=np.int64)
    first, begin = [0], []
    shifts = np.arange(20) / 20
    for rows in np.split(np.arange(len(time)), breaks):
        phase = (time[rows] - time[rows[0]]) / dt
        # among possible placements of the steps, choose the one with nearly all readings in the middle of a step
        off = [np.percentile(np.abs((phase[:10_000] + shift) % 1.0 - 0.5), 90) for shift in shifts]
        shift = shifts[int(np.argmin(off))]
        steps = np.floor(phase + shift)
        if steps[-1] + first[-1] > _MOST_STEPS:
            raise InputError(
                f"would take more than {_MOST_STEPS} steps of {dt:.3g} s", file=file, key="time_s",
                remedy="split the recording into shorter files",
            )  # fmt: skip
        step[rows] = first[-1] + steps.astype(np.int64)
        first.append(int(step[rows[-1]]) + 1)
        begin.append(float(time[rows[0]] + (0.5 - shift) * dt))
    return step, np.array(first[:-1]), np.array(begin)
