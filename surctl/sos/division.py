"""Exact division of polynomials."""

from __future__ import annotations

from fractions import Fraction

from surctl.sos.polynomial import Monomial, Polynomial

__all__ = ["quotient"]


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
    lead = max(by.terms, key=_rank)
    scale, powers = Fraction(by.terms[lead]), dict(lead)
    rest = dict(of.terms)
    total: dict[Monomial, Fraction] = {}
    while rest:
        top = max(rest, key=_rank)
        own = dict(top)
        if any(own.get(k, 0) < e for k, e in lead):
            return None
        factor = tuple((k, e - powers.get(k, 0)) for k, e in top if e > powers.get(k, 0))
        total[factor] = Fraction(rest[top]) / scale
        for m, c in (by * Polynomial({factor: total[factor]})).terms.items():
            value = Fraction(rest.get(m, 0)) - Fraction(c)
            if value:
                rest[m] = value
            else:
                rest.pop(m, None)
    return Polynomial(total)


def _rank(m: Monomial) -> tuple[int, tuple[tuple[int, int], ...]]:
    # a graded order: of equal degrees, the higher power of the first variable is larger
    return sum(e for _, e in m), tuple((-k, e) for k, e in m)
