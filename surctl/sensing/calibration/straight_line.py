"""A weighted straight line by least squares, and how far each row lies from it."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["StraightLine", "fit_line", "studentised_residuals"]


@dataclass(frozen=True, kw_only=True)
class StraightLine:
    """y = beta[0] + beta[1]·x by least squares of rows with known relative sd.

    Attributes:
        beta: (2,) intercept, slope.
        beta_sd: (2,) their standard errors.
        residuals: (n,).
        scaled: (n,) residuals over the relative sd.
        leverage: (n,) diagonal of the hat matrix.
        sd: of a row of relative sd 1, with n − 2 degrees of freedom.
    """

    beta: NDArray[np.float64]
    beta_sd: NDArray[np.float64]
    residuals: NDArray[np.float64]
    scaled: NDArray[np.float64]
    leverage: NDArray[np.float64]
    sd: float


def fit_line(x: NDArray[np.float64], y: NDArray[np.float64], relative: NDArray[np.float64]) -> StraightLine:
    """Least squares of y (n,) on x (n,), each row over its relative sd (n,) > 0; n > 2, x not all one."""
    columns = np.column_stack([np.ones_like(x), x]) / relative[:, None]
    q, r = np.linalg.qr(columns)
    error = (y - x) / relative  # about the line with slope 1, near which sensors are: no digits go
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
    """Externally studentised residuals (n,) (Cook and Weisberg 1982): over the sd that the other rows have.

    Very large, not infinite, where the others leave no noise; n > 3.
    """
    n = len(line.scaled)
    free = np.maximum(1.0 - line.leverage, 1e-12)
    others = np.maximum((n - 2) * line.sd**2 - line.scaled**2 / free, 0.0) / (n - 3)
    floor = (1e-9 * line.sd) ** 2
    residuals: NDArray[np.float64] = line.scaled / np.sqrt(np.maximum(others, floor) * free)
    return residuals
