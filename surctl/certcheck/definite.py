"""Exact test whether a symmetric matrix of integers is positive semidefinite.

A Cholesky factor R of the scaled matrix minus a multiple of the identity is computed in floats. Its numbers need not be
correct: matrix − R R' is computed in integers, and a matrix is positive semidefinite if this difference is diagonally
dominant with a diagonal that is not negative. Matrices of a moderate size are judged by the characteristic polynomial,
which FLINT computes in integers.
"""

from __future__ import annotations

from operator import mul

import numpy as np
from flint import fmpz_mat

from surctl.certcheck.patience import go_on

__all__ = ["by_spectrum", "is_semidefinite"]

_EXACT, _BITS = 40, 60_000  # largest matrix whose characteristic polynomial is computed, and its most bits


def is_semidefinite(matrix: list[list[int]]) -> bool:
    """Return whether a symmetric matrix (n, n) is shown to be positive semidefinite."""
    nonzero = [k for k, row in enumerate(matrix) if any(row)]
    a = [[matrix[i][j] for j in nonzero] for i in nonzero]
    if not a:
        return True
    bits = len(a) * max(x.bit_length() for row in a for x in row)
    return by_spectrum(a) if len(a) <= _EXACT and bits <= _BITS else _by_factor(a)


def _by_factor(a: list[list[int]]) -> bool:
    size = len(a)
    half = [(row[k].bit_length() + 1) // 2 for k, row in enumerate(a)]
    try:
        scaled = np.array([[x / (1 << (half[i] + half[j])) for j, x in enumerate(row)] for i, row in enumerate(a)])
        least = np.linalg.eigvalsh(scaled)[0]
        root = np.linalg.cholesky(scaled - least / 2 * np.eye(size)) if least > 0 else None
    except (OverflowError, np.linalg.LinAlgError):
        return False
    if root is None or not np.all(np.isfinite(root)):
        return False
    grid = 50
    rows = [[int(x * 2.0**grid) for x in root[i, : i + 1].tolist()] for i in range(size)]
    outside, inside, top = [0] * size, [0] * size, max(half)
    for i in range(size):
        go_on()
        for j in range(i + 1):
            product = sum(map(mul, rows[i], rows[j])) if i == j else sum(map(mul, rows[i][: j + 1], rows[j]))
            rest = (a[i][j] << (2 * grid)) - (product << (half[i] + half[j]))
            # compare in the scaled matrix: entry (i, j) counts 2^−(half_i + half_j)
            if i == j:
                inside[i] = rest << (top - half[i])
            else:
                outside[i] += abs(rest) << (top - half[j])
                outside[j] += abs(rest) << (top - half[i])
    return all(own >= others for own, others in zip(inside, outside, strict=True))


def by_spectrum(a: list[list[int]], *, strictly: bool = False) -> bool:
    """Return whether a symmetric matrix (n, n) is positive semidefinite, or positive definite with `strictly`.

    The coefficients of det(x I + A) = Π (x + λ_k) are sums of products of the eigenvalues: none is negative if and only
    if no eigenvalue is.
    """
    go_on()
    sums = fmpz_mat([[-x for x in row] for row in a]).charpoly().coeffs()
    return min(sums) >= 0 and (sums[0] > 0 or not strictly)
