"""Values and derivatives of the checker's functions of one variable that `surctl.certcheck.exponentials` bounds.

The formulas are those of the prover, so that a proof with its wider intervals is accepted.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from mpmath import libmp

from surctl.certcheck.angles import BITS, Interval, arccos, arcsin, tangent
from surctl.certcheck.exponentials import (
    exponential,
    hyperbolic_cosine,
    hyperbolic_sine,
    hyperbolic_tangent,
    logarithm,
    real_power,
)

__all__ = ["ELEMENTARY", "Undefined", "elementary"]

ELEMENTARY = ("asin", "cosh", "exp", "log", "powr", "sinh", "tan", "tanh")
"""The operations of `elementary`; `powr` is the power with a fractional exponent."""

_ONE = (libmp.fone, libmp.fone)
_LINE = (libmp.fninf, libmp.finf)
Derivatives = Callable[[], tuple[Interval, Interval]]


class Undefined(Exception):
    """Error for an operation that is not defined on the whole interval of its operand."""


def elementary(op: str, x: Interval, exponent: Fraction) -> tuple[Interval, Derivatives]:
    """Return the range of a function on an interval, and a function that returns the ranges of f' and f''.

    Args:
        op: a name in `ELEMENTARY`, or acos.
        x: the interval; its ends are finite.
        exponent: the exponent of `powr`; the other operations do not use it.

    Raises:
        Undefined: the function is not defined on the whole interval, or its values are too large.
    """
    match op:
        case "exp":
            value = _known(exponential(x), "an exponential of numbers above 2^20")
            return value, lambda: (value, value)
        case "log":
            if not libmp.mpf_gt(x[0], libmp.fzero):
                raise Undefined("a logarithm of an interval that contains numbers of at most 0")
            return _known(logarithm(x), "a logarithm of a number that is too large"), lambda: _of_log(x)
        case "sinh" | "cosh":
            sinh, cosh = (_known(f(x), f"a {op} of numbers above 2^20") for f in (hyperbolic_sine, hyperbolic_cosine))
            return (sinh, lambda: (cosh, sinh)) if op == "sinh" else (cosh, lambda: (sinh, cosh))
        case "tanh":
            value = _known(hyperbolic_tangent(x), "a tanh of an unbounded interval")
            return value, lambda: _of_tangent(value, -1)
        case "tan":
            value = _known(tangent(x), "a tangent of an interval that may contain a pole")
            return value, lambda: _of_tangent(value, 1)
        case "asin" | "acos":
            if libmp.mpf_lt(x[0], libmp.fnone) or libmp.mpf_gt(x[1], libmp.fone):
                raise Undefined(f"an arc{op[1:]} of an interval that is not within [-1, 1]")
            return (arcsin(x), lambda: _of_arcsin(x)) if op == "asin" else (arccos(x), lambda: _of_arccos(x))
        case "powr":
            if libmp.mpf_lt(x[0], libmp.fzero):
                raise Undefined("a fractional power of an interval that contains negative numbers")
            if exponent < 0 and x[0] == libmp.fzero:
                raise Undefined("a negative power of an interval that contains 0")
            value = _known(real_power(x, exponent), "a power that is too large")
            return value, lambda: _of_power(x, exponent)
    raise Undefined(f"the operation {op!r} is not known")


def _known(a: Interval | None, trouble: str) -> Interval:
    if a is None:
        raise Undefined(trouble)
    return a


def _times(factor: Fraction | int, a: Interval) -> Interval:
    if a == _LINE:
        return a
    p, q = Fraction(factor).as_integer_ratio()
    ends = libmp.from_rational(p, q, BITS, "f"), libmp.from_rational(p, q, BITS, "c")
    return libmp.mpi_mul(ends, a, BITS)


def _square(a: Interval) -> Interval:
    return libmp.mpi_pow_int(a, 2, BITS)


def _not_negative(a: Interval) -> Interval:
    return (a[0] if libmp.mpf_gt(a[0], libmp.fzero) else libmp.fzero), a[1]


def _of_log(x: Interval) -> tuple[Interval, Interval]:
    first = libmp.mpi_div(_ONE, x, BITS)
    return first, libmp.mpi_neg(_square(first))


def _of_tangent(t: Interval, sign: int) -> tuple[Interval, Interval]:
    # tan' = 1 + tan², tan'' = 2 tan (1 + tan²); tanh' = 1 − tanh², tanh'' = −2 tanh (1 − tanh²)
    step = libmp.mpi_add if sign > 0 else libmp.mpi_sub
    first = _not_negative(step(_ONE, _square(t), BITS))
    return first, _times(2 * sign, libmp.mpi_mul(t, first, BITS))


def _of_arcsin(x: Interval) -> tuple[Interval, Interval]:
    rest = _not_negative(libmp.mpi_sub(_ONE, _square(x), BITS))
    if rest[0] == libmp.fzero:
        return _LINE, _LINE
    root = libmp.mpi_sqrt(rest, BITS)
    cube = libmp.mpi_mul(rest, root, BITS)
    return libmp.mpi_div(_ONE, root, BITS), libmp.mpi_mul(x, libmp.mpi_div(_ONE, cube, BITS), BITS)


def _of_arccos(x: Interval) -> tuple[Interval, Interval]:
    first, second = _of_arcsin(x)
    return libmp.mpi_neg(first), libmp.mpi_neg(second)


def _of_power(x: Interval, e: Fraction) -> tuple[Interval, Interval]:
    return _times(e, _power_or_line(x, e - 1)), _times(e * (e - 1), _power_or_line(x, e - 2))


def _power_or_line(x: Interval, e: Fraction) -> Interval:
    # the whole line if a negative power is unbounded at 0
    bounds = None if e < 0 and x[0] == libmp.fzero else real_power(x, e)
    return _LINE if bounds is None else bounds
