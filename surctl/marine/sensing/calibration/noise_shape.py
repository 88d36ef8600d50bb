"""Fit of range-dependent noise, sd(x) = s0 + s1·x, to the residuals of a straight line by restricted likelihood.

The residuals e of n readings about a line are normally distributed, e ~ N(0, sd(x)²), at the range x. The shape
parameter of the noise is λ = ln(sd at the largest range / sd at the smallest range), limited to |λ| ≤ ln 50. For a
given λ, the maximum-likelihood level of the noise (the root of the mean of sd²) has a closed form, and one weighted
regression gives the restricted likelihood of Patterson and Thompson (1971). The 95 % interval of a parameter contains
the values that a likelihood-ratio test does not reject, with t²(0.975; n − 3) instead of χ²(1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import log, sqrt

import numpy as np
from numpy.typing import NDArray

_MOST = log(50.0)  # largest |λ|
_GRID = 401
_ZOOMS = 5
_DEEP = 25.0  # the grid spans log-likelihoods down to this far below the largest
_THIN = 4
_CELLS = 4096  # with more distinct ranges, ranges within 1/4096 of the span share a weight


@dataclass(frozen=True, kw_only=True)
class NoiseShape:
    """The standard deviation of the noise, fitted as a function of range.

    Attributes:
        p: p-value of the likelihood-ratio test of the hypothesis that the noise is the same at all ranges.
        s0: sd extrapolated to range 0 [m]: estimate, low, high (95 %); it may be negative.
        s1: slope of the sd [m/m]: estimate, low, high (95 %).
        level: root of the mean of sd² over the readings [m]: estimate, low, high (95 %).
        relative: (n,) sd of each reading divided by `level`; the weights of the line fit follow from it.
    """

    p: float
    s0: tuple[float, float, float]
    s1: tuple[float, float, float]
    level: tuple[float, float, float]
    relative: NDArray[np.float64]
    _line: Callable[[], NDArray[np.float64]] = field(repr=False)

    @cached_property
    def line(self) -> NDArray[np.float64]:
        """Weighted line (2, 3), with rows for intercept at x = 0 and slope, and columns estimate, low, high (95 %).

        Each interval comes from Student's t for a given λ, averaged over λ with a flat prior, so the interval accounts
        for the error of the estimated weights.
        """
        return self._line()


def noise_shape(x: NDArray[np.float64], residuals: NDArray[np.float64]) -> NoiseShape:
    """Fit sd(x) = s0 + s1·x to residuals (n,) [m], not all 0, about a line through readings at x (n,) [m], n > 4.

    In the result, `line` is the weighted line minus the unweighted line.
    """
    from scipy import stats  # the import takes about a second

    cells = _Cells.of(x, residuals)
    dof = len(x) - 2
    grid = np.linspace(-_MOST, _MOST, _GRID)
    flat = _profile(cells, np.zeros(1))
    for _ in range(_ZOOMS):
        profile = _profile(cells, grid)
        near = np.flatnonzero(profile.likelihood > profile.likelihood.max() - _DEEP)
        grid = np.linspace(grid[max(near[0] - 1, 0)], grid[min(near[-1] + 1, _GRID - 1)], _GRID)
    best = int(np.argmax(profile.likelihood))
    top = profile.likelihood[best]
    ratio = 2.0 * max(float(top - flat.likelihood[0]), 0.0)
    cut = float(stats.t.ppf(0.975, dof - 1)) ** 2
    inside = 2.0 * (top - profile.likelihood) <= cut
    shrink, stretch = _level_limits(dof, 0.5 * cut - (top - profile.likelihood[inside]))

    def interval(per_level: NDArray[np.float64]) -> tuple[float, float, float]:
        limits = per_level[inside] * profile.level[inside] * np.array([shrink, stretch])
        return float(per_level[best] * profile.level[best]), float(limits.min()), float(limits.max())

    slope = profile.scale * np.expm1(profile.shape) / cells.span
    near_end = profile.scale - slope * cells.start
    chosen = profile.scale[best] * (1.0 + np.expm1(profile.shape[best]) * (x - cells.start) / cells.span)
    return NoiseShape(
        p=float(2.0 * stats.t.sf(sqrt(ratio), dof - 1)),
        s0=interval(near_end),
        s1=interval(slope),
        level=interval(np.ones_like(profile.scale)),
        relative=chosen,
        _line=partial(_marginal_line, profile, cells.centre, dof, best),
    )


@dataclass(frozen=True, kw_only=True)
class _Cells:
    """Sums of 1, x, x², r, x r and r² over groups of readings at nearly equal ranges x, with residuals r."""

    sums: NDArray[np.float64]
    at: NDArray[np.float64]
    start: float
    span: float
    centre: float
    rows: int

    @classmethod
    def of(cls, x: NDArray[np.float64], r: NDArray[np.float64]) -> _Cells:
        start, span, centre = float(x.min()), float(np.ptp(x)), float(x.mean())
        at, cell = np.unique(x, return_inverse=True)
        if len(at) > _CELLS:
            cell = np.minimum((x - start) / span * _CELLS, _CELLS - 1).astype(int)
            at = start + span * (np.arange(_CELLS) + 0.5) / _CELLS
        about = x - centre
        powers = (np.ones_like(x), about, about * about, r, about * r, r * r)
        sums: NDArray[np.float64] = np.stack([np.bincount(cell, power, len(at)).astype(float) for power in powers])
        return cls(sums=sums, at=at, start=start, span=span, centre=centre, rows=len(x))


@dataclass(frozen=True, kw_only=True)
class _Profile:
    """For each λ: largest restricted likelihood, noise level, sd at the smallest range / level, and line."""

    shape: NDArray[np.float64]
    likelihood: NDArray[np.float64]
    level: NDArray[np.float64]
    scale: NDArray[np.float64]
    line: NDArray[np.float64]
    covariance: NDArray[np.float64]
    """(k, 3): variance of the intercept, covariance, and variance of the slope, at level 1."""


def _profile(cells: _Cells, shape: NDArray[np.float64]) -> _Profile:
    dof = cells.rows - 2
    bent = 1.0 + np.expm1(shape)[:, None] * ((cells.at - cells.start) / cells.span)
    scale = 1.0 / np.sqrt(bent**2 @ cells.sums[0] / cells.rows)
    sd = bent * scale[:, None]
    one, x, xx, r, xr, rr = ((sd**-2) @ cells.sums.T).T
    det = one * xx - x * x
    line = np.stack([(xx * r - x * xr) / det, (one * xr - x * r) / det], axis=1)
    left = np.maximum(rr - line[:, 0] * r - line[:, 1] * xr, np.finfo(float).tiny)
    level = np.sqrt(left / dof)
    likelihood = -dof * np.log(level) - np.log(sd) @ cells.sums[0] - 0.5 * np.log(det)
    covariance = np.stack([xx / det, -x / det, one / det], axis=1)
    return _Profile(shape=shape, likelihood=likelihood, level=level, scale=scale, line=line, covariance=covariance)


def _level_limits(dof: int, drop: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the factors t < 1 and t > 1 on the noise level that lower the log-likelihood by `drop`.

    Each factor solves ln t + (1/t² − 1)/2 = drop/dof: −1/t² is a value of Lambert's function W.
    """
    from scipy.special import lambertw

    x = -np.exp(-1.0 - 2.0 * drop / dof)
    short, long = (np.sqrt(-1.0 / lambertw(x, branch).real) for branch in (-1, 0))
    return short, long


def _marginal_line(profile: _Profile, centre: float, dof: int, best: int) -> NDArray[np.float64]:
    """Return (2, 3): intercept and slope, each with the ends of its 95 % interval.

    The ends are the 2.5 % and 97.5 % points of Student's t distribution, averaged over λ; `centre` is the mean range
    [m], `dof` the degrees of freedom, and `best` the index of the best λ.
    """
    from scipy.optimize import brentq
    from scipy.special import stdtr  # without the overhead of scipy.stats

    def excess(at: float, p: float, value: NDArray[np.float64], sd: NDArray[np.float64]) -> float:
        return float(weight @ stdtr(dof, (at - value) / sd)) - p

    some = slice(best % _THIN, None, _THIN)  # sufficient for the integral
    weight = np.exp(profile.likelihood[some] - profile.likelihood[best])
    weight /= weight.sum()
    c, level, best = profile.covariance[some], profile.level[some], best // _THIN
    slope, slope_sd = profile.line[some, 1], level * np.sqrt(c[:, 2])
    start = profile.line[some, 0] - centre * slope
    start_sd = level * np.sqrt(np.maximum(c[:, 0] - 2.0 * centre * c[:, 1] + centre**2 * c[:, 2], 0.0))
    rows = []
    for value, sd in ((start, start_sd), (slope, slope_sd)):
        row = [float(value[best])]
        for p in (0.025, 0.975):
            low, high = float((value - 60.0 * sd).min()), float((value + 60.0 * sd).max())
            row.append(float(brentq(excess, low, high, (p, value, sd), xtol=1e-12 * (high - low))))
        rows.append(row)
    return np.array(rows)
