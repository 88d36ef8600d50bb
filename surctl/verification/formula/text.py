"""Write an expression as text, from which the parser restores the expression exactly."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

from surctl.errors import InputError
from surctl.verification.formula.node import Node, ordered
from surctl.verification.formula.parser import LONGEST

__all__ = ["decimal_text", "text_of"]


@lru_cache(128)
def text_of(root: Node) -> str:
    """Return the text of an expression in the claim grammar.

    Raises:
        InputError: the text would be too long, because shared subexpressions are written out at every use.
    """
    texts: dict[Node, tuple[str, int]] = {}
    for node in ordered(root):
        text, level = _one(node, [texts[a] for a in node.args])
        if len(text) > LONGEST:
            raise InputError(f"is longer than {LONGEST} characters", key="expression", remedy="split the claim")
        texts[node] = text, level
    return texts[root][0]


def decimal_text(value: Fraction) -> str:
    """Return the text of a number: a decimal if the number has an exact decimal, otherwise a fraction p/q."""
    if value.denominator == 1 and abs(value.numerator) < 10**16:
        return str(value.numerator)
    short = repr(float(value))
    if Fraction(short) == value:
        return short
    return f"{value.numerator}/{value.denominator}"


def _one(node: Node, args: list[tuple[str, int]]) -> tuple[str, int]:
    op = node.op
    if op == "num":
        text = decimal_text(node.value)
        level = 3 if node.value < 0 else 5
        return text, 2 if "/" in text else level
    if op in ("pi", "var"):
        return node.name or "pi", 5
    if op in ("add", "sub"):
        right = _inside(args[1], 2)
        return f"{args[0][0]} {'+' if op == 'add' else '-'} {right}", 1
    if op in ("mul", "div"):
        return f"{_inside(args[0], 2)}{'*' if op == 'mul' else '/'}{_inside(args[1], 4)}", 2
    if op == "neg":
        return f"-{_inside(args[0], 4)}", 3
    if op in ("pow", "powr"):
        exponent = decimal_text(node.value)
        return f"{_inside(args[0], 5)}^{f'({exponent})' if '/' in exponent else exponent}", 4
    return f"{op}({', '.join(text for text, _ in args)})", 5


def _inside(part: tuple[str, int], least: int) -> str:
    text, level = part
    return text if level >= least else f"({text})"
