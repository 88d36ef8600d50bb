"""What a log does not excite: axes at rest, thrust in a few rows, combinations of parameters; and its residuals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.fitted import AXIS_OF, CONSTANT_FORCE, OFFSETS, axes_of
from surctl.marine.vehicle.identification.intervals import Spread
from surctl.marine.vehicle.identification.model import Model, Section
from surctl.marine.vehicle.identification.trim import Trial
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.marine.vehicle.specs import TERMS

__all__ = ["at_rest", "drift_note", "few_thrusts", "ill_excited", "measured_forces", "notes_of", "slow_residuals"]

_FEW = 0.1  # smallest share of rows with thrust, or of its changes, that determine a lag
_LEAST_CHANGES = 8  # changes of thrust that determine a lag
_CHANGE = 0.02  # share of the largest thrust that counts as a change
_WIDE = 0.5  # relative half-interval of a direction above which it is named
_SHARE = 0.4  # smallest component of a direction that is named, relative to the largest
_WHITE = 4.0  # correlation of neighbouring residuals over its standard deviation, above which they are not white noise
_SLOW, _SLOW_SHARE = 2.0, 0.5  # [s] slow residuals: share of the variance that means over this time have
_ROUNDING = 1e-6  # [m, rad, m/s, rad/s] residual standard deviation that is only rounding

_POSE, _RATE = np.array([0, 1, 2, 3, 8, 9]), np.array([4, 5, 6, 7, 10, 11])  # columns of surge to yaw, roll, pitch

Array = NDArray[np.float64]


def at_rest(model: Model, theta: Array, noise: Array) -> frozenset[str]:
    """Return the names of the masses on axes that did not move by more than the noise.

    If an axis is at rest, the fit interprets noise as motion, and the mass of this axis wrongly seems to be identified.
    An axis has moved if its velocity exceeds the noise of the measured velocity, or its displacement in the sections
    that of the measured position or heading. A body that oscillates, such as a fish with its tail, may have a
    velocity that is mostly noise for the model, but a large displacement.
    """
    axes = len(model.masses)
    present = np.atleast_1d(model.present.any(axis=0))
    states = model.states(theta, model.sections)
    velocities = [x[:, model.outputs[_RATE[:axes]]] for x in states]
    fast = np.sqrt(np.mean(np.vstack(velocities) ** 2, axis=0)) > noise[_RATE[:axes]]
    paths = [np.cumsum(v[1:] * s.dt[:, None], axis=0) for v, s in zip(velocities, model.sections, strict=True)]
    displaced = np.sqrt(np.mean(np.vstack([(p - p.mean(axis=0)) ** 2 for p in paths]), axis=0))
    level = noise[_POSE[:axes]]
    level[:2] = max(level[:2])
    far = (displaced > level) & _placed(present, axes)
    still = ~((fast & present[_RATE[:axes]]) | far)
    return frozenset(np.array(model.masses)[still].tolist())


def measured_forces(model: Model) -> frozenset[str]:
    """Return the names of the constant forces on axes with a measured pose or velocity."""
    return frozenset(k for k, measured in zip(CONSTANT_FORCE, measured_axes(model), strict=False) if measured)


def measured_axes(model: Model) -> NDArray[np.bool_]:
    """Return which axes of the vehicle (4,) or (6,) have a measured pose or velocity."""
    axes = len(model.masses)
    present = np.atleast_1d(model.present.any(axis=0))
    return np.asarray(present[_RATE[:axes]] | _placed(present, axes))


def _placed(present: NDArray[np.bool_], axes: int) -> NDArray[np.bool_]:
    # which axes have a measured pose; surge and sway need both x and y
    placed = np.asarray(present[_POSE[:axes]])
    placed[:2] = placed[:2].all()
    return placed


def few_thrusts(log: MotionLog, sections: tuple[Section, ...]) -> str:
    """Return why the thrust of a log does not determine a lag; an empty text if it does."""
    largest = np.max(np.abs(log.thrust), axis=0)
    scale = np.where(largest > 0, largest, 1.0)
    thrust = [log.thrust[s.rows] / scale for s in sections]
    pushed = float(np.mean(np.concatenate([(np.abs(t) > _CHANGE).any(axis=1) for t in thrust])))
    rows = sum(len(t) for t in thrust)
    if pushed < _FEW:
        return f"the thrust is not 0 in only {round(pushed * rows)} of {rows} rows"
    changes = sum(int((np.abs(np.diff(t, axis=0)) > _CHANGE).any(axis=1).sum()) for t in thrust)
    return f"the thrust changes only {changes} times" if changes < _LEAST_CHANGES else ""


def ill_excited(
    model: Model, spread: Spread, estimates: Mapping[str, tuple[float, float]], rest: frozenset[str]
) -> tuple[str, ...]:
    """Return the axes at rest, and the combinations of parameters that the log does not determine, one text each.

    The combinations are the eigenvectors of the covariance of the relative changes with a large eigenvalue.
    """
    unmeasured = {k for k, measured in zip(model.masses, measured_axes(model), strict=True) if not measured}
    force_of = dict(zip(model.masses, CONSTANT_FORCE, strict=False))
    texts = [
        f"{AXIS_OF[k]}: not measured, so {k}, its drag and {force_of.get(k, 'its moment')} are unknown"
        if k in unmeasured
        else f"{AXIS_OF[k]}: no motion above the noise, so {k} and its drag are unknown"
        for k in AXIS_OF
        if k in rest
    ]
    unknown = set(CONSTANT_FORCE) - measured_forces(model)
    names = [k for k in model.names if not axes_of(k) & rest and k not in unknown]
    places = [model.names.index(k) for k in names]
    scale = model.scale[places]
    size = np.array(
        [max(abs(estimates[k][0]), (0.1 if k in OFFSETS else 1.0) * s) for k, s in zip(names, scale, strict=True)]
    )
    size *= np.sign([estimates[k][0] or 1.0 for k in names])  # a change away from 0 is positive
    covariance = spread.covariance[np.ix_(places, places)] * np.outer(scale / size, scale / size)
    values, vectors = np.linalg.eigh(covariance)
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        wide = 1.96 * float(np.sqrt(max(value, 0.0)))
        if wide <= _WIDE:
            break
        large = sorted(np.flatnonzero(np.abs(vector) >= _SHARE * np.abs(vector).max()), key=lambda k: -abs(vector[k]))
        vector = vector * np.sign(vector[large[0]])
        if len(large) == 1:
            texts.append(f"{names[large[0]]} is uncertain by ± {wide:.0%}")
        else:
            sign = " ".join(f"{'+' if vector[k] > 0 else '-'}{names[k]}" for k in large)
            texts.append(f"{sign} (changes together, relative to their values) is uncertain by ± {wide:.0%}")
    return tuple(texts)


def notes_of(model: Model, left: list[Array]) -> tuple[str, ...]:
    """Return a text that names the columns whose residuals are not white noise, with possible causes; or none."""
    coloured = []
    for k, column in enumerate(model.columns):
        series = [e[model.present[s.rows][:, k], k] for s, e in zip(model.sections, left, strict=True)]
        number, square = sum(len(e) for e in series), sum(float(e @ e) for e in series)
        if number < 3 or np.sqrt(square / number) < _ROUNDING:
            continue
        alike = sum(float(e[1:] @ e[:-1]) for e in series) / square
        if abs(alike) * np.sqrt(number) > _WHITE:
            coloured.append(f"{column} ({alike:+.2f})")
    if not coloured:
        return ()
    return (
        f"residuals are not white noise: {', '.join(coloured)} (correlation from row to row); the intervals allow for "
        "slow noise, but not for what the model misses: a delay or another curve of the thrust, a current, filtered "
        "measurements, another drag law",
    )


def slow_residuals(model: Model, left: list[Array]) -> bool:
    """Return whether residuals are mainly slow: the means over two seconds have most of the variance of a column."""
    rows = max(int(_SLOW / float(np.median(np.diff(model.log.time)))), 2)
    for k in range(len(model.columns)):
        series = [e[model.present[s.rows][:, k], k] for s, e in zip(model.sections, left, strict=True)]
        blocks = [e[: len(e) // rows * rows].reshape(-1, rows) for e in series]
        values = np.vstack(blocks)
        if len(values) > 2 and np.mean(values.mean(axis=1) ** 2) > _SLOW_SHARE * max(np.mean(values**2), _ROUNDING**2):
            return True
    return False


def drift_note(model: Model, theta: Array, trial: Trial | None) -> list[str]:
    """Return a text with the range of the constant force over the log, if it drifts, or why a drift is not fitted."""
    if trial is None:
        return []
    if not model.drift:
        return [
            "residuals are slow: a constant force that drifts was tried and not used, because with it the errors of "
            f"predicting unseen parts over {trial.window:g} s are {trial.ratio:.3g} times those without it; the "
            "model misses something else"
        ]
    own = theta[model.size :].reshape(-1, model.local)[:, model.order :]
    values = model.values(theta)
    ends = np.concatenate([own[:, :4] - own[:, 4:], own[:, :4] + own[:, 4:]])
    listed = [
        f"{k} from {values[k] + low:.3g} to {values[k] + high:.3g} {TERMS[k].unit}"
        for k, low, high in zip(CONSTANT_FORCE, ends.min(axis=0), ends.max(axis=0), strict=True)
    ]
    return [
        f"the constant force drifts ({', '.join(listed)}); each section of the log has its own force, which changes "
        "linearly, and the file has the mean; with it the errors of predicting unseen parts over "
        f"{trial.window:g} s are {trial.ratio:.3g} times those without it"
    ]
