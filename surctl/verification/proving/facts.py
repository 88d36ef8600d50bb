"""Polynomial inequalities between a function of one argument and its argument, for proofs by sums of squares.

The numbers come from samples and are rounded to the safe side; the checker proves the inequalities.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.sos.polynomial import Polynomial
from surctl.verification.formula import Node, ordered, parse, variable

__all__ = ["VALUES", "fact_polynomial", "facts_about"]

Array = NDArray[np.float64]
Fact = tuple[str, ...]
"""One or two texts in t; their product is not negative."""

VALUES: dict[str, tuple[Callable[[Array], Array], Fraction]] = {
    "sin": (np.sin, Fraction(0)),
    "cos": (np.cos, Fraction(1)),
    "tan": (np.tan, Fraction(0)),
    "tanh": (np.tanh, Fraction(0)),
    "atan": (np.arctan, Fraction(0)),
    "asin": (np.arcsin, Fraction(0)),
    "exp": (np.exp, Fraction(1)),
}
"""Functions with a rational value at 0: the function and this value."""
_OTHERS: dict[str, Callable[[Array], Array]] = {"log": np.log, "sqrt": np.sqrt, "acos": np.arccos}

_SAMPLES, _SAFE = 400, 1e-3


def facts_about(op: str, low: float, high: float, *, touching: bool) -> list[Fact]:
    """Return inequalities that hold where the argument t is in [low, high].

    Args:
        op: name of the function.
        low: lower end of the argument's range.
        high: upper end of the argument's range.
        touching: whether the inequalities have to be equalities at t = 0.
    """
    function = VALUES[op][0] if op in VALUES else _OTHERS.get(op)
    if function is None or not low < high:
        return []
    if touching and op in VALUES and low <= 0 <= high:
        return _even(low, high) if op == "cos" else _odd(op, low, high)
    with np.errstate(all="ignore"):
        return _around(op, function, low, high)


def fact_polynomial(text: str, op: str, argument: Polynomial, atom: Polynomial) -> Polynomial:
    """Return a text in t with a polynomial for t, and another one for the function `op` of t."""
    values: dict[Node, Polynomial] = {}
    root = parse(text, {"t": variable("t")})
    for node in ordered(root):
        args = [values[a] for a in node.args]
        match node.op:
            case "num":
                values[node] = Polynomial.constant(node.value)
            case "var":
                values[node] = argument
            case "add":
                values[node] = args[0] + args[1]
            case "sub":
                values[node] = args[0] - args[1]
            case "neg":
                values[node] = -args[0]
            case "mul":
                values[node] = args[0] * args[1]
            case "div":
                values[node] = args[0] * (1 / Fraction(args[1].terms[()]))
            case "pow":
                values[node] = args[0] ** node.value.numerator
            case _:
                assert node.op == op
                values[node] = atom
    return values[root]


def _odd(op: str, low: float, high: float) -> list[Fact]:
    """Return sector bounds: the function minus its value at 0 lies between two multiples of t."""
    function, start = VALUES[op]
    t = np.concatenate([np.linspace(low, 0, _SAMPLES, endpoint=False), np.linspace(high, 0, _SAMPLES, endpoint=False)])
    t = t[t != 0]
    value = f"{op}(t)" if not start else f"{op}(t) - {start}"
    with np.errstate(all="ignore"):
        ratio = (function(t) - float(start)) / t
        least, most = float(ratio.min()), float(ratio.max())
        if not (math.isfinite(least) and math.isfinite(most)):
            return []
        a, b = _under(least), _over(most)
        # the slope 1 at 0 is exact for these functions
        a = "1" if 1 - 1e-3 < least <= 1 + 1e-9 and op in ("tan", "asin") else a
        b = "1" if 1 - 1e-3 < most <= 1 + 1e-9 and op in ("sin", "tanh", "atan") else b
        facts: list[Fact] = [(f"{value} - {_times(a)}t", f"{_times(b)}t - ({value})")]
        if op != "sin":
            return facts
        cube = (t - np.sin(t)) / t**3
        c, d = _under(float(cube.min())), "0.16667"
    facts.append((f"{value} - {_times(a)}t", f"t - {c}*t^3 - {value}"))
    facts.append((f"{value} - t + {d}*t^3", f"t - {value}"))
    facts.append((f"{value} - t + {d}*t^3", f"t - {c}*t^3 - {value}"))
    return facts


def _even(low: float, high: float) -> list[Fact]:
    most = max(-low, high)
    least = (1 - math.cos(min(most, math.pi))) / most**2
    return [("t^2/2 - 1 + cos(t)",), (f"1 - {_under(least)}*t^2 - cos(t)",)]


def _around(op: str, function: Callable[[Array], Array], low: float, high: float) -> list[Fact]:
    """Return bounds by parabolas a constant distance above and below."""
    middle, half = (low + high) / 2, (high - low) / 2
    t = middle + half * np.cos(np.linspace(0, np.pi, _SAMPLES))
    values = function(t)
    if not np.all(np.isfinite(values)):
        return []
    degree = 2 if half > 1e-4 else 0
    fitted = [round(float(c), 9) for c in np.polynomial.polynomial.polyfit(t, values, degree)]
    rest = values - np.polynomial.polynomial.polyval(t, fitted)
    below, above = float(rest.min()), float(rest.max())
    margin = 0.05 * (above - below) + 1e-8
    curve = " + ".join(f"({c!r})" + ("" if k == 0 else f"*t^{k}") for k, c in enumerate(fitted))
    return [
        (f"{op}(t) - ({curve} + ({_under(below - margin)}))",),
        (f"{curve} + ({_over(above + margin)}) - {op}(t)",),
    ]


def _times(factor: str) -> str:
    return "" if factor == "1" else f"({factor})*"


def _under(x: float) -> str:
    """Return a short decimal a little below x."""
    return _short(x - _SAFE * abs(x), math.floor)


def _over(x: float) -> str:
    """Return a short decimal a little above x."""
    return _short(x + _SAFE * abs(x), math.ceil)


def _short(x: float, rounded: Callable[[float], int]) -> str:
    if x == 0:
        return "0"
    digits = 4 - math.floor(math.log10(abs(x)))
    return repr(float(rounded(x * 10.0**digits) / 10.0**digits))
