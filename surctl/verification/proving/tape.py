"""Instruction lists of expressions, evaluated on many boxes at once; operations that are not defined there."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property, lru_cache
from math import inf, nextafter, pi
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.verification.formula import Node, derivative, number, ordered, text_of, variable
from surctl.verification.proving import functions as fn
from surctl.verification.proving import intervals as iv
from surctl.verification.proving.intervals import Ends
from surctl.verification.proving.jets import Jet, choose

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Read:
    """The result of evaluating an instruction list on B boxes.

    Attributes:
        jets: for each expression, the enclosures of its value and derivatives.
        defined: for each expression, an array (B,): whether all operations of the expression are defined on the whole
            box.
    """

    jets: tuple[Jet, ...]
    defined: tuple[NDArray[np.bool_], ...]


@dataclass(frozen=True, eq=False)
class Tape:
    """An instruction list: the operations of several expressions in evaluation order.

    Attributes:
        names: names of the variables, in the order of the first axis of the box arrays (n, B).
        expressions: the expressions.
    """

    names: tuple[str, ...]
    expressions: tuple[Node, ...]

    @cached_property
    def nodes(self) -> Sequence[Node]:
        """Every distinct node of the expressions; the operands of a node come before the node."""
        return ordered(*self.expressions)

    @cached_property
    def _places(self) -> dict[Node, int]:
        return {node: k for k, node in enumerate(self.nodes)}

    @cached_property
    def steps(self) -> tuple[tuple[Node, tuple[int, ...]], ...]:
        """The nodes, each with the indices of its operands."""
        at = self._places
        return tuple((node, tuple(at[a] for a in node.args)) for node in self.nodes)

    @cached_property
    def roots(self) -> tuple[int, ...]:
        """For each expression, the index of its last step."""
        return tuple(self._places[r] for r in self.expressions)

    @cached_property
    def total(self) -> bool:
        """Whether all operations are defined for all numbers."""
        return all(
            node.op in _TOTAL
            or (node.op == "pow" and node.value >= 0)
            or (node.op == "div" and node.args[1].op == "num" and node.args[1].value != 0)
            for node in self.nodes
        )

    def run(self, box: Ends, *, order: int = 0) -> Read:
        """Evaluate the expressions on boxes (n, B); return enclosures, with derivatives up to `order` ≤ 2."""
        count = box[0].shape[1]
        jets: list[Jet] = []
        defined = [np.ones(count, dtype=bool)] * (len(self.steps) if self.total else 0)
        with np.errstate(all="ignore"):
            for node, args in self.steps:
                operands = [jets[a] for a in args]
                jets.append(self._step(node, operands, box, order))
                if self.total:
                    continue
                fine = np.ones(count, dtype=bool)
                if args:
                    fine = fn.defined(node.op, [operand.value for operand in operands], node.value)
                for a in args:
                    fine = fine & defined[a]
                defined.append(fine)
        return Read(tuple(jets[r] for r in self.roots), tuple(defined[r] for r in self.roots))

    def trouble(self, boxes: Ends) -> tuple[int, str]:
        """Return the index of one of the boxes (n, count) on which an operation is undefined, and a description of it.

        The text is empty if all operations are defined on all boxes.
        """
        read = build_tape(self.names, self.nodes).run(boxes)
        for (node, args), fine in zip(self.steps, read.defined, strict=True):
            if not fine.all():
                at = int(np.argmin(fine))
                low, high = (float(end[at]) for end in read.jets[args[-1]].value)
                return at, f"{_TROUBLES[node.op]} [{low:.3g}, {high:.3g}] in {_short(text_of(node))}"
        return 0, ""

    def _step(self, node: Node, args: list[Jet], box: Ends, order: int) -> Jet:
        n, count = box[0].shape
        match node.op:
            case "var":
                at = self.names.index(node.name)
                return _jet((box[0][at], box[1][at]), at, n, order)
            case "num" | "pi":
                low, high = _enclosed(node)
                return _jet((np.full(count, low), np.full(count, high)), None, n, order)
            case "add":
                return args[0] + args[1]
            case "sub":
                return args[0] - args[1]
            case "mul":
                # the product of equal factors is a square, which gives narrower intervals
                return args[0].power(2) if node.args[0] == node.args[1] else args[0] * args[1]
            case "div":
                inverse = args[1].inverse()
                return inverse if node.args[0] == number(1) else args[0] * inverse  # a product is rounded
            case "neg":
                return -args[0]
            case "pow":
                exponent = node.value.numerator
                return args[0].power(exponent) if exponent >= 0 else args[0].power(-exponent).inverse()
            case "powr":
                return _through(node, fn.powr(args[0].value, node.value), args[0])
            case _ if node.op in _UNARY:
                return _through(node, _UNARY[node.op](args[0].value), args[0])
            case "atan":
                return args[0].angle(_jet(iv.point(np.ones(count)), None, n, order))
            case "atan2":
                return args[0].angle(args[1])
            case "abs":
                return args[0].magnitude()
            case "min":
                return args[0].smaller(args[1])
            case "max":
                return args[0].larger(args[1])
            case _:
                return choose(args[0].value, args[1].value, args[2], args[3])


def build_tape(names: Sequence[str], roots: Sequence[Node]) -> Tape:
    """Return the instruction list of several expressions; shared subexpressions are computed only once."""
    return Tape(tuple(names), tuple(roots))


def _through(node: Node, value: Ends, inside: Jet) -> Jet:
    """Return a function of one quantity, with its value there; its derivatives are those of its expression."""
    first, second = _derivatives(node.op, node.value)
    at = inside.value[0][None], inside.value[1][None]
    return inside.through(value, lambda: first.run(at).jets[0].value, lambda: second.run(at).jets[0].value)


@lru_cache(64)
def _derivatives(op: str, exponent: Fraction) -> tuple[Tape, Tape]:
    first = derivative(Node(op, (variable("t"),), exponent), "t")
    return build_tape(["t"], [first]), build_tape(["t"], [derivative(first, "t")])


_UNARY: Mapping[str, Callable[[Ends], Ends]] = MappingProxyType(
    {"sqrt": iv.squared_root, "sin": iv.sine, "cos": iv.cosine, "acos": iv.acos, "asin": fn.arcsine, "tan": fn.tan,
     "exp": fn.exp, "log": fn.log, "sinh": fn.sinh, "cosh": fn.cosh, "tanh": fn.tanh}
)  # fmt: skip
_TOTAL = frozenset({"num", "pi", "var", "add", "sub", "mul", "neg"})
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
    **{op: f"{op} of an interval beyond {fn.LARGEST_EXPONENT:.0f}:" for op in ("exp", "sinh", "cosh")},
}


def _jet(value: Ends, at: int | None, n: int, order: int) -> Jet:
    """Return the enclosures of the variable `at`, or of a constant."""
    if not order:
        return Jet(value)
    slope = np.zeros((n, value[0].size))
    if at is not None:
        slope[at] = 1.0
    return Jet(value, iv.point(slope), iv.point(np.zeros((n, n, value[0].size))) if order > 1 else None)


def _enclosed(node: Node) -> tuple[float, float]:
    """Return two doubles that enclose an exact number or π: the nearest double below and the nearest double above."""
    if node.op == "pi":
        return pi, nextafter(pi, 4.0)  # the double lies below π
    value, largest = node.value, sys.float_info.max
    try:
        near = float(value)
    except OverflowError:
        return (largest, inf) if value > 0 else (-inf, -largest)
    over, under = near.as_integer_ratio()
    above = over * value.denominator - value.numerator * under  # a comparison of fractions is slow
    low = near if above <= 0 else nextafter(near, -inf)
    return low, near if above >= 0 else nextafter(near, inf)


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
