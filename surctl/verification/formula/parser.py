"""Parse text into an expression by recursive descent; the text is never executed as code.

::

    sum     = product { ("+" | "-") product }
    product = signed { ("*" | "/") signed }
    signed  = ("-" | "+") signed | power
    power   = atom [ "^" exponent ]
    exponent = ["-"] ( number | name ) | "(" sum ")"
    atom    = number | name | function "(" sum { "," sum } ")" | "(" sum ")"

A number has exactly the value of its decimal notation; `pi` is π exactly. An exponent is a constant: it has numbers,
names of constants, + - * / and parentheses. A power with a fractional exponent is defined for a positive base, and for
the base 0 if the exponent is positive.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from surctl.errors import InputError, nearest
from surctl.verification.formula.node import ARITY, DEEPEST, PI, Node, number, ordered

__all__ = ["FUNCTIONS", "IDENTIFIER", "LARGEST_POWER", "LONGEST", "decimal", "is_name", "parse", "parse_relation"]

FUNCTIONS = (
    "abs", "acos", "asin", "atan", "atan2", "cos", "cosh", "exp", "log", "max", "min", "select", "sin", "sinh", "sqrt",
    "tan", "tanh",
)  # fmt: skip
"""The functions of the grammar; `select(a, b, x, y)` is x if a ≤ b, and y otherwise."""

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
LONGEST = 60_000
"""The largest number of characters in one expression."""
_TOKEN = re.compile(
    r"\s*(?:(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|(\*\*|[-+*/^(),])|(\S))"
)
LARGEST_POWER = 64
"""The largest exponent."""
_LARGEST_EXPONENT, _MOST_DIGITS = 320, 400
_LONGEST = 30  # most digits of numerator and denominator of an exponent


def is_name(name: str) -> bool:
    """Return whether an expression may use the name for a variable or a constant."""
    return IDENTIFIER.fullmatch(name) is not None and name not in (*FUNCTIONS, "pi")


def parse(text: str, known: Mapping[str, Node], *, file: object = None, key: str | None = None) -> Node:
    """Parse a text into an expression.

    Args:
        text: an expression of the claim grammar.
        known: mapping from every allowed name to its variable or number.
        file: the file that holds the text, for error messages.
        key: the key of the text in the file, for error messages.

    Raises:
        InputError: the text is not an expression of the grammar; the error names file, key, token and column, and the
            remedy. For an unknown name, the error proposes the nearest known name.
    """
    if not isinstance(text, str):
        raise InputError("must be an expression in quotes", file=file, key=key, value=text, remedy='write e.g. "x^2"')
    if len(text) > LONGEST:
        raise InputError(f"is longer than {LONGEST} characters", file=file, key=key, remedy="split the claim")
    return _Parser(text, known, file, key).whole()


def parse_relation(text: str, known: Mapping[str, Node], *, file: object = None, key: str | None = None) -> Node:
    """Parse an inequality with one <= or >= into an expression that is ≤ 0 where the inequality holds.

    The arguments and errors are those of `parse`.
    """
    signs = [sign for sign in ("<=", ">=") if sign in text]
    if len(signs) != 1 or text.count(signs[0]) != 1:
        raise InputError("needs one <= or >=", file=file, key=key, value=text, remedy='write e.g. "x^2 <= 4"')
    at = text.index(signs[0])
    # pad with blanks, so that errors name the right column for the text after the sign
    first = parse(text[:at], known, file=file, key=key)
    second = parse(" " * (at + 2) + text[at + 2 :], known, file=file, key=key)
    if signs[0] == "<=" and second == number(0):
        return first
    return first - second if signs[0] == "<=" else second - first


def decimal(text: str) -> Fraction:
    """Return the exact value of a decimal number such as 1.5e-3."""
    return Fraction(text)


def _constant(root: Node) -> Fraction | None:
    """Return the value of an expression of numbers and + - * /; None if the expression is another."""
    values: dict[Node, Fraction] = {}
    for node in ordered(root):
        args = [values[a] for a in node.args]
        match node.op:
            case "num":
                values[node] = node.value
            case "add" | "sub":
                values[node] = args[0] + args[1] if node.op == "add" else args[0] - args[1]
            case "mul":
                values[node] = args[0] * args[1]
            case "div" if args[1]:
                values[node] = args[0] / args[1]
            case "neg":
                values[node] = -args[0]
            case _:
                return None
    return values[root]


class _Token(NamedTuple):
    kind: str
    text: str
    column: int


class _Parser:
    def __init__(self, text: str, known: Mapping[str, Node], file: object, key: str | None) -> None:
        self._known, self._file, self._key, self._depth = known, file, key, 0
        self._tokens = self._split(text)
        self._at = 0

    def whole(self) -> Node:
        tree = self._sum()
        if self._next.kind != "end":
            remedy = "write * between factors" if self._next.kind in ("name", "number") else "remove this token"
            raise self._mistake("is not expected here", self._next, remedy)
        return tree

    def _split(self, text: str) -> list[_Token]:
        tokens, at, end = [], 0, len(text.rstrip())
        while at < end:
            match = _TOKEN.match(text, at)
            assert match is not None  # the last group matches any character
            kind = ("number", "name", "sign", "other")[(match.lastindex or 1) - 1]
            token = _Token(kind, match[match.lastindex or 1], match.start(match.lastindex or 1) + 1)
            if kind == "other":
                raise self._mistake("is not part of the grammar", token, "use + - * / ^ ( ) , numbers and names")
            if token.text == "**":
                raise self._mistake("is not part of the grammar", token, "write ^ for a power")
            tokens.append(token)
            at = match.end()
        tokens.append(_Token("end", "end of text", end + 1))
        return tokens

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        token = self._next
        self._at += 1
        return token

    def _takes(self, *signs: str) -> str:
        if self._next.kind == "sign" and self._next.text in signs:
            return self._take().text
        return ""

    def _expect(self, sign: str) -> None:
        if not self._takes(sign):
            raise self._mistake(f"appears where {sign!r} is expected", self._next, f"write {sign}")

    def _sum(self) -> Node:
        self._depth += 1
        if self._depth > DEEPEST // 4:
            raise self._mistake("is nested too deeply", self._next, "write it with less nesting")
        tree = self._product()
        while sign := self._takes("+", "-"):
            right = self._product()
            tree = self._joined(tree + right if sign == "+" else tree - right)
        self._depth -= 1
        return tree

    def _product(self) -> Node:
        tree = self._signed()
        while sign := self._takes("*", "/"):
            right = self._signed()
            tree = self._joined(tree * right if sign == "*" else tree / right)
        return tree

    def _joined(self, tree: Node) -> Node:
        if tree.depth >= DEEPEST - 1:
            raise self._mistake("makes the expression too long", self._next, "put parts of it in parentheses")
        return tree

    def _signed(self) -> Node:
        negative = False
        while sign := self._takes("+", "-"):
            negative ^= sign == "-"
        tree = self._power()
        if negative and tree.op == "num":
            return number(-tree.value)
        return -tree if negative else tree

    def _power(self) -> Node:
        base = self._atom()
        if not self._takes("^"):
            return base
        token = self._next
        tree = self._signed_constant()
        value = _constant(tree)
        if value is None or abs(value) > LARGEST_POWER or max(map(len, map(str, value.as_integer_ratio()))) > _LONGEST:
            remedy = f"write a constant of at most {LARGEST_POWER}, such as 2, -1.5 or (3/2)"
            raise self._mistake("is not an exponent", token, remedy)
        if self._next.text == "^":
            raise self._mistake("has no defined order here", self._next, "write parentheses")
        return Node("pow" if value.denominator == 1 else "powr", (base,), value)

    def _signed_constant(self) -> Node:
        negative = bool(self._takes("-"))
        tree = self._atom()
        return -tree if negative else tree

    def _atom(self) -> Node:
        token = self._take()
        if token.kind == "number":
            exponent = re.split("[eE]", token.text)[1:]
            if len(token.text) > _MOST_DIGITS or (exponent and abs(int(exponent[0][:9])) > _LARGEST_EXPONENT):
                raise self._mistake("is out of range", token, "scale the claim")
            return number(decimal(token.text))
        if token.kind == "name":
            return self._called(token) if self._next.text == "(" else self._named(token)
        if token.text == "(":
            tree = self._sum()
            self._expect(")")
            return tree
        raise self._mistake("appears where a number, a name or ( is expected", token, "complete the expression")

    def _named(self, token: _Token) -> Node:
        if token.text in FUNCTIONS:
            raise self._mistake("is a function", token, f"write {token.text}( … )")
        if token.text == "pi":
            return PI
        if token.text not in self._known:
            raise self._mistake("is not known", token, nearest(token.text, {*self._known, "pi"}))
        return self._known[token.text]

    def _called(self, token: _Token) -> Node:
        if token.text not in FUNCTIONS:
            remedy = "write * before (" if token.text in self._known else nearest(token.text, FUNCTIONS)
            raise self._mistake("is not a function", token, remedy)
        self._expect("(")
        args = [self._sum()]
        while self._takes(","):
            args.append(self._sum())
        self._expect(")")
        if len(args) != ARITY[token.text]:
            count = ARITY[token.text]
            takes = f"give {count} argument{'s' * (count != 1)}"
            raise self._mistake(f"has {len(args)} argument{'s' * (len(args) != 1)}", token, takes)
        return Node(token.text, tuple(args))

    def _mistake(self, problem: str, token: _Token, remedy: str) -> InputError:
        shown = token.text if len(token.text) <= 40 else token.text[:37] + "..."
        message = f"{shown!r} at column {token.column} {problem}"
        return InputError(message, file=self._file, key=self._key or "expression", remedy=remedy)
