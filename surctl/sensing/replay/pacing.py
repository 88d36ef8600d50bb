"""The pace of a recording, and the steps on which its readings lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["on_steps", "usual_cycle"]

Array = NDArray[np.float64]
_SILENCE = 5.0  # s, at least; after a longer silence of all sensors a new segment begins
_SLOWEST, _FASTEST = 10.0, 1e-3  # s from one reading of a sensor to its next
_SURE = 20  # readings that a gap may swallow and still be counted
_MOST_STEPS = 5_000_000


def usual_cycle(time: Array, sensor: NDArray[np.int64], *, file: str) -> float:
    """Usual time from one reading of a sensor to its next [s].

    Args:
        time: (rows,) [s], ascending.
        sensor: (rows,) index.
        file: named in errors.

    Raises:
        InputError: no sensor reads twice, or at a pace that cannot be filtered.
    """
    waits = np.concatenate([np.diff(time[sensor == i]) for i in np.unique(sensor)])
    waits = waits[waits > 0]
    if not len(waits):
        raise InputError("no sensor has two readings at two times", file=file, remedy="give a longer recording")
    cycle = _pace(time, sensor, float(np.median(waits)))
    if not _FASTEST <= cycle <= _SLOWEST:
        raise InputError(
            f"a sensor's readings are {cycle:.3g} s apart", file=file, key="time_s",
            remedy=f"give seconds; {_FASTEST:g} to {_SLOWEST:g} s can be filtered",
        )  # fmt: skip
    return cycle


def _pace(time: Array, sensor: NDArray[np.int64], median: float) -> float:
    """The median wait, sharpened: slope of time over the number of readings, so that jitter at the ends does not count.

    A gap that is not surely a whole number of readings ends a run; each run has its own start.
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
    return pace if 0.5 * median < pace < 2.0 * median else median  # else the waits are too uneven to be counted


def on_steps(time: Array, dt: float, *, file: str) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Step of each row; first step of each segment between silences, and its time [s].

    The steps lie such that jitter seldom moves a reading into the neighbouring one. A segment's first row lies in its
    first step. InputError when there would be very many steps.

    Args:
        time: (rows,) [s], ascending.
        dt: from step to step [s].
        file: named in errors.
    """
    silence = max(_SILENCE, 20.0 * dt)
    breaks = np.flatnonzero(np.diff(time) > silence) + 1
    step = np.empty(len(time), dtype=np.int64)
    first, begin = [0], []
    shifts = np.arange(20) / 20
    for rows in np.split(np.arange(len(time)), breaks):
        phase = (time[rows] - time[rows[0]]) / dt
        # of the ways to lay the steps, that in which nearly all readings come in the middle of one
        off = [np.percentile(np.abs((phase[:10_000] + shift) % 1.0 - 0.5), 90) for shift in shifts]
        shift = shifts[int(np.argmin(off))]
        steps = np.floor(phase + shift)
        if steps[-1] + first[-1] > _MOST_STEPS:
            raise InputError(
                f"would take more than {_MOST_STEPS} steps of {dt:.3g} s", file=file, key="time_s",
                remedy="cut the recording",
            )  # fmt: skip
        step[rows] = first[-1] + steps.astype(np.int64)
        first.append(int(step[rows[-1]]) + 1)
        begin.append(float(time[rows[0]] + (0.5 - shift) * dt))
    return step, np.array(first[:-1]), np.array(begin)
