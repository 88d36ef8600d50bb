"""Exact test whether a symmetric matrix of integers is positive semidefinite."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_semidefinite"]

_SMALL = 8  # up to this size, integers are faster than floats
_MOST_EXACT = 40  # largest size of a nearly singular matrix that is decomposed in integers


def is_semidefinite(matrix: Sequence[Sequence[int]]) -> bool:
    """Return True only if a symmetric matrix (n, n) of integers is positive semidefinite; False may mean too large.

    A Cholesky factor L of the matrix minus a small multiple of the identity is computed in floats and rounded. The
    difference between the matrix and L L' is computed exactly; if it is diagonally dominant, the matrix is positive
    semidefinite. A small matrix, or a nearly singular one up to a size of 40, is decomposed exactly instead.

    Example:
        >>> from surctl.sos import is_semidefinite
        >>> is_semidefinite([[2, -1], [-1, 1]]), is_semidefinite([[1, 1], [1, 1]]), is_semidefinite([[1, 2], [2, 3]])
        (True, True, False)
    """
    keep = [k for k, row in enumerate(matrix) if any(row)]
    a = [[matrix[i][j] for j in keep] for i in keep]
    if any(a[k][k] <= 0 for k in range(len(a))):
        return False
    if not a:
        return True
    if len(a) <= _SMALL:
        return _decomposes(a)
    shifts = [(row[k].bit_length() + 1) // 2 for k, row in enumerate(a)]
    try:
        floats = np.array([[x / (1 << (shifts[i] + shifts[j])) for j, x in enumerate(row)] for i, row in enumerate(a)])
        least = float(np.linalg.eigvalsh(floats)[0])
    except (OverflowError, np.linalg.LinAlgError):
        return False
    if least > 1e-13 * len(a) and _dominates(a, floats, shifts, least / 2):
        return True
    return least > -1e-9 and len(a) <= _MOST_EXACT and _decomposes(a)


def _dominates(a: list[list[int]], floats: NDArray[np.float64], shifts: list[int], part: float) -> bool:
    size = len(a)
    try:
        factor = np.linalg.cholesky(floats - part * np.eye(size))
    except np.linalg.LinAlgError:
        return False
    bits = int(np.clip(np.ceil(np.log2(16 * size / part)), 20, 52))
    rows = [[round(x * 2.0**bits) for x in factor[i, : i + 1].tolist()] for i in range(size)]
    rest = [[0] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            square = sum(map(mul, rows[i][: j + 1], rows[j]))
            rest[i][j] = rest[j][i] = (a[i][j] << (2 * bits)) - (square << (shifts[i] + shifts[j]))
    most = max(shifts)
    for i in range(size):
        outside = sum(abs(rest[i][j]) << (most - shifts[j]) for j in range(size) if j != i)
        if rest[i][i] << (most - shifts[i]) < outside:
            return False
    return True


def _decomposes(a: list[list[int]]) -> bool:
    # elimination without fractions (Bareiss): every division is exact
    m = [list(row) for row in a]
    before = 1
    for k in range(len(m)):
        pivot = m[k][k]
        if pivot < 0 or (pivot == 0 and any(m[k][j] for j in range(k, len(m)))):
            return False
        if pivot == 0:
            continue
        for i in range(k + 1, len(m)):
            for j in range(k + 1, i + 1):
                m[i][j] = m[j][i] = (m[i][j] * pivot - m[i][k] * m[k][j]) // before
            m[i][k] = 0
        before = pivot
    return True
