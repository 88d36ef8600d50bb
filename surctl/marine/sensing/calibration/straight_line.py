"""Weighted least-squares fit of a straight line, and the studentised residuals of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["StraightLine", "fit_line", "studentised_residuals"]


@dataclass(frozen=True, kw_only=True)
class StraightLine:
    """The least-squares fit y = beta[0] + beta[1]·x to points whose relative standard deviations are known.

    Attributes:
        beta: (2,) intercept beta[0] and slope beta[1] of the fitted line.
        beta_sd: (2,) standard error of the intercept, and of the slope.
        residuals: (n,) residuals y − line.
        scaled: (n,) residual of each point divided by its relative sd.
        leverage: (n,) diagonal of the hat matrix.
        sd: estimated sd of a point with relative sd 1, with n − 2 degrees of freedom.
    """

    beta: NDArray[np.float64]
    beta_sd: NDArray[np.float64]
    residuals: NDArray[np.float64]
    scaled: NDArray[np.float64]
    leverage: NDArray[np.float64]
    sd: float


def fit_line(x: NDArray[np.float64], y: NDArray[np.float64], relative: NDArray[np.float64]) -> StraightLine:
    """Fit a line to n > 2 points (x, y) by weighted least squares; not all x are equal.

    The residual of each point is divided by the point's relative standard deviation `relative` (n,) > 0.
    """
    columns = np.column_stack([np.ones_like(x), x]) / relative[:, None]
    q, r = np.linalg.qr(columns)
    error = (y - x) / relative  # from slope 1, which is typical of sensors: avoids loss of digits
    beta = np.linalg.solve(r, q.T @ error)
    scaled = error - columns @ beta
    sd = sqrt(float(scaled @ scaled) / (len(x) - 2))
    inverse = np.linalg.inv(r)
    return StraightLine(
        beta=beta + np.array([0.0, 1.0]),
        beta_sd=sd * np.sqrt((inverse**2).sum(axis=1)),
        residuals=scaled * relative,
        scaled=scaled,
        leverage=(q**2).sum(axis=1),
        sd=sd,
    )


def studentised_residuals(line: StraightLine) -> NDArray[np.float64]:
    """Return the residuals (n,), each divided by its sd as estimated from the other points.

    These are the externally studentised residuals (Cook and Weisberg 1982).

    If the other points have no noise, a studentised residual is very large but finite. The function requires n > 3.
    """
    n = len(line.scaled)
    free = np.maximum(1.0 - line.leverage, 1e-12)
    others = np.maximum((n - 2) * line.sd**2 - line.scaled**2 / free, 0.0) / (n - 3)
    floor = (1e-9 * line.sd) ** 2
    residuals: NDArray[np.float64] = line.scaled / np.sqrt(np.maximum(others, floor) * free)
    return residuals
