"""Expressions that instruction lists compute, derived from the instructions, and their comparison with stated texts.

`Derivation` is an algebra for `surctl.certcheck.instructions`: each value is the position of an expression in a table,
so the evaluation of a list gives one expression in real numbers for each output. Constants are exact, and operations of
constants are computed. A comparison is an operation of its own until an operation selects by it.

The exported code has its own sine, cosine, atan2, arccosine, exp, log and tanh, which its lists write out in basic
operations. Wherever a value may begin such a formula, the formula for this value is put into the table; the instruction
that completes it is then the function. The formulas agree with the functions up to a few units in the last place, which
belong to the rounding of the code, for the arguments that `require_arguments` permits.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import Interval
from surctl.certcheck.enclosure import enclose, outward
from surctl.certcheck.expressions import BRANCHES, ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.instructions import Numbers
from surctl.certcheck.patience import go_on
from surctl.certcheck.rounding import OVERFLOW, STEP, TINY, propagated

__all__ = ["Derivation"]

Places: TypeAlias = NDArray[np.intp]

_TRUTHS = ("le", "lt", "eq", "ne", "and", "or", "not")  # operations whose value is true or false
_COMMUTE = ("add", "mul", "min", "max", "eq", "ne", "and", "or")
_COMPUTED: Mapping[str, Callable[..., Fraction | int]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
    "abs": abs, "min": min, "max": max, "lt": lambda a, b: int(a < b), "le": lambda a, b: int(a <= b),
    "eq": lambda a, b: int(a == b), "ne": lambda a, b: int(a != b),
}  # fmt: skip
"""Operations whose results of numbers are numbers."""
_NAMES = {"fabs": "abs", "fmin": "min", "fmax": "max"}  # of operations whose names in the grammar are others

_SINE = (
    "-0x1.5555555555555p-3 0x1.1111111110babp-7 -0x1.a01a019e820aep-13 0x1.71de37946ed6dp-19 -0x1.ae6008d114485p-26 "
    "0x1.5e0a4fc16be59p-33"
)
_COSINE = (
    "0x1.5555555555555p-5 -0x1.6c16c16c16963p-10 0x1.a01a019f4ddfdp-16 -0x1.27e4fa16cc2d1p-22 0x1.1eeb67d026ec6p-29 "
    "-0x1.907cd8ff5ede7p-37"
)
_ARCTANGENT = (
    "-0x1.5555555555555p-2 0x1.999999999933dp-3 -0x1.24924924355d5p-3 0x1.c71c7184c32bfp-4 -0x1.745d0b153ffadp-4 "
    "0x1.3b126143b5cbcp-4 -0x1.10fa5ee9ab25cp-4 0x1.dfe49b2919c4ep-5 -0x1.a090d1950d2b4p-5 0x1.41495cefb6c73p-5 "
    "-0x1.39f38ad451ea6p-6"
)
_EXPONENTIAL = (
    "0x1.0000000000001p-1 0x1.5555555555556p-3 0x1.5555555553d63p-5 0x1.11111111109b3p-7 0x1.6c16c1788bd90p-10 "
    "0x1.a01a01a7c41d5p-13 0x1.a019b90d2ae7ap-16 0x1.71de0dae63bb3p-19 0x1.289185613a3d6p-22 0x1.af38a9b0ec855p-26"
)
_LOGARITHM = (
    "0x1.5555555555558p-2 0x1.99999999952d7p-3 0x1.2492492df281ap-3 0x1.c71c62e3f11e6p-4 0x1.7462b51cb66b1p-4 "
    "0x1.39fe51a7c18f9p-4 0x1.2b5900de53b32p-4"
)
_HYPERBOLIC = (
    "-0x1.5555555555555p-2 0x1.1111111110c20p-3 -0x1.ba1ba1b9781ddp-5 0x1.664f48410984fp-6 -0x1.226e27eb22333p-7 "
    "0x1.d6d0a4264e8f3p-9 -0x1.7d68a684c1e80p-10 0x1.32b08be7b1d07p-11 -0x1.cf9da632b4e6ap-13 0x1.f2d7e77542a4ap-15"
)
_LN_2, _BY_LN_2 = "0x1.62ep-1 0x1.0bfp-15 0x1.7d1cf79abc9e4p-28", "0x1.71547652b82fep+0"
_EXPONENTS = [2**bit for bit in reversed(range(10))]  # of a power of two, from bits
_LARGEST_EXPONENT, _LEAST, _SCALE = 1023.0, 2.0**-1022, 54
_HALF_PI = "0x1.921p+0 0x1.f6ap-13 0x1.110b4611p-26 0x1.4c4c6628b80dcp-59"
_TWO_BY_PI, _TAN_PI_8, _LARGEST = "0x1.45f306dc9c883p-1", "0x1.a827999fcef34p-2", 2.0**20
_ARGUMENTS = {
    **dict.fromkeys(("sin", "cos", "tan"), (-_LARGEST, _LARGEST)),
    **dict.fromkeys(("exp", "sinh", "cosh"), (-86.9, 86.9)),
    **dict.fromkeys(("log", "powr"), (2.0**-126, 2.0**127)),
}  # where the formulas are the functions, also in float
_BITS = 65_536  # most bits of an exact number
_BY_ROUNDING = "an instruction list selects by rounding how it goes on: no expression is derived"


class Derivation(Numbers):
    """Expressions of the named variables, as positions in a table.

    Attributes:
        table: the table.
        constants: bounds of the errors with which the code computes numbers from constants, by position.
    """

    dtype = np.intp

    def __init__(self, names: Sequence[str]) -> None:
        self.table = ExpressionTable(names)
        self.constants: dict[int, float] = {}
        self._normal = Exact(self.table)
        self._functions: dict[int, int] = {}  # position of a complete formula → position of its function
        self._same: list[int] = []  # operands of branches, no two of them equal

    def variable(self, name: str) -> int:
        """Return the position of a variable."""
        return self.table.put("var", value=self.table.names.index(name))

    # ---- the algebra

    def constant(self, value: float) -> int:
        """Return the position of a number."""
        if math.isinf(value):
            return self.table.put("neg", self.table.put("inf")) if value < 0 else self.table.put("inf")
        return self.table.put("num", value=Fraction(value))

    def truth(self, values: Any) -> Any:
        """Return whether a value that is a number is not 0."""
        number, error = self._number(values[0])
        if error and abs(number) <= error:
            raise Rejected(_BY_ROUNDING)
        return np.array([number != 0])

    def places(self, values: Any, last: int) -> Places:
        """Return a value that is a number, rounded down to a place from 0 to `last`."""
        number, error = self._number(values[0])
        place, *others = (min(max(math.floor(x), 0), last) for x in (number, number - error, number + error))
        if set(others) != {place}:
            raise Rejected(_BY_ROUNDING)
        return np.array([place])

    def procedure(self, run: Any, vectors: Any) -> Any:
        """Raise Rejected: of a procedure, no expression is derived."""
        raise Rejected("an instruction list has a procedure, of which no expression is derived")

    def apply(self, op: str, operands: Sequence[Any]) -> int:
        """Return the position of the result of an instruction."""
        at = self._put(op, *(int(np.ravel(a)[0]) for a in operands))
        entry = self.table.entries[at]
        if entry.op == "abs":
            for function in ("sin", "cos", "tanh"):
                self._await(function, *entry.args)
        elif op == "lt":  # atan2 and acos compare the two sides of their triangle first
            x, y = (int(np.ravel(a)[0]) for a in operands)
            for sides in product(self._with_size(y), self._with_size(x)):
                self._await("atan2", *sides)
            if self._op(x) == "sqrt" == self._op(y):
                below = self.table.entries[self.table.entries[y].args[0]]
                if below.op == "sub":
                    self._await("acos", below.args[1])
            if self._is(y, _LEAST):
                self._await("log", x)
        elif entry.op == "min":  # the first instruction of exp
            for x in (x for x, limit in (entry.args, entry.args[::-1]) if self._is(limit, _LARGEST_EXPONENT)):
                self._await("exp", x)
        return self._functions.get(at, at)

    def _is(self, at: int, value: float) -> bool:
        entry = self.table.entries[at]
        return entry.op == "num" and entry.value == Fraction(value)

    def _with_size(self, at: int) -> tuple[int, ...]:
        """Return what a value may be the absolute value of."""
        op = self._op(at)
        return self.table.entries[at].args if op == "abs" else (at, self._put("neg", at)) if op == "num" else ()

    def _number(self, at: Any) -> tuple[Fraction, Fraction]:
        """Return a number, and the error with which the code computes it."""
        place = int(np.ravel(at)[0])
        entry = self.table.entries[place]
        if entry.op != "num":
            raise Rejected("an instruction list selects by the state how it goes on: no expression is derived")
        return entry.value, self._error(place)

    def _error(self, at: int) -> Fraction:
        return Fraction(self.constants.get(at, 0.0))

    def _await(self, function: str, *args: int) -> None:
        formula = getattr(self, f"_{function}")(*args)
        if formula not in self._functions and self._op(formula) != "num":
            self._functions[formula] = self.table.put(function, *args)

    # ---- operations

    def _put(self, op: str, *args: int) -> int:
        match op:
            case "fma":
                return self._put("add", self._put("mul", *args[:2]), args[2])
            case "inv":
                return self._put("div", self._num(1), *args)
            case "sq":
                return self._put("mul", *args, *args)
            case "twice":
                return self._put("mul", self._num(2), *args)
            case "select":
                return self._chosen(*args)
            case "if_else_zero":
                return self._chosen(args[0], args[1], self._num(0))
            case "not" if self._op(args[0]) in ("lt", "le"):
                return self._put("le" if self._op(args[0]) == "lt" else "lt", *self.table.entries[args[0]].args[::-1])
        op = _NAMES.get(op, op)
        if op not in ("and", "or", "not"):
            args = tuple(self._chosen(a, self._num(1), self._num(0)) if self._op(a) in _TRUTHS else a for a in args)
        values = [self.table.entries[a].value for a in args if self._op(a) == "num"]
        if len(values) == len(args) and op in _COMPUTED and not (op == "div" and not values[1]):
            return self._computed(op, args, values)
        if op == "add" and (joined := self._joined(*args)) is not None:
            return joined
        return self.table.put(op, *(sorted(args) if op in _COMMUTE else args))

    def _computed(self, op: str, args: Sequence[int], values: Sequence[Fraction]) -> int:
        """Return the number that an operation gives; a comparison that rounding may decide stays as it is."""
        go_on()
        errors = [self._error(a) for a in args]
        if op in _TRUTHS:
            near = any(errors) and abs(values[0] - values[1]) <= sum(errors)
            return self.table.put(op, *args) if near else self._num(_COMPUTED[op](*values))
        result = Fraction(_COMPUTED[op](*values))
        bound = propagated(op, errors, [(value, value) for value in values], abs(result))
        if not (abs(result) < OVERFLOW and bound < OVERFLOW):
            problem = "that is too large for the code, or divides by one that may be rounded to 0"
            raise Rejected(f"an instruction list computes a number {problem}")
        if result.numerator.bit_length() + result.denominator.bit_length() > _BITS:
            raise Rejected("an instruction list computes a number with too many digits")
        error = Fraction(bound)
        if op in ("add", "sub", "mul", "div") and (error or Fraction(float(result)) != result):
            error += abs(result) * Fraction(STEP) + Fraction(TINY)
        at = self._num(result)
        if error:  # a number may be computed in several ways
            self.constants[at] = max(self.constants.get(at, 0.0), math.nextafter(float(error), math.inf))
        return at

    def _num(self, value: Fraction | int) -> int:
        return self.table.put("num", value=value)

    def _op(self, at: int) -> str:
        return self.table.entries[at].op

    def _chosen(self, condition: int, x: int, y: int) -> int:
        """Return x if the condition holds, and y otherwise."""
        go_on()  # branches of branches are as many as the file wants
        entry = self.table.entries[condition]
        match entry.op:
            case "num" if not (self._error(condition) and abs(entry.value) <= self._error(condition)):
                return x if entry.value else y
            case "le":
                return self.table.put("select", *entry.args, x, y)
            case "lt":
                return self.table.put("select", *entry.args[::-1], y, x)
            case "eq":
                a, b = entry.args
                return self._chosen(self._put("le", a, b), self._chosen(self._put("le", b, a), x, y), y)
            case "ne":
                return self._chosen(self._put("eq", *entry.args), y, x)
            case "not":
                return self._chosen(entry.args[0], y, x)
            case "and":
                return self._chosen(entry.args[0], self._chosen(entry.args[1], x, y), y)
            case "or":
                return self._chosen(entry.args[0], x, self._chosen(entry.args[1], x, y))
        return self._chosen(self._put("eq", condition, self._num(0)), y, x)

    def _joined(self, a: int, b: int) -> int | None:
        """Return the sum of two selections by one comparison, of which one is 0 in each case; None for other terms."""
        p, q, zero = self.table.entries[a], self.table.entries[b], self._num(0)
        if p.op == "select" == q.op and p.args[:2] == q.args[:2]:
            for first, second in ((p, q), (q, p)):
                if first.args[3] == zero == second.args[2]:
                    return self.table.put("select", *first.args[:3], second.args[3])
        return None

    # ---- formulas of the exported code

    def _do(self, op: str, *args: int | float | str) -> int:
        def place(a: int | float | str) -> int:
            return a if isinstance(a, int) else self.constant(float.fromhex(a) if isinstance(a, str) else a)

        return self._put(op, *map(place, args))

    def _polynomial(self, z: int, coefficients: str) -> int:
        *others, last = coefficients.split()
        value: int | str = last
        for coefficient in others[::-1]:
            value = self._do("add", self._do("mul", value, z), coefficient)
        return int(value)

    def _wave(self, x: int) -> tuple[int, int, int]:
        """Return the quadrant of an angle, and its sine and cosine up to their signs."""
        do = self._do
        r = do("select", do("le", do("fabs", x), _LARGEST), x, math.inf)
        k = do("floor", do("add", do("mul", r, _TWO_BY_PI), 0.5))
        for part in _HALF_PI.split():
            r = do("sub", r, do("mul", k, part))
        z = do("sq", r)
        sine = do("mul", r, do("add", do("mul", z, self._polynomial(z, _SINE)), 1.0))
        half = do("sub", do("mul", z, 0.5), do("mul", do("sq", z), self._polynomial(z, _COSINE)))
        cosine, pair = do("sub", 1.0, half), do("mul", k, 0.5)
        quadrant = do("sub", k, do("mul", do("floor", do("mul", k, 0.25)), 4.0))
        odd = do("ne", pair, do("floor", pair))
        return quadrant, do("select", odd, cosine, sine), do("select", odd, sine, cosine)

    def _sin(self, x: int) -> int:
        quadrant, size, _ = self._wave(x)
        return self._do("select", self._do("le", 2.0, quadrant), self._do("neg", size), size)

    def _cos(self, x: int) -> int:
        quadrant, _, size = self._wave(x)
        middle = self._do("lt", self._do("fabs", self._do("sub", quadrant, 1.5)), 1.0)
        return self._do("select", middle, self._do("neg", size), size)

    def _quarter(self, y: int, x: int) -> int:
        """Return atan2(y, x) for y and x that are not negative."""
        do = self._do
        steep = do("lt", x, y)
        small, large = do("select", steep, x, y), do("select", steep, y, x)
        cut = do("lt", do("mul", large, _TAN_PI_8), small)
        over = do("select", cut, do("sub", small, large), small)
        under = do("select", cut, do("add", small, large), large)
        t = do("div", over, do("select", do("eq", under, 0.0), 1.0, under))
        z = do("sq", t)
        angle = do("add", t, do("mul", do("mul", t, z), self._polynomial(z, _ARCTANGENT)))
        angle = do("select", cut, do("add", angle, math.pi / 4), angle)
        return do("select", steep, do("sub", math.pi / 2, angle), angle)

    def _atan2(self, y: int, x: int) -> int:
        do = self._do
        angle = self._quarter(do("fabs", y), do("fabs", x))
        angle = do("select", do("lt", x, 0.0), do("sub", math.pi, angle), angle)
        return do("select", do("lt", y, 0.0), do("neg", angle), angle)

    def _acos(self, x: int) -> int:
        do = self._do
        return do("twice", self._quarter(do("sqrt", do("sub", 1.0, x)), do("sqrt", do("add", x, 1.0))))

    def _exp(self, x: int) -> int:
        do, most = self._do, _LARGEST_EXPONENT
        r = do("fmax", do("fmin", x, most), -most)
        k = do("floor", do("add", do("mul", r, _BY_LN_2), 0.5))
        for part in _LN_2.split():
            r = do("sub", r, do("mul", k, part))
        value = do("add", do("add", do("mul", do("sq", r), self._polynomial(r, _EXPONENTIAL)), r), 1.0)
        left, scale = do("fmin", do("fabs", k), most), self._num(1)
        for size in _EXPONENTS:
            has = do("le", float(size), left)
            left = do("sub", left, do("if_else_zero", has, float(size)))
            scale = do("mul", scale, do("select", has, 2.0**size, 1.0))
        value = do("mul", value, do("select", do("lt", k, 0.0), do("inv", scale), scale))
        return do("select", do("lt", most, k), math.inf, do("select", do("lt", k, 2.0 - most), 0.0, value))

    def _log(self, x: int) -> int:
        do = self._do
        tiny = do("lt", x, _LEAST)
        m = do("select", tiny, do("mul", x, 2.0**_SCALE), x)
        low, e = do("lt", m, 1.0), self._num(0)
        for size in _EXPONENTS:
            scaled = do("mul", m, do("select", low, 2.0**size, 2.0**-size))
            has = do("eq", do("lt", scaled, 1.0), low)
            m, e = do("select", has, scaled, m), do("add", e, do("if_else_zero", has, float(size)))
        e = do("select", low, do("neg", e), e)
        high, deep = do("lt", math.sqrt(2.0), m), do("lt", m, math.sqrt(0.5))
        m = do("select", high, do("mul", m, 0.5), do("select", deep, do("twice", m), m))
        e = do("sub", do("add", e, high), do("add", deep, do("if_else_zero", tiny, float(_SCALE))))
        s = do("div", do("sub", m, 1.0), do("add", m, 1.0))
        z = do("sq", s)
        value = do("twice", do("add", s, do("mul", do("mul", s, z), self._polynomial(z, _LOGARITHM))))
        for part in _LN_2.split()[::-1]:
            value = do("add", value, do("mul", e, part))
        value = do("select", do("lt", x, math.inf), value, x)
        value = do("select", do("eq", x, 0.0), -math.inf, value)
        return do("select", do("lt", x, 0.0), do("sqrt", x), value)

    def _tanh(self, x: int) -> int:
        do = self._do
        size, z = do("fabs", x), do("sq", x)
        near = do("add", x, do("mul", do("mul", x, z), self._polynomial(z, _HYPERBOLIC)))
        e = self.table.put("exp", do("mul", size, -2.0))
        far = do("div", do("sub", 1.0, e), do("add", e, 1.0))
        far = do("select", do("lt", x, 0.0), do("neg", far), far)
        return do("select", do("lt", size, 0.5), near, far)

    # ---- comparison

    def equal(self, first: int, second: int) -> bool:
        """Return whether two expressions are equal wherever both are defined."""
        return self._alike(self._canonical(first), self._canonical(second))

    def _alike(self, a: int, b: int) -> bool:
        return a == b or (self._normal.equal(a, lambda e: e.of(b)) and not self._normal.assumed)

    def _canonical(self, root: int) -> int:
        """Return an expression whose branches have equal operands wherever their values are equal."""
        place: dict[int, int] = {}
        for at in self.table.needed([root]):
            entry = self.table.entries[at]
            args = [place[a] for a in entry.args]
            if entry.op in BRANCHES:
                args = [self._first(a) for a in args]
            plain = self._plain(entry.op, args, entry.value)
            place[at] = (
                self.table.put(entry.op, *(sorted(args) if entry.op in ("min", "max") else args), value=entry.value)
                if plain is None
                else plain
            )
        return place[root]

    def _plain(self, op: str, args: Sequence[int], value: Fraction) -> int | None:
        """Return a function that instruction lists write by others, written so; None for any other operation."""
        put = self._put
        match op, args:
            case "tan", [x]:
                return put("div", put("sin", x), put("cos", x))
            case "asin", [x]:
                square = put("mul", put("sub", self._num(1), x), put("add", self._num(1), x))
                return put("atan2", x, put("sqrt", square))
            case "sinh" | "cosh", [x]:
                e = put("exp", x)
                cosh = put("mul", put("add", e, put("inv", e)), self._num(Fraction(1, 2)))
                return cosh if op == "cosh" else put("mul", put("tanh", x), cosh)
            case "powr", [x]:
                return put("exp", put("mul", self._num(value), put("log", x)))
        return None

    def _first(self, at: int) -> int:
        known = next((known for known in self._same if self._alike(at, known)), None)
        if known is None:
            self._same.append(at)
        return at if known is None else known

    def require_arguments(self, roots: Sequence[int], box: Sequence[Interval]) -> None:
        """Raise Rejected unless the code has the sines, cosines, exp and log in these expressions on a box.

        Raises:
            Undefined: an argument is not defined on the whole box.
        """
        entries = [self.table.entries[at] for at in self.table.needed(roots)]
        limited = [e for e in entries if e.op in _ARGUMENTS]
        for entry, value in zip(limited, enclose(self.table, [e.args[0] for e in limited], box), strict=True):
            low, high = outward(value)
            least, most = _ARGUMENTS[entry.op]
            if not least <= low <= high <= most:
                raise Rejected(f"the code has no {entry.op} of an argument beyond {least:g} to {most:g}")
