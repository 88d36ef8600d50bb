"""Linear matrix inequalities F0 + Σ x_i F_i ⪰ 0, solved by Clarabel; matrices of equal size are stored in one array."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.sos.program import solved

Array = NDArray[np.float64]
Inequality = tuple[Array, Array]
"""The matrices F0 (k, n, n) and F (k, m, n, n) of k inequalities in m unknowns."""


def symmetric_basis(size: int) -> Array:
    """Return a basis of the symmetric matrices as an array (size (size + 1)/2, size, size), ordered row by row."""
    rows, columns = np.tril_indices(size)
    basis = np.zeros((len(rows), size, size))
    basis[np.arange(len(rows)), rows, columns] = basis[np.arange(len(rows)), columns, rows] = 1
    return basis


def minimise(cost: Array, inequalities: Sequence[Inequality], *, tolerance: float = 1e-8) -> Array | None:
    """Return x (m,) that minimises cost·x under the inequalities; None if the solver finds no solution.

    The solution is only a proposal: the caller must check it.
    """
    import clarabel
    from scipy import sparse

    rows, sides, cones = [], [], []
    for constant, slopes in inequalities:
        size = constant.shape[-1]
        # upper triangle by columns, with off-diagonal entries times √2
        upper = np.tril_indices(size)
        weight = np.where(upper[0] == upper[1], 1.0, np.sqrt(2))
        sides.append((constant[:, upper[1], upper[0]] * weight).reshape(-1))
        flat = slopes[:, :, upper[1], upper[0]] * weight
        rows.append(sparse.csr_matrix(-flat.transpose(0, 2, 1).reshape(-1, len(cost))))
        cones += [clarabel.PSDTriangleConeT(size)] * len(constant)
    matrix, right = sparse.vstack(rows, format="csc"), np.concatenate(sides)
    return solved(cost, matrix, right, cones, tolerance=tolerance, iterations=60)
