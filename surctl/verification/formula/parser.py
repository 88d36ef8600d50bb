"""Text of the claim grammar to expressions and back, mistakes with their column; long texts cut; from CasADi.

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

import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import lru_cache
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import NamedTuple

import casadi as ca

from surctl.errors import InputError, UnsupportedOperation, nearest
from surctl.verification.formula.node import ARITY, DEEPEST, PI, Node, exact_values, number, ordered, power, variable

FUNCTIONS = (
    "abs", "acos", "asin", "atan", "atan2", "cos", "cosh", "exp", "log", "max", "min", "select", "sin", "sinh", "sqrt",
    "tan", "tanh",
)  # fmt: skip
"""The functions of the grammar; `select(a, b, x, y)` is x if a ≤ b, and y otherwise."""

IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
LONGEST = 60_000
"""The largest number of characters in one expression."""
_TOKEN = re.compile(
    r"\s*(?:(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|(\*\*|[-+*/^(),])|(\S))",
    re.ASCII,
)
LARGEST_POWER = 64
"""The largest exponent."""
_LARGEST_EXPONENT, _MOST_DIGITS, _LARGEST_NUMBER = 320, 400, Fraction(sys.float_info.max)
_CONSTANT = frozenset({"num", "neg", "add", "sub", "mul", "div"})  # operations of an exponent
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
        negative = bool(self._takes("-"))
        exponent = self._atom()
        tree = -exponent if negative else exponent
        values = exact_values([tree], {}) if all(n.op in _CONSTANT for n in ordered(tree)) else None
        value = values[0] if values else None
        if value is None or abs(value) > LARGEST_POWER or max(map(len, map(str, value.as_integer_ratio()))) > _LONGEST:
            remedy = f"write a constant of at most {LARGEST_POWER}, such as 2, -1.5 or (3/2)"
            raise self._mistake("is not an exponent", token, remedy)
        if self._next.text == "^":
            raise self._mistake("has no defined order here", self._next, "write parentheses")
        return Node("pow" if value.denominator == 1 else "powr", (base,), value)

    def _atom(self) -> Node:
        token = self._take()
        if token.kind == "number":
            exponent = re.split("[eE]", token.text)[1:]
            long = len(token.text) > _MOST_DIGITS or (exponent and abs(int(exponent[0][:9])) > _LARGEST_EXPONENT)
            if long or (value := Fraction(token.text)) > _LARGEST_NUMBER:
                raise self._mistake("is out of range", token, "scale the claim")
            return number(value)
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


# Write an expression as text, from which the parser restores the expression exactly


_DIGITS = 120  # most decimals of a number that is not written as a fraction
_LARGEST = 10**16  # integers below it are written as such


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


@lru_cache(256)
def reread(node: Node, names: tuple[str, ...]) -> Node:
    """Return the expression of named variables that a reader obtains from the text of an expression."""
    return parse(text_of(node), {name: variable(name) for name in names})


_LONG_NUMBER = re.compile(r"(?<![\w.])(?=\d*\.)((?:0?\.0*)?[1-9](?:\.?\d){16})\d+(?![\w.])")
_LONG_FRACTION = re.compile(r"(?<![\w./^])(\d{9,})/(\d{9,})(?![\w.^])")


def clipped(text: str, most: int = 400) -> str:
    """Return the text of an expression for a screen: its first characters, and its length if that is more than `most`.

    A long number has the fewest digits that identify it if it is a double; of others, the first 17 stay, with `…`, and
    a long fraction p/q becomes a decimal with 10 digits and `…`.

    Example:
        >>> from surctl.verification.formula.parser import clipped
        >>> clipped("x + y", 3), clipped("0.50000000000000011102230246251565404236316680908203125*x")
        ('x + ... (5 characters)', '0.5000000000000001*x')
    """

    def short(number: re.Match[str]) -> str:
        double = float(number[0])
        return repr(double) if Fraction(number[0]) == Fraction(double) else f"{number[1]}…"

    text = _LONG_FRACTION.sub(lambda one: f"{Decimal(one[1]) / Decimal(one[2]):.10g}…", text)
    text = _LONG_NUMBER.sub(short, text)
    return text if len(text) <= most else f"{text[:most]} ... ({len(text)} characters)"


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


# Convert CasADi SX expressions to expressions of the claim grammar, operation by operation


_SHARES = tuple(Fraction(p, q) for p in range(1, 5) for q in (1, 2, 3, 4, 6))
_PI_PARTS: Mapping[float, Fraction] = MappingProxyType(
    {sign * math.pi * p.numerator / p.denominator: sign * p for p in _SHARES for sign in (1, -1)}
)
_NAMES: Mapping[int, str] = MappingProxyType(
    {int(getattr(ca, n)): n[3:].lower() for n in dir(ca) if n.startswith("OP_")}
)
_PLAIN = MappingProxyType(
    {"add": "add", "sub": "sub", "mul": "mul", "div": "div", "neg": "neg", "sqrt": "sqrt", "fabs": "abs",
     "fmin": "min", "fmax": "max", "sin": "sin", "cos": "cos", "atan2": "atan2", "acos": "acos", "atan": "atan",
     "asin": "asin", "tan": "tan", "exp": "exp", "log": "log", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh"}
)  # fmt: skip
_COMPOSED: Mapping[str, Callable[..., Node]] = MappingProxyType(
    {"sq": lambda x: power(x, 2), "twice": lambda x: number(2) * x, "inv": lambda x: number(1) / x,
     "fma": lambda x, y, z: x * y + z, "log1p": lambda x: Node("log", (number(1) + x,)),
     "expm1": lambda x: Node("exp", (x,)) - number(1)}
)  # fmt: skip
_SUBSTITUTES: Mapping[str, str] = MappingProxyType(
    {"hypot": "write sqrt(x*x + y*y)", "sign": "write tanh(x/width), or a saturation min(max(x/width, -1), 1)",
     "copysign": "use if_else and fabs",
     "asinh": "write log(x + sqrt(x*x + 1))", "acosh": "write log(x + sqrt(x*x - 1))",
     "atanh": "write log((1 + x)/(1 - x))/2", "eq": "compare by <=, or feed a difference back",
     "ne": "compare by <="}
)  # fmt: skip
_COMMUTATIVE = frozenset({"add", "mul"})
_COMPARISONS = frozenset({"lt", "le"})
_LONG = 15  # a number with at least this many digits is assumed to result from rounding
_LARGEST_SHARE = 1000  # an exponent of 15 digits or more is read as a fraction with at most this denominator


@dataclass(frozen=True)
class _Comparison:
    # a < b or a <= b, or its negation
    op: str
    a: Node
    b: Node
    negated: bool = False


@dataclass(frozen=True)
class _Branch:
    # the value if the comparison holds, otherwise 0
    condition: _Comparison
    value: Node


_Value = Node | _Comparison | _Branch


def from_casadi(
    symbols: ca.SX, names: Sequence[str], expressions: Sequence[ca.SX], *, to_the_bit: bool = False
) -> list[Node]:
    """Convert scalar SX expressions in the symbols to expressions of the grammar.

    With `to_the_bit`, every number is exactly the double of the instruction list, as the exported code has it; nothing
    is guessed. Otherwise the expressions stand for a formula on paper, which was written with decimals: a number
    becomes the shortest decimal number whose nearest double is the constant in the CasADi expression. CasADi evaluates
    constant subexpressions when they are created. Therefore a constant that equals a fraction of π in double precision
    is read as this fraction of π, and an exponent that equals a fraction such as 1/3 as this fraction. A constant of 15
    digits or more that equals the rounded product of two other constants is read as this product.

    A power with a variable exponent, x^y, becomes exp(y*log(x)), which is defined for x > 0.

    Args:
        symbols: column of symbols (n, 1).
        names: names of the symbols, in order.
        expressions: scalar expressions, dense or structurally zero.
        to_the_bit: whether numbers are the doubles themselves, as for a law or plant; not for a formula on paper.

    Raises:
        UnsupportedOperation: an expression has an operation that the grammar lacks, such as floor or a logical
            operation other than a comparison.
    """
    function = ca.Function("claim", [symbols], [ca.densify(ca.vertcat(*expressions, 0))])
    count = function.n_instructions()
    ops = [_NAMES.get(function.instruction_id(k), "unknown") for k in range(count)]
    constants = [float(function.instruction_constant(k)) for k in range(count) if ops[k] == "const"]
    reader = _Reader(guess=not to_the_bit)
    slots: dict[int, _Value] = {}  # CasADi reuses work slots: each write gives a slot a new value
    stored: dict[int, Node] = {}
    for k, op in enumerate(ops):
        args, result = function.instruction_input(k), function.instruction_output(k)
        if op == "output":
            stored[int(result[1])] = _plain(slots[args[0]], op)
        elif op == "input":
            slots[result[0]] = reader.put(variable(names[args[1]]))
        elif op == "const":
            value = float(function.instruction_constant(k))
            slots[result[0]] = reader.put(_double(value) if to_the_bit else _short_constant(value, constants))
        else:
            slots[result[0]] = reader.put(reader.operation(op, [slots[a] for a in args]))
    return [stored[k] for k in range(len(expressions))]


class _Reader:
    # operands of sums and products are ordered by their first occurrence, so that equal expressions have equal nodes
    def __init__(self, *, guess: bool) -> None:
        self._guess = guess
        self._order: dict[_Value, int] = {}

    def put(self, value: _Value) -> _Value:
        self._order.setdefault(value, len(self._order))
        return value

    def operation(self, op: str, values: Sequence[_Value]) -> _Value:
        if op in _COMPARISONS:
            return _Comparison(op, _plain(values[0], op), _plain(values[1], op))
        if op == "not" and isinstance(condition := values[0], _Comparison):
            return _Comparison(condition.op, condition.a, condition.b, not condition.negated)
        if op == "if_else_zero" and isinstance(condition := values[0], _Comparison):
            return _Branch(condition, _plain(values[1], op))
        if op == "add" and (joined := _joined(*values)) is not None:
            return joined
        if op in _COMMUTATIVE:
            values = sorted(values, key=lambda v: self._order[v])
        args = [_plain(v, op) for v in values]
        if op in _PLAIN:
            return Node(_PLAIN[op], tuple(args))
        if op in _COMPOSED:
            return _COMPOSED[op](*args)
        if op in ("pow", "constpow"):
            return _power(*args, guess=self._guess)
        remedy = _SUBSTITUTES.get(op, "use + - * / ^ and the functions " + ", ".join(FUNCTIONS))
        raise UnsupportedOperation(f"operation {op!r} is not part of the claim grammar", key="claim", remedy=remedy)


def _joined(first: _Value, second: _Value) -> Node | None:
    """Return the select that CasADi writes as the sum of two branches with opposite conditions; None otherwise."""
    if not (isinstance(first, _Branch) and isinstance(second, _Branch)):
        return None
    p, q = first.condition, second.condition
    if (p.op, p.a, p.b) != (q.op, q.a, q.b) or p.negated == q.negated:
        return None
    x, y = (second.value, first.value) if p.negated else (first.value, second.value)
    return Node("select", (p.a, p.b, x, y)) if p.op == "le" else Node("select", (p.b, p.a, y, x))


def _plain(value: _Value, op: str) -> Node:
    if isinstance(value, _Branch):  # CasADi leaves out a branch that is 0
        c = value.condition
        joined = _joined(value, _Branch(_Comparison(c.op, c.a, c.b, not c.negated), number(0)))
        assert joined is not None
        return joined
    if not isinstance(value, Node):
        raise UnsupportedOperation(
            f"a comparison as an operand of {op!r} is not part of the claim grammar", key="claim", remedy="use select"
        )
    return value


def _power(base: Node, exponent: Node, *, guess: bool) -> Node:
    if exponent.op != "num":
        return Node("exp", (exponent * Node("log", (base,)),))
    value = exponent.value
    near = value.limit_denominator(_LARGEST_SHARE)
    if guess and float(near) == float(value):
        value = near
    if abs(value) > LARGEST_POWER:
        raise UnsupportedOperation(
            f"a power with the exponent {float(value):g} is not part of the claim grammar",
            key="claim",
            remedy=f"use an exponent of at most {LARGEST_POWER}",
        )
    return power(base, value)


def _double(value: float) -> Node:
    if not math.isfinite(value):
        raise UnsupportedOperation(
            f"contains the constant {value}", key="claim", remedy="find the expression that is undefined"
        )
    return number(Fraction(value))


def _short_constant(value: float, others: Sequence[float]) -> Node:
    _double(value)
    share = _PI_PARTS.get(value)
    if share is not None:
        return PI if share == 1 else number(share) * PI
    exact = Fraction(repr(value))
    if sum(c.isdigit() for c in repr(value).split("e")[0].lstrip("-0.")) < _LONG:
        return number(exact)
    for b, c in combinations_with_replacement([x for x in others if x > 0 and x not in (1.0, abs(value))], 2):
        if b * c == abs(value):
            product = power(_short_constant(b, ()), 2) if b == c else _short_constant(b, ()) * _short_constant(c, ())
            return product if value > 0 else -product
    return number(exact)
