"""Polynomials with exact rational coefficients; their indeterminates are the atoms of `proving.algebra`, by index."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from surctl.sos.polynomial import ONE

__all__ = ["Monomial", "Poly", "TooLarge", "added", "constant", "key_of", "leading", "multiplied", "scaled", "single"]

Monomial = tuple[tuple[int, int], ...]
"""A monomial: pairs (atom, exponent ≥ 1) in the order of the atoms."""
Poly = dict[Monomial, Fraction]
"""A polynomial: the coefficient of each monomial; no coefficient is 0."""

_MOST = 400
_KEY = frozenset


class TooLarge(Exception):
    """Error: a polynomial has too many terms, or an operation has no normal form."""


def constant(value: Fraction | int) -> Poly:
    """Return a constant polynomial."""
    return {(): value if type(value) is Fraction else Fraction(value)} if value else {}


def single(atom: int, exponent: int = 1) -> Poly:
    """Return the polynomial atom^exponent of one atom."""
    return {((atom, exponent),): ONE}


def added(a: Mapping[Monomial, Fraction], b: Mapping[Monomial, Fraction], factor: Fraction | int = 1) -> Poly:
    """Return the sum a + factor · b."""
    total = dict(a)
    for monomial, coefficient in b.items():
        value = coefficient if factor == 1 else -coefficient if factor == -1 else factor * coefficient
        if monomial in total:
            value += total[monomial]
        if value:
            total[monomial] = value
        else:
            total.pop(monomial, None)
    return total


def scaled(a: Mapping[Monomial, Fraction], factor: Fraction | int) -> Poly:
    """Return the product factor · a."""
    if factor == -1:
        return {m: -c for m, c in a.items()}
    return {m: c * factor for m, c in a.items()} if factor else {}


def multiplied(a: Mapping[Monomial, Fraction], b: Mapping[Monomial, Fraction]) -> Poly:
    """Return the product a b without using relations between atoms."""
    if len(a) * len(b) > _MOST * 10:
        raise TooLarge
    total: Poly = {}
    for m, c in a.items():
        for n, d in b.items():
            product = _joined(m, n)
            value = d if c is ONE else c if d is ONE else c * d
            if product in total:
                value += total[product]
            if value:
                total[product] = value
            else:
                total.pop(product, None)
    if len(total) > _MOST:
        raise TooLarge
    return total


def leading(a: Mapping[Monomial, Fraction]) -> tuple[Monomial, Fraction]:
    """Return the leading monomial and its coefficient, in a fixed order of monomials."""
    first = max(a, key=lambda m: (sum(e for _, e in m), m))
    return first, a[first]


def key_of(a: Mapping[Monomial, Fraction]) -> frozenset[tuple[Monomial, Fraction]]:
    """Return a hashable key of the polynomial; equal polynomials have equal keys."""
    return _KEY(a.items())


def _joined(m: Monomial, n: Monomial) -> Monomial:
    if not m or not n:
        return m or n
    powers = dict(m)
    for atom, exponent in n:
        powers[atom] = powers.get(atom, 0) + exponent
    return tuple(sorted(powers.items()))
