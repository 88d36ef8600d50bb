"""Row space and null space of a Jacobian, with a cut-off that removes rounding noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["CUTOFF", "ZERO_ROW", "RowSpace", "project", "row_space"]

CUTOFF = 1e-10
"""Singular values below CUTOFF·‖J‖ count as 0."""

ZERO_ROW = 1e-15
"""A Jacobian smaller than this belongs to an inactive task."""


@dataclass(frozen=True)
class RowSpace:
    """A singular value decomposition J = left · diag(s) · rows, without singular values below the cut-off.

    Attributes:
        left: (k, r), orthonormal columns.
        s: (r,), singular values, all positive.
        rows: (r, n), an orthonormal basis of the row space.
        null: (n − r, n), an orthonormal basis of the null space.
    """

    left: NDArray[np.float64]
    s: NDArray[np.float64]
    rows: NDArray[np.float64]
    null: NDArray[np.float64]

    def pinv(self) -> NDArray[np.float64]:
        """Return the pseudo-inverse J⁺, (n, k)."""
        return (self.rows.T / self.s) @ self.left.T

    def particular(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the product J⁺x, (n,)."""
        return self.rows.T @ ((self.left.T @ x) / self.s)


def row_space(J: NDArray[np.float64], *, cutoff: float = CUTOFF, scale: float | None = None) -> RowSpace:
    """Decompose J (k, n) without singular values below `cutoff`·`scale` or `ZERO_ROW`; `scale` None means ‖J‖."""
    left, s, rows = np.linalg.svd(J, full_matrices=True)
    largest = scale if scale is not None else float(s[0]) if s.size else 0.0
    rank = int(np.count_nonzero(s > max(cutoff * largest, ZERO_ROW)))
    return RowSpace(left[:, :rank], s[:rank], rows[:rank], rows[rank:])


def project(
    w: NDArray[np.float64], J: NDArray[np.float64], *, x: NDArray[np.float64], cutoff: float = CUTOFF
) -> NDArray[np.float64]:
    """Return, of all z that minimise ‖J z − x‖, the one nearest to w (n,), which is w + J⁺(x − J w).

    This also holds for a rank-deficient J.
    """
    if J.shape[0] == 1:
        row = J[0]
        square = row @ row
        return w if square <= ZERO_ROW**2 else w + row * ((x[0] - row @ w) / square)
    space = row_space(J, cutoff=cutoff)
    # J w is not computed, because its error would be divided by the smallest singular value
    moved: NDArray[np.float64] = w + space.rows.T @ ((space.left.T @ x) / space.s - space.rows @ w)
    return moved
