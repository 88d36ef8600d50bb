"""Expressions as instruction lists that are evaluated on many boxes at once; operations that are not defined there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from surctl.certcheck.arrays import Ends
from surctl.certcheck.jets import Functions
from surctl.certcheck.jets import Tape as Evaluator
from surctl.verification.formula import Node, ordered, text_of
from surctl.verification.formula.node import table_of
from surctl.verification.proving.functions import LARGEST_EXPONENT, quick_functions


@dataclass(frozen=True, eq=False)
class Tape(Evaluator):
    """An instruction list: the operations of several expressions in evaluation order.

    Attributes:
        names: names of the variables, in the order of the first axis of the box arrays (n, B).
        expressions: the expressions.
    """

    functions: Functions = quick_functions
    names: tuple[str, ...] = ()
    expressions: tuple[Node, ...] = ()

    @cached_property
    def nodes(self) -> Sequence[Node]:
        """Every distinct node of the expressions; the operands of a node come before the node."""
        return ordered(*self.expressions)

    def trouble(self, boxes: Ends) -> tuple[int, str]:
        """Return the index of one of the boxes (n, count) on which an operation is undefined, and a description of it.

        The text is empty if all operations are defined on all boxes.
        """
        read = replace(self, roots=tuple(range(len(self.nodes)))).run(boxes)
        places = {node: k for k, node in enumerate(self.nodes)}
        for node, fine in zip(self.nodes, read.defined, strict=True):
            if not fine.all():
                at = int(np.argmin(fine))
                low, high = (float(end[at]) for end in read.jets[places[node.args[-1]]].value)
                text = text_of(node)
                text = text if len(text) <= 60 else text[:57] + "..."
                return at, f"{_TROUBLES[node.op]} [{low:.3g}, {high:.3g}] in {text}"
        return 0, ""


def build_tape(names: Sequence[str], roots: Sequence[Node]) -> Tape:
    """Return the instruction list of several expressions; shared subexpressions are computed only once."""
    table, places = table_of(names, roots)
    return Tape(table, tuple(places), names=tuple(names), expressions=tuple(roots))


_TROUBLES = {
    "div": "division by an interval that contains 0:",
    "pow": "division by an interval that contains 0:",
    "sqrt": "square root of an interval that is partly negative:",
    "acos": "arccos of an interval beyond [-1, 1]:",
    "atan2": "atan2 of a box that contains (0, 0): x in",
    "asin": "arcsin of an interval beyond [-1, 1]:",
    "tan": "tangent of an interval that may contain a pole:",
    "log": "logarithm of an interval that is partly 0 or negative:",
    "powr": "fractional power of an interval that contains 0 or negative numbers:",
    **{op: f"{op} of an interval beyond {LARGEST_EXPONENT:.0f}:" for op in ("exp", "sinh", "cosh")},
}
