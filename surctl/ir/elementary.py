"""sin, cos, tan, atan2, acos, exp, log and tanh from exactly defined operations only: equal bytes on all machines.

Arguments are reduced by the method of Cody and Waite (1980): to |r| ≤ π/4 for sin and cos, to |t| ≤ tan(π/8) for atan2,
to |r| ≤ ln(2)/2 for exp, and to √½ ≤ m ≤ √2 for log. The polynomials interpolate (sin r / r − 1) / r², (cos r − 1 +
r²/2) / r⁴, (atan t / t − 1) / t², (exp r − 1 − r) / r², with s = (m − 1)/(m + 1) (artanh s / s − 1) / s², and (tanh x /
x − 1) / x² for |x| < 0.5, at Chebyshev nodes. They were computed with 60 digits and rounded to double; their errors are
below 3e-17, 2e-18, 4e-17, 2e-17, 2e-18 and 2e-17. For float there are shorter polynomials, with errors below 1e-8,
1e-9, 1e-9, 8e-9, 1e-9 and 2e-9, and π/2 is split into three numbers. The float versions cost half as much.

In double, the error is 2e-16 for sin and cos with |x| ≤ 1e6, 5e-16 for atan2 and acos, which is two to three units in
the last place near 1, and 5e-16 of the value for exp, log and tanh. In float, the error is 4e-7 for atan2 and acos, and
3e-7 of the value for exp, log and tanh. For sin and cos in float, the error is
1.5e-7 if |x| ≤ 3000, and half a unit in the last place of x for larger |x|.

The value is NaN for sin, cos and tan of a NaN, of an infinity and of |x| > 2²⁰, for atan2 of a NaN or of two
infinities, for acos outside [−1, 1], for log of a negative number, and for exp, log and tanh of a NaN. log(0) is −∞.
exp is 0 below −708 and ∞ above 709.4 (in float below −86.9 and above 88.3), so that no value is subnormal. atan2 treats
−0 as +0, so that its values lie in (−π, π] and atan2(0, 0) = 0; the sine of −0 is −0. For atan2, the sum of |y| and |x|
must not overflow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from surctl.ir.c99 import Real
from surctl.ir.folding import Numbering
from surctl.ir.program import LIBM, Program
from surctl.ir.routine import Block, changed_programs

# Sine and cosine of angles that stay near a reference angle, by a short series around that angle


_SINE = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880)
_COSINE = (-1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800)


def nearby_angles(program: Program, source: int, entry: int) -> Program:
    """Replace sin(a + d) and cos(a + d), where a is an entry of an input, by the angle sum and a series in d.

    This costs a third of a general sine. It is meant for the stages of a Runge-Kutta integrator, because there the
    angle changes little within a call. The errors of the Taylor series for sin d and cos d are |d|¹¹ / 11! and |d|¹² /
    12!: less than a unit in the last place of 1 up to d = 0.18, and below 1e-11 at d = 0.5. Only sines and cosines of
    sums that contain a are replaced.
    """
    text, moved = Numbering(), list[int]()
    near: dict[int, int | None] = {}  # position → position in `text` of the distance from a; None for a itself
    for at, instruction in enumerate(program.instructions):
        if instruction.op == "input" and instruction.args == (source, entry):
            near[at] = None
        distance = near.get(instruction.args[0]) if instruction.op in ("sin", "cos") else None
        if distance is not None:
            moved.append(_turned(text, instruction.op, text.add("input", (source, entry)), distance))
            continue
        moved.append(text.copy(instruction, moved))
        known = [a for a in instruction.args if instruction.op == "add" and a in near]
        if len(known) == 1:
            (base,) = known
            step = moved[instruction.args[1] if instruction.args[0] == base else instruction.args[0]]
            so_far = near[base]
            near[at] = step if so_far is None else text.add("add", (so_far, step))
    return text.rewritten(program, moved)


def _turned(text: Numbering, op: str, angle: int, distance: int) -> int:
    """Return the position in the instruction list of sin or cos (`op`) of angle + distance."""
    square = text.add("sq", (distance,))

    def series(coefficients: tuple[float, ...]) -> int:
        value = text.constant(coefficients[-1])
        for coefficient in (*coefficients[-2::-1], 1.0):
            value = text.add("add", (text.add("mul", (value, square)), text.constant(coefficient)))
        return value

    sine, cosine = text.add("mul", (distance, series(_SINE))), series(_COSINE)
    own, other = text.add(op, (angle,)), text.add("cos" if op == "sin" else "sin", (angle,))
    products = text.add("mul", (own, cosine)), text.add("mul", (other, sine))
    return text.add("add" if op == "sin" else "sub", products)


# π/2 in four parts: 13, 13 and 33 bits, so that their products with a quadrant number are exact, and the remainder
_HALF_PI = tuple(float.fromhex(x) for x in ("0x1.921p+0", "0x1.f6ap-13", "0x1.110b4611p-26", "0x1.4c4c6628b80dcp-59"))
_TWO_BY_PI = float.fromhex("0x1.45f306dc9c883p-1")
_LARGEST = 2.0**20
# ln 2 in three parts: 13 and 13 bits, so that their products with an exponent are exact, and the remainder
_LN_2 = tuple(float.fromhex(x) for x in ("0x1.62ep-1", "0x1.0bfp-15", "0x1.7d1cf79abc9e4p-28"))
_BY_LN_2 = float.fromhex("0x1.71547652b82fep+0")
_TAN_PI_8 = math.sqrt(2.0) - 1.0  # argument at which atan is reduced; its last bits do not matter

_SIN = (
    *(-0.16666666666666666, 0.008333333333330936, -0.00019841269836740532, 2.7557316093198404e-06),
    *(-2.5051129896450185e-08, 1.5917988979397435e-10),
)
_COS = (
    *(0.041666666666666664, -0.0013888888888887389, 2.48015872987544e-05, -2.755731726587808e-07),
    *(2.087614504941318e-09, -1.138254464534925e-11),
)
_ATAN = (
    *(-0.3333333333333333, 0.1999999999999548, -0.14285714284657894, 0.11111111014561013, -0.09090904549884611),
    *(0.07692182535116648, -0.06664502215671447, 0.058580687568615106, -0.05085030492810941),
    *(0.03921955253255129, -0.019162068915902573),
)
_TANH = (
    *(-0.3333333333333333, 0.13333333333329822, -0.053968253963606584, 0.021869488297078295, -0.008863229266596306),
    *(
        0.003592033422276869,
        -0.0014549590716245453,
        0.000584964055598742,
        -0.0002210692487866096,
        5.946676439279716e-05,
    ),
)
_EXP = (
    *(0.5000000000000001, 0.16666666666666669, 0.04166666666662413, 0.008333333333330062, 0.0013888888917213717),
    *(0.00019841269863053618, 2.4801521295954376e-05, 2.7557268459997064e-06, 2.7620088445409746e-07),
    2.510038549551032e-08,
)
_LOG = (
    *(0.3333333333333335, 0.19999999999949722, 0.14285714313001635, 0.11111105565129939, 0.09091444727837474),
    *(0.07665855309105386, 0.07308292712444311),
)


class _Series(NamedTuple):
    """Coefficients of the polynomials, and the numbers that add up to π/2, for one floating-point type."""

    sin: tuple[float, ...]
    cos: tuple[float, ...]
    atan: tuple[float, ...]
    tanh: tuple[float, ...]
    exp: tuple[float, ...]
    log: tuple[float, ...]
    half_pi: tuple[float, ...]
    bits: int  # of the exponent's size
    subnormal: float  # least normal number
    within: float = 0.0  # |r| is clamped to this, for proofs in a precision with a small largest number


_SERIES: Mapping[Real, _Series] = MappingProxyType(
    {
        "float64": _Series(_SIN, _COS, _ATAN, _TANH, _EXP, _LOG, _HALF_PI, 10, 2.0**-1022),
        "float32": _Series(
            (-0.1666666466231438, 0.008332748270629749, -0.00019587890880412386),
            (0.04166666465950221, -0.0013888303035894866, 2.4547942085071572e-05),
            (
                *(-0.3333333176116852, 0.19999540483648964, -0.1426395559798464),
                0.10743731490791084,
                -0.06451928208121749,
            ),
            (
                -0.3333333279637591,
                0.13333225734965642,
                -0.05393345948536633,
                0.021470611228009497,
                -0.006942778214039691,
            ),
            (0.5, 0.16666576989698775, 0.041666554617204574, 0.008363179052722578, 0.0013926183587713494),
            (0.33333342522578013, 0.19994389141081403, 0.1479002652159422),
            _HALF_PI[:3],
            7,
            2.0**-126,
            1.0,
        ),
    }
)


def without_libm(block: Block, real: Real = "float64") -> Block:
    """Return the program or routine with the functions of `LIBM` replaced by exact operations of number type `real`.

    The module's docstring states the errors, and the values for zeros, infinities and NaN. An intermediate value that
    several functions need, such as a reduced angle, is computed once.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower, replay, without_libm
        >>> psi = ca.SX.sym("psi")
        >>> program = lower(ca.Function("ahead", [psi], [ca.cos(psi)]))
        >>> own = without_libm(program)
        >>> [(sorted(block.libm), replay(block, [1.0])[0].round(6).tolist()) for block in (program, own)]
        [(['cos'], [0.540302]), ([], [0.540302])]
    """
    if not block.libm:
        return block
    return changed_programs(block, partial(_program, series=_SERIES[real]))


def _program(program: Program, *, series: _Series) -> Program:
    if not program.libm:
        return program
    text, moved = _Formulas(series), list[int]()
    for instruction in program.instructions:
        if instruction.op in _WRITTEN_OUT:
            moved.append(_WRITTEN_OUT[instruction.op](text, *(moved[a] for a in instruction.args)))
        else:
            moved.append(text.copy(instruction, moved))
    return text.rewritten(program, moved)


class _Formulas(Numbering):
    """Instruction list under construction; an operand of type float is a constant, one of type int a list position."""

    def __init__(self, series: _Series) -> None:
        super().__init__()
        self.series = series

    def polynomial(self, z: int, coefficients: tuple[float, ...]) -> int:
        # Horner's rule; the constant coefficient comes first
        value: int | float = coefficients[-1]
        for coefficient in coefficients[-2::-1]:
            value = self.do("add", self.do("mul", value, z), coefficient)
        return int(value)

    def reduced(self, x: int) -> tuple[int, int]:
        # x = k π/2 + r and |r| ≤ π/4 up to rounding
        inside = self.do("le", self.do("fabs", x), _LARGEST)
        x = self.do("select", inside, x, math.inf)
        k = self.do("floor", self.do("add", self.do("mul", x, _TWO_BY_PI), 0.5))
        r = x
        for part in self.series.half_pi:
            r = self.do("sub", r, self.do("mul", k, part))
        if self.series.within:  # the clamp changes nothing (and keeps a NaN), but gives interval analysis a bound
            r = self.do("fmin", self.do("fmax", r, -self.series.within), self.series.within)
        return k, r

    def wave(self, x: int) -> tuple[int, int, int]:
        """Return the list positions of the quadrant (0 to 3) of x, and of sin x and cos x up to their signs."""
        k, r = self.reduced(x)
        z = self.do("sq", r)
        sine = self.do("mul", r, self.do("add", self.do("mul", z, self.polynomial(z, self.series.sin)), 1.0))
        half = self.do(
            "sub", self.do("mul", z, 0.5), self.do("mul", self.do("sq", z), self.polynomial(z, self.series.cos))
        )
        cosine = self.do("sub", 1.0, half)
        quadrant = self.do("sub", k, self.do("mul", self.do("floor", self.do("mul", k, 0.25)), 4.0))
        pair = self.do("mul", k, 0.5)
        odd = self.do("ne", pair, self.do("floor", pair))
        return quadrant, self.do("select", odd, cosine, sine), self.do("select", odd, sine, cosine)

    def sin(self, x: int) -> int:
        quadrant, size, _ = self.wave(x)
        return self.do("select", self.do("le", 2.0, quadrant), self.do("neg", size), size)

    def cos(self, x: int) -> int:
        quadrant, _, size = self.wave(x)
        middle = self.do("lt", self.do("fabs", self.do("sub", quadrant, 1.5)), 1.0)
        return self.do("select", middle, self.do("neg", size), size)

    def first_quadrant(self, y: int, x: int) -> int:
        """Return the list position of atan2(y, x) for non-negative y and x."""
        # not fmin and fmax, because they may drop a NaN
        steep = self.do("lt", x, y)
        small, large = self.do("select", steep, x, y), self.do("select", steep, y, x)
        cut = self.do("lt", self.do("mul", large, _TAN_PI_8), small)
        over = self.do("select", cut, self.do("sub", small, large), small)
        under = self.do("select", cut, self.do("add", small, large), large)
        t = self.do("div", over, self.do("select", self.do("eq", under, 0.0), 1.0, under))
        z = self.do("sq", t)
        angle = self.do("add", t, self.do("mul", self.do("mul", t, z), self.polynomial(z, self.series.atan)))
        angle = self.do("select", cut, self.do("add", angle, math.pi / 4), angle)
        return self.do("select", steep, self.do("sub", math.pi / 2, angle), angle)

    def atan2(self, y: int, x: int) -> int:
        angle = self.first_quadrant(self.do("fabs", y), self.do("fabs", x))
        angle = self.do("select", self.do("lt", x, 0.0), self.do("sub", math.pi, angle), angle)
        return self.do("select", self.do("lt", y, 0.0), self.do("neg", angle), angle)

    def acos(self, x: int) -> int:
        below, above = self.do("sub", 1.0, x), self.do("add", x, 1.0)
        return self.do("twice", self.first_quadrant(self.do("sqrt", below), self.do("sqrt", above)))

    def tan(self, x: int) -> int:
        return self.do("div", self.sin(x), self.cos(x))

    def exp(self, x: int) -> int:
        # 2^k exp r with |r| ≤ ln(2)/2 up to rounding
        bits = self.series.bits
        most = 2.0**bits - 1.0
        bounded = self.do("fmax", self.do("fmin", x, most), -most)
        k = self.do("floor", self.do("add", self.do("mul", bounded, _BY_LN_2), 0.5))
        r = bounded
        for part in _LN_2:
            r = self.do("sub", r, self.do("mul", k, part))
        value = self.do(
            "add", self.do("add", self.do("mul", self.do("sq", r), self.polynomial(r, self.series.exp)), r), 1.0
        )
        # 2^|k|, bit by bit
        left, scale = self.do("fmin", self.do("fabs", k), most), self.constant(1.0)
        for bit in reversed(range(bits)):
            has = self.do("le", 2.0**bit, left)
            left = self.do("sub", left, self.do("if_else_zero", has, 2.0**bit))
            scale = self.do("mul", scale, self.do("select", has, 2.0 ** (2**bit), 1.0))
        value = self.do("mul", value, self.do("select", self.do("lt", k, 0.0), self.do("inv", scale), scale))
        value = self.do("select", self.do("lt", k, 2.0 - most), 0.0, value)
        return self.do("select", self.do("lt", most, k), math.inf, value)

    def log(self, x: int) -> int:
        # 2^e m with m in [√½, √2]; a subnormal number is scaled before
        bits, digits = self.series.bits, 54 if self.series.bits == 10 else 24
        tiny = self.do("lt", x, self.series.subnormal)
        m = self.do("select", tiny, self.do("mul", x, 2.0**digits), x)
        low, e = self.do("lt", m, 1.0), self.constant(0.0)
        for bit in reversed(range(bits)):
            scaled = self.do("mul", m, self.do("select", low, 2.0 ** (2**bit), 2.0 ** -(2**bit)))
            has = self.do("eq", self.do("lt", scaled, 1.0), low)
            m = self.do("select", has, scaled, m)
            e = self.do("add", e, self.do("if_else_zero", has, 2.0**bit))
        e = self.do("select", low, self.do("neg", e), e)
        high, deep = self.do("lt", math.sqrt(2.0), m), self.do("lt", m, math.sqrt(0.5))
        m = self.do("select", high, self.do("mul", m, 0.5), self.do("select", deep, self.do("twice", m), m))
        e = self.do("sub", self.do("add", e, high), self.do("add", deep, self.do("if_else_zero", tiny, float(digits))))
        s = self.do("div", self.do("sub", m, 1.0), self.do("add", m, 1.0))
        z = self.do("sq", s)
        value = self.do(
            "twice", self.do("add", s, self.do("mul", self.do("mul", s, z), self.polynomial(z, self.series.log)))
        )
        for part in reversed(_LN_2):
            value = self.do("add", value, self.do("mul", e, part))
        value = self.do("select", self.do("lt", x, math.inf), value, x)  # keeps ∞ and NaN
        value = self.do("select", self.do("eq", x, 0.0), -math.inf, value)
        return self.do("select", self.do("lt", x, 0.0), self.do("sqrt", x), value)

    def tanh(self, x: int) -> int:
        size, z = self.do("fabs", x), self.do("sq", x)
        near = self.do("add", x, self.do("mul", self.do("mul", x, z), self.polynomial(z, self.series.tanh)))
        e = self.exp(self.do("mul", size, -2.0))
        far = self.do("div", self.do("sub", 1.0, e), self.do("add", e, 1.0))
        far = self.do("select", self.do("lt", x, 0.0), self.do("neg", far), far)
        return self.do("select", self.do("lt", size, 0.5), near, far)


_WRITTEN_OUT: Mapping[str, Callable[..., int]] = MappingProxyType({name: getattr(_Formulas, name) for name in LIBM})


# Functions that the instruction list has not, by those that it has


def _arcsine(code: Numbering, x: int) -> int:
    return code.do("atan2", x, code.do("sqrt", code.do("mul", code.do("sub", 1.0, x), code.do("add", 1.0, x))))


def _signed(code: Numbering, x: int, size: int) -> int:
    return code.do("select", code.do("lt", x, 0.0), code.do("neg", size), size)


def _sign(code: Numbering, x: int) -> int:
    # a zero and a NaN remain
    above = code.do("select", code.do("lt", 0.0, x), 1.0, x)
    return code.do("select", code.do("lt", x, 0.0), -1.0, above)


def _hyperbolic_cosine(code: Numbering, x: int) -> int:
    e = code.do("exp", x)
    return code.do("mul", code.do("add", e, code.do("inv", e)), 0.5)


def _hyperbolic_sine(code: Numbering, x: int) -> int:
    return code.do("mul", code.do("tanh", x), _hyperbolic_cosine(code, x))


def _exp_less_1(code: Numbering, x: int) -> int:
    """Return exp x − 1 = tanh(x/2) (exp x + 1), without cancellation, and ∞ where exp x is."""
    e = code.do("exp", x)
    return code.do("mul", code.do("tanh", code.do("mul", x, 0.5)), code.do("add", e, 1.0))


def _log_of_1_more(code: Numbering, x: int) -> int:
    """Return log(1 + x) = x log(u)/(u − 1) for the rounded sum u, whose rounding error then cancels."""
    u = code.do("add", x, 1.0)
    share = code.do("div", code.do("mul", x, code.do("log", u)), code.do("sub", u, 1.0))
    inside = code.do("and", code.do("lt", u, math.inf), code.do("lt", -math.inf, code.do("log", u)))
    value = code.do("select", inside, share, code.do("log", u))
    return code.do("select", code.do("eq", u, 1.0), x, value)


def _area_sine(code: Numbering, x: int) -> int:
    """Return ± log(1 + s + s²/(1 + √(s² + 1))) for s = |x|; log(2 s) for large s."""
    size = code.do("fabs", x)
    square = code.do("sq", size)
    root = code.do("sqrt", code.do("add", square, 1.0))
    near = _log_of_1_more(code, code.do("add", size, code.do("div", square, code.do("add", root, 1.0))))
    far = code.do("add", code.do("log", size), math.log(2.0))
    return _signed(code, x, code.do("select", code.do("lt", 1e8, size), far, near))


def _area_cosine(code: Numbering, x: int) -> int:
    below, above = code.do("sqrt", code.do("sub", x, 1.0)), code.do("sqrt", code.do("add", x, 1.0))
    return code.do("log", code.do("add", x, code.do("mul", below, above)))


def _area_tangent(code: Numbering, x: int) -> int:
    return code.do("mul", _log_of_1_more(code, code.do("div", code.do("twice", x), code.do("sub", 1.0, x))), 0.5)


def _hypotenuse(code: Numbering, x: int, y: int) -> int:
    one, other = code.do("fabs", x), code.do("fabs", y)
    large, small = code.do("fmax", one, other), code.do("fmin", one, other)
    ratio = code.do("div", small, code.do("select", code.do("eq", large, 0.0), 1.0, large))
    return code.do("mul", large, code.do("sqrt", code.do("add", code.do("sq", ratio), 1.0)))


def _power(code: Numbering, x: int, y: int) -> int:
    """Return x^y: by products for a whole number y, otherwise exp(y log x), which is NaN for a negative x."""
    exponent = code.instructions[y].value
    if exponent is None or not exponent.is_integer():  # nor infinite
        return code.do("exp", code.do("mul", y, code.do("log", x)))
    bits, value = f"{abs(int(exponent)):b}", x
    for bit in bits[1:]:
        value = code.do("sq", value)
        value = code.do("mul", value, x) if bit == "1" else value
    return code.do("inv", value) if exponent < 0 else value if exponent else code.constant(1.0)


COMPOSED: Mapping[str, Callable[..., int]] = MappingProxyType(
    {
        "acosh": _area_cosine,
        "asin": _arcsine,
        "asinh": _area_sine,
        "atan": lambda code, x: code.do("atan2", x, 1.0),
        "atanh": _area_tangent,
        "ceil": lambda code, x: code.do("neg", code.do("floor", code.do("neg", x))),
        "constpow": _power,
        "cosh": _hyperbolic_cosine,
        "expm1": _exp_less_1,
        "hypot": _hypotenuse,
        "log1p": _log_of_1_more,
        "pow": _power,
        "sign": _sign,
        "sinh": _hyperbolic_sine,
    }
)
"""Functions of CasADi that `lower` writes by operations of the instruction list."""
