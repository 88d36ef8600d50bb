"""What a log does not excite: axes at rest, thrust in a few rows, combinations of parameters; and its residuals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.vehicle.identification.fitted import AXIS_OF, CONSTANT_FORCE, OFFSETS, axes_of
from surctl.vehicle.identification.intervals import Spread
from surctl.vehicle.identification.model import Model, Section
from surctl.vehicle.motion_log import MotionLog
from surctl.vehicle.specs import TERMS

__all__ = ["at_rest", "drift_note", "few_thrusts", "ill_excited", "notes_of", "slow_residuals"]

_FEW = 0.1  # smallest share of rows with thrust, or of its changes, that determine a lag
_LEAST_CHANGES = 8  # changes of thrust that determine a lag
_CHANGE = 0.02  # share of the largest thrust that counts as a change
_WIDE = 0.5  # relative half-interval of a direction above which it is named
_SHARE = 0.4  # smallest component of a direction that is named, relative to the largest
_WHITE = 4.0  # correlation of neighbouring residuals over its standard deviation, above which they are not white noise
_SLOW, _SLOW_SHARE = 2.0, 0.5  # [s] slow residuals: share of the variance that means over this time have
_ROUNDING = 1e-6  # [m, rad, m/s, rad/s] residual standard deviation that is only rounding

Array = NDArray[np.float64]


def at_rest(model: Model, theta: Array, noise: Array) -> frozenset[str]:
    """Return the names of the masses on axes that did not move by more than the noise.

    If an axis is at rest, the fit interprets noise as motion, and the mass of this axis wrongly seems to be identified.
    """
    # an axis without a measured velocity uses the position noise per second
    axes = len(model.masses)
    pose, rate = np.array([0, 1, 2, 3, 8, 9])[:axes], np.array([4, 5, 6, 7, 10, 11])[:axes]
    level = noise[pose]
    level[:2] = max(level[:2])
    level = np.where(np.atleast_1d(model.present.any(axis=0))[rate], noise[rate], level)
    velocities = np.vstack([states[:, model.outputs[rate]] for states in model.states(theta, model.sections)])
    still = ~(np.sqrt(np.mean(velocities**2, axis=0)) > level)
    return frozenset(np.array(model.masses)[still].tolist())


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
    texts = [f"{AXIS_OF[k]}: no motion above the noise, so {k} and its drag are unknown" for k in AXIS_OF if k in rest]
    names = [k for k in model.names if not axes_of(k) & rest]
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
        "it; possible causes: a current, filtered measurements, another drag law",
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


def drift_note(model: Model, theta: Array) -> list[str]:
    """Return a text with the range of the constant force over the log, if it drifts."""
    if not model.drift:
        return []
    own = theta[model.size :].reshape(-1, model.local)[:, model.order :]
    values = model.values(theta)
    ends = np.concatenate([own[:, :4] - own[:, 4:], own[:, :4] + own[:, 4:]])
    listed = [
        f"{k} from {values[k] + low:.3g} to {values[k] + high:.3g} {TERMS[k].unit}"
        for k, low, high in zip(CONSTANT_FORCE, ends.min(axis=0), ends.max(axis=0), strict=True)
    ]
    return [
        f"the constant force drifts ({', '.join(listed)}); each section of the log has its own force, which changes "
        "linearly, and the file has the mean"
    ]
