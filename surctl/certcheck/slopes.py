"""Slope rule: a quadratic V decreases on {V ≤ level} if a matrix is positive definite at all vertices of a box.

On {V ≤ level}, the dynamics are x' = f(x*, w) + A(θ) (x − x*) (`surctl.certcheck.slope_rows`). The decrease of V
follows from a matrix S(θ) ≻ 0 that is linear in each slope θ when the others are fixed: S(θ) is then a convex
combination of its values at the vertices of the slopes' ranges, all of which are tested.

In discrete time, the Schur complement [[loss, AᵀP], [PA, P]] is linear in A. A disturbance with a gain is a linear
variable beside x − x*, and f(x*, w) ≠ 0 multiplies the number 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import Undefined, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.inequality import Box
from surctl.certcheck.patience import afford, go_on
from surctl.certcheck.radii import least_rate, norm, require_rest, widened
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite, magnitude, up
from surctl.certcheck.slope_rows import Number, Poly, Row, Rows

__all__ = [
    "Decrease", "check_decrease", "is_definite", "quadratic_form", "require_in_box",
]  # fmt: skip

Array = NDArray[np.float64]

_MOST_SLOPES = 20  # in one matrix
_MOST_STATES = 20
_UNIT = 2.0**-53
_CHUNK = 2**18  # numbers of the matrices that are tested together


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
        radii: radii (n,) of x* about `centre` (`surctl.certcheck.radii`); empty if it is there. With radii, V about
            every x* within them decreases on the region {V ≤ level} about `centre`, which contains an equilibrium.
        fixed: whether all parameters are constant, and an equilibrium of each lies within the radii.
    """

    p: Matrix
    centre: Sequence[Fraction]
    level: Fraction
    rate: Fraction
    gains: Mapping[str, Fraction]
    constant: Fraction = Fraction(0)
    radii: Sequence[Fraction] = ()
    fixed: bool = False


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


def check_decrease(
    names: Sequence[str],
    box: Box,
    rates: Sequence[str],
    needed: Decrease,
    *,
    discrete: bool,
    feedbacks: Sequence[Sequence[Fraction]] = (),
) -> None:
    """Raise Rejected unless the slope rule proves the decrease.

    Args:
        names: names of the states, then of the parameters.
        box: bounds of `names`.
        rates: texts of the rates or successors of the states.
        needed: what is to be shown.
        discrete: whether `rates` are successors.
        feedbacks: feedback (n,) of each limit, see `surctl.certcheck.slope_rows`.
    """
    try:
        ends = [span(*bounds) for bounds in box]
        cover, gains, radii = inverse(needed.p), list(needed.gains), needed.radii
        level = widened(needed.p, needed.level, radii)
        rows = Rows(names, ends, rates, [cover], needed.centre, level, gains, feedbacks, radii)
        still_at = needed.centre if discrete else [Fraction(0)] * len(rates)
        free = [] if needed.fixed else [rows.resting(k, at) for k, at in enumerate(still_at)]
        if needed.fixed:
            still = [f"({rate}) - {name}" if discrete else rate for name, rate in zip(names, rates, strict=False)]
            require_rest(names, box[len(rates) :], still, needed.centre, radii)
    except Undefined as reason:
        raise Rejected(f"an expression is not defined on the region: {reason}") from None
    if len(rows.limits) != len(feedbacks):
        raise Rejected(f"there are {len(feedbacks)} feedbacks for {len(rows.limits)} limits")
    if needed.constant < 0:
        raise Rejected("V would have to become negative")
    moves = any(entry.poly or entry.error for entry in free)
    if moves and radii:
        least = least_rate(norm(needed.p, [rows.size(entry) for entry in free]), [cover], radii)
        needed, moves = replace(needed, rate=max(needed.rate, least)), False
    if moves and not needed.constant:
        raise Rejected("the dynamics do not rest at the equilibrium for all parameters")
    if not is_definite(rows, _decrease(rows, free if moves else [], needed, discrete)):
        raise Rejected("the slope rule does not show the decrease")


def _decrease(rows: Rows, free: Sequence[Number], needed: Decrease, discrete: bool) -> Row:
    """Return the matrix S(θ) that must be positive definite."""
    n, p = rows.states, np.array(needed.p, dtype=object)
    matrix = np.array([[*row, *([free[k]] if free else [])] for k, row in enumerate(rows.rows)], dtype=object)
    pulled, width = p @ matrix, matrix.shape[1]  # of x', or of x⁺ − x*
    whole = np.full((width + n * discrete,) * 2, Fraction(0), dtype=object)
    whole[:n, :n] = p * ((1 if discrete else 0) - needed.rate)
    for k, place in enumerate(rows.linear[n:], start=n):
        whole[k, k] = needed.gains[rows.names[place]]
    if free:
        whole[width - 1, width - 1] = needed.constant
    if discrete:
        whole[width:, :width], whole[:width, width:], whole[width:, width:] = pulled, pulled.T, p
    else:
        whole[:n, :width] = -pulled + whole[:n, :width]
        whole[:width, :n] = -pulled.T + whole[:width, :n]
    return whole


def is_definite(rows: Rows, stated: Row) -> bool:
    """Return whether the symmetric matrix of numbers and polynomials is shown to be positive definite everywhere."""
    size, whole = len(stated), stated + Number({})
    lower = [(i, j) for i in range(size) for j in range(i + 1)]
    ranges = dict(enumerate(rows.slopes))
    polys = _joined([whole[i][j].poly for i, j in lower], ranges)
    used = sorted({k for poly in polys for term in poly for k in term})
    if len(used) > _MOST_SLOPES:
        raise Rejected(f"the slope rule needs {len(used)} slopes, more than {_MOST_SLOPES}")
    terms = sorted({term for poly in polys for term in poly})
    if not terms:
        return False
    # scale by powers of 2, which is exact, so that the diagonal is about 1
    half = [magnitude(rows.size(whole[k][k])) // 2 for k in range(size)]
    # and so that no slope is rounded to 0
    unit = {k: Fraction(2) ** magnitude(max(map(abs, ranges[k]))) for k in used}
    inner = min(len(used), max(0, (_CHUNK // len(lower)).bit_length() - 1))
    afford(8 * len(lower) * (len(terms) + 12 * 2**inner))
    table = {term: np.zeros((len(lower), 1)) for term in terms}
    error = np.zeros((size, size))
    for at, ((i, j), poly) in enumerate(zip(lower, polys, strict=True)):
        factor = Fraction(2) ** -(half[i] + half[j])
        error[i, j] = error[j, i] = up(whole[i][j].error * factor)
        for term, number in poly.items():
            table[term][at] = float(number * prod([unit[k] for k in term], start=factor))
    ends = {k: (float(ranges[k][0] / unit[k]), float(ranges[k][1] / unit[k])) for k in used}
    # rounding of the numbers, of the products of slopes, and of the sums
    size_of = np.zeros((size, size))
    for at, (i, j) in enumerate(lower):
        parts = (abs(table[term][at, 0]) * prod(max(map(abs, ends[k])) for k in term) for term in polys[at])
        size_of[i, j] = size_of[j, i] = sum(parts)
    error += size_of * ((len(terms) + 2 * _MOST_SLOPES + 8) * _UNIT)
    trace = float(np.trace(size_of))
    # Rump: if the factorisation of A − shift·I succeeds in floating-point numbers, A is positive semidefinite; with
    # twice the shift, it is positive definite
    shift = 2 * (float(error.sum(axis=1).max()) * (1 + 1e-12) + 8 * (size + 2) * _UNIT * trace)
    for values in _vertices(table, [(k, *ends[k]) for k in used], len(used) - inner):
        go_on()
        matrix = np.zeros((size, size, values.shape[1]))
        for at, (i, j) in enumerate(lower):
            matrix[i, j] = values[at] - shift if i == j else values[at]
        for k in range(size):
            if not np.all((matrix[k, k] > 0) & (matrix[k, k] < np.inf)):  # a NaN fails this test too
                return False
            column = matrix[k + 1 :, k] / np.sqrt(matrix[k, k])
            for i in range(size - k - 1):
                matrix[k + 1 + i, k + 1 : k + 2 + i] -= column[i] * column[: i + 1]
    return True


def _vertices(
    table: dict[tuple[int, ...], Array], slopes: Sequence[tuple[int, float, float]], outer: int
) -> Iterator[Array]:
    """Yield the values (entries, vertices) of polynomials in the slopes at all vertices of their ranges, in parts.

    Args:
        table: coefficients (entries, 1) of each term.
        slopes: each slope with its range.
        outer: number of slopes that have one value in a part.
    """
    if not slopes:
        yield table[()]
        return
    (k, low, high), rest = slopes[0], slopes[1:]
    for values in ((low,), (high,)) if outer > 0 else ((low, high),):
        reduced: dict[tuple[int, ...], Array] = {}
        for term, numbers in table.items():
            parts = [numbers * value if k in term else numbers for value in values]
            own = tuple(other for other in term if other != k)
            more = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
            reduced[own] = reduced[own] + more if own in reduced else more
        yield from _vertices(reduced, rest, outer - 1)


def _joined(polys: Sequence[Poly], ranges: dict[int, tuple[Fraction, Fraction]]) -> list[Poly]:
    """Return polynomials with fewer slopes: if two only occur in multiples of one function of both, it is one slope.

    The function is x a + y b + z a b. The range of the slope, which is added to `ranges`, is that at the vertices.
    """
    polys = list(polys)
    while pair := _pair(polys):
        go_on()
        (a, b), (x, y, z) = pair
        new = max(ranges) + 1
        ends = [x * s + y * t + z * s * t for s in ranges[a] for t in ranges[b]]
        ranges[new] = min(ends), max(ends)
        for at, poly in enumerate(polys):
            first = next(k for k, size in (((a,), x), ((b,), y), ((a, b), z)) if size)
            polys[at] = {}
            for term, number in poly.items():
                own = tuple(k for k in term if k in (a, b))
                if own in ((), first):
                    rest = (k for k in term if k not in own)
                    size = {(): Fraction(1), (a,): x, (b,): y, (a, b): z}[own]
                    polys[at][tuple(sorted([*rest, *([new] if own else [])]))] = number / size
    return polys


def _pair(polys: Sequence[Poly]) -> tuple[tuple[int, int], tuple[Fraction, ...]] | None:
    """Return two slopes a < b and x, y, z, if they only occur in multiples of x a + y b + z a b; None if none do."""
    places: dict[int, dict[Any, Fraction]] = {}
    for at, poly in enumerate(polys):
        for term, number in poly.items():
            for k in term:
                places.setdefault(k, {})[at, term] = number
    polys_of = {k: {at for at, _ in own} for k, own in places.items()}
    for a, b in combinations(sorted(places), 2):
        few, many = sorted((len(places[a]), len(places[b])))
        if polys_of[a] != polys_of[b] or many not in (few, 2 * few):
            continue
        triples: dict[Any, list[Fraction]] = {}
        for k, at in ((a, 0), (b, 1)):
            for (poly, term), number in places[k].items():
                both = a in term and b in term
                rest = tuple(k for k in term if k not in (a, b))
                triples.setdefault((poly, rest), [Fraction(0)] * 3)[2 if both else at] = number
        first = next(iter(triples.values()))
        i = next(i for i, number in enumerate(first) if number)
        if all(x[j] * first[i] == x[i] * first[j] for x in triples.values() for j in range(3)):
            return (a, b), tuple(first)
    return None
