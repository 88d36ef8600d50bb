"""Prediction of the motion in a log over short windows, and whether a drifting force predicts it better.

A force that may change explains the fitted part of every log better, also where the model is wrong in another way. It
then replaces drag and mass, and their intervals are wrong. It therefore has to pass a cross-validation in blocks of
time (Ljung 1999, chapter 16; Bergmeir & Benítez 2012): fitted to one half of the log, it predicts the other half.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.identification.model import (
    MASS_OF,
    LogSection,
    Model,
    drift_sections_of,
    names_of,
    sections_of,
    with_all_constants,
)
from surctl.marine.vehicle.identification.solve import minimise, simulable, spread_out, without_outliers
from surctl.marine.vehicle.motion_log import LOG_MOTION, LOG_TILT, MotionLog
from surctl.marine.vehicle.parameters import Vehicle

WINDOW = 5.0
"""Length of a window [s], if none is given."""

_BEFORE, _BEFORE_ROWS = 1.0, 8  # [s] motion before a window for a velocity without measurement, at least these rows
_LEAST_ROWS = 4  # rows of a window
_LAGS = 5.0  # thrust lags after which the thrust no longer depends on its start

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """The motion in windows of a log, measured and predicted from the first row of each window.

    Attributes:
        model: root mean square of the error of the vehicle's model, by column of the log.
        hold: the same for a motion that keeps the velocity of the first row of each window.
        window: length of the windows [s].
        windows: number of windows.
        time: (n,) [s] of the rows of all windows.
        starts: (windows,) index of the first row of each window in `time`.
        measured: (n, 8) measured motion; NaN where there is no measurement. If the vehicle rolls and pitches, (n, 12).
        predicted: motion of the model, like `measured`.
        held: motion with the velocity held, like `measured`.
    """

    model: Mapping[str, float]
    hold: Mapping[str, float]
    window: float
    windows: int
    time: Array
    starts: NDArray[np.int64]
    measured: Array
    predicted: Array
    held: Array


def predict(log: MotionLog, vehicle: Vehicle, *, window: float = WINDOW) -> Prediction:
    """Predict the motion of a log over successive windows with the model of a vehicle.

    Each window starts with the measured motion of its first row. A velocity that the log does not contain follows from
    the measured poses of the second before, or of eight rows if they take longer. The thrust has the lag of the
    vehicle.

    Args:
        window: length of the windows [s].

    Raises:
        InputError: no window of the log begins with a measured state.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog, load_vehicle, predict
        >>> boat, t = load_vehicle("sur400"), 0.1 * np.arange(200)
        >>> speed = 0.3 / (1 + 0.3 * 29.5 / 50 * t)  # coasting with quadratic drag
        >>> motion = np.full((200, 8), np.nan)
        >>> motion[:, 4] = speed
        >>> result = predict(MotionLog(t, motion, np.zeros((200, 4))), boat)
        >>> result.model["u_m_per_s"] < result.hold["u_m_per_s"], result.windows
        (True, 3)
    """
    whole = with_all_constants(vehicle)
    return predict_with(log, vehicle, {k: whole[k] for k in names_of(whole)}, window=window)


def predict_with(log: MotionLog, start: Vehicle, values: Mapping[str, float], *, window: float = WINDOW) -> Prediction:
    """Predict like `predict`, with parameters by name, which may be negative; `start` supplies all others."""
    lag = values.get("thrust_lag", 0.0)
    log = without_outliers(_columns(log, 12 if start.form.tilts else 8))
    after = max(min(_LAGS * lag, window), _before(log))
    windows = [w for section in sections_of(log) for w in _windows(log, section, window, after=after)]
    states = [(w, x) for w in windows if (x := _first_state(log, *w, lag=lag)) is not None]
    if not states:
        raise InputError(
            f"has no window of {window:g} s with a measured start", file=log.source, remedy="give a longer log"
        )
    sections = tuple(part for (_, part), _ in states)
    model = Model(log, start, sections)
    theta = model.begin(sections)
    theta[: model.size] = (np.array([values[k] for k in model.names]) - model.start) / model.scale
    theta[model.size :] = np.concatenate([x for _, x in states])
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = [x[s.at][:, model.outputs] for s, x in zip(sections, model.states(theta, sections), strict=True)]
    held = [_held(x, log.time[s.rows]) for s, (_, x) in zip(sections, states, strict=True)]
    rows = np.concatenate([np.arange(s.rows.start, s.rows.stop) for s in sections])
    measured, all_predicted, all_held = log.motion[rows], np.vstack(predicted), np.vstack(held)
    return Prediction(
        _errors(all_predicted - measured),
        _errors(all_held - measured),
        window,
        len(sections),
        log.time[rows],
        np.concatenate([[0], np.cumsum([len(s.at) for s in sections])[:-1]]).astype(np.int64),
        measured,
        all_predicted,
        all_held,
    )


def _before(log: MotionLog) -> float:
    # [s] motion before a window from which velocities follow that the log does not contain
    present = np.atleast_1d(np.isfinite(log.motion).any(axis=0))
    if not (present[:4] & ~present[4:8]).any():
        return 0.0
    return max(_BEFORE, _BEFORE_ROWS * float(np.median(np.diff(log.time))))


def _columns(log: MotionLog, count: int) -> MotionLog:
    # with roll and pitch or without, as the vehicle
    missing = np.full((len(log.time), max(count - log.motion.shape[1], 0)), np.nan)
    return replace(log, motion=np.hstack([log.motion[:, :count], missing]))


def _windows(
    log: MotionLog, section: LogSection, window: float, *, after: float
) -> list[tuple[LogSection, LogSection]]:
    # each with its section; the thrust at its start follows from the commands of the time `after` before
    time = log.time[section.rows]
    count = max(int((time[-1] - time[0] - after) // window), 0)
    cuts = np.searchsorted(time, time[0] + after + window * np.arange(count + 1) - 1e-9)
    pairs = pairwise(cuts.tolist())
    return [(section, section.part(one, other - one)) for one, other in pairs if other - one >= _LEAST_ROWS]


def _first_state(log: MotionLog, section: LogSection, part: LogSection, *, lag: float) -> Array | None:
    """Return the state (12,) or (16,) at the first row of a window, or None if a velocity cannot be computed."""
    row, origin = part.rows.start, section.rows.start
    motion = log.motion[row].copy()
    measured = np.atleast_1d(np.isfinite(log.motion).any(axis=0))
    if not np.isfinite(motion[measured]).all():
        return None
    pose, rate = (np.array(p)[: len(motion) // 2] for p in ((0, 1, 2, 3, 8, 9), (4, 5, 6, 7, 10, 11)))
    first = min(int(np.searchsorted(log.time, log.time[row] - _BEFORE)), row + 1 - _BEFORE_ROWS)
    before = slice(max(origin, first), row + 1)
    poses, time = log.motion[before][:, pose], log.time[before]
    if np.isnan(motion[rate]).any() and len(time) > 1:
        speed = np.full(len(pose), np.nan)
        for k in np.flatnonzero(np.isfinite(poses).all(axis=0)):
            speed[k] = np.polyfit(time - time[-1], poses[:, k], 1)[0]
        psi = motion[3] if np.isfinite(motion[3]) else 0.0
        c, s = np.cos(psi), np.sin(psi)
        speed[:2] = c * speed[0] + s * speed[1], c * speed[1] - s * speed[0]
        motion[rate] = np.where(np.isnan(motion[rate]), speed, motion[rate])
    needed = np.isfinite(motion[rate]) | ~(measured[pose] | measured[rate])
    if not needed.all():
        return None
    motion = np.nan_to_num(motion)
    return np.concatenate([motion[:8], _thrust(log, slice(origin, row + 1), lag), motion[8:]])


def _thrust(log: MotionLog, rows: slice, lag: float) -> Array:
    # thrust (4,) at the last of the rows
    time, command = log.time[rows], log.thrust[rows]
    if lag <= 0 or len(time) < 2:
        return np.asarray(command[0] if len(time) < 2 else command[-2])
    thrust = command[0]
    for step, before in zip(np.diff(time), command[:-1], strict=True):
        thrust = before + (thrust - before) * np.exp(-step / lag)
    return np.asarray(thrust)


def _held(state: Array, time: Array) -> Array:
    # motion (n, 8) or (n, 12) with constant velocity in the body frame
    t = (time - time[0])[:, None]
    u, v, w, r = state[4:8]
    turn = r * t[:, 0]
    along = np.sinc(turn / (2 * np.pi)) * t[:, 0]  # chord of the arc
    direction = state[3] + turn / 2
    x = state[0] + along * (u * np.cos(direction) - v * np.sin(direction))
    y = state[1] + along * (u * np.sin(direction) + v * np.cos(direction))
    pose = np.column_stack([x, y, state[2] + w * t[:, 0], state[3] + turn])
    rates = np.tile(state[4:8], (len(time), 1))
    if len(state) == 12:
        return np.hstack([pose, rates])
    return np.hstack([pose, rates, state[12:14] + state[14:] * t, np.tile(state[14:], (len(time), 1))])


def _errors(difference: Array) -> dict[str, float]:
    return {
        column: float(np.sqrt(np.mean(e[np.isfinite(e)] ** 2)))
        for column, e in zip((*LOG_MOTION, *LOG_TILT), difference.T, strict=False)
        if np.isfinite(e).any()
    }


_WINDOWS, _LEAST_WINDOWS = (20.0, 10.0, 5.0, 2.0, 1.0), 2  # [s] lengths of windows; least number in each half
# Error of the prediction with the drift, relative to that without it, below which the force drifts. Chosen with these
# ratios in view: simulated drifts 0.76 to 0.93, a simulated beat 1.07, ship and glider of study 32 0.90 and 0.94.
_BETTER = 0.9
_MOST = 3.0  # factor of an error that counts in the mean over the columns
_MOST_STEPS = 15_000  # integration steps of each half that are fitted
_ROUGH = 1e-3  # relative change of the cost that ends a fit


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
        parameters: (p,) scaled parameters of a fit of the whole log with a constant force, where the fits begin.
        noise: (c,) standard deviation of the residuals of that fit.
    """
    try:
        halves = log.halves(len(log.time) // 2)
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
    model = Model(
        log, start, spread_out(drift_sections_of(log) if drift else sections_of(log), _MOST_STEPS), drift=drift
    )
    for k, name in enumerate(model.names):
        if name in MASS_OF:
            model.low[k] = -model.start[k] / model.scale[k]
    theta = model.begin(model.sections)
    theta[: model.size] = np.maximum(parameters, model.low)
    theta = simulable(model, theta, noise, model.sections)
    free = np.ones(model.size, dtype=bool)
    return model.values(minimise(model, theta, noise, model.sections, free=free, tolerance=_ROUGH)[0])


def _log_ratios(constant: Prediction, drifting: Prediction) -> list[float]:
    ratios = []
    for column in constant.model:
        one, other = constant.model[column], drifting.model.get(column, np.inf)
        ratio = other / max(one, 1e-12) if np.isfinite(one) else (0.0 if np.isfinite(other) else 1.0)
        ratios.append(float(np.log(np.clip(ratio, 1.0 / _MOST, _MOST))))
    return ratios
