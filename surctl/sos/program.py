"""Semidefinite programs whose constraints are identities of polynomials, solved by Clarabel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.sos.polynomial import Monomial, Number, Polynomial, joined

Array = NDArray[np.float64]

_FIXED = -1  # the key of the known part of a coefficient


@dataclass(frozen=True, eq=False)
class Affine:
    """A polynomial whose coefficients are affine in the unknowns of a program.

    Sums, differences and products with known polynomials and numbers use the operators + − *. A product of two unknown
    polynomials is not affine: fix one of them.

    Attributes:
        terms: for each monomial, the factor of each unknown by its index, and the known part at index −1.
    """

    terms: Mapping[Monomial, Mapping[int, float]]

    def __add__(self, other: Affine | Polynomial | Number) -> Affine:
        return self._plus(_affine(other), 1.0)

    def __sub__(self, other: Affine | Polynomial | Number) -> Affine:
        return self._plus(_affine(other), -1.0)

    def __radd__(self, other: Polynomial | Number) -> Affine:
        return self + other

    def __rsub__(self, other: Polynomial | Number) -> Affine:
        return _affine(other) - self

    def __neg__(self) -> Affine:
        return self * -1.0

    def __mul__(self, other: Polynomial | Number) -> Affine:
        known = other if isinstance(other, Polynomial) else Polynomial.constant(other)
        total: dict[Monomial, dict[int, float]] = {}
        factors = [(n, float(d)) for n, d in known.terms.items()]
        for m, row in self.terms.items():
            for n, d in factors:
                into = total.setdefault(joined(m, n), {})
                for at, c in row.items():
                    into[at] = into.get(at, 0.0) + c * d
        return Affine(total)

    def __rmul__(self, other: Polynomial | Number) -> Affine:
        return self * other

    def _plus(self, other: Affine, sign: float) -> Affine:
        total = {m: dict(row) for m, row in self.terms.items()}
        for m, row in other.terms.items():
            into = total.setdefault(m, {})
            for at, c in row.items():
                into[at] = into.get(at, 0.0) + sign * c
        return Affine(total)

    def derivative(self, variable: int) -> Affine:
        """Return the partial derivative with respect to a variable of the polynomial."""
        total: dict[Monomial, dict[int, float]] = {}
        for m, row in self.terms.items():
            exponent = dict(m).get(variable, 0)
            if exponent:
                less = tuple((k, e - (k == variable)) for k, e in m if (k, e) != (variable, 1))
                total[less] = {at: exponent * c for at, c in row.items()}
        return Affine(total)

    def at(self, point: Sequence[float]) -> Affine:
        """Return the value at a point as a constant polynomial with unknown coefficient."""
        row: dict[int, float] = {}
        for m, coefficients in self.terms.items():
            size = float(np.prod([float(point[k]) ** e for k, e in m]))
            for index, c in coefficients.items():
                row[index] = row.get(index, 0.0) + size * c
        return Affine({(): row})


@dataclass(frozen=True, eq=False)
class Squares(Affine):
    """An unknown sum of squares b' G b with a positive semidefinite Gram matrix G.

    Attributes:
        basis: the polynomials b (n), often monomials.
        first: index of the first unknown of the lower triangle of G, row by row.
    """

    basis: tuple[Polynomial, ...]
    first: int


class Program:
    """A semidefinite program: unknown numbers, polynomials and sums of squares, identities, and a linear objective.

    Example:
        The largest lower bound of a polynomial that a sum of squares proves:

        >>> from surctl.sos import Polynomial, Program, monomials
        >>> x, y = Polynomial.variables(2)
        >>> p = x**4 + y**4 - x * y
        >>> program = Program()
        >>> bound = program.scalar()
        >>> squares = program.squares(monomials([0, 1], 2))
        >>> program.zero(p - bound - squares)
        >>> program.maximise(bound)
        >>> solution = program.solve()
        >>> round(solution.number(bound), 6), solution.gram(squares).shape
        (-0.125, (6, 6))

        A quadratic Lyapunov function of x' = −x + y, y' = −y − x³ where x² + y² ≤ 1:

        >>> f = (-1 * x + y, -1 * y - x**3)
        >>> program = Program()
        >>> v = program.polynomial(monomials([0, 1], 2, lowest=2))
        >>> rate = v.derivative(0) * f[0] + v.derivative(1) * f[1]
        >>> program.zero(v - 0.1 * (x**2 + y**2) - program.squares(monomials([0, 1], 1, lowest=1)))
        >>> multiplier = program.squares(monomials([0, 1], 1, lowest=1))
        >>> squares = program.squares(monomials([0, 1], 2, lowest=1))
        >>> program.zero(rate + 0.1 * (x**2 + y**2) + squares + multiplier * (1 - x**2 - y**2))
        >>> program.minimise(v.at([1, 0]) + v.at([0, 1]))
        >>> solution = program.solve()
        >>> solution is not None and solution.polynomial(v).degree
        2
    """

    def __init__(self) -> None:
        self._count = 0
        self._blocks: list[tuple[Squares, Affine | None]] = []
        self._rows: list[Mapping[int, float]] = []
        self._nonnegative: list[Mapping[int, float]] = []
        self._cost: Mapping[int, float] = {}

    def scalar(self) -> Affine:
        """Return a new unknown number, as a constant polynomial."""
        return self.polynomial([()])

    def polynomial(self, monomials: Sequence[Monomial]) -> Affine:
        """Return a new polynomial with these monomials and free unknown coefficients."""
        first = self._count
        self._count += len(monomials)
        return Affine({m: {first + k: 1.0} for k, m in enumerate(monomials)})

    def squares(self, basis: Sequence[Monomial | Polynomial], *, above: Affine | None = None) -> Squares:
        """Return a new sum of squares b' G b.

        Args:
            basis: the monomials or polynomials b (n).
            above: an unknown number t, for the stricter condition G ⪰ t I.
        """
        b = tuple(p if isinstance(p, Polynomial) else Polynomial.monomial(p) for p in basis)
        first, at = self._count, self._count
        terms: dict[Monomial, dict[int, float]] = {}
        floats = [[(m, float(c)) for m, c in p.terms.items()] for p in b]
        for i, p in enumerate(b):
            for j, q in enumerate(b[: i + 1]):
                weight = 1.0 if p is q else 2.0
                for m, c in floats[i]:
                    for n, d in floats[j]:
                        into = terms.setdefault(joined(m, n), {})
                        into[at] = into.get(at, 0.0) + weight * c * d
                at += 1
        self._count = at
        block = Squares(terms, b, first)
        if b:
            self._blocks.append((block, above))
        return block

    def zero(self, expression: Affine | Polynomial) -> None:
        """Add the constraint that all coefficients of a polynomial are 0."""
        self._rows += _affine(expression).terms.values()

    def nonnegative(self, number: Affine | Number) -> None:
        """Add the constraint that a number, given as a constant polynomial, is not negative."""
        self._nonnegative.append(_number(number))

    def minimise(self, cost: Affine) -> None:
        """Set the objective: a number, given as a constant polynomial, to be minimised."""
        self._cost = _number(cost)

    def maximise(self, gain: Affine) -> None:
        """Set the objective: a number, given as a constant polynomial, to be maximised."""
        self.minimise(-gain)

    def solve(self, *, tolerance: float = 1e-8, seconds: float = 1e9) -> Solution | None:
        """Return a numerical solution; None if the solver finds none within `seconds` [s] of wall-clock time.

        The solution satisfies the constraints only to within about `tolerance`: it is a proposal, not a proof.
        """
        import clarabel
        from scipy import sparse

        rows = _Rows()
        for row in self._rows:
            rows.add({at: c for at, c in row.items() if at != _FIXED}, -row.get(_FIXED, 0.0))
        cones: list[Any] = [clarabel.ZeroConeT(len(rows.sides))] if rows.sides else []
        lone = [block for block in self._blocks if len(block[0].basis) == 1]
        for row in self._nonnegative:
            rows.add({at: -c for at, c in row.items() if at != _FIXED}, row.get(_FIXED, 0.0))
        for block, above in lone:
            rows.add(*_entry(block.first, above, 1.0, diagonal=True))
        if self._nonnegative or lone:
            cones.append(clarabel.NonnegativeConeT(len(self._nonnegative) + len(lone)))
        for block, above in self._blocks:
            size = len(block.basis)
            if size == 1:
                continue
            # upper triangle by columns = lower triangle by rows, with off-diagonal entries times √2
            for k, (i, j) in enumerate(zip(*np.tril_indices(size), strict=True)):
                rows.add(*_entry(block.first + k, above, 1.0 if i == j else np.sqrt(2), diagonal=bool(i == j)))
            cones.append(clarabel.PSDTriangleConeT(size))
        cost = np.zeros(self._count)
        for at, c in self._cost.items():
            if at != _FIXED:
                cost[at] = c
        settings: Any = clarabel.DefaultSettings()
        settings.verbose = False
        settings.max_iter = 100
        settings.time_limit = seconds
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        shape = len(rows.sides), self._count
        matrix = sparse.csc_matrix((rows.values, (rows.rows, rows.columns)), shape=shape)
        quadratic = sparse.csc_matrix((self._count, self._count))
        solved = clarabel.DefaultSolver(quadratic, cost, matrix, np.array(rows.sides), cones, settings).solve()
        if str(solved.status) not in ("Solved", "AlmostSolved"):
            return None
        return Solution(np.asarray(solved.x, dtype=float))


@dataclass(frozen=True, eq=False)
class Solution:
    """Numerical solution of a program.

    Attributes:
        unknowns: value of each unknown.
    """

    unknowns: Array

    def polynomial(self, expression: Affine) -> Polynomial:
        """Return the polynomial with the solution's coefficients (floats)."""
        values = {m: self._value(row) for m, row in expression.terms.items()}
        return Polynomial({m: c for m, c in values.items() if c})

    def number(self, expression: Affine) -> float:
        """Return the value of a constant polynomial."""
        return self._value(_number(expression))

    def gram(self, squares: Squares) -> Array:
        """Return the Gram matrix (n, n) of a sum of squares."""
        size = len(squares.basis)
        gram = np.zeros((size, size))
        rows, columns = np.tril_indices(size)
        gram[rows, columns] = self.unknowns[squares.first : squares.first + len(rows)]
        gram[columns, rows] = gram[rows, columns]
        return gram

    def _value(self, row: Mapping[int, float]) -> float:
        return float(sum(c if at == _FIXED else c * self.unknowns[at] for at, c in row.items()))


class _Rows:
    def __init__(self) -> None:
        self.rows: list[int] = []
        self.columns: list[int] = []
        self.values: list[float] = []
        self.sides: list[float] = []

    def add(self, row: Mapping[int, float], side: float) -> None:
        self.rows += [len(self.sides)] * len(row)
        self.columns += row.keys()
        self.values += row.values()
        self.sides.append(side)


def _entry(at: int, above: Affine | None, weight: float, *, diagonal: bool) -> tuple[dict[int, float], float]:
    """Return the row and right side of the slack variable weight · (unknown − above · [diagonal])."""
    row, side = {at: -weight}, 0.0
    if above is not None and diagonal:
        for index, c in _number(above).items():
            if index == _FIXED:
                side -= c
            else:
                row[index] = row.get(index, 0.0) + c
    return row, side


def _affine(value: Affine | Polynomial | Number) -> Affine:
    if isinstance(value, Affine):
        return value
    known = value if isinstance(value, Polynomial) else Polynomial.constant(value)
    return Affine({m: {_FIXED: float(c)} for m, c in known.terms.items()})


def _number(value: Affine | Number) -> Mapping[int, float]:
    terms = _affine(value).terms
    if any(any(row.values()) for m, row in terms.items() if m):
        raise ValueError("needs a number, not a polynomial with variables")
    return terms.get((), {})
