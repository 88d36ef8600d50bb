"""Parser of expressions for the checker: it converts text to a list of operations without duplicates.

An expression may contain sums, products, powers with ^ and a constant exponent, the functions in `FUNCTIONS`, exact
decimal numbers and `pi`. An exponent is a decimal number, or a fraction of decimal numbers in parentheses. A power with
an integer exponent is the operation `pow`, any other power is `powr`, which is defined for positive numbers, and for 0
if the exponent is positive.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import Account, go_on

__all__ = ["BRANCHES", "FUNCTIONS", "RESERVED", "Entry", "ExpressionTable"]

FUNCTIONS = {
    "abs": 1, "acos": 1, "asin": 1, "atan": 1, "atan2": 2, "cos": 1, "cosh": 1, "exp": 1, "log": 1, "max": 2, "min": 2,
    "select": 4, "sin": 1, "sinh": 1, "sqrt": 1, "tan": 1, "tanh": 1,
}  # fmt: skip
"""Number of arguments of each function; select(a, b, x, y) is x if a ≤ b, and y otherwise."""

RESERVED = ("abs", "acos", "atan", "atan2", "cos", "max", "min", "pi", "select", "sin", "sqrt")
"""Names that no variable has. The other functions came later, and older certificates may have variables of their names:
a name followed by a parenthesis is a function, any other name is a variable."""

BRANCHES = ("abs", "max", "min", "select")
"""Functions whose value is one of two expressions."""

_LONGEST, _DEEPEST, _MOST = 60_000, 150, 50_000
_LONGEST_EXPONENT = 40  # characters of a number in an exponent
_TOTAL = ("add", "mul", "neg", "num", "pi", "sub", "var")
_CACHED, _SHORT = 100_000, 4000  # most positions in stored lists; longest text whose parts are stored
_SIZE = 400  # memory of an operation, without the digits of its number [bytes]
_LEXEME = re.compile(r"[ \t\n]*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)|([A-Za-z]\w*)|([-+*/^(),])|$)", re.ASCII)
_BINDS = {"+": 1, "-": 1, "*": 2, "/": 2}
_OPS = {"+": "add", "-": "sub", "*": "mul", "/": "div"}


_NONE = Fraction(0)  # the value of an operation that has none


class Entry(NamedTuple):
    """One operation; `value` is the number of `num`, the exponent of `pow` and `powr`, or the index of the variable."""

    op: str
    args: tuple[int, ...] = ()
    value: Fraction = _NONE


def _lexemes(text: str) -> tuple[tuple[str, str], ...]:
    lexemes: list[tuple[str, str]] = []
    at = 0
    while at < len(text):
        match = _LEXEME.match(text, at)
        if match is None:
            raise Rejected(f"an expression cannot be read at column {at + 1}: {text[at : at + 20]!r}")
        if match.lastindex:
            lexemes.append((("number", "name", "sign")[match.lastindex - 1], match[match.lastindex]))
        at = match.end() if match.end() > at else len(text)
    return tuple(lexemes)


_short_lexemes = lru_cache(64)(_lexemes)  # a certificate repeats most of its texts


@lru_cache(256)
def _short_decimal(text: str) -> Fraction:
    return Fraction(text)


def _decimal(text: str) -> Fraction:
    return _short_decimal(text) if len(text) <= _LONGEST_EXPONENT else Fraction(text)


class ExpressionTable:
    """Table of all operations of one certificate; equal operations are one entry, and operands precede their use."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self.entries: list[Entry] = []
        self._at: dict[tuple[str, tuple[int, ...], int, int], int] = {}
        self._live: dict[tuple[int, ...], list[int]] = {}
        self._cached = 0
        self._account = Account()
        self._read: dict[str, int] = {}

    def put(self, op: str, *args: int, value: Fraction | int = _NONE) -> int:
        """Return the position of an operation in the table; add the operation to the table if it is new."""
        over, under = (0, 1) if value is _NONE else value.as_integer_ratio()
        key = op, args, over, under  # the hash of a fraction is slow
        at = self._at.get(key)
        if at is None:
            if len(self.entries) >= _MOST:
                raise Rejected(f"the expressions have more than {_MOST} operations")
            self._account.hold(_SIZE + (over.bit_length() + under.bit_length()) // 4)
            at = self._at[key] = len(self.entries)
            self.entries.append(Entry(op, args, value if type(value) is Fraction else Fraction(value)))
        return at

    def needed(self, roots: Iterable[int]) -> list[int]:
        """Return, in table order, the positions of the given roots and of all operations on which the roots depend."""
        key = tuple(roots)
        if key not in self._live:
            live, waiting = set(key), list(key)
            while waiting:
                for a in self.entries[waiting.pop()].args:
                    if a not in live:
                        live.add(a)
                        waiting.append(a)
            self._cached += len(live)
            if self._cached > _CACHED:
                self._live.clear()
                self._cached = len(live)
            self._live[key] = sorted(live)
        return self._live[key]

    def rewritten(self, roots: Sequence[int], change: Callable[[int, tuple[int, ...]], int | None]) -> list[int]:
        """Return the roots after change(position, new operands) has replaced each entry; None means no replacement."""
        replaced: dict[int, int] = {}
        for at in self.needed(roots):
            entry = self.entries[at]
            args = tuple(replaced[a] for a in entry.args)
            changed = change(at, args)
            replaced[at] = self.put(entry.op, *args, value=entry.value) if changed is None else changed
        return [replaced[r] for r in roots]

    def read(self, text: object) -> int:
        """Return the table position of the expression in `text`; raise Rejected if the text is not an expression."""
        if isinstance(text, str) and text in self._read:
            return self._read[text]
        if not isinstance(text, str) or len(text) > _LONGEST:
            raise Rejected(f"an expression is not a text of at most {_LONGEST} characters")
        go_on()
        lexemes = [("end", ""), *reversed(_short_lexemes(text) if len(text) <= _SHORT else _lexemes(text))]
        tree = self._expression(lexemes, 0, 0)
        if lexemes[-1][0] != "end":
            raise Rejected(f"an expression cannot be read at {lexemes[-1][1]!r}")
        if len(text) <= _SHORT:
            self._read[text] = tree
        return tree

    def total(self, roots: Iterable[int]) -> bool:
        """Return whether all operations of expressions are defined for all numbers."""
        return all(self._is_total(self.entries[at]) for at in self.needed(roots))

    def _is_total(self, entry: Entry) -> bool:
        if entry.op == "div":
            under = self.entries[entry.args[1]]
            return under.op == "num" and under.value != 0
        return entry.op in _TOTAL or (entry.op == "pow" and entry.value >= 0)

    def _expression(self, rest: list[tuple[str, str]], least: int, depth: int) -> int:
        # precedence climbing; a sign before a factor binds weaker than ^ and stronger than * and /
        if depth > _DEEPEST:
            raise Rejected("an expression is nested too deeply")
        tree = self._factor(rest, depth)
        while rest[-1][0] == "sign" and _BINDS.get(rest[-1][1], -1) > least:
            sign = rest.pop()[1]
            tree = self.put(_OPS[sign], tree, self._expression(rest, _BINDS[sign], depth + 1))
        return tree

    def _factor(self, rest: list[tuple[str, str]], depth: int) -> int:
        minus = False
        while rest[-1] in (("sign", "-"), ("sign", "+")):
            minus ^= rest.pop()[1] == "-"
        tree = self._operand(rest, depth)
        if rest[-1] == ("sign", "^"):
            rest.pop()
            exponent = self._exponent(rest)
            if rest[-1] == ("sign", "^"):
                raise Rejected("a power of a power needs parentheses")
            tree = self.put("pow" if exponent.denominator == 1 else "powr", tree, value=exponent)
        if minus:
            entry = self.entries[tree]
            return self.put("num", value=-entry.value) if entry.op == "num" else self.put("neg", tree)
        return tree

    def _exponent(self, rest: list[tuple[str, str]]) -> Fraction:
        fraction = rest[-1] == ("sign", "(")
        if fraction:
            rest.pop()
        minus = rest[-1] == ("sign", "-")
        if minus:
            rest.pop()
        value = self._constant(rest)
        if fraction:
            if rest[-1] == ("sign", "/"):
                rest.pop()
                under = self._constant(rest)
                if not under:
                    raise Rejected("the denominator of an exponent is 0")
                value /= under
            self._close(rest)
        if value > 64:
            raise Rejected(f"{value} is not an exponent: give a number of at most 64")
        return -value if minus else value

    @staticmethod
    def _constant(rest: list[tuple[str, str]]) -> Fraction:
        kind, text = rest.pop()
        if kind != "number" or len(text) > _LONGEST_EXPONENT:
            raise Rejected(f"{text!r} is not an exponent: give a number of at most 64")
        return _short_decimal(text)

    def _operand(self, rest: list[tuple[str, str]], depth: int) -> int:
        kind, text = rest.pop()
        if kind == "number":
            return self.put("num", value=_decimal(text))
        if kind == "name" and rest[-1] == ("sign", "("):
            rest.pop()
            args = [self._expression(rest, 0, depth + 1)]
            while rest[-1] == ("sign", ","):
                rest.pop()
                args.append(self._expression(rest, 0, depth + 1))
            self._close(rest)
            if FUNCTIONS.get(text) != len(args):
                raise Rejected(f"the grammar has no function {text!r} with {len(args)} arguments")
            return self.put(text, *args)
        if kind == "name":
            if text == "pi":
                return self.put("pi")
            if text not in self.names:
                raise Rejected(f"{text!r} is not one of the claim's variables")
            return self.put("var", value=self.names.index(text))
        if text == "(":
            tree = self._expression(rest, 0, depth + 1)
            self._close(rest)
            return tree
        raise Rejected(f"an expression cannot be read at {text!r}")

    @staticmethod
    def _close(rest: list[tuple[str, str]]) -> None:
        if rest.pop() != ("sign", ")"):
            raise Rejected("a parenthesis is not closed")
