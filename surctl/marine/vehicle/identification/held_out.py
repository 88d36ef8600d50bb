"""Prediction of the last part of a log with a vehicle that is fitted to the part before."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from surctl.errors import InputError
from surctl.marine.vehicle.identification.identify import identify
from surctl.marine.vehicle.identification.prediction import WINDOW, Prediction, predict
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.marine.vehicle.parameters import Vehicle

__all__ = ["HELD_OUT", "held_out", "held_out_windows"]

HELD_OUT = 0.4
"""Share of a log, at its end, that is predicted by a fit to the rest."""


def held_out(log: MotionLog, start: Vehicle, *, share: float = HELD_OUT, window: float = WINDOW) -> Prediction | None:
    """Predict the last part of a log with a vehicle that is fitted to the part before; None if the log is too short.

    Args:
        log: the log.
        start: vehicle with the initial values of the fit.
        share: share of the time that is predicted.
        window: length of the windows [s].

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog, held_out, load_vehicle
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(60)
        >>> held_out(MotionLog(t, np.zeros((60, 8)), np.zeros((60, 4))), boat) is None
        True
    """
    predictions = held_out_windows(log, start, [window], share=share)
    return predictions[0] if predictions else None


def held_out_windows(
    log: MotionLog, start: Vehicle, windows: Sequence[float], *, share: float = HELD_OUT
) -> tuple[Prediction, ...]:
    """Predict the last part of a log over windows of several lengths with one fit to the part before.

    Lengths for which the log has no window are omitted.

    Args:
        log: the log.
        start: vehicle with the initial values of the fit.
        windows: lengths of the windows [s].
        share: share of the time that is predicted.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog, held_out_windows, load_vehicle
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(60)
        >>> held_out_windows(MotionLog(t, np.zeros((60, 8)), np.zeros((60, 4))), boat, [1.0, 5.0])
        ()
    """
    cut = int(np.searchsorted(log.time, log.time[0] + (1.0 - share) * (log.time[-1] - log.time[0])))
    results = []
    try:
        parts = [
            MotionLog(log.time[rows], log.motion[rows], log.thrust[rows], log.source)
            for rows in (slice(0, cut), slice(cut, len(log.time)))
        ]
        fitted = identify(parts[0], start, name=start.name).vehicle
    except InputError:  # one part is too short, or has no motion
        return ()
    for window in windows:
        with suppress(InputError):  # no part of the log is so long
            results.append(predict(parts[1], fitted, window=window))
    return tuple(results)
