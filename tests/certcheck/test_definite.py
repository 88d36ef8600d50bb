"""Definiteness by the checker, compared with all principal minors and with forms that a vector refutes."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, product

import numpy as np
import pytest

from surctl.certcheck import definite
from surctl.certcheck.definite import is_semidefinite
from surctl.certcheck.region_exact import is_positive_definite

Whole = list[list[int]]


def minor(matrix: Whole, chosen: tuple[int, ...]) -> int:
    if not chosen:
        return 1
    first, *rest = chosen
    return sum(
        (-1) ** k * matrix[first][j] * minor_of([[matrix[i][c] for c in chosen if c != j] for i in rest])
        for k, j in enumerate(chosen)
    )


def minor_of(m: Whole) -> int:
    return (
        1 if not m else sum((-1) ** k * m[0][k] * minor_of([r[:k] + r[k + 1 :] for r in m[1:]]) for k in range(len(m)))
    )


def minors(matrix: Whole) -> list[int]:
    n = len(matrix)
    return [minor(matrix, c) for size in range(1, n + 1) for c in combinations(range(n), size)]


def symmetric(size: int, entries: tuple[int, ...]) -> Whole:
    at = iter(entries)
    lower = [[next(at) for _ in range(i + 1)] for i in range(size)]
    return [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def test_every_small_matrix_is_semidefinite_exactly_if_no_principal_minor_is_negative() -> None:
    seen = set()
    for size, values in ((1, (-2, -1, 0, 3)), (2, (-2, -1, 0, 1, 2, 4)), (3, (-1, 0, 1, 2))):
        for entries in product(values, repeat=size * (size + 1) // 2):
            matrix = symmetric(size, entries)
            of = minors(matrix)
            assert is_semidefinite(matrix) == (min(of) >= 0), matrix
            leading = [minor(matrix, tuple(range(k))) for k in range(1, size + 1)]
            assert is_positive_definite([[Fraction(e) for e in row] for row in matrix]) == (min(leading) > 0), matrix
            seen.add((min(of) >= 0, min(leading) > 0))
    assert len(seen) == 3


def test_a_matrix_that_is_not_symmetric_is_not_definite() -> None:
    whole = [[Fraction(9 * (i == j)) for j in range(3)] for i in range(3)]
    assert is_positive_definite(whole)
    for i, j in ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1)):
        assert not is_positive_definite(
            [[e + ((i, j) == (k, n)) for n, e in enumerate(row)] for k, row in enumerate(whole)]
        )


def spread(small: Whole, size: int, factor: int) -> Whole:
    """A matrix of `size` axes that is as definite as the small one, with all axes mixed and scaled by powers of 2."""
    n = len(small)
    m = [[small[i][j] if i < n and j < n else 7 * (i == j) for j in range(size)] for i in range(size)]
    scales = [1 << (3 * k % 11) for k in range(size)]
    for k in range(1, size):
        m[k] = [a + factor * b for a, b in zip(m[k], m[k - 1], strict=True)]
        for row in m:
            row[k] += factor * row[k - 1]
    return [[x * scales[i] * scales[j] for j, x in enumerate(row)] for i, row in enumerate(m)]


SMALL = [  # last pivot 1, 0, −1: definite, singular, indefinite
    (definite_, [[2, 1, 0], [1, 2, 1], [0, 1, last]]) for definite_, last in ((1, 1), (0, Fraction(2, 3)), (-1, 0))
]


@pytest.mark.parametrize("size", [9, 12, 40])
@pytest.mark.parametrize(("kind", "small"), SMALL)
def test_a_larger_matrix_is_semidefinite_exactly_if_its_core_is(size: int, kind: int, small: list[list[int]]) -> None:
    matrix = spread([[int(3 * x) for x in row] for row in small], size, 1)
    assert is_semidefinite(matrix) == (kind >= 0)
    assert definite._by_factor(matrix) == (kind > 0)  # a factor in floats shows nothing about a singular matrix
    turned = [row[::-1] for row in matrix[::-1]]
    assert is_semidefinite(turned) == (kind >= 0)
    assert definite._by_factor(turned) == (kind > 0)


def test_large_singular_matrices_are_not_decomposed() -> None:
    singular = SMALL[1][1]
    assert not is_semidefinite(spread([[int(3 * x) for x in row] for row in singular], 41, 1))
    big = [[int(3 * x) << 7000 for x in row] for row in singular]
    assert is_semidefinite(big) and not is_semidefinite(spread(big, 9, 1))
    assert not is_semidefinite(
        [[*row, *[0] * 6] for row in big] + [[int(i == j) for j in range(9)] for i in range(3, 9)]
    )


def test_a_factor_that_is_wrong_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The floats only propose: whatever they are, no indefinite matrix passes."""
    rng = np.random.default_rng(1)
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda m: np.ones(len(m)))
    for kind, small in SMALL[::2]:
        for size in (3, 9):
            matrix = spread([[int(3 * x) for x in row] for row in small], size, 1)
            for at in range(size):
                root = np.tril(rng.uniform(-1, 1, size=(size, size)))
                scaled = np.array([[float(x) for x in row] for row in matrix])
                half = [(row[k].bit_length() + 1) // 2 for k, row in enumerate(matrix)]
                scaled /= 2.0 ** np.add.outer(half, half)
                good = np.linalg.svd(scaled)[0] @ np.diag(np.sqrt(np.linalg.svd(scaled)[1]))  # U √Σ: of |matrix|
                near = np.linalg.qr(good.T)[1].T
                for proposed in (root, near, np.where(np.arange(size)[:, None] == at, root, near)):
                    monkeypatch.setattr(np.linalg, "cholesky", lambda _, p=proposed: p)
                    assert not definite._by_factor(matrix) or kind > 0
        for bad in (np.nan, np.inf):
            monkeypatch.setattr(np.linalg, "cholesky", lambda m, b=bad: np.full(m.shape, b))
            assert not definite._by_factor(matrix)


def test_each_entry_of_a_remainder_counts() -> None:
    """A factor of zeros leaves the matrix itself: it must be diagonally dominant in every row and column."""
    size = 4  # entry (i, j) is larger than one or both of the two diagonal entries
    for i in range(size):
        for j in range(i):
            for sign in (1, -1):
                for diagonal, dominant in ((4, True), (3, False)):
                    m = [[diagonal * (a == b) for b in range(size)] for a in range(size)]
                    m[i][j] = m[j][i] = 4 * sign
                    with pytest.MonkeyPatch.context() as patch:
                        patch.setattr(np.linalg, "eigvalsh", lambda m: np.ones(len(m)))
                        patch.setattr(np.linalg, "cholesky", np.zeros_like)
                        assert definite._by_factor(m) == dominant


def test_every_row_must_be_dominant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda m: np.ones(len(m)))
    monkeypatch.setattr(np.linalg, "cholesky", np.zeros_like)
    for least, dominant in ((8, True), (7, False)):
        for row in range(3):
            m = [[8 if i == j else 4 * (row in (i, j)) for j in range(3)] for i in range(3)]
            m[row][row] = least
            assert definite._by_factor(m) == dominant
