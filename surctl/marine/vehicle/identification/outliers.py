"""Isolated values of a log that differ from their neighbours by far more than the noise: glitches of a sensor.

A value is an outlier if it differs from the median of the seven values about it by more than the noise and by more than
the motion within these seven values can explain (Hampel 1974; Pearson 2002). Slow errors of a model are no outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.motion_log import MotionLog

__all__ = ["outliers", "without_outliers"]

_HALF = 3  # values before and after
_FAR = 6.0  # standard deviations of the noise
_STEEP = 6.0  # spreads of the middle three of seven values
_MEDIAN = 0.6745  # of the absolute value of a standard normal variable
_ROUNDING = 1e-9  # share of the range of the values below which a difference is rounding

Array = NDArray[np.float64]


def outliers(values: Array) -> NDArray[np.bool_]:
    """Return which of the values (n,) are outliers; NaN is none, and is skipped.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle.identification.outliers import outliers
        >>> values = np.sin(0.1 * np.arange(100)) + 0.01 * np.cos(40.0 * np.arange(100))
        >>> values[[20, 60]] += 3.0, -2.0
        >>> np.flatnonzero(outliers(values)).tolist()
        [20, 60]
    """
    outlying = np.zeros(len(values), dtype=bool)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 4 * _HALF:
        return outlying
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(values[known], 2 * _HALF + 1), axis=1)
    middle = np.pad(windows[:, _HALF], _HALF, mode="edge")
    spread = np.pad(windows[:, _HALF + 1] - windows[:, _HALF - 1], _HALF, mode="edge")
    far = np.abs(values[known] - middle)
    # a signal at rest, or one with a coarse resolution, does not change at all in most rows
    least = _ROUNDING * float(np.ptp(values[known]))
    steps, apart = (x[x > least] for x in (np.abs(np.diff(values[known])), far))
    if not len(apart):
        return outlying
    noise = max(float(np.median(apart)) / _MEDIAN, float(steps.min()))
    inner = slice(_HALF, len(known) - _HALF)  # the first and last values have neighbours on one side only
    outlying[known[inner]] = ((far > _FAR * noise) & (far > _STEEP * spread))[inner]
    return outlying


def without_outliers(log: MotionLog) -> MotionLog:
    """Return the log with NaN in the place of outliers.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog
        >>> from surctl.marine.vehicle.identification.outliers import without_outliers
        >>> motion = np.full((60, 8), np.nan)
        >>> motion[:, 4] = 0.2 + 0.001 * (np.arange(60) % 2)
        >>> motion[30, 4] = 5.0
        >>> log = MotionLog(0.1 * np.arange(60), motion, np.zeros((60, 4)))
        >>> int(np.isfinite(without_outliers(log).motion[:, 4]).sum())
        59
    """
    outlying = np.column_stack([outliers(column) for column in log.motion.T])
    return replace(log, motion=np.where(outlying, np.nan, log.motion)) if outlying.any() else log
