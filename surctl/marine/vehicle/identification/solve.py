"""Least squares for the model of a log (Levenberg-Marquardt), its first values, and outliers left out.

A value is an outlier if it differs from the median of the seven values about it by more than the noise and by more than
the motion within these seven values can explain (Hampel 1974; Pearson 2002). Slow errors of a model are no outliers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.identification.model import LogSection, Model
from surctl.marine.vehicle.motion_log import MotionLog

_HALF = 3  # values before and after
_FAR = 6.0  # standard deviations of the noise
_STEEP = 6.0  # spreads of the middle three of seven values
_MEDIAN = 0.6745  # of the absolute value of a standard normal variable
_ROUNDING = 1e-9  # share of the range of the values below which a difference is rounding

Array = NDArray[np.float64]


def outliers(values: Array) -> NDArray[np.bool_]:
    """Return which of the values (n,) are outliers; NaN is none, and is skipped."""
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
    """Return the log with NaN in the place of outliers."""
    outlying = np.column_stack([outliers(column) for column in log.motion.T])
    return replace(log, motion=np.where(outlying, np.nan, log.motion)) if outlying.any() else log


_CONVERGED, _NEAR = 1e-6, 1e-3  # relative change of the cost at which a fit and a first fit have converged
_TRIES = 40
_BLOCK = 500  # rows that are multiplied at a time
_FIRST_ROWS, _FIRST_S, _LONGER = 20, 4.0, 3  # first fit: rows and [s] of each piece, growth per fit
_MOST_STEPS, _LEAST_STEPS = 6000, 5  # integration steps of a first fit, and of a piece of it
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-9, 1e8


def minimise(
    model: Model,
    theta: Array,
    noise: Array,
    sections: tuple[LogSection, ...],
    *,
    free: NDArray[np.bool_],
    tolerance: float = _CONVERGED,
) -> tuple[Array, bool]:
    """Return the θ of least cost near `theta`, which has a finite cost, and whether the iteration has converged.

    A heading that is wrong by whole turns over a section changes no other column: a local minimum, in which the noise
    of the heading counts as several radians. The headings are therefore turned back at the end, and if that changes
    one, the iteration goes on from there.

    Args:
        noise: (c,) standard deviation of the measurements by column.
        free: (p,) parameters that may change; the initial states always may.
        tolerance: relative change of the cost at which the iteration ends.
    """
    free = np.concatenate([free, np.ones(model.local * len(sections), dtype=bool)])
    low = np.concatenate([model.low, np.full(model.local * len(sections), -np.inf)])

    def descent(theta: Array) -> tuple[Array, bool]:
        cost, damping = model.cost(theta, noise, sections), _DAMPING
        for _ in range(_TRIES):
            information, gradient = _normal(model, theta, noise, sections)
            movable = free & ~((theta <= low) & (gradient > 0))  # at a bound, and the cost decreases beyond it
            matrix, slope = information[np.ix_(movable, movable)], gradient[movable]
            while True:
                change = np.zeros(len(theta))
                change[movable] = -np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), slope)
                expected = -0.5 * float(change[movable] @ slope)  # gain of the cost
                if expected <= 0.1 * tolerance * max(cost, 1.0):
                    return theta, True
                candidate = np.maximum(theta + change, low)
                after = model.cost(candidate, noise, sections)
                if after <= cost:
                    break
                damping *= 10.0
                if damping > _MOST_DAMPING:
                    return theta, True  # no step decreases the cost
            gained, theta, cost = cost - after, candidate, after
            damping = max(damping / 10.0, _LEAST_DAMPING)
            if gained <= tolerance * max(cost, 1.0):
                return theta, True
        return theta, False

    theta, converged = descent(theta)
    turned = model.turned_back(theta, sections)
    return (theta, converged) if np.array_equal(turned, theta) else descent(turned)


def _normal(model: Model, theta: Array, noise: Array, sections: tuple[LogSection, ...]) -> tuple[Array, Array]:
    # the matrix JᵀJ and the gradient Jᵀe of all residuals, with the prior
    mean, weight = model.prior(sections)
    information, gradient = np.diag(weight), weight * (theta - mean)
    size = model.size
    for k, (left, slope) in enumerate(model.slopes(theta, noise, sections)):
        flat = slope.reshape(-1, size + model.local)
        places = np.concatenate([np.arange(size), size + model.local * k + np.arange(model.local)])
        information[np.ix_(places, places)] += products(flat, flat)
        gradient[places] += flat.T @ left.reshape(-1)
    return information, gradient


def products(one: Array, other: Array) -> Array:
    """Return oneᵀ other of (n, p) and (n, q), summed over blocks of rows.

    For a whole section, the linear algebra library starts threads. For so few columns they cost more than they gain, on
    a machine with other load 40 times as much.
    """
    blocks = range(0, len(one), _BLOCK)
    return np.asarray(np.sum([one[k : k + _BLOCK].T @ other[k : k + _BLOCK] for k in blocks], axis=0))


def beginning(model: Model, noise: Array, *, free: NDArray[np.bool_]) -> Array:
    """Return a first θ for all sections, fitted to short pieces of them, then to pieces three times as long, and so on.

    Over a whole section, a simulated heading may be wrong by more than half a turn, and the fit would end in a local
    minimum; a short piece has an initial state of its own. A long log is represented by some of its pieces.
    """
    longest = max(len(s.at) for s in model.sections)
    rows = max(_FIRST_ROWS, int(_FIRST_S / float(np.median(np.diff(model.log.time)))))
    parameters = np.zeros(model.size)
    while rows < longest:
        pieces = _pieces(model, rows)
        theta = model.begin(pieces)
        theta[: model.size] = parameters
        theta = simulable(model, theta, noise, pieces)
        theta, _ = minimise(model, theta, noise, pieces, free=free, tolerance=_NEAR)
        parameters = theta[: model.size]
        rows *= _LONGER
    theta = model.begin(model.sections)
    theta[: model.size] = parameters
    return theta


def _pieces(model: Model, rows: int) -> tuple[LogSection, ...]:
    pieces = [s.part(k, rows) for s in model.sections for k in range(0, len(s.at), rows)]
    pieces = [s for s in pieces if len(s.dt) >= _LEAST_STEPS and model.present[s.rows].any()] or [model.sections[0]]
    return spread_out(pieces, _MOST_STEPS)


def spread_out(sections: Sequence[LogSection], steps: int) -> tuple[LogSection, ...]:
    """Return sections that are spread over a log, with at most `steps` integration steps unless one is longer."""
    count = int(np.clip(steps // max(len(s.dt) for s in sections), 1, len(sections)))
    return tuple(sections[k] for k in np.unique(np.linspace(0, len(sections) - 1, count).round().astype(int)))


def simulable(model: Model, theta: Array, noise: Array, sections: tuple[LogSection, ...]) -> Array:
    """Return θ, if necessary nearer to the start vehicle, so that the simulated motion over the sections is finite.

    With a negative drag, as a fit to a short part of the log may give, the motion over a whole section can diverge.
    """
    for share in (1.0, 0.5, 0.25, 0.0):
        tried = np.concatenate([share * theta[: model.size], theta[model.size :]])
        for candidate in (tried, model.begin(sections)) if share == 0.0 else (tried,):
            if np.isfinite(model.cost(candidate, noise, sections)):
                return candidate
    remedy = "check the units (angles in rad) and the axes of thrust and motion: enu (x forward, y left, z up) or ned"
    raise InputError("no simulated motion fits the log", file=model.log.source, remedy=remedy)
