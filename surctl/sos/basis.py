"""Monomial bases of Gram matrices: a polynomial z' G z with G ⪰ 0 is a sum of squares."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_mat
from numpy.typing import NDArray

from surctl.sos.polynomial import Monomial, Polynomial


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
        >>> from surctl.sos import Polynomial, monomials
        >>> from surctl.sos.basis import parity_classes
        >>> x, y = Polynomial.variables(2)
        >>> parity_classes(monomials([0, 1], 1), [x**2 + x * y])
        [[()], [((0, 1),), ((1, 1),)]]
    """
    # the odd variables of all monomials span a space over the integers modulo 2; masks are its vectors
    reduced: dict[int, int] = {}

    def remainder(mask: int) -> int:
        for top in sorted(reduced, reverse=True):
            mask ^= reduced[top] if mask >> top & 1 else 0
        return mask

    for odd in {_odd(m) for polynomial in polynomials for m in polynomial.terms}:
        if mask := remainder(odd):
            reduced[mask.bit_length() - 1] = mask
    classes: dict[int, list[Monomial]] = {}
    for m in basis:
        classes.setdefault(remainder(_odd(m)), []).append(m)
    return list(classes.values())


def _odd(m: Monomial) -> int:
    return sum(1 << k for k, e in m if e % 2)


# Removal of monomials whose diagonal entry in a Gram matrix must be 0


_POSITIVE, _TINY, _DENOMINATOR = 1e-9, 1e-7, 4096  # of a weight at a zero; error and denominator of rational rows
_BITS = 16  # of the exponent of one variable in the number of a monomial


@dataclass(frozen=True)
class Gram:
    """An unknown sum of squares times a weight.

    Attributes:
        at: index of the weight; −1 for the weight 1.
        weight: the weight.
        basis: monomials of the Gram matrix.
        forms: polynomials in these monomials that replace them; empty for the monomials themselves.
    """

    at: int
    weight: Polynomial
    basis: tuple[Monomial, ...]
    forms: tuple[Polynomial, ...] = ()

    @property
    def roots(self) -> tuple[Polynomial, ...]:
        """The polynomials b of the sum of squares b' H b."""
        return self.forms or tuple(map(Polynomial.monomial, self.basis))


def restricted(gram: Gram, zeros: Sequence[Sequence[Fraction | float]]) -> Gram:
    """Return the block with forms that are 0 at each zero of the target where the block's weight is positive.

    A target that is 0 at a point of the set has only squares that are 0 there. Zeros in floats are irrational: a
    polynomial with rational coefficients also has their conjugates as zeros, so that the equations of all of them
    together have rational coefficients.
    """
    own = [zero for zero in zeros if gram.weight.value(zero) > _POSITIVE]
    rows = [[Polynomial.monomial(m).value(zero) for m in gram.basis] for zero in own]
    exact = [not isinstance(zero[0], float) for zero in own]
    values = [[Fraction(x) for x in row] for row, known in zip(rows, exact, strict=True) if known]
    values += _rational(np.array([row for row, known in zip(rows, exact, strict=True) if not known], dtype=float))
    flat = [fmpq(*x.as_integer_ratio()) for row in values for x in row]
    pivots = echelon(fmpq_mat(len(values), len(gram.basis), flat))
    if not pivots:
        return gram
    forms = []
    for k, m in enumerate(gram.basis):
        if k not in pivots:
            terms = {gram.basis[at]: -row[k] for at, row in pivots.items() if row[k]}
            forms.append(Polynomial({m: Fraction(1), **terms}))
    return replace(gram, forms=tuple(forms), basis=gram.basis if forms else ())


def echelon(matrix: fmpq_mat) -> dict[int, list[Fraction]]:
    """Return the nonzero rows of the reduced row echelon form of a matrix, by the column of their leading 1."""
    reduced, rank = matrix.rref()
    rows = [[Fraction(int(x.p), int(x.q)) for x in row] for row in reduced.tolist()[:rank]]
    return {next(k for k, x in enumerate(row) if x): row for row in rows}


def _rational(rows: NDArray[np.float64]) -> list[list[Fraction]]:
    """Return the reduced rows of a matrix whose rows span a rational subspace; nothing if it is not rational."""
    from scipy.linalg import qr

    if not rows.size:
        return []
    _, upper, order = qr(rows, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(upper)) > _TINY).sum())
    reduced = np.empty((rank, rows.shape[1]))
    reduced[:, order] = np.linalg.solve(upper[:rank, :rank], upper[:rank])
    near = [[Fraction(x).limit_denominator(_DENOMINATOR) for x in row] for row in reduced.tolist()]
    return near if np.all(np.abs(np.array(near, dtype=float) - reduced) <= _TINY) else []


def pruned(
    target: Polynomial, grams: Sequence[Gram], free: Sequence[tuple[Polynomial, Sequence[Monomial]]]
) -> list[Gram]:
    """Return the blocks without the monomials whose diagonal entries are 0 in every identity with the target.

    If the coefficient of a monomial is 0 in the target, and only diagonal entries of Gram matrices with coefficients of
    one sign have an influence on it, these entries are 0.

    Args:
        target: the polynomial that the sum of all blocks must equal.
        grams: the blocks.
        free: relations with the monomials of their unknown multipliers, which have any sign.
    """
    code = _coded
    fixed = {code(m) for m in target.terms}
    for relation, some in free:
        fixed |= {code(m) + code(n) for m in some for n in relation.terms}
    blocks = list(grams)
    while True:
        signed: dict[int, set[tuple[int, Monomial, bool]]] = {}
        mixed = set(fixed)
        for block, gram in enumerate(blocks):
            basis = [code(m) for m in gram.basis]
            products = {m + n for i, m in enumerate(basis) for n in basis[:i]}
            for w, c in gram.weight.terms.items():
                offset = code(w)
                mixed.update([product + offset for product in products])
                for m, own in zip(gram.basis, basis, strict=True):
                    signed.setdefault(2 * own + offset, set()).add((block, m, c > 0))
        gone: set[tuple[int, Monomial]] = set()
        for product, entries in signed.items():
            if product not in mixed and len({sign for _, _, sign in entries}) == 1:
                gone |= {(block, m) for block, m, _ in entries}
        if not gone:
            return [gram for gram in blocks if gram.basis]
        blocks = [
            replace(gram, basis=tuple(m for m in gram.basis if (block, m) not in gone))
            for block, gram in enumerate(blocks)
        ]


def _coded(m: Monomial) -> int:
    """Return a number of a monomial; the number of a product is the sum, which is much faster to form."""
    return sum(e << (_BITS * k) for k, e in m)
