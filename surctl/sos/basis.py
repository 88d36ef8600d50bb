"""Monomial bases of Gram matrices: a polynomial z' G z with G ⪰ 0 is a sum of squares."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

from surctl.sos.polynomial import Monomial, Polynomial, joined

__all__ = ["gram_basis", "monomials", "parity_classes"]


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


def gram_basis(polynomial: Polynomial, candidates: Sequence[Monomial] | None = None) -> list[Monomial]:
    """Return the monomials that can occur in the squares of a sum of squares with the polynomial's monomials.

    The candidates are all monomials of half the polynomial's degrees, unless given. A monomial m is left out if m² is
    neither a monomial of the polynomial nor the product of two other monomials of the basis, because its diagonal entry
    in the Gram matrix is then 0. So the monomial 1 is left out if the polynomial vanishes to second order at 0. The
    result is contained in half the Newton polytope.

    Example:
        >>> from surctl.sos import Polynomial, gram_basis
        >>> x, y = Polynomial.variables(2)
        >>> gram_basis(x**4 * y**2 + x**2 * y**4 + 1 - 3 * x**2 * y**2)  # the Motzkin polynomial
        [(), ((0, 1), (1, 1)), ((0, 2), (1, 1)), ((0, 1), (1, 2))]
    """
    support = set(polynomial.terms)
    if candidates is None:
        among = sorted({k for m in support for k, _ in m})
        candidates = monomials(among, polynomial.degree // 2, lowest=(polynomial.order + 1) // 2)
        highest = {k: max(dict(m).get(k, 0) for m in support) for k in among}
        candidates = [m for m in candidates if all(2 * e <= highest[k] for k, e in m)]
    basis = list(candidates)
    while True:
        sums = set(support)
        for a, b in itertools.combinations(basis, 2):
            sums.add(joined(a, b))
        fewer = [m for m in basis if joined(m, m) in sums]
        if len(fewer) == len(basis):
            return basis
        basis = fewer


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
