"""Check of a proof that left ≤ right + slack on the part of a box where no constraint is positive.

The proof distinguishes cases and divides the box of each case. A case has these entries:

- `choice`: which of its two expressions each abs, max, min and select takes;
- `numerator`, `denominators`, `multipliers`: left − right = numerator / Π denominators + Σ multiplier · constraint; a
  numerator of null is left − right;
- `tree`: the division of the box, in preorder. A capital letter or digit halves the box in the variable that it names
  (at 0 if 0 lies inside); a small letter names the rule that proves the inequality on the box;
- `points`: the points of contact of the tangents, for the rule `c`;
- `squares` instead of `tree` and `points`: sums of squares, which `surctl.certcheck.squares` describes.

The cases must cover all choices, and an incomplete tree is rejected. So the cases and boxes cover the whole domain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from mpmath import libmp

from surctl.certcheck.arrays import TOGETHER, proved_together
from surctl.certcheck.document import Rejected, listed, number, record
from surctl.certcheck.elementary import BITS, pi
from surctl.certcheck.enclosure import (
    Interval,
    Jet,
    Undefined,
    above,
    decimal,
    enclose,
    exact,
    greatest,
    is_zero,
    mul,
    over,
    plus,
    rational,
    span,
)  # fmt: skip
from surctl.certcheck.expressions import BRANCHES, ExpressionTable
from surctl.certcheck.identity import Exact, Fraction_, Sum
from surctl.certcheck.patience import go_on
from surctl.certcheck.squares import Claimed, check_squares

__all__ = ["DIMENSIONS", "Box", "Inequality", "halves", "listed", "number"]

DIMENSIONS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
"""The letters and digits that name the variables of a claim in a tree."""

_CASE = {"choice", "numerator", "denominators", "multipliers"}
_MOST_BRANCHES = 12
_DEEPEST = 10_000  # largest number of boxes that wait to be checked

Box = list[tuple[float, float]]


class Inequality:
    """The inequality left ≤ right + slack on the part of a box where no constraint is positive.

    Attributes:
        expressions: table of all expressions.
        parts: table positions of left, right and the constraints; a variable whose range has zero width is replaced by
            its decimal number.
        box: lower and upper bound of each variable of the table.
        slack: amount by which left may exceed right.
        normal: normal forms of expressions of the table that an earlier proof has.
    """

    def __init__(
        self,
        expressions: ExpressionTable,
        parts: Sequence[int],
        box: Box,
        slack: float = 0.0,
        normal: Exact | None = None,
    ) -> None:
        self.expressions, self.box, self.slack = expressions, box, slack
        self.normal = Exact(expressions) if normal is None else normal
        self.parts = self._substituted(parts)
        self.everywhere = self.defined(box)

    def _substituted(self, roots: Sequence[int]) -> list[int]:
        """Replace each variable whose range has zero width by its decimal number."""
        if all(low < high for low, high in self.box):
            return list(roots)

        def change(at: int, _: tuple[int, ...]) -> int | None:
            entry = self.expressions.entries[at]
            if entry.op != "var":
                return None
            low, high = self.box[entry.value.numerator]
            return self.expressions.put("num", value=Fraction(repr(low))) if low == high else None

        return self.expressions.rewritten(roots, change)

    def defined(self, box: Box) -> bool:
        """Return whether left, right and the constraints are defined everywhere on the box."""
        if self.expressions.total(self.parts):
            return True
        try:
            enclose(self.expressions, self.parts, [span(*ends) for ends in box])
        except Undefined:
            return False
        return True

    def check(self, cases: Sequence[Mapping[str, Any]]) -> None:
        """Raise Rejected unless the cases prove the inequality."""
        branches = self._branches()
        choices = [case["choice"] for case in cases]
        if choices != [""]:
            if len(branches) > _MOST_BRANCHES:
                raise Rejected("too many cases")
            expected = {format(k, f"0{len(branches)}b") for k in range(2 ** len(branches))} if branches else {""}
            if set(choices) != expected or len(choices) != len(expected):
                raise Rejected("the cases do not cover every choice exactly once")
        for case in cases:
            go_on()
            record(case, _CASE | ({"squares"} if "squares" in case else {"tree", "points"}), "a case")
            picked = dict(zip(branches, case["choice"], strict=True)) if case["choice"] else {}
            _Case(self, case, picked).check()

    def _branches(self) -> list[int]:
        """Return the distinct abs, max, min and select entries: of the left side, the right side, the constraints."""
        met, visited, waiting = list[int](), set[int](), list(reversed(self.parts))
        while waiting:
            at = waiting.pop()
            if at not in visited:
                visited.add(at)
                entry = self.expressions.entries[at]
                if entry.op in BRANCHES:
                    met.append(at)
                waiting += reversed(entry.args)
        return met


class _Case:
    def __init__(self, claim: Inequality, case: Mapping[str, Any], picked: Mapping[int, str]) -> None:
        self.claim, self.expressions = claim, claim.expressions
        chosen, conditions = self._chosen(picked)
        self.margin = self.expressions.put("sub", chosen[0], chosen[1])
        self.constraints = [*chosen[2:], *conditions]
        stated = case["numerator"]
        self.numerator = self.margin if stated is None else self.expressions.read(stated)
        self.denominators = [self.expressions.read(t) for t in listed(case["denominators"])]
        self.multipliers = [self.expressions.read(t) for t in listed(case["multipliers"])]
        self.case = case
        self.tree, self.points = case.get("tree", ""), list(reversed(listed(case.get("points", []))))
        if not isinstance(self.tree, str):
            raise Rejected("the division of the box ('tree') is not a text")

    def _chosen(self, picked: Mapping[int, str]) -> tuple[list[int], list[int]]:
        """Return the claim's expressions after all choices, and expressions that are ≤ 0 where the choices hold."""
        if not picked:
            return list(self.claim.parts), []
        put, conditions = self.expressions.put, dict[int, int]()

        def change(at: int, args: tuple[int, ...]) -> int | None:
            if at not in picked:
                return None
            entry, second = self.expressions.entries[at], picked[at] == "1"
            if entry.op == "abs":
                conditions[at] = args[0] if second else put("neg", args[0])
                return put("neg", args[0]) if second else args[0]
            a, b = args[:2]
            first_is_less = entry.op != "max"
            conditions[at] = put("sub", b, a) if second == first_is_less else put("sub", a, b)
            return args[len(args) // 2 + second] if entry.op == "select" else args[int(second)]

        chosen = self.expressions.rewritten(self.claim.parts, change)
        return chosen, [conditions[at] for at in picked]

    def check(self) -> None:
        root = [span(*ends) for ends in self.claim.box]
        for jet in enclose(self.expressions, self.denominators, root):
            if not above(jet.value):
                raise Rejected("a denominator is not positive on the whole box")
        for jet in enclose(self.expressions, self.multipliers, root):
            if libmp.mpf_lt(jet.value[0], libmp.fzero):
                raise Rejected("a multiplier may be negative")
        self._identity()
        if "squares" in self.case:
            self._sums()
            return
        self._leaves()
        if self.points:
            raise Rejected("the certificate has more tangent points than it needs")

    def _identity(self) -> None:
        """Check left − right = numerator / Π denominators + Σ multiplier · constraint."""
        if len(self.multipliers) != len(self.constraints):
            raise Rejected("the numbers of multipliers and constraints differ")
        pairs = [(m, c) for m, c in zip(self.multipliers, self.constraints, strict=True) if not self._is_zero(m)]
        if not pairs and not self.denominators and self.numerator == self.margin:
            return
        exactly = Exact(self.expressions)

        def built(e: Exact) -> Fraction_:
            total = e.of(self.numerator)
            for d in self.denominators:
                over_, under = e.of(d)
                total = e.times(total, (under, over_))
            for m, c in pairs:
                total = e.add(total, e.times(e.of(m), e.of(c)))
            return total

        if not exactly.equal(self.margin, built):
            raise Rejected("numerator, denominators and multipliers do not make up the claim")
        for poly in exactly.assumed:
            if not above(_range(poly, exactly, self.claim.box)):
                raise Rejected("a fraction under a root has a denominator of unknown sign")

    def _sums(self) -> None:
        if not self.claim.everywhere:
            raise Rejected("the claim is not defined everywhere on the box")
        normal = self.claim.normal if self.claim.normal.reusable else Exact(self.expressions)
        claimed = Claimed(
            self.expressions, self.numerator, self.denominators, self.constraints, self.claim.box, self.claim.slack,
            normal,
        )  # fmt: skip
        check_squares(self.case["squares"], claimed)

    def _is_zero(self, at: int) -> bool:
        entry = self.expressions.entries[at]
        return entry.op == "num" and entry.value == 0

    def _leaves(self) -> None:
        waiting, leaves = [list(self.claim.box)], list[tuple[str, Box]]()
        for letter in self.tree:
            if not waiting:
                raise Rejected("the tree goes on after its last leaf")
            if len(waiting) > _DEEPEST:
                raise Rejected("the tree is too deep")
            box = waiting.pop()
            at = DIMENSIONS.find(letter)
            if at < 0:
                leaves.append((letter, box))
                if len(leaves) == TOGETHER:
                    self._decide(leaves)
                    leaves = []
                continue
            if at >= len(box):
                raise Rejected(f"the tree halves in variable {at}, which does not exist")
            low, high = box[at]
            cut = 0.0 if low < 0 < high else _middle(low, high)
            waiting += [[*box[:at], (cut, high), *box[at + 1 :]], [*box[:at], (low, cut), *box[at + 1 :]]]
        if waiting:
            raise Rejected("the tree does not cover the box")
        self._decide(leaves)

    def _decide(self, leaves: Sequence[tuple[str, Box]]) -> None:
        """Check leaves: all of them in arrays of doubles, then one by one those that this leaves open."""
        numerator = self.numerator if self.claim.everywhere else None
        quick = proved_together(self.expressions, numerator, self.constraints, leaves)
        for (rule, box), done in zip(leaves, quick, strict=True):
            if not done:
                self._leaf(rule, box)

    def _leaf(self, rule: str, box: Box) -> None:
        wide = [span(*ends) for ends in box]
        if rule == "i":
            good = any(self._excluded(c, wide, None) for c in self.constraints)
        elif rule == "j":
            good = any(self._excluded(c, wide, box) for c in self.constraints)
        elif rule in ("n", "m", "c"):
            if not (self.claim.everywhere or self.claim.defined(box)):
                raise Rejected(f"the claim is not defined everywhere on a box: {_box_text(box)}")
            good = {"n": self._natural, "m": self._mean, "c": self._tangent}[rule](box, wide)
        else:
            raise Rejected(f"{rule!r} is not a rule for a box")
        if not good:
            raise Rejected(f"rule {rule!r} does not decide a box: {_box_text(box)}")

    def _excluded(self, constraint: int, wide: list[Interval], box: Box | None) -> bool:
        """Return whether a constraint is positive on the whole box, by its range or by its mean-value form."""
        try:
            jet = enclose(self.expressions, [constraint], wide, order=0 if box is None else 1)[0]
            if box is None:
                return above(jet.value)
            centre = [_middle(*ends) for ends in box]
            return above(self._linear(constraint, jet, box, centre))
        except Undefined:
            return False

    def _linear(self, at: int, jet: Jet, box: Box, centre: Sequence[float]) -> Interval:
        """Return the expression's range on the box by the mean-value form: value at the centre + slopes · offsets."""
        total = enclose(self.expressions, [at], [exact(c) for c in centre])[0].value
        for slope, (low, high), c in zip(jet.slope or [], box, centre, strict=True):
            if slope is not None:
                total = plus(total, mul(slope, libmp.mpi_sub(span(low, high), exact(c), BITS)))
        return total

    def _small(self, value: Interval, wide: list[Interval]) -> bool:
        """Return whether the range `value` is ≤ slack · Π denominators."""
        bound = decimal(self.claim.slack)
        if self.claim.slack:
            for jet in enclose(self.expressions, self.denominators, wide):
                bound = mul(bound, jet.value)
        return bool(libmp.mpf_le(value[1], bound[0]))

    def _natural(self, _: Box, wide: list[Interval]) -> bool:
        return self._small(enclose(self.expressions, [self.numerator], wide)[0].value, wide)

    def _face(self, box: Box, wide: list[Interval]) -> tuple[Jet, Box, list[bool]]:
        """Return the slopes on the box, the box's face that has the maximum, and which variables vary on the face."""
        jet = enclose(self.expressions, [self.numerator], wide, order=1)[0]
        face, free = Box(), []
        for slope, (low, high) in zip(jet.slope or [], box, strict=True):
            if slope is None or libmp.mpf_ge(slope[0], libmp.fzero):
                face.append((high, high))
            elif libmp.mpf_le(slope[1], libmp.fzero):
                face.append((low, low))
            else:
                face.append((low, high))
            free.append(face[-1][0] < face[-1][1])
        return jet, face, free

    def _mean(self, box: Box, wide: list[Interval]) -> bool:
        jet, face, _ = self._face(box, wide)
        if self._small(enclose(self.expressions, [self.numerator], [span(*e) for e in face])[0].value, wide):
            return True
        centre = [_middle(*ends) for ends in face]
        return self._small(self._linear(self.numerator, jet, face, centre), wide)

    def _tangent(self, box: Box, wide: list[Interval]) -> bool:
        """Return whether the numerator is concave and a tangent is small enough on the face that has the maximum."""
        _, face, free = self._face(box, wide)
        point = [number(x) for x in listed(self.points.pop())]
        if len(point) != len(face) or any(not low <= x <= high for x, (low, high) in zip(point, face, strict=True)):
            raise Rejected("a tangent point does not lie in its box")
        bend = enclose(self.expressions, [self.numerator], [span(*e) for e in face], order=2)[0].bend
        if not _bends_down(bend or [], free):
            return False
        # a variable at its worse end may be the double or its decimal; the free variables are concave for both
        touching = [exact(x) if is_free else span(*e) for x, is_free, e in zip(point, free, face, strict=True)]
        at = enclose(self.expressions, [self.numerator], touching, order=1)[0]
        total = at.value
        for slope, is_free, e, x in zip(at.slope or [], free, face, point, strict=True):
            if is_free and slope is not None:
                total = plus(total, mul(slope, libmp.mpi_sub(span(*e), exact(x), BITS)))
        return self._small(total, wide)


def _bends_down(bend: list[list[Interval]], free: list[bool]) -> bool:
    """Return whether minus the Hessian `bend`, without zero rows, is positive definite in the variables `free`."""
    among = [k for k, is_free in enumerate(free) if is_free]
    keep = [k for k in among if not all(bend[k][j] is None or is_zero(bend[k][j]) for j in among)]
    m = [[None if bend[i][j] is None else libmp.mpi_neg(bend[i][j]) for j in keep] for i in keep]
    for k in range(len(keep)):
        pivot = m[k][k]
        if pivot is None or not above(pivot):
            return False
        for i in range(k + 1, len(keep)):
            for j in range(k + 1, len(keep)):
                product = mul(over(m[i][k], pivot), m[k][j])
                m[i][j] = m[i][j] if product is None else plus(m[i][j], libmp.mpi_neg(product))
    return True


def _range(poly: Sum, exactly: Exact, box: Box) -> Interval:
    total = rational(Fraction(0))
    for term, factor in poly.items():
        product = rational(factor)
        for atom, e in term:
            product = mul(product, libmp.mpi_pow_int(_atom_range(atom, exactly, box), e, BITS))
        total = plus(total, product)
    return total


def _atom_range(atom: str, exactly: Exact, box: Box) -> Interval:
    if atom[0] == "v":
        return span(*box[int(atom[1:])])
    if atom == "pi":
        return pi()
    if atom.startswith("sqrt{"):
        inside = _range(exactly.under_root(atom), exactly, box)
        return libmp.mpi_sqrt(greatest(inside, rational(Fraction(0))), BITS)
    if atom[:5] in ("cosi{", "sine{"):
        return span(-1.0, 1.0)
    if atom[:5] in ("acos{", "atan2"):
        return span(-3.2, 3.2)
    if atom in exactly.entry_of:
        return enclose(exactly.expressions, [exactly.entry_of[atom]], [span(*ends) for ends in box])[0].value
    raise Rejected("the sign of a denominator under a root cannot be checked")


def _middle(low: float, high: float) -> float:
    # the sum of the ends may overflow
    whole = low + high
    return whole / 2 if math.isfinite(whole) else low / 2 + high / 2


def halves(part: Box, whole: Box) -> list[Box]:
    """Return both halves of a part of a box in the direction in which it is widest, relative to the whole box."""
    widths = [(high - low) / (top - bottom or 1.0) for (low, high), (bottom, top) in zip(part, whole, strict=True)]
    k = widths.index(max(widths))
    low, high = part[k]
    cut = low / 2 + high / 2
    return [[*part[:k], ends, *part[k + 1 :]] for ends in ((low, cut), (cut, high))]


def _box_text(box: Box) -> str:
    return ", ".join(f"[{low:.6g}, {high:.6g}]" for low, high in box)
