"""Proof of a case by sums of squares: its normal form as a polynomial, and what is known of the polynomial's atoms."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property, reduce
from math import ceil, log2, prod
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.sos.exact import Certificate, certify, completed
from surctl.sos.polynomial import Monomial, Polynomial, quotient
from surctl.verification.formula import Node, exact_values, number, ordered, text_of
from surctl.verification.proving.algebra import MOST_TERMS, Ratio, TooLarge
from surctl.verification.proving.forms import Case, Form, normal_form
from surctl.verification.proving.tape import build_tape
from surctl.verification.proving.touching import fact_polynomial, facts_about

# Search for points at which a polynomial that is not negative is 0: a sum of squares is 0 at all of them


_STARTS, _MOST_VARIABLES = 40, 4
_SMALL, _DENOMINATOR = 1e-7, 24
_STEPS, _CLEAR, _APART = 8, 1e-13, 1e-6  # Newton steps; relative value at, and distance between, irrational zeros


def zeros_of(
    target: Polynomial,
    box: Sequence[tuple[Fraction, Fraction]],
    sides: Sequence[Polynomial],
    *,
    scales: Sequence[Fraction],
) -> list[tuple[Fraction | float, ...]]:
    """Return the zeros, other than 0, of a polynomial in a box where all `sides` are not negative.

    A rational zero is exact; an irrational one has floats.

    Args:
        target: the polynomial.
        box: lower and upper end of each variable.
        sides: polynomials of the constraints.
        scales: unit of each variable; zeros are sought whose coordinates in these units have small denominators.
    """
    if len(box) > _MOST_VARIABLES:
        return []
    from scipy.optimize import minimize

    box = _within(box, sides)
    ends = np.array([[float(low), float(high)] for low, high in box])
    if np.any(ends[:, 0] > ends[:, 1]):
        return []
    slopes = [target.derivative(k) for k in range(len(box))]
    size = max(abs(float(c)) for c in target.terms.values())
    rng = np.random.default_rng(0)
    zeros: dict[tuple[Fraction, ...], None] = {}
    others: list[np.ndarray] = []
    for start in rng.uniform(ends[:, 0], ends[:, 1], size=(_STARTS, len(box))):
        best = minimize(
            lambda x: float(target.value(x.tolist())),
            start,
            jac=lambda x: np.array([float(s.value(x.tolist())) for s in slopes]),
            method="L-BFGS-B",
            bounds=ends,
            options={"maxiter": 60},
        )
        if best.fun > _SMALL * size:
            continue
        # the zero itself has a smaller error than the square root of the value
        point = tuple(
            Fraction(float(x * float(s))).limit_denominator(_DENOMINATOR) / s
            for x, s in zip(best.x, scales, strict=True)
        )
        inside = all(low <= x <= high for x, (low, high) in zip(point, box, strict=True))
        if any(point) and inside and target.value(point) == 0 and all(side.value(point) >= 0 for side in sides):
            zeros[point] = None
            continue
        near = _polished(best.x, slopes)
        new = all(np.abs(near - other).max() > _APART for other in others)
        inside = bool(np.all((ends[:, 0] <= near) & (near <= ends[:, 1]))) and np.abs(near).max() > _APART
        value = abs(float(target.value(near.tolist())))
        if new and inside and value <= _CLEAR * size and all(float(s.value(near.tolist())) > 0 for s in sides):
            others.append(near)
    return [*zeros, *(tuple(map(float, near)) for near in others)]


def _polished(point: np.ndarray, slopes: Sequence[Polynomial]) -> np.ndarray:
    """Return the stationary point near a point, by Newton's method."""
    bends = [[slope.derivative(k) for k in range(len(slopes))] for slope in slopes]
    for _ in range(_STEPS):
        at = point.tolist()
        slope = np.array([float(s.value(at)) for s in slopes])
        bend = np.array([[float(b.value(at)) for b in row] for row in bends])
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(bend))):
            break
        point = point - np.linalg.lstsq(bend, slope, rcond=None)[0]
    return point


def _within(box: Sequence[tuple[Fraction, Fraction]], sides: Sequence[Polynomial]) -> list[tuple[Fraction, Fraction]]:
    """Return the box without the part where a bound of one variable, given as polynomial, is negative."""
    ends = [list(pair) for pair in box]
    for side in sides:
        among = {k for m in side.terms for k, _ in m}
        if side.degree != 1 or len(among) != 1:
            continue
        (k,) = among
        slope, offset = side.terms[((k, 1),)], side.terms.get((), Fraction(0))
        if slope > 0:
            ends[k][0] = max(ends[k][0], -offset / slope)
        else:
            ends[k][1] = min(ends[k][1], -offset / slope)
    return [(low, high) for low, high in ends]


Array = NDArray[np.float64]

_MOST_ATOMS, _HIGHEST = 16, 10
_PLAIN = 3  # number of the first identities, for which no zeros of the polynomial are searched
_LEVELS = 3  # the degrees of the identity: that of the polynomial, and 2 and 4 more


class SquaresProof(NamedTuple):
    """Form of the margin and entry `squares` of the case, if sums of squares prove it; what was tried, in words."""

    form: Form | None
    squares: dict[str, Any]
    tried: str


def prove_by_squares(
    case: Case, names: tuple[str, ...], box: tuple[Array, Array], *, seconds: float, most: int | None = None
) -> SquaresProof:
    """Try to prove a case by sums of squares, first with identities of low degree.

    Args:
        case: the case.
        names: names of the variables.
        box: lower and upper bounds of the variables (n,).
        seconds: time limit [s] of processor time.
        most: largest number of identities that are tried.
    """
    try:
        return _tried(case, names, box, time.process_time() + seconds, most)
    except (TooLarge, InputError, ArithmeticError, ValueError):  # no polynomial, or numbers beyond the range of floats
        return SquaresProof(None, {}, "")


def _tried(case: Case, names: tuple[str, ...], box: tuple[Array, Array], end: float, most: int | None) -> SquaresProof:
    problem = _Problem(case, names, box)
    if not problem.usable:
        return SquaresProof(None, {}, "")
    tried = 0
    multiple = problem.multiple()
    if multiple is not None:
        return SquaresProof(problem.form, multiple, "")
    for count, (degree, factors) in enumerate(problem.levels()[:most]):
        left = end - time.process_time()
        if left <= 0:
            break
        proof = certify(
            problem.target,
            [problem.weight(each) for each in factors],
            relations=[r for _, r in problem.relations],
            zeros=problem.zeros if count >= _PLAIN else (),
            degree=degree,
            seconds=left,
        )
        tried = degree
        if proof is not None:
            return SquaresProof(problem.form, problem.entry(proof, factors), "")
    return SquaresProof(None, {}, f"sums of squares of degree up to {tried} found no proof" if tried else "")


class _Problem:
    """A case as polynomials in symbols, which are scaled and moved atoms."""

    def __init__(self, case: Case, names: tuple[str, ...], box: tuple[Array, Array]) -> None:
        self._names, self._box, self._at = names, box, case.touching
        self.usable = False
        normal = normal_form(case, names, (box[0][:, None], box[1][:, None]), MOST_TERMS, split=True)
        if normal is None or not normal.over:
            return
        self._algebra, self._written = normal.algebra, normal.written
        written, over, under, guards = normal.written, normal.over, normal.under, normal.guards
        # the checker reads a polynomial from the margin as it is written
        node = case.margin if not under and _has_no_division(case.margin) else written.poly(over)
        self.form = Form(node, under, (number(0),) * len(guards))
        polynomials = [over, *(g.over for g in guards if g is not None and not g.under)]
        self._atoms = self._closed({k for p in polynomials for m in p.terms for k, _ in m})
        if len(self._atoms) > _MOST_ATOMS or not self._atoms:
            return
        if not self._read_ranges([written.atom(at) for at in self._atoms]):
            return
        self._decimals = [tuple(Fraction(repr(float(x))) for x in pair) for pair in zip(*box, strict=True)]
        self._choose_symbols(-over)
        self.target = self.moved(-over)
        self._factors: dict[str, Polynomial] = {}
        for j, guard in enumerate(guards):
            if guard is not None and guard.over and not guard.under:
                self._factors[f"c{j}"] = self.moved(-guard.over)
        self._add_bounds()
        self._facts: list[dict[str, Any]] = []
        self._add_facts()
        self.relations = self._relations()
        self.usable = True

    def _read_ranges(self, atoms: Sequence[Node]) -> bool:
        """Read the range of each atom on the box; return whether all atoms are defined there."""
        lower, upper = self._box
        if all(node.op == "var" for node in atoms):
            places = [self._names.index(node.name) for node in atoms]
            self._ranges = [(float(lower[k]), float(upper[k])) for k in places]
            return True
        read = build_tape(self._names, atoms).run((lower[:, None], upper[:, None]))
        self._ranges = [(float(jet.value[0][0]), float(jet.value[1][0])) for jet in read.jets]
        return all(fine[0] for fine in read.defined)

    @cached_property
    def zeros(self) -> list[tuple[Fraction | float, ...]]:
        """The zeros of the target, other than the origin of the symbols, if the symbols are variables."""
        if not all(self._algebra.atoms[at][0] == "var" for at in self._atoms):
            return []
        hull = [
            ((Fraction(low) - o) / s, (Fraction(high) - o) / s)
            for (low, high), o, s in zip(self._ranges, self._origins, self._scales, strict=True)
        ]
        sides = [p for name, p in self._factors.items() if name[0] == "c"]
        return zeros_of(self.target, hull, sides, scales=self._scales)

    def _closed(self, atoms: set[int]) -> list[int]:
        """Return the atoms with those that relations and facts about them need, in order."""
        waiting, among = list(atoms), set[int]()
        while waiting:
            at = waiting.pop()
            if at in among:
                continue
            among.add(at)
            kind, args = self._algebra.atoms[at]
            inside = [a for a in args if isinstance(a, Ratio)]
            if kind in ("sin", "cos"):
                waiting.append(self._algebra._atom("cos" if kind == "sin" else "sin", inside[0]))
            if len(inside) == 1 or self._is_atan(at):
                waiting += [k for m in inside[0].over.terms for k, _ in m]
        return sorted(among)

    def _is_atan(self, at: int) -> bool:
        kind, args = self._algebra.atoms[at]
        return kind == "atan2" and isinstance(args[1], Ratio) and args[1] == Ratio(Polynomial.constant(1))

    def _choose_symbols(self, target: Polynomial) -> None:
        """Choose for each atom its origin and scale: symbol = (atom − origin) / scale."""
        nearest = {
            name: min(max(Fraction(0), low), high)
            for name, (low, high) in zip(self._names, self._decimals, strict=True)
        } | dict(self._at)
        values = {at: exact_values([self._written.atom(at)], nearest) for at in self._atoms}
        known: dict[int, Fraction] = {at: v[0] for at, v in values.items() if v is not None}
        self._touching = False
        if all(k in known for m in target.terms for k, _ in m):
            nonzero = [(m, c) for m, c in target.terms.items() if all(known[k] for k, _ in m)]
            self._touching = not sum((c * prod(known[k] ** e for k, e in m) for m, c in nonzero), Fraction(0))
        self._origins, self._scales = [], []
        for at, (low, high) in zip(self._atoms, self._ranges, strict=True):
            origin = known.get(at) if self._touching else None
            if origin is None:
                middle, half = (low + high) / 2, (high - low) / 2
                grid = 2.0 ** (ceil(log2(half)) - 4) if half > 0 else 1.0
                origin = Fraction(0) if abs(middle) < half / 4 else Fraction(round(middle / grid) * grid)
            size = max(abs(low - float(origin)), abs(high - float(origin))) or 1.0
            self._origins.append(origin)
            self._scales.append(Fraction(2) ** ceil(log2(size)))
        place = {at: k for k, at in enumerate(self._atoms)}
        self._by = {at: self._scales[k] * Polynomial.variable(k) + self._origins[k] for at, k in place.items()}
        self._place = place

    def moved(self, poly: Polynomial) -> Polynomial:
        """Return a polynomial in atoms as a polynomial in the symbols."""
        return poly.substituted(self._by)

    def _add_bounds(self) -> None:
        for at in self._atoms:
            kind, args = self._algebra.atoms[at]
            if kind != "var":
                continue
            i = self._names.index(str(args[0]))
            variable = self._by[at]
            # as in the checker, a bound contains the double and its decimal
            self._factors[f"l{i}"] = variable - min(Fraction(float(self._box[0][i])), self._decimals[i][0])
            self._factors[f"h{i}"] = max(Fraction(float(self._box[1][i])), self._decimals[i][1]) - variable

    def _add_facts(self) -> None:
        for at in self._atoms:
            kind, args = self._algebra.atoms[at]
            inside = args[0] if args else None
            if not isinstance(inside, Ratio) or inside.under or (len(args) > 1 and not self._is_atan(at)):
                continue
            op = "atan" if kind == "atan2" else kind
            node = self._written.ratio(inside)
            jet = build_tape(self._names, [node]).run((self._box[0][:, None], self._box[1][:, None])).jets[0]
            low, high = float(jet.value[0][0]), float(jet.value[1][0])
            argument, atom = self.moved(inside.over), self._by[at]
            for factors in facts_about(op, low, high, touching=self._touching):
                total = Polynomial.constant(1)
                for text in factors:
                    total = total * fact_polynomial(text, op, argument, atom)
                self._factors[f"f{len(self._facts)}"] = total
                self._facts.append({"of": text_of(node), "factors": list(factors)})

    def _relations(self) -> list[tuple[int, Polynomial]]:
        """Return sin² + cos² − 1 and root² − radicand, with the index of the sine or root among the symbols."""
        relations = []
        for at in self._atoms:
            kind, args = self._algebra.atoms[at]
            inside = args[0] if args else None
            if kind == "sin" and isinstance(inside, Ratio):
                cosine = self._algebra._atom("cos", inside)
                relations.append(
                    (
                        self._place[at],
                        self._by[at] ** 2 + self._by[cosine] ** 2 - 1,
                    )
                )
            elif kind == "sqrt" and isinstance(inside, Ratio) and not inside.under:
                relations.append((self._place[at], self._by[at] ** 2 - self.moved(inside.over)))
        return relations

    def weight(self, factors: Sequence[str]) -> Polynomial:
        """Return the product of factors, scaled by a power of 2 to a largest coefficient of about 1."""
        total = self._product(factors)
        return total * (1 / _size(total))

    def multiple(self) -> dict[str, Any] | None:
        """Return the entry `squares` if the target is a sum of squares times a constraint, which has no interior."""
        for name in self._factors:
            other = quotient(self.target, self.weight((name,))) if name[0] == "c" else None
            if other is None:
                continue
            proof = certify(other, zeros=self.zeros)
            if proof is not None:
                blocks = tuple(replace(b, weight=0) for b in completed(other, proof.blocks))
                return self.entry(Certificate(blocks, (), proof.least), [(name,)])
        return None

    def levels(self) -> list[tuple[int, list[tuple[str, ...]]]]:
        """Return the identities to try: their degree and the products of factors."""
        first = self.target.degree + self.target.degree % 2
        known = [(name,) for name in self._factors if name[0] in "cf"]
        ends = [(name,) for name in self._factors if name[0] in "lh"]
        boxes = [(f"l{name[1:]}", name) for (name,) in ends if name[0] == "h"]
        constraints = [name for name in self._factors if name[0] == "c"]
        pairs = [*itertools.combinations(constraints, 2)]
        levels: list[tuple[int, list[tuple[str, ...]]]] = [(first, [])]  # many claims hold everywhere
        for degree in range(first, min(first + 2 * _LEVELS, _HIGHEST + 1), 2):
            # with few factors, the matrices are smaller
            if known:
                levels.append((degree, [*known, *pairs]))
            # products of both bounds keep the symmetry to changes of signs, which divides the matrices into blocks
            levels.append((degree, [*known, *pairs, *boxes]))
            levels.append((degree, [*known, *pairs, *ends]))
            levels.append((degree, [*known, *pairs, *ends, *boxes]))
        return levels

    def entry(self, proof: Certificate, factors: Sequence[tuple[str, ...]]) -> dict[str, Any]:
        """Return the entry `squares` of a case."""
        count = len(self._atoms)
        used = sorted({name for b in proof.blocks if b.weight >= 0 for name in factors[b.weight] if name[0] == "f"})
        renamed = {name: f"f{k}" for k, name in enumerate(used)}
        blocks = []
        for block in proof.blocks:
            names = factors[block.weight] if block.weight >= 0 else ()
            size = 1 / _size(self._product(names)) if names else Fraction(1)
            over, entries = _integers([x * size for x in block.entries])
            blocks.append(
                {
                    "factors": [renamed.get(name, name) for name in names],
                    "monomials": [_exponents(m, count) for m in block.basis],
                    "over": over,
                    "gram": entries,
                }
            )
        relations = [
            {
                "symbol": at,
                "monomials": [_exponents(m, count) for m in h.terms],
                "factors": [list(c.as_integer_ratio()) for c in h.terms.values()],
            }
            for (at, _), h in zip(self.relations, proof.multipliers, strict=True)
            if h.terms
        ]
        facts = [self._facts[int(name[1:])] for name in used]
        return {"symbols": self._symbols(), "facts": facts, "blocks": blocks, "relations": relations}

    def _product(self, names: Sequence[str]) -> Polynomial:
        return reduce(mul, [self._factors[name] for name in names])

    def _symbols(self) -> list[str]:
        texts = []
        for at, origin, scale in zip(self._atoms, self._origins, self._scales, strict=True):
            node: Node = self._written.atom(at)
            if origin:
                node = node - number(origin) if origin > 0 else node + number(-origin)
            texts.append(text_of(node if scale == 1 else number(1 / scale) * node))
        return texts


def _has_no_division(node: Node) -> bool:
    """Return whether an expression divides by nothing but numbers."""
    return not any((n.op == "div" and n.args[1].op != "num") or (n.op == "pow" and n.value < 0) for n in ordered(node))


def _size(p: Polynomial) -> Fraction:
    return Fraction(2) ** round(log2(max(abs(float(c)) for c in p.terms.values())))


def _exponents(m: Monomial, count: int) -> list[int]:
    powers = dict(m)
    return [powers.get(k, 0) for k in range(count)]


def _integers(entries: Sequence[Fraction]) -> tuple[int, list[int | list[int]]]:
    """Return a power of 2 and the entries times it; an entry with another denominator is a list [p, q]."""
    over = max((x.denominator for x in entries if x.denominator & (x.denominator - 1) == 0), default=1)
    return over, [
        x.numerator * (over // x.denominator) if over % x.denominator == 0 else [x.numerator, x.denominator]
        for x in entries
    ]
