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
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from mpmath import libmp

from surctl.certcheck.arrays import Ends, Flags, decimals, has_gradual_underflow
from surctl.certcheck.derivative import branched, branches_of, composed
from surctl.certcheck.document import Rejected, listed, number, record
from surctl.certcheck.elementary import BITS, pi
from surctl.certcheck.enclosure import Interval, Undefined, above, enclose, greatest, mul, plus, rational, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact, Fraction_, Sum
from surctl.certcheck.jets import Tape
from surctl.certcheck.patience import go_on
from surctl.certcheck.rules import DIMENSIONS, Rules
from surctl.certcheck.squares import Claimed, check_squares

__all__ = ["DIMENSIONS", "Box", "Inequality", "Obligation", "check_all", "halves", "listed", "number"]

_CASE = {"choice", "numerator", "denominators", "multipliers"}
_MOST_BRANCHES = 12
_SHARED = 500  # most operations of earlier inequalities in the table of the next one
_DEEPEST = 10_000  # largest number of boxes that wait to be checked
_TOGETHER, _MOST = 512, 500_000  # boxes that are checked together, and most intervals in the arrays of an expression

Box = list[tuple[float, float]]


@dataclass(frozen=True)
class Obligation:
    """An inequality that a certificate has to prove: left ≤ right + slack on a box where all constraints are ≤ 0."""

    names: Sequence[str]
    box: Box
    left: str
    right: str
    constraints: Sequence[str] = ()
    slack: float = 0.0

    def check(self, cases: object, normal: Exact | None = None) -> Exact:
        """Raise Rejected unless the cases prove the inequality; return the normal forms of its expressions.

        `normal` holds normal forms of earlier inequalities about the same variables.
        """
        table = ExpressionTable(self.names) if normal is None else normal.expressions
        normal = normal or Exact(table)
        try:
            parts = [table.read(text) for text in (self.left, self.right, *self.constraints)]
            Inequality(table, parts, self.box, self.slack, normal).check(listed(cases))
        except Undefined as reason:
            raise Rejected(f"an expression is not defined where it must be: {reason}") from None
        return normal


def check_all(obligations: Sequence[Obligation], proofs: object, known: Exact) -> None:
    """Raise Rejected unless there is one proof for each obligation; `known` holds normal forms of expressions."""
    proved = listed(proofs)
    if len(proved) != len(obligations):
        raise Rejected(f"the certificate has {len(proved)} proofs, but {len(obligations)} inequalities must be proved")
    earlier = {known.expressions.names: known}
    for k, (obligation, cases) in enumerate(zip(obligations, proved, strict=True)):
        names = tuple(obligation.names)
        normal = earlier.get(names)
        if normal is not None and not (normal.reusable and len(normal.expressions.entries) <= _SHARED):
            normal = None  # limits on sizes count for each inequality
        try:
            earlier[names] = obligation.check(cases, normal)
        except Rejected as reason:
            raise Rejected(f"inequality {k + 1} of {len(obligations)}: {reason}") from None


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
        ends = (Fraction(repr(low)) if low == high else None for low, high in box)
        fixed = {k: expressions.put("num", value=end) for k, end in enumerate(ends) if end is not None}
        self.parts = [composed(expressions, part, fixed) for part in parts] if fixed else list(parts)
        self.everywhere = expressions.total(self.parts) or self._is_defined()

    def _is_defined(self) -> bool:
        """Return whether left, right and the constraints are defined everywhere on the box."""
        try:
            enclose(self.expressions, self.parts, [span(*ends) for ends in self.box])
        except Undefined:
            return False
        return True

    def check(self, cases: Sequence[Mapping[str, Any]]) -> None:
        """Raise Rejected unless the cases prove the inequality."""
        branches = branches_of(self.expressions, self.parts)
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


class _Case:
    def __init__(self, claim: Inequality, case: Mapping[str, Any], picked: Mapping[int, str]) -> None:
        self.claim, self.expressions = claim, claim.expressions
        chosen, conditions = branched(self.expressions, claim.parts, picked)
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

    def check(self) -> None:
        root = [span(*ends) for ends in self.claim.box]
        for value in enclose(self.expressions, self.denominators, root):
            if not above(value):
                raise Rejected("a denominator is not positive on the whole box")
        for value in enclose(self.expressions, self.multipliers, root):
            if libmp.mpf_lt(value[0], libmp.fzero):
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
                if len(leaves) == _TOGETHER:
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

    @cached_property
    def _rules(self) -> Rules:
        bound = Tape(self.expressions, (self.numerator, *self.denominators))
        return Rules(bound, Tape(self.expressions, tuple(self.constraints)), self.claim.slack, decimals)

    def _decide(self, leaves: Sequence[tuple[str, Box]]) -> None:
        """Raise Rejected unless each leaf, a rule and a box, is shown."""
        if not has_gradual_underflow():
            raise Rejected("this processor replaces denormal numbers by 0, so that no box can be checked")
        letters, order = np.array([rule for rule, _ in leaves]), {"i": 0, "n": 0, "j": 1, "m": 1, "c": 2}
        for rule in dict.fromkeys(letters.tolist()):
            if rule not in order:
                raise Rejected(f"{rule!r} is not a rule for a box")
            among = np.flatnonzero(letters == rule)
            operations = len(self._rules.bound.needed) + len(self._rules.constraints.needed)
            step = max(1, _MOST // (operations * (len(self.claim.box) + 1) ** order[rule]))
            for begin in range(0, len(among), step):
                part = among[begin : begin + step].tolist()
                low, high = np.array([leaves[k][1] for k in part]).transpose(2, 1, 0)
                shown = self._shown(rule, (low, high))
                if not shown.all():
                    box = leaves[part[int(np.argmin(shown))]][1]
                    raise Rejected(f"rule {rule!r} does not decide a box: {_box_text(box)}")

    def _shown(self, rule: str, box: Ends) -> Flags:
        """Return on which boxes (n, B) a rule holds."""
        if rule in "ij":
            return self._rules.outside(box) if rule == "i" else self._rules.outside_by_slopes(box)[0]
        if not self.claim.everywhere:
            written = Tape(self.expressions, tuple(self.claim.parts))
            defined = np.logical_and.reduce(written.run(decimals(*box)).defined)
            if not defined.all():
                where = [*zip(*(end[:, int(np.argmin(defined))].tolist() for end in box), strict=True)]
                raise Rejected(f"the claim is not defined everywhere on a box: {_box_text(where)}")
        if rule == "n":
            return self._rules.natural(box)
        if rule == "m":
            return self._rules.by_slopes(box)[0]
        face, _ = self._rules.face(box)
        points = [[number(x) for x in listed(self.points.pop())] for _ in face.defined]
        fitting = all(len(point) == len(face.low) for point in points)
        if not (fitting and np.all((points >= face.low.T) & (points <= face.high.T))):
            raise Rejected("a tangent point does not lie in its box")
        return self._rules.concave(face) & self._rules.tangent(face, np.array(points).T)


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
        return enclose(exactly.expressions, [exactly.entry_of[atom]], [span(*ends) for ends in box])[0]
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
