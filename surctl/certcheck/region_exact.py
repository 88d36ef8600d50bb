"""Linear algebra in exact rational numbers; if a function rounds, its docstring states in which direction."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import inf, isqrt, lcm, nextafter, sqrt

from flint import fmpq, fmpq_mat

from surctl.certcheck.definite import by_spectrum
from surctl.certcheck.patience import go_on

__all__ = [
    "Matrix", "inverse", "is_positive_definite", "largest_eigenvalue", "magnitude", "product", "quadratic",
    "relative_root_up", "root_down", "root_up", "transpose", "up",
]  # fmt: skip

Matrix = list[list[Fraction]]

_DIGITS = 10**9  # square roots are rounded to the ninth decimal


def transpose(a: Matrix) -> Matrix:
    """Return Aᵀ."""
    return [list(row) for row in zip(*a, strict=True)]


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return A B."""
    columns = transpose(b)
    return [
        [sum((x * y for x, y in zip(row, column, strict=True) if x and y), Fraction(0)) for column in columns]
        for row in a
    ]


def quadratic(p: Matrix, x: Sequence[Fraction]) -> Fraction:
    """Return xᵀ P x."""
    return sum((x[i] * p[i][j] * x[j] for i in range(len(x)) for j in range(len(x))), Fraction(0))


def inverse(a: Matrix) -> Matrix:
    """Return A⁻¹; raise ZeroDivisionError if there is none."""
    go_on()
    rows = fmpq_mat([[fmpq(*entry.as_integer_ratio()) for entry in row] for row in a]).inv().tolist()
    return [[Fraction(int(entry.p), int(entry.q)) for entry in row] for row in rows]


def is_positive_definite(a: Matrix) -> bool:
    """Return whether a symmetric matrix is positive definite; no if it is not symmetric."""
    n = len(a)
    if any(a[i][j] != a[j][i] for i in range(n) for j in range(i)):
        return False
    common = lcm(*(entry.denominator for row in a for entry in row))
    return by_spectrum([[int(entry * common) for entry in row] for row in a], strictly=True)


def magnitude(x: Fraction) -> int:
    """Return n with 2^(n − 1) < |x| < 2^(n + 1), for x ≠ 0; 0 for x = 0."""
    return x.numerator.bit_length() - x.denominator.bit_length() if x else 0


def up(x: Fraction) -> float:
    """Return a double that is at least x ≥ 0."""
    return nextafter(float(x), inf) if x else 0.0


def relative_root_up(value: Fraction) -> Fraction:
    """Return a number that is ≥ √value and at most a share of 1e-11 above √value, for a value ≥ 0 of any size."""
    unit = Fraction(2) ** (magnitude(value) // 2)
    return Fraction(sqrt(up(value / unit**2)) * (1 + 1e-12)) * unit


def root_up(value: Fraction) -> Fraction:
    """Return a number that is ≥ √value and at most 2e-9 above √value."""
    return Fraction(isqrt(-(-value.numerator * _DIGITS**2 // value.denominator)) + 1, _DIGITS)


def root_down(value: Fraction) -> Fraction:
    """Return a number ≥ 0 that is ≤ √value and at most 2e-9 below √value."""
    return Fraction(isqrt(value.numerator * _DIGITS**2 // value.denominator), _DIGITS)


def largest_eigenvalue(g: Matrix) -> Fraction:
    """Return an upper bound on the largest eigenvalue of a symmetric 2 × 2 matrix."""
    half = (g[0][0] + g[1][1]) / 2
    return half + root_up(((g[0][0] - g[1][1]) / 2) ** 2 + g[0][1] ** 2)
