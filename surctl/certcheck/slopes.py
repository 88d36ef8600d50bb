"""Slope rule: a quadratic V decreases on {V ≤ level} if a matrix is positive definite at all vertices of a box.

On {V ≤ level}, the dynamics are x' = f(x*, w) + A(θ) (x − x*) (`surctl.certcheck.slope_rows`). The decrease of V
follows from a matrix S(θ) ≻ 0 that is linear in each slope θ when the others are fixed: S(θ) is then a convex
combination of its values at the vertices of the slopes' ranges, all of which are tested.

In discrete time, the Schur complement [[loss, AᵀP], [PA, P]] is linear in A. A disturbance with a gain is a linear
variable beside x − x*, and f(x*, w) ≠ 0 multiplies the number 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import Undefined, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.inequality import Box
from surctl.certcheck.patience import afford, go_on
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite
from surctl.certcheck.slope_rows import Number, Rows, magnitude, up

__all__ = [
    "Decrease", "check_decrease", "constants", "is_definite", "multiplied", "quadratic_form", "require_in_box",
]  # fmt: skip

Array = NDArray[np.float64]

_MOST_SLOPES = 18  # in one matrix
_MOST_STATES = 20
_UNIT = 2.0**-53
_CHUNK = 2**18  # numbers of the matrices that are tested together
_NONE = Number({})


@dataclass(frozen=True)
class Decrease:
    """What is to be shown: (change of V) < −rate · V + Σ gain_j w_j² + constant on {V ≤ level} without x*.

    Attributes:
        p: matrix P (n, n) of V = ξᵀ P ξ, with ξ = x − x*.
        centre: x* (n,).
        level: level of the region.
        rate: decay rate ≥ 0; in discrete time, V⁺ < (1 − rate) V + ...
        gains: gain of each parameter that is a disturbance, by name.
        constant: a number ≥ 0; if it is 0, the dynamics must rest at x*.
    """

    p: Matrix
    centre: Sequence[Fraction]
    level: Fraction
    rate: Fraction
    gains: Mapping[str, Fraction]
    constant: Fraction = Fraction(0)


def quadratic_form(states: Sequence[str], function: str, centre: Sequence[Fraction]) -> Matrix:
    """Return P of a function of the states that equals (x − x*)ᵀ P (x − x*); raise Rejected if it does not."""
    n = len(states)
    if n > _MOST_STATES:
        raise Rejected(f"the slope rule has more than {_MOST_STATES} states")
    exactly = Exact(table := ExpressionTable(states))
    above, below = exactly.of(root := table.read(function))
    if set(below) != {()}:
        raise Rejected("the slope rule needs a quadratic function")
    p = [[Fraction(0)] * n for _ in range(n)]
    rest = {term: number / below[()] for term, number in above.items()}
    for i in range(n):
        for j in range(i + 1):
            term = ((f"v{i}", 2),) if i == j else tuple(sorted(((f"v{i}", 1), (f"v{j}", 1))))
            number = rest.pop(term, Fraction(0))
            p[i][j] = p[j][i] = number if i == j else number / 2
    pull = [sum((p[i][j] * centre[j] for j in range(n)), Fraction(0)) for i in range(n)]
    for i in range(n):
        if rest.pop(((f"v{i}", 1),), Fraction(0)) != -2 * pull[i]:
            raise Rejected("the function is not a quadratic form about the equilibrium")
    if rest.pop((), Fraction(0)) != sum((x * y for x, y in zip(centre, pull, strict=True)), Fraction(0)) or rest:
        raise Rejected("the function is not a quadratic form about the equilibrium")
    if not table.total([root]):  # a root or quotient that cancels
        raise Rejected("the function may be undefined")
    if not is_positive_definite(p):
        raise Rejected("the function is not positive definite")
    return p


def require_in_box(cover: Matrix, centre: Sequence[Fraction], level: Fraction, box: Box) -> None:
    """Raise Rejected unless the region ξᵀ Q⁻¹ ξ < level, with the matrix Q, lies in the box, and is not empty."""
    if not level > 0:
        raise Rejected("the level is not positive")
    for k, (low, high) in enumerate(box):
        apart = min(centre[k] - Fraction(repr(low)), Fraction(repr(high)) - centre[k])
        if not apart > 0 or level * cover[k][k] > apart**2:
            raise Rejected("the region reaches the border of the box")


def check_decrease(names: Sequence[str], box: Box, rates: Sequence[str], needed: Decrease, *, discrete: bool) -> None:
    """Raise Rejected unless the slope rule proves the decrease.

    Args:
        names: names of the states, then of the parameters.
        box: bounds of `names`.
        rates: texts of the rates or successors of the states.
        needed: what is to be shown.
        discrete: whether `rates` are successors.
    """
    try:
        ends = [span(*bounds) for bounds in box]
        rows = Rows(names, ends, rates, [inverse(needed.p)], needed.centre, needed.level, list(needed.gains))
        free = [rows.resting(k, needed.centre[k] if discrete else Fraction(0)) for k in range(len(rates))]
    except Undefined as reason:
        raise Rejected(f"an expression is not defined on the region: {reason}") from None
    if needed.constant < 0:
        raise Rejected("V would have to become negative")
    moves = any(entry.poly or entry.error for entry in free)
    if moves and not needed.constant:
        raise Rejected("the dynamics do not rest at the equilibrium for all parameters")
    if not is_definite(rows, _decrease(rows, free if moves else [], needed, discrete)):
        raise Rejected("the slope rule does not show the decrease")


def _decrease(rows: Rows, free: Sequence[Number], needed: Decrease, discrete: bool) -> list[list[Number]]:
    """Return the matrix S(θ) that must be positive definite."""
    n, p = rows.states, needed.p
    matrix = [[*row, *([free[k]] if free else [])] for k, row in enumerate(rows.rows)]  # x', or x⁺ − x*
    width = len(matrix[0])
    pulled = multiplied(rows, p, matrix)
    whole = [[_NONE] * (width + n * discrete) for _ in range(width + n * discrete)]
    for i in range(n):
        for j in range(n):
            whole[i][j] = _number(p[i][j] * ((1 if discrete else 0) - needed.rate))
    for k, place in enumerate(rows.linear[n:], start=n):
        whole[k][k] = _number(needed.gains[rows.names[place]])
    if free:
        whole[width - 1][width - 1] = _number(needed.constant)
    for i in range(n):
        for j in range(width):
            if discrete:
                whole[width + i][j] = whole[j][width + i] = pulled[i][j]
            else:
                loss = rows.times(_number(Fraction(-1)), pulled[i][j])
                whole[i][j] = rows.plus(whole[i][j], loss)
                whole[j][i] = rows.plus(whole[j][i], loss)
        if discrete:
            whole[width + i][width:] = [_number(entry) for entry in p[i]]
    return whole


def multiplied(rows: Rows, a: Matrix, b: Sequence[Sequence[Number]]) -> list[list[Number]]:
    """Return the product A B of a matrix of numbers and a matrix of polynomials in the slopes."""
    product = [[_NONE] * len(b[0]) for _ in a]
    for i, row in enumerate(a):
        for j in range(len(b[0])):
            for k, x in enumerate(row):
                if x:
                    product[i][j] = rows.plus(product[i][j], rows.times(_number(x), b[k][j]))
    return product


def constants(a: Matrix) -> list[list[Number]]:
    """Return a matrix of numbers as one of polynomials in the slopes."""
    return [[_number(x) for x in row] for row in a]


def _number(x: Fraction) -> Number:
    return Number({(): x}) if x else _NONE


def is_definite(rows: Rows, whole: list[list[Number]]) -> bool:
    """Return whether the symmetric matrix is shown to be positive definite at all vertices."""
    size = len(whole)
    used = sorted({k for row in whole for entry in row for term in entry.poly for k in term})
    if len(used) > _MOST_SLOPES:
        raise Rejected(f"the slope rule needs {len(used)} slopes, more than {_MOST_SLOPES}")
    terms = sorted({term for row in whole for entry in row for term in entry.poly})
    if not terms:
        return False
    # scale by powers of 2, which is exact, so that the diagonal is about 1
    half = [magnitude(rows.size(whole[k][k])) // 2 for k in range(size)]
    # and so that no slope is rounded to 0
    unit = {k: Fraction(2) ** magnitude(max(map(abs, rows.slopes[k]))) for k in used}
    afford(8 * (2 * _CHUNK + len(terms) * size**2))
    numbers = np.zeros((len(terms), size, size))
    error = np.zeros((size, size))
    place = {term: t for t, term in enumerate(terms)}
    for i in range(size):
        for j in range(size):
            factor = Fraction(2) ** -(half[i] + half[j])
            error[i, j] = up(whole[i][j].error * factor)
            for term, number in whole[i][j].poly.items():
                numbers[place[term], i, j] = float(number * prod([unit[k] for k in term], start=factor))
    ends = np.array([[float(end / unit[k]) for end in rows.slopes[k]] for k in used]).reshape(len(used), 2)
    members = [[used.index(k) for k in term] for term in terms]
    largest = np.array([np.prod(np.abs(ends[term]).max(axis=1)) for term in members])
    # rounding of the numbers, of the products of slopes, and of the sums
    size_of = np.einsum("t,tij->ij", largest, np.abs(numbers))
    error += size_of * ((len(terms) + _MOST_SLOPES + 8) * _UNIT)
    trace = float(np.trace(size_of))
    # Rump: if the factorisation of A − shift·I succeeds in floating-point numbers, A is positive semidefinite; with
    # twice the shift, it is positive definite
    shift = 2 * (float(error.sum(axis=1).max()) * (1 + 1e-12) + 8 * (size + 2) * _UNIT * trace)
    for chosen in _vertices(len(used), max(1, _CHUNK // (size**2 + len(terms)))):
        go_on()
        slopes = np.where(chosen, ends[:, 1], ends[:, 0])  # (vertices, slopes)
        products = np.array([slopes[:, term].prod(axis=1) for term in members])
        matrices = np.tensordot(products.T, numbers, axes=1) - shift * np.eye(size)
        try:
            factors = np.linalg.cholesky(matrices)
        except np.linalg.LinAlgError:
            return False
        if not np.all(np.isfinite(factors)):
            return False
    return True


def _vertices(count: int, together: int) -> Iterator[NDArray[np.bool_]]:
    """Yield all vertices of a box, in parts (K, count) of at most `together`."""
    together = min(together, 2**count)
    for begin in range(0, 2**count, together):
        indices = np.arange(begin, begin + together)  # from 2^count on, vertices are repeated
        yield ((indices[:, None] >> np.arange(count)) & 1).astype(bool)
