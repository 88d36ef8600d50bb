"""Whether the constant force of a vehicle drifts: a hypothesis that must predict unseen parts of the log better.

A force that may change explains the fitted part of every log better, also where the model is wrong in another way. It
then replaces drag and mass, and their intervals are wrong. It therefore has to pass a cross-validation in blocks of
time (Ljung 1999, chapter 16; Bergmeir & Benítez 2012): fitted to one half of the log, it predicts the other half.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.identification.fitted import MASS_OF
from surctl.marine.vehicle.identification.model import Model, Section, drift_sections_of, sections_of
from surctl.marine.vehicle.identification.prediction import Prediction, predict_with
from surctl.marine.vehicle.identification.solve import minimise, simulable
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.marine.vehicle.parameters import Vehicle

__all__ = ["Trial", "drift_trial"]

_WINDOWS, _LEAST_WINDOWS = (20.0, 10.0, 5.0, 2.0, 1.0), 2  # [s] lengths of windows; least number in each half
# Error of the prediction with the drift, relative to that without it, below which the force drifts. Chosen with these
# ratios in view: simulated drifts 0.76 to 0.93, a simulated beat 1.07, ship and glider of study 32 0.90 and 0.94.
_BETTER = 0.9
_MOST = 3.0  # factor of an error that counts in the mean over the columns
_MOST_STEPS = 15_000  # integration steps of each half that are fitted
_ROUGH = 1e-3  # relative change of the cost that ends a fit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """The error with a drifting constant force, relative to that with a constant one, over windows [s] of unseen parts.

    Attributes:
        ratio: geometric mean of the ratios of the errors of all columns and both halves of the log.
        window: length of the windows [s].
    """

    ratio: float
    window: float

    @property
    def drifts(self) -> bool:
        """Whether the drift predicts unseen parts clearly better."""
        return self.ratio < _BETTER


def drift_trial(log: MotionLog, start: Vehicle, parameters: Array, noise: Array) -> Trial | None:
    """Fit each half of a log with a constant force and with one that drifts, and predict the other half; None if short.

    The predictions use the mean force of the fitted half, as a vehicle file does, and negative drag is excluded.

    Args:
        log: the log.
        start: vehicle with the initial values of the fit.
        parameters: (p,) scaled parameters of a fit of the whole log with a constant force, where the fits begin.
        noise: (c,) standard deviation of the residuals of that fit.
    """
    cut = len(log.time) // 2
    try:
        halves = [
            MotionLog(log.time[rows], log.motion[rows], log.thrust[rows], log.source)
            for rows in (slice(0, cut), slice(cut, len(log.time)))
        ]
        values = [[_values(half, start, parameters, noise, drift=drift) for drift in (False, True)] for half in halves]
    except InputError:  # a half is too short
        return None
    for window in _WINDOWS:
        try:
            pairs = [
                [predict_with(other, start, one, window=window) for one in own]
                for own, other in zip(values, halves[::-1], strict=True)
            ]
        except InputError:  # a half has no window of this length
            continue
        if min(pair[0].windows for pair in pairs) >= _LEAST_WINDOWS:
            return Trial(float(np.exp(np.mean([_log_ratios(*pair) for pair in pairs]))), window)
    return None


def _values(log: MotionLog, start: Vehicle, parameters: Array, noise: Array, *, drift: bool) -> dict[str, float]:
    model = Model(log, start, _some(drift_sections_of(log) if drift else sections_of(log)), drift=drift)
    for k, name in enumerate(model.names):
        if name in MASS_OF:
            model.low[k] = -model.start[k] / model.scale[k]
    theta = model.begin(model.sections)
    theta[: model.size] = np.maximum(parameters, model.low)
    theta = simulable(model, theta, noise, model.sections)
    free = np.ones(model.size, dtype=bool)
    return model.values(minimise(model, theta, noise, model.sections, free=free, tolerance=_ROUGH)[0])


def _some(sections: tuple[Section, ...]) -> tuple[Section, ...]:
    # sections, spread over the log, with at most `_MOST_STEPS` steps unless one is longer
    count = int(np.clip(_MOST_STEPS // max(len(s.dt) for s in sections), 1, len(sections)))
    return tuple(sections[k] for k in np.unique(np.linspace(0, len(sections) - 1, count).round().astype(int)))


def _log_ratios(constant: Prediction, drifting: Prediction) -> list[float]:
    ratios = []
    for column in constant.model:
        one, other = constant.model[column], drifting.model.get(column, np.inf)
        ratio = other / max(one, 1e-12) if np.isfinite(one) else (0.0 if np.isfinite(other) else 1.0)
        ratios.append(float(np.log(np.clip(ratio, 1.0 / _MOST, _MOST))))
    return ratios
