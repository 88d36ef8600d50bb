"""Dynamics that a certificate is about: change of a function along them, jumps, box, equilibrium, period.

The solutions are those of x' = f(x, w) (`time` is "continuous") or of x⁺ = f(x, w) ("discrete"). The parameters w may
take any value of their ranges, and may vary in time. All texts are expressions of the claim grammar.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from mpmath import libmp

from surctl.certcheck.derivative import along, composed
from surctl.certcheck.document import Rejected, record
from surctl.certcheck.enclosure import Undefined, above, decimal, enclose, rational, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.inequality import Box, Obligation, halves, listed, number
from surctl.certcheck.interval import printable, variables_of
from surctl.certcheck.patience import go_on

__all__ = [
    "Motion", "decimal_text", "read_motion", "require_defined", "require_loop", "rest_of",
]  # fmt: skip

_MOST_DECIMALS = 400  # characters
_LOOP = {
    "plant", "controller", "period_s", "plant_state", "controller_state", "gains", "parameters", "reference",
    "disturbance",
}  # fmt: skip
_MOST_HALVED = 2000  # most boxes that are halved to see that the dynamics are defined


@dataclass(frozen=True)
class Motion:
    """The dynamics of a claim.

    Attributes:
        states: names of the states.
        names: names of the states, then of the parameters.
        box: bounds of all `names`.
        rates: text of the rate or successor of each state.
        discrete: whether the dynamics are x⁺ = f(x, w).
    """

    states: Sequence[str]
    names: Sequence[str]
    box: Box
    rates: Sequence[str]
    discrete: bool

    @cached_property
    def state_box(self) -> Box:
        """Return the bounds of the states."""
        return self.box[: len(self.states)]

    @cached_property
    def _of_states(self) -> ExpressionTable:
        return ExpressionTable(self.states)

    @cached_property
    def normal(self) -> Exact:
        """The normal forms of expressions of all names so far, with their table."""
        return Exact(self._of_states if self.names == self.states else ExpressionTable(self.names))

    def verify_change(self, function: object, stated: object) -> str:
        """Return the stated change of a function of the states: its time derivative, or its value at the successor.

        The stated text is rejected unless it equals the change that is computed from the dynamics. The dynamics and the
        change must be defined in the whole box; so a function with a derivative is smooth there.
        """
        self._of_states.read(function)  # a function of the states alone
        table = self.normal.expressions
        root, claimed = table.read(function), table.read(stated)
        rates = [table.read(text) for text in self.rates]
        if not self.discrete:
            # the solutions of rates that jump are not those of an ordinary differential equation
            self.require_continuous(table, rates, "the dynamics contain")
        own = composed(table, root, dict(enumerate(rates))) if self.discrete else along(table, root, rates)
        require_defined(table, [*rates, own], self.box)
        if own != claimed and (not self.normal.equal(claimed, lambda e: e.of(own)) or self.normal.assumed):
            raise Rejected("the stated change of the function does not follow from the dynamics")
        return str(stated)

    def require_continuous(self, table: ExpressionTable, roots: Sequence[int], what: str) -> None:
        """Raise Rejected if the expressions may jump in the box."""
        wide = [span(*ends) for ends in self.box]
        for at in table.needed(roots):
            entry = table.entries[at]
            if entry.op == "select":
                raise Rejected(f"{what} select, which may jump")
            if entry.op == "atan2":
                try:
                    y, x = enclose(table, entry.args, wide)
                except Undefined as reason:
                    raise Rejected(f"{what} an atan2 that may be undefined in the box: {reason}") from None
                if not (above(x) or above(y) or libmp.mpf_lt(y[1], libmp.fzero)):
                    raise Rejected(f"{what} an atan2 that may jump in the box")

    def require_inside(self, function: str, level: object, point: Mapping[str, Any]) -> None:
        """Raise Rejected unless the set function < level, in the box, is a neighbourhood of the point.

        The function must be continuous, the point must lie inside the box, and the function must be below the level at
        the point. The point has a number for each state, or a text with all decimals of one.
        """
        if self.discrete:  # in continuous time, the function has a derivative
            table = self.normal.expressions
            self.require_continuous(table, [table.read(function)], "the function contains")
        at = [rest_of(point[name])[1] for name in self.states]
        if not all(
            Fraction(repr(low)) < x < Fraction(repr(high)) for x, (low, high) in zip(at, self.box, strict=False)
        ):
            raise Rejected("the equilibrium does not lie inside the box")
        own = self._of_states
        try:
            value = enclose(own, [own.read(function)], [rational(x) for x in at])[0]
        except Undefined as reason:
            raise Rejected(f"the function is not defined at the equilibrium: {reason}") from None
        if not libmp.mpf_lt(value[1], decimal(number(level))[0]):
            raise Rejected("the function is not shown to be below the level at the equilibrium")

    def stays(self, constraints: Sequence[str]) -> list[Obligation]:
        """Return the obligations that a successor of a state with all constraints ≤ 0 lies in the box."""
        needed = []
        for rate, (low, high) in zip(self.rates, self.state_box, strict=True):
            needed.append(Obligation(self.names, self.box, decimal_text(low), rate, constraints))
            needed.append(Obligation(self.names, self.box, rate, decimal_text(high), constraints))
        return needed


def require_defined(table: ExpressionTable, roots: Sequence[int], whole: Box) -> None:
    """Raise Rejected unless the expressions are defined in the whole box; parts are halved as needed."""
    waiting, halved = [] if table.total(roots) else [whole], 0
    while waiting:
        box = waiting.pop()
        go_on()
        try:
            enclose(table, roots, [span(*ends) for ends in box])
        except Undefined as reason:
            halved += 1
            if halved > _MOST_HALVED:
                raise Rejected(f"the dynamics may be undefined in the box: {reason}") from None
            waiting += halves(box, whole)


def read_motion(claim: Mapping[str, Any]) -> Motion:
    """Return the dynamics of a claim; raise Rejected if they are not complete."""
    states, box = variables_of(claim["states"])
    names, ranges = variables_of([*claim["states"], *listed(claim["parameters"])])
    dynamics = claim["dynamics"]
    if not isinstance(dynamics, dict) or set(dynamics) != set(states):
        raise Rejected("the dynamics do not name every state once")
    if claim["time"] not in ("continuous", "discrete"):
        raise Rejected("the time is neither continuous nor discrete")
    if any(low == high for low, high in box):
        raise Rejected("the range of a state has no width")
    printable(claim["name"])
    if claim["about"] and "system" not in claim["about"]:  # a named system is compared with its law's list
        require_loop(claim["about"])
    return Motion(states, names, ranges, [dynamics[name] for name in states], claim["time"] == "discrete")


def require_loop(about: object) -> None:
    """Raise Rejected unless the entry `about` states digests, period and vectors of the loop of the dynamics."""
    loop = record(about, _LOOP, "claim.about")
    printable(loop["plant"], loop["controller"])
    if not number(loop["period_s"]) > 0 or not isinstance(loop["gains"], dict):
        raise Rejected("the certificate does not state the period, or the gains by name")
    printable(*loop["gains"])
    vectors = [loop[key] for key in _LOOP - {"plant", "controller", "period_s", "gains"}]
    for entry in (e for vector in (*vectors, *loop["gains"].values()) for e in listed(vector)):
        if not isinstance(entry, str):
            number(entry)


def rest_of(value: object) -> tuple[str, Fraction]:
    """Return a coordinate as an expression and as a number; a text has digits that a double in JSON would lose."""
    if isinstance(value, str):
        if len(value) > _MOST_DECIMALS or not re.fullmatch(r"-?\d+(\.\d+|/[1-9]\d*)?", value, re.ASCII):
            raise Rejected(f"{value[:40]!r} is not a decimal number or a fraction")
        return f"({value})", Fraction(value)
    return decimal_text(value), Fraction(repr(number(value)))


def decimal_text(value: object) -> str:
    """Return a number of the document as an expression with exactly the value of the printed decimal."""
    return f"({number(value)!r})"
