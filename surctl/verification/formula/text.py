"""Write an expression as text, from which the parser restores the expression exactly."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache

from surctl.errors import InputError
from surctl.verification.formula.node import Node, ordered
from surctl.verification.formula.parser import FUNCTIONS, LARGEST_POWER, LONGEST

__all__ = ["decimal_text", "reads_back", "text_of"]

_SHALLOW = 50  # depth up to which no text is nested too deeply for the parser
_DIGITS = 120  # most decimals of a number that is not written as a fraction
_LARGEST = 10**16  # integers below it are written as such
_BESIDE = 10  # most characters of an operation beside its operands: a name, commas, blanks and parentheses


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


def reads_back(root: Node, names: Collection[str]) -> bool:
    """Return whether the parser certainly restores the very same expression from the text of an expression.

    Otherwise it may refuse the text, or restore another expression with the same values, such as 1 divided by 3 for
    the number 1/3.

    Args:
        root: the expression.
        names: the names that the parser knows.
    """
    if root.depth > _SHALLOW:
        return False
    lengths: dict[Node, int] = {}
    for node in ordered(root):
        op, length = node.op, _BESIDE
        if op == "num":
            text = decimal_text(node.value)
            if "/" in text or "e-3" in text:  # the parser has a least exponent
                return False
            length += len(text)
        elif op == "var":
            if node.name not in names or node.name in FUNCTIONS or node.name == "pi":
                return False
            length += len(node.name)
        elif op == "neg" and node.args[0].op == "num":
            return False  # the parser reads a negative number
        elif op in ("pow", "powr"):
            exponent = node.value
            if op == "powr" or exponent.denominator != 1 or abs(exponent.numerator) > LARGEST_POWER:
                return False
        for a in node.args:
            length += lengths[a]
        lengths[node] = length
    return lengths[root] <= LONGEST


def decimal_text(value: Fraction) -> str:
    """Return the text of a number: its exact decimal if it has a short one, otherwise a fraction p/q."""
    over, under = value.as_integer_ratio()
    return str(over) if under == 1 and -_LARGEST < over < _LARGEST else _decimal_text(over, under)


@lru_cache(256)
def _decimal_text(over: int, under: int) -> str:
    with suppress(OverflowError):  # the parser reads larger numbers than doubles
        short = repr(over / under)
        if Fraction(short) == Fraction(over, under):
            return short
    if 10**_DIGITS % under == 0:
        digits = str(abs(over) * 10**_DIGITS // under).zfill(_DIGITS + 1)
        whole = f"{digits[:-_DIGITS]}.{digits[-_DIGITS:]}".rstrip("0").rstrip(".")
        if len(whole) <= _DIGITS:
            return f"-{whole}" if over < 0 else whole
    return f"{over}/{under}"


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
