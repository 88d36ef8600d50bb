"""Monomial bases of Gram matrices: a polynomial z' G z with G ⪰ 0 is a sum of squares."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

from surctl.sos.polynomial import Monomial, Polynomial

__all__ = ["monomials", "parity_classes"]


def monomials(variables: Iterable[int], highest: int, *, lowest: int = 0) -> list[Monomial]:
    """Return all monomials in the variables with a total degree from `lowest` to `highest`, ordered by degree.

    Example:
        >>> from surctl.sos import monomials
        >>> monomials([0, 1], 2, lowest=1)
        [((0, 1),), ((1, 1),), ((0, 2),), ((0, 1), (1, 1)), ((1, 2),)]
    """
    among = sorted(set(variables))
    out: list[Monomial] = []
    for degree in range(lowest, highest + 1):
        picks = itertools.combinations_with_replacement(among, degree)
        out += [tuple((k, len(list(same))) for k, same in itertools.groupby(picked)) for picked in picks]
    return out


def parity_classes(basis: Sequence[Monomial], polynomials: Iterable[Polynomial]) -> list[list[Monomial]]:
    """Divide a basis into classes between which the Gram matrix may be 0, by the sign symmetries of the polynomials.

    If all polynomials stay unchanged when the signs of some variables change, a sum of squares with that symmetry has a
    Gram matrix with one block for each class.

    Example:
        >>> from surctl.sos import Polynomial, monomials, parity_classes
        >>> x, y = Polynomial.variables(2)
        >>> parity_classes(monomials([0, 1], 1), [x**2 + x * y])
        [[()], [((0, 1),), ((1, 1),)]]
    """
    # the odd variables of all monomials span a space over the integers modulo 2; masks are its vectors
    reduced: dict[int, int] = {}

    def remainder(mask: int) -> int:
        while mask and (top := mask.bit_length()) in reduced:
            mask ^= reduced[top]
        return mask

    for polynomial in polynomials:
        for m in polynomial.terms:
            mask = remainder(_odd(m))
            if mask:
                reduced[mask.bit_length()] = mask
    classes: dict[int, list[Monomial]] = {}
    for m in basis:
        mask, low = _odd(m), 0
        while mask:
            top = mask.bit_length()
            if top in reduced:
                mask ^= reduced[top]
            else:
                low |= 1 << (top - 1)
                mask ^= 1 << (top - 1)
        classes.setdefault(low, []).append(m)
    return list(classes.values())


def _odd(m: Monomial) -> int:
    return sum(1 << k for k, e in m if e % 2)
