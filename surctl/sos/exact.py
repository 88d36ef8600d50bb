"""Exact proofs that a polynomial is not negative where others are not negative: sums of squares with rational numbers.

The proof is an identity target = Σ_k σ_k · weight_k + Σ_j h_j · relation_j. Each σ_k is a sum of squares, each weight
is a polynomial that is not negative, and each relation is a polynomial that is 0. A semidefinite program proposes the
numbers. They are rounded, and the rounding error is moved into entries of the Gram matrices, so that the identity holds
exactly. An exact test shows that the Gram matrices are positive semidefinite.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, islice
from math import ceil, lcm, log2
from typing import NamedTuple

import numpy as np
from flint import fmpq, fmpq_mat

from surctl.certcheck.definite import is_semidefinite
from surctl.sos.basis import Gram, echelon, monomials, parity_classes, pruned, restricted
from surctl.sos.polynomial import Monomial, Polynomial, from_ring, in_ring, joined
from surctl.sos.program import Proposal, best_identity

_LARGEST = 120  # largest size of a Gram matrix


# Exact solution of linear equations by a change of few unknowns


Name = tuple[int, int | Monomial]
_MOST = 2_000_000  # most coefficients of the equations


class LinearUnknown(NamedTuple):
    """An unknown of linear equations.

    Attributes:
        name: index of the block and place of the entry, or index of the relation and monomial of its multiplier.
        row: its coefficient in each equation.
        rank: unknowns of a low rank are changed first.
    """

    name: Name
    row: Mapping[Monomial, Fraction]
    rank: int


def corrected(rest: Mapping[Monomial, Fraction], columns: Sequence[LinearUnknown]) -> dict[Name, Fraction] | None:
    """Return changes of unknowns such that Σ change · row = rest; None if there are none.

    Unknowns that few equations contain are changed first.

    Args:
        rest: right side of the equations; 0 where a monomial is missing.
        columns: the unknowns.
    """
    order = sorted(columns, key=lambda column: (len(column.row), column.rank))
    place = {m: k for k, m in enumerate(dict.fromkeys(m for column in order for m in column.row))}
    if any(c and m not in place for m, c in rest.items()) or len(place) * len(order) > _MOST:
        return None
    matrix = fmpq_mat(len(place), len(order) + 1)
    for k, row in enumerate([*(column.row for column in order), rest]):
        for m, c in row.items():
            matrix[place[m], k] = fmpq(*c.as_integer_ratio())
    reduced, changes = echelon(matrix), dict[Name, Fraction]()
    for pivot, entries in reduced.items():
        if pivot == len(order):
            return None
        if entries[-1]:
            changes[order[pivot].name] = entries[-1]
    return changes


_LEAST = 1e-11  # a smaller least eigenvalue of the numerical Gram matrices leaves no margin for rounding
_PER_ENTRY = 5e-10  # [s] per cube of a number of entries: a block of size 65 takes about 5 s
_SPARE = (3, 10, 18)  # bits of the rounding beyond the size of the least eigenvalue, by attempt


@dataclass(frozen=True)
class GramBlock:
    """A sum of squares z' G z times a weight.

    Attributes:
        weight: index of the weight; −1 for the weight 1.
        basis: the monomials z (n).
        entries: the lower triangle of G, row by row.
    """

    weight: int
    basis: tuple[Monomial, ...]
    entries: tuple[Fraction, ...]


@dataclass(frozen=True)
class Certificate:
    """An exact identity target = Σ σ_k · weight_k + Σ h_j · relation_j, once the remainder is added.

    The blocks leave a small remainder polynomial: target minus the right side. For each of its monomials, the
    coefficient is added to the first entry of the blocks with weight 1 whose two monomials have that product (half of
    it to each of two symmetric entries). The matrices are positive semidefinite after this step.

    Attributes:
        blocks: the sums of squares.
        multipliers: the polynomial h of each relation.
        least: least eigenvalue of the numerical Gram matrices, relative to the largest coefficient; 0 if the target is
            a sum of squares in only one way, which needs no numbers.
    """

    blocks: tuple[GramBlock, ...]
    multipliers: tuple[Polynomial, ...]
    least: float


def certify(
    target: Polynomial,
    weights: Sequence[Polynomial] = (),
    *,
    relations: Sequence[Polynomial] = (),
    zeros: Sequence[Sequence[Fraction | float]] = (),
    degree: int | None = None,
    seconds: float = 60.0,
) -> Certificate | None:
    """Prove that a polynomial is not negative where all weights are not negative and all relations are 0.

    Scale the variables so that the set of interest has a size of about 1. If the target is 0 at a point of the set,
    move this point to 0.

    Args:
        target: the polynomial, with exact coefficients.
        weights: polynomials with exact coefficients; products of weights must be listed as weights.
        relations: polynomials with exact coefficients that are 0.
        zeros: points of the set, other than 0, at which the target is 0; a proof then needs all of them.
        degree: largest degree of the products in the identity; by default the largest of the given degrees.
        seconds: limit of the processor time [s]; the solver stops after four times as much wall-clock time.

    Returns:
        The proof; None if none is found.

    Example:
        >>> from surctl.sos import Polynomial, certify
        >>> x, y = Polynomial.variables(2)
        >>> proof = certify(2 - x - y, [1 - x**2 - y**2])
        >>> [(block.weight, len(block.basis)) for block in proof.blocks]
        [(-1, 3), (0, 1)]
        >>> certify(1 - x - y, [1 - x**2 - y**2]) is None
        True
    """
    began = time.process_time()
    if not target.terms:
        return Certificate((), tuple(Polynomial({}) for _ in relations), 0.0)
    highest = max(p.degree for p in (target, *weights, *relations)) if degree is None else degree
    highest += highest % 2
    grams, free = _candidates(target, weights, relations, highest)
    grams = pruned(target, grams, [(relations[j], f) for j, f in enumerate(free)])
    grams = [gram for gram in (restricted(g, zeros) for g in grams) if gram.basis]
    grams.sort(key=lambda gram: bool(gram.forms))  # a remainder goes to the first block that can take it
    if not grams or max(len(g.basis) for g in grams) > _LARGEST or _expected(grams) > seconds:
        return None
    if not relations and all(gram.at < 0 and not gram.forms for gram in grams):
        pairs = _pairs(grams)
        if all(len(places) == 1 for places in pairs.values()):
            return _only(target, grams, pairs)
    size = Fraction(2) ** round(log2(max(abs(float(c)) for c in target.terms.values())))
    scaled = target * (1 / size)
    left = max(4 * (seconds - (time.process_time() - began)), 1.0)
    solution = best_identity(scaled, grams, relations, free, seconds=left)
    if solution is None or solution.least < _LEAST:
        return None
    for spare in _SPARE:
        if time.process_time() - began > seconds:
            return None
        rounded = _rounded(scaled, grams, relations, solution, spare)
        if rounded is not None:
            blocks, polynomials = rounded
            blocks = [GramBlock(b.weight, b.basis, tuple(x * size for x in b.entries)) for b in blocks]
            return Certificate(tuple(blocks), tuple(p * size for p in polynomials), solution.least)
    return None


def _only(
    target: Polynomial, grams: Sequence[Gram], pairs: Mapping[Monomial, Sequence[tuple[int, int, int]]]
) -> Certificate | None:
    """Return the only sum of squares that the target can be, if each monomial is the product of one pair."""
    values = [[Fraction(0)] * (len(g.basis) * (len(g.basis) + 1) // 2) for g in grams]
    for m, c in target.terms.items():
        if m not in pairs:
            return None
        [(block, place, weight)] = pairs[m]
        values[block][place] = c / weight
    if not all(_semidefinite(len(g.basis), v) for g, v in zip(grams, values, strict=True)):
        return None
    return Certificate(tuple(GramBlock(-1, g.basis, tuple(v)) for g, v in zip(grams, values, strict=True)), (), 0.0)


def completed(target: Polynomial, blocks: Sequence[GramBlock]) -> tuple[GramBlock, ...]:
    """Return blocks with weight 1 whose sum is exactly the target, with the remainder of a certificate added.

    Args:
        target: the target of the certificate.
        blocks: all blocks of the certificate; each has the weight 1.

    Example:
        >>> from surctl.sos import Polynomial, certify, completed
        >>> x, y = Polynomial.variables(2)
        >>> target = 3 * x**2 - 2 * x * y + y**2
        >>> [block] = completed(target, certify(target).blocks)
        >>> block.entries == (3, -1, 1)
        True
    """
    grams = [Gram(-1, Polynomial.constant(1), block.basis) for block in blocks]
    rest = _remainder(target, grams, [block.entries for block in blocks], (), ())
    waiting = dict(rest.terms)
    total = []
    for block in blocks:
        entries = list(block.entries)
        for at, (i, j) in enumerate(zip(*np.tril_indices(len(block.basis)), strict=True)):
            c = waiting.pop(joined(block.basis[i], block.basis[j]), None)
            if c is not None:
                entries[at] += c if i == j else c / 2
        total.append(replace(block, entries=tuple(entries)))
    return tuple(total)


def _expected(grams: Sequence[Gram]) -> float:
    """Return a rough estimate of the solver's time [s]: it factors a dense matrix of the entries of each block."""
    return sum((len(g.basis) * (len(g.basis) + 1) / 2) ** 3 for g in grams) * _PER_ENTRY


def _candidates(
    target: Polynomial, weights: Sequence[Polynomial], relations: Sequence[Polynomial], highest: int
) -> tuple[list[Gram], list[list[Monomial]]]:
    """Return the Gram blocks to try, and the monomials of each relation's multiplier."""
    among = sorted({k for p in (target, *weights, *relations) for m in p.terms for k, _ in m})
    # where the target is 0, a sum of squares with a positive weight is 0 as well
    vanishes = () not in target.terms
    symmetric = [target, *weights, *relations]
    grams = []
    for at, weight in [(-1, Polynomial.constant(1)), *enumerate(weights)]:
        half = (highest - weight.degree) // 2
        if half < 0:
            continue
        positive = weight.terms.get((), 0) > 0
        basis = monomials(among, half, lowest=1 if vanishes and positive else 0)
        grams += [Gram(at, weight, tuple(part)) for part in parity_classes(basis, symmetric)]
    free = [
        parity_classes(monomials(among, highest - r.degree), symmetric)[0] if highest >= r.degree else []
        for r in relations
    ]
    return grams, free


def _rounded(
    target: Polynomial, grams: Sequence[Gram], relations: Sequence[Polynomial], solution: Proposal, spare: int
) -> tuple[list[GramBlock], list[Polynomial]] | None:
    """Return the rounded blocks and multipliers; None if a matrix is not positive semidefinite."""
    most = max(len(g.roots) for g in grams)
    grid = 2 ** min(max(ceil(log2(most / solution.least)) + spare, 8), 60)

    def near(x: float) -> Fraction:
        return Fraction(round(x * grid), grid)

    values = [[near(x) for x in matrix[np.tril_indices(len(matrix))].tolist()] for matrix in solution.grams]
    polynomials = [{m: near(c) for m, c in h.items()} for h in solution.multipliers]
    pairs = _pairs(grams)
    rest = _remainder(target, grams, values, relations, polynomials)
    outside = {m: c for m, c in rest.terms.items() if m not in pairs}
    if outside:
        columns = _columns(grams, relations, solution.multipliers, pairs)
        changes = corrected(outside, columns)
        if changes is None:
            return None
        for (at, place), change in changes.items():
            if isinstance(place, int):
                values[at][place] += change
            else:
                polynomials[at][place] = polynomials[at].get(place, Fraction(0)) + change
        rest = _remainder(target, grams, values, relations, polynomials)
    # spread the remainder evenly, round it, and leave to the reader what is less than the grid
    left = dict(rest.terms)
    for m, c in left.items():
        places = pairs.get(m)
        if places is None:
            return None
        weights = sum(w for _, _, w in places)
        share = Fraction(round(float(c) / weights * grid), grid)
        for block, place, _ in places:
            values[block][place] += share
        left[m] = c - share * weights
    full = [list(v) for v in values]
    for m, c in left.items():
        block, place, weight = pairs[m][0]
        full[block][place] += c / weight
    if not all(_semidefinite(len(g.roots), v) for g, v in zip(grams, full, strict=True)):
        return None
    blocks = [GramBlock(g.at, g.basis, _expanded(g, v)) for g, v in zip(grams, values, strict=True)]
    return blocks, [Polynomial({m: c for m, c in p.items() if c}) for p in polynomials]


def _pairs(grams: Sequence[Gram]) -> dict[Monomial, list[tuple[int, int, int]]]:
    """Return, by monomial, the entries of the blocks with the weight 1: block, place, and 1 or 2 for off-diagonal."""
    pairs: dict[Monomial, list[tuple[int, int, int]]] = {}
    for block, gram in enumerate(grams):
        if gram.at < 0 and not gram.forms:
            place = 0
            for i, m in enumerate(gram.basis):
                for j, n in enumerate(gram.basis[: i + 1]):
                    pairs.setdefault(joined(m, n), []).append((block, place, 1 if i == j else 2))
                    place += 1
    return pairs


def _remainder(
    target: Polynomial,
    grams: Sequence[Gram],
    values: Sequence[Sequence[Fraction]],
    relations: Sequence[Polynomial],
    polynomials: Sequence[Mapping[Monomial, Fraction]],
) -> Polynomial:
    """Return target − Σ σ_k · weight_k − Σ h_j · relation_j."""
    roots = [gram.roots for gram in grams]
    others = [*(gram.weight for gram in grams), *relations, *(Polynomial(terms) for terms in polynomials)]
    rest, *every = in_ring(target, *others, *chain.from_iterable(roots))
    factors, products = every[: len(others)], iter(every[len(others) :])
    for gram, entries, weight in zip(roots, values, factors, strict=False):
        own, total, place = list(islice(products, len(gram))), 0 * rest, iter(entries)
        for i, p in enumerate(own):
            for j in range(i + 1):
                x = next(place) * (1 if i == j else 2)
                total += fmpq(*x.as_integer_ratio()) * p * own[j]
        rest -= total * weight
    for relation, multiplier in zip(factors[len(grams) :], factors[len(grams) + len(relations) :], strict=False):
        rest -= relation * multiplier
    return from_ring(rest)


def _expanded(gram: Gram, entries: Sequence[Fraction]) -> tuple[Fraction, ...]:
    """Return the lower triangle of the Gram matrix of the monomials, from that of the forms."""
    if not gram.forms:
        return tuple(entries)
    rows = [[f.terms.get(m, Fraction(0)) for m in gram.basis] for f in gram.forms]
    full = _full(len(rows), entries)
    columns = [[row[k] for row in rows] for k in range(len(gram.basis))]
    half = [[_dot(row, column) for row in full] for column in columns]
    return tuple(_dot(columns[i], half[j]) for i in range(len(columns)) for j in range(i + 1))


def _dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def _columns(
    grams: Sequence[Gram],
    relations: Sequence[Polynomial],
    multipliers: Sequence[Mapping[Monomial, float]],
    inside: Mapping[Monomial, object],
) -> list[LinearUnknown]:
    """Return the unknowns that change coefficients which no block with the weight 1 has."""
    columns = []
    for at, (relation, unknown) in enumerate(zip(relations, multipliers, strict=True)):
        for m in unknown:
            row = {joined(m, n): c for n, c in relation.terms.items()}
            columns.append(LinearUnknown((at, m), {m: c for m, c in row.items() if m not in inside}, 0))
    for at, gram in enumerate(grams):
        place = 0
        roots = gram.roots if gram.at >= 0 or gram.forms else ()
        for i, p in enumerate(roots):
            for j, q in enumerate(roots[: i + 1]):
                product = p * q * gram.weight * (1 if i == j else 2)
                row = {m: c for m, c in product.terms.items() if m not in inside}
                columns.append(LinearUnknown((at, place), row, 2 if i == j else 1))
                place += 1
    return [c for c in columns if c.row]


def _semidefinite(size: int, entries: Sequence[Fraction]) -> bool:
    over = lcm(*(x.denominator for x in entries))
    return is_semidefinite([[x.numerator * (over // x.denominator) for x in row] for row in _full(size, entries)])


def _full(size: int, entries: Sequence[Fraction]) -> list[list[Fraction]]:
    """Return the symmetric matrix with this lower triangle."""
    matrix = [[Fraction(0)] * size for _ in range(size)]
    for i, j, x in zip(*np.tril_indices(size), entries, strict=True):
        matrix[i][j] = matrix[j][i] = x
    return matrix
