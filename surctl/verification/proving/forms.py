"""Forms in which a case may be proved: as written, or in normal form minus nonnegative multiples of constraints."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from surctl.certcheck.arrays import Ends
from surctl.certcheck.derivative import branched, branches_of
from surctl.sos.polynomial import Monomial, Polynomial
from surctl.verification.claim import Claim
from surctl.verification.formula import Node, Statement, from_casadi, number, ordered, power, reread, substitute
from surctl.verification.formula.node import nodes_of, table_of
from surctl.verification.proving.algebra import Algebra, Ratio, TooLarge, Written
from surctl.verification.proving.tape import build_tape
from surctl.verification.proving.touching import touching_form

# Claims as exact expressions, split into cases: in a case, every min, max, abs and select takes one branch


MOST_BRANCHES = 5
"""The largest number of min, max, abs and select in a claim that is split into cases."""


@dataclass(frozen=True, eq=False)
class Case:
    """A case of a statement: every branching expression (min, max, abs, select) takes one of its branches.

    Attributes:
        choice: "0" or "1" for each branching expression, in the order in which the expressions occur in left, right and
            the constraints; empty if there is no branching expression.
        margin: left − right.
        constraints: the constraints of the statement, then one constraint for each chosen branch.
        touching: values of variables for which the margin is 0, if known.
    """

    choice: str
    margin: Node
    constraints: tuple[Node, ...]
    touching: Mapping[str, Fraction] = field(default_factory=dict)


def statement_of(claim: Claim) -> Statement:
    """Return the claim's expressions with exact numbers.

    Raises:
        UnsupportedOperation: the claim has an operation that the claim grammar lacks.
        InputError: an expression is too long to write out.
    """
    if claim.exact is not None:
        return claim.exact
    names = tuple(v.name for v in claim.variables)
    rows = [claim.constraints[k] for k in range(claim.constraints.numel())]
    nodes = from_casadi(claim.symbols, names, [claim.left, claim.right, *rows])
    nodes = [reread(node, names) for node in nodes]  # as a reader of the certificate obtains them
    return Statement(names, claim.lower, claim.upper, nodes[0], nodes[1], tuple(nodes[2:]))


def substituted(statement: Statement) -> tuple[Node, ...]:
    """Return left, right and constraints; a variable with equal bounds is replaced by its decimal value."""
    ends = zip(statement.names, statement.lower, statement.upper, strict=True)
    fixed = {name: number(Fraction(repr(float(low)))) for name, low, high in ends if low == high}
    return tuple(substitute(part, fixed) for part in statement.parts) if fixed else statement.parts


def cases_of(parts: Sequence[Node]) -> list[Case]:
    """Return one case for each choice of branches; if there are too many branches, a single case without choices."""
    table, roots = table_of(sorted({node.name for node in ordered(*parts) if node.op == "var"}), parts)
    branches = branches_of(table, roots)
    if not 0 < len(branches) <= MOST_BRANCHES:
        return [Case("", parts[0] - parts[1], tuple(parts[2:]))]
    choices = [format(bits, f"0{len(branches)}b") for bits in range(2 ** len(branches))]
    split = [branched(table, roots, dict(zip(branches, choice, strict=True))) for choice in choices]
    nodes = nodes_of(table)
    return [
        Case(choice, nodes[left] - nodes[right], tuple(nodes[k] for k in (*rows, *conditions)))
        for choice, ((left, right, *rows), conditions) in zip(choices, split, strict=True)
    ]


_STEPS, _TRIALS = 4, 12
_MOST_TERMS = 60


@dataclass(frozen=True, eq=False)
class Form:
    """A form of the margin left − right of a case: numerator / Π denominators + Σ multiplier · constraint.

    All multipliers are ≥ 0 and all denominators are > 0.

    Attributes:
        numerator: expression for which numerator ≤ 0 remains to be proved.
        denominators: positive expressions; a power is listed as repeated factors.
        multipliers: nonnegative expressions, one for each constraint.
    """

    numerator: Node
    denominators: tuple[Node, ...]
    multipliers: tuple[Node, ...]


def forms_of(case: Case, names: Sequence[str], box: Ends) -> list[Form]:
    """Return the forms to try, the most promising form first; the form as written is always among them.

    Args:
        case: the case.
        names: names of the variables.
        box: the root box (n, 1).
    """
    plain = as_written(case)
    try:
        forms = [*_rewritten(case, names, box), plain]
    except TooLarge:
        forms = [plain]
    return [*_touching(case, names, box), *forms]


def as_written(case: Case) -> Form:
    """Return the form without any rewriting."""
    return Form(case.margin, (), (number(0),) * len(case.constraints))


class Normal(NamedTuple):
    """A case in normal form: margin = over / Π under; `factors` are all denominators as positive expressions."""

    algebra: Algebra
    written: Written
    margin: Ratio
    over: Polynomial
    signs: dict[int, int]
    factors: dict[int, Node]
    under: tuple[Node, ...]
    guards: list[Ratio | None]


def normal_form(case: Case, names: Sequence[str], box: Ends, most: int, *, split: bool = False) -> Normal | None:
    """Return a case in normal form; None if a denominator has no certain sign, or the margin over `most` terms.

    Raises:
        TooLarge: the margin has no normal form.
    """
    algebra = Algebra(split=split)
    margin = algebra.of(case.margin)
    guards = [_constraint_ratio(algebra, c) for c in case.constraints]
    written = Written(algebra)
    signs = _signs_of(algebra, written, names, box) if len(margin.over.terms) <= most else None
    if signs is None:
        return None
    factors = {at: written.factor(at) if sign > 0 else -written.factor(at) for at, sign in signs.items()}
    under = tuple(itertools.chain.from_iterable((factors[at],) * e for at, e in margin.under))
    return Normal(algebra, written, margin, _signed(margin, signs), signs, factors, under, guards)


def _touching(case: Case, names: Sequence[str], box: Ends) -> Iterator[Form]:
    """Yield the form whose terms are all exactly 0 where the claim holds with equality, if this is known."""
    if not case.touching:
        return
    with suppress(TooLarge):
        if (normal := normal_form(case, names, box, _MOST_TERMS, split=True)) is not None:
            node = touching_form(normal.algebra, normal.written, normal.over, case.touching)
            if node is not None:
                yield Form(node, normal.under, (number(0),) * len(case.constraints))


def _rewritten(case: Case, names: Sequence[str], box: Ends) -> Iterator[Form]:
    normal = normal_form(case, names, box, _MOST_TERMS)
    if normal is None:
        return
    written = normal.written
    ratios = [None if g is None else Ratio(_signed(g, normal.signs), g.under) for g in normal.guards]
    rest, weights = _reduced(normal.algebra, normal.over, ratios, _Sizes(normal.algebra, written, names, box))
    if any(weights):
        multipliers = [_multiplier(normal, poly, ratio) for poly, ratio in zip(weights, ratios, strict=True)]
        yield Form(written.poly(rest), normal.under, tuple(multipliers))
    yield Form(written.poly(normal.over), normal.under, (number(0),) * len(ratios))


def _constraint_ratio(algebra: Algebra, constraint: Node) -> Ratio | None:
    """Return a constraint as a ratio of polynomials; None if it is too large."""
    try:
        return algebra.of(constraint)
    except TooLarge:
        return None


def _signs_of(algebra: Algebra, written: Written, names: Sequence[str], box: Ends) -> dict[int, int] | None:
    """Return the sign of every denominator on the box; None if a sign is unknown or not as a rewriting assumed."""
    signs: dict[int, int] = {}
    if not algebra.factors:
        return signs
    read = build_tape(names, [written.factor(at) for at in range(len(algebra.factors))]).run(box)
    for at, (jet, fine) in enumerate(zip(read.jets, read.defined, strict=True)):
        positive, negative = bool(jet.value[0][0] > 0), bool(jet.value[1][0] < 0)
        if not fine[0] or not (positive or negative) or (negative and at in algebra.positive):
            return None
        signs[at] = 1 if positive else -1
    return signs


def _signed(ratio: Ratio, signs: dict[int, int]) -> Polynomial:
    """Return the numerator of a fraction whose denominators have these signs, for positive denominators."""
    flips = sum(e for at, e in ratio.under if signs[at] < 0)
    return -ratio.over if flips % 2 else ratio.over


def _multiplier(normal: Normal, weight: Polynomial, guard: Ratio | None) -> Node:
    """Return the multiplier weight · (denominator of the constraint) / (denominator of the margin) as an expression."""
    if guard is None or not weight:
        return number(0)
    tree = normal.written.poly(weight)
    for at, exponent in guard.under:
        tree = tree * power(normal.factors[at], exponent)
    for at, exponent in normal.margin.under:
        tree = tree / power(normal.factors[at], exponent)
    return tree


class _Sizes:
    # ranges on the root box guide the search; they are not part of a proof
    def __init__(self, algebra: Algebra, written: Written, names: Sequence[str], box: Ends) -> None:
        self._written, self._names, self._box = written, names, box
        nodes = [written.atom(at) for at in range(len(algebra.atoms))]
        read = build_tape(names, nodes).run(box) if nodes else None
        self._ends = [(float(j.value[0][0]), float(j.value[1][0])) for j in read.jets] if read else []

    def of(self, monomial: Monomial) -> tuple[float, float]:
        low, high = 1.0, 1.0
        for at, exponent in monomial:
            a, b = self._ends[at]
            try:
                ends = [a**exponent, b**exponent] + [0.0] * (a < 0 < b and exponent % 2 == 0)
            except OverflowError:
                return -float("inf"), float("inf")
            products = [x * y for x in (low, high) for y in (min(ends), max(ends))]
            low, high = min(products), max(products)
        return low, high

    def bound(self, poly: Polynomial) -> float:
        """Return an upper bound of the polynomial on the root box, computed in nested form."""
        high = float(build_tape(self._names, [self._written.poly(poly)]).run(self._box).jets[0].value[1][0])
        return high if np.isfinite(high) else float("inf")

    def worst(self, poly: Polynomial) -> float:
        """Return an upper bound of the polynomial, summed term by term: coarser than `bound`, but faster."""
        total = 0.0
        for monomial, coefficient in poly.terms.items():
            total += max(float(coefficient) * end for end in self.of(monomial))
        return total if np.isfinite(total) else float("inf")


def _reduced(
    algebra: Algebra, over: Polynomial, guards: Sequence[Ratio | None], sizes: _Sizes
) -> tuple[Polynomial, list[Polynomial]]:
    """Subtract nonnegative monomials times constraints from the numerator while its upper bound decreases.

    Return the remaining numerator and the monomials.
    """
    weights: list[Polynomial] = [Polynomial({}) for _ in guards]
    rest, bound = over, sizes.bound(over)
    for _ in range(_STEPS):
        if bound <= 0:
            break
        trials = [
            (rest - algebra.product(factor, guard.over), j, factor)
            for j, guard in enumerate(guards)
            if guard is not None
            for factor in _candidates(rest, guard.over, sizes)
        ]
        trials = sorted(trials, key=lambda trial: (sizes.worst(trial[0]), len(trial[0].terms)))[:_TRIALS]
        if not trials:
            break
        least, k = min((sizes.bound(trial), k) for k, (trial, _, _) in enumerate(trials))
        if least >= bound * (1 - 1e-9):
            break
        bound = least
        rest, j, factor = trials[k]
        weights[j] = weights[j] + factor
    return rest, weights


def _candidates(rest: Polynomial, guard: Polynomial, sizes: _Sizes) -> Iterator[Polynomial]:
    """Yield nonnegative monomials whose product with the constraint cancels a term of the numerator."""
    visited: set[tuple[Monomial, object]] = set()
    for m, c in rest.terms.items():
        powers = dict(m)
        for g, d in guard.terms.items():
            if c / d <= 0 or any(powers.get(at, 0) < e for at, e in g):
                continue
            less = dict(g)
            quotient = tuple((at, e - less.get(at, 0)) for at, e in m if e > less.get(at, 0))
            if (quotient, c / d) in visited or sizes.of(quotient)[0] < 0:
                continue
            visited.add((quotient, c / d))
            yield Polynomial({quotient: c / d})
