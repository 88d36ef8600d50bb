"""Sparse polynomials in numbered variables with exact coefficients."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from flint import Ordering, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

Monomial = tuple[tuple[int, int], ...]
"""A monomial: pairs (variable, exponent ≥ 1) in the order of the variables; () is the monomial 1."""
Number = Fraction | float
"""A number; as a coefficient, a float is exactly the double."""


@dataclass(frozen=True)
class Polynomial:
    """A polynomial: the coefficient of each monomial; no coefficient is 0.

    Use the operators + − * **, and / for a quotient by a number; numbers count as constant polynomials.

    Attributes:
        terms: coefficient of each monomial.

    Example:
        >>> from surctl.sos import Polynomial
        >>> x, y = Polynomial.variables(2)
        >>> p = (x + 2 * y) ** 2 - 1
        >>> p.degree, p.value([1, 1]), p.derivative(0) == 2 * x + 4 * y
        (2, Fraction(8, 1), True)
    """

    terms: Mapping[Monomial, Fraction]

    @staticmethod
    def constant(value: Number) -> Polynomial:
        """Return the constant polynomial."""
        return Polynomial({(): Fraction(value)} if value else {})

    @staticmethod
    def variable(index: int) -> Polynomial:
        """Return the polynomial x_index."""
        return Polynomial({((index, 1),): Fraction(1)})

    @staticmethod
    def variables(count: int) -> tuple[Polynomial, ...]:
        """Return the polynomials x_0, …, x_(count − 1)."""
        return tuple(map(Polynomial.variable, range(count)))

    @staticmethod
    def monomial(monomial: Monomial) -> Polynomial:
        """Return the polynomial with this monomial alone, with the coefficient 1."""
        return Polynomial({monomial: Fraction(1)})

    def __bool__(self) -> bool:
        return bool(self.terms)

    @property
    def degree(self) -> int:
        """The largest total degree of a monomial; 0 for the polynomial 0."""
        return max((sum(e for _, e in m) for m in self.terms), default=0)

    def __add__(self, other: Polynomial | Number) -> Polynomial:
        return self._with(other, operator.add)

    def __sub__(self, other: Polynomial | Number) -> Polynomial:
        return self._with(other, operator.sub)

    def __mul__(self, other: Polynomial | Number) -> Polynomial:
        return self._with(other, operator.mul)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: Number) -> Polynomial:
        return Polynomial.constant(other) - self

    def __neg__(self) -> Polynomial:
        return Polynomial({m: -c for m, c in self.terms.items()})

    def __truediv__(self, other: Number) -> Polynomial:
        return self * (1 / Fraction(other))

    def __pow__(self, exponent: int) -> Polynomial:
        return from_ring(in_ring(self)[0] ** exponent)

    def _with(
        self, other: Polynomial | Number, operation: Callable[[fmpq_mpoly, fmpq_mpoly], fmpq_mpoly]
    ) -> Polynomial:
        if not isinstance(other, Polynomial | Fraction | float | int):
            return NotImplemented
        second = other if isinstance(other, Polynomial) else Polynomial.constant(other)
        return from_ring(operation(*in_ring(self, second)))

    def derivative(self, variable: int) -> Polynomial:
        """Return the partial derivative with respect to a variable."""
        whole, _ = in_ring(self, Polynomial.variable(variable))
        return from_ring(whole.derivative(variable))

    def substituted(self, by: Mapping[int, Polynomial]) -> Polynomial:
        """Return the polynomial with the variables in `by` replaced by polynomials."""
        whole, *images = in_ring(self, *by.values())
        generators = list(whole.context().gens())
        for k, image in zip(by, images, strict=True):
            if k < len(generators):
                generators[k] = image
        return from_ring(whole.compose(*generators))

    def value(self, point: Sequence[Number]) -> Number:
        """Return the value at a point, which has a number for each variable."""
        total: Number = Fraction(0)
        for m, factor in self.terms.items():
            term: Number = factor
            for k, e in m:
                term = term * point[k] ** e
            total = total + term
        return total


def joined(m: Monomial, n: Monomial) -> Monomial:
    """Return the product of two monomials."""
    if not m or not n:
        return m or n
    powers = dict(m)
    for variable, exponent in n:
        powers[variable] = powers.get(variable, 0) + exponent
    return tuple(sorted(powers.items()))


# Exact division of polynomials


def quotient(of: Polynomial, by: Polynomial) -> Polynomial | None:
    """Return the polynomial q with of = q · by; None if there is none.

    Example:
        >>> from surctl.sos import Polynomial, quotient
        >>> x, y = Polynomial.variables(2)
        >>> quotient(x**3 - x * y**2, x + y) == x**2 - x * y, quotient(x**2 + y, x + y)
        (True, None)
    """
    if not by.terms:
        return None
    first, second = in_ring(of, by)
    whole, rest = divmod(first, second)
    return None if rest else from_ring(whole)


def in_ring(*polynomials: Polynomial) -> list[fmpq_mpoly]:
    """Return polynomials in FLINT's ring of their variables, whose arithmetic is faster."""
    count = 1 + max((k for p in polynomials for m in p.terms for k, _ in m), default=0)
    ring = fmpq_mpoly_ctx.get(("x", count), Ordering.deglex)
    return [
        ring.from_dict(
            {tuple(dict(m).get(k, 0) for k in range(count)): fmpq(*c.as_integer_ratio()) for m, c in p.terms.items()}
        )
        for p in polynomials
    ]


def from_ring(polynomial: fmpq_mpoly) -> Polynomial:
    """Return a polynomial of FLINT's ring."""
    terms = polynomial.to_dict().items()
    return Polynomial(
        {tuple((k, int(e)) for k, e in enumerate(m) if e): Fraction(int(c.p), int(c.q)) for m, c in terms}
    )
