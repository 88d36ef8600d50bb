"""Exact test whether a symmetric matrix of integers is positive semidefinite.

A Cholesky factor R of the scaled matrix minus a multiple of the identity is computed in floats. Its numbers need not be
correct: matrix − R R' is computed in integers, and a matrix is positive semidefinite if this difference is diagonally
dominant with a diagonal that is not negative. Small matrices, and singular ones of a moderate size, are decomposed in
integers.
"""

from __future__ import annotations

from operator import mul

import numpy as np

from surctl.certcheck.patience import go_on

__all__ = ["by_elimination", "is_semidefinite"]

_EXACT, _BITS = 40, 60_000  # largest matrix that is decomposed in integers, and its largest pivot
_SMALL = 8  # up to this size, integers are faster than floats


def is_semidefinite(matrix: list[list[int]]) -> bool:
    """Return whether a symmetric matrix (n, n) is shown to be positive semidefinite."""
    nonzero = [k for k, row in enumerate(matrix) if any(row)]
    a = [[matrix[i][j] for j in nonzero] for i in nonzero]
    if not a:
        return True
    bits = len(a) * max(row[k].bit_length() for k, row in enumerate(a))
    if len(a) <= _SMALL and bits <= _BITS // _SMALL:
        return by_elimination(a)
    return _by_factor(a) or (len(a) <= _EXACT and bits <= _BITS and by_elimination(a))


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


def by_elimination(a: list[list[int]], *, strictly: bool = False) -> bool:
    """Return whether a symmetric matrix (n, n) is positive semidefinite, or positive definite with `strictly`.

    All pivots of Gaussian elimination are positive or, unless `strictly`, belong to a row of zeros (Bareiss).
    """
    m, last = [list(row) for row in a], 1
    for k in range(len(m)):
        go_on()
        pivot = m[k][k]
        if pivot < 0 or (not pivot and (strictly or any(m[i][k] for i in range(k + 1, len(m))))):
            return False
        if not pivot:
            continue
        for i in range(k + 1, len(m)):
            go_on()
            for j in range(k + 1, i + 1):
                m[i][j] = (m[i][j] * pivot - m[i][k] * m[j][k]) // last
        last = pivot
    return True
