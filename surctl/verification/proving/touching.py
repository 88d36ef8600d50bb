"""Where a claim holds with equality: normal forms about the point; polynomial bounds of sines, exp and others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.arrays import Ends
from surctl.sos.polynomial import Monomial, Polynomial
from surctl.verification.formula import Node, exact_values, number, ordered, parse, power, rebuilt, substitute, variable
from surctl.verification.proving.algebra import Algebra, Ratio, TooLarge, Written
from surctl.verification.proving.tape import build_tape

# Polynomial inequalities between a function of one argument and its argument, for proofs by sums of squares.
#
# The numbers come from samples and are rounded to the safe side; the checker proves the inequalities.


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

    def change(node: Node, args: tuple[Node, ...]) -> Node:
        return variable("value") if node.op == op else Node(node.op, args, node.value, node.name)

    root = rebuilt(parse(text, {"t": variable("t")}), change)
    values: Any = exact_values([root], {"t": argument, "value": atom})
    total: Polynomial = Polynomial.constant(0) + values[0]
    return total


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
    return [(f"{op}(t) - ({curve} + ({_under(below - margin)}))",), (f"{curve} + ({_over(above + margin)}) - {op}(t)",)]


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


def vanishes(node: Node) -> bool:
    """Return True only if an expression is 0 wherever it is defined, which exact rewriting shows."""
    try:
        return not Algebra(split=True).of(node).over
    except (TooLarge, ArithmeticError):
        return False


def range_at(node: Node, point: Mapping[str, float]) -> tuple[float, float] | None:
    """Return bounds of the value of an expression at a point; None if it may be undefined there."""
    at = np.array([[x] for x in point.values()])
    read = build_tape(tuple(point), [node]).run((at, at))
    low, high = read.jets[0].value
    return (float(low[0]), float(high[0])) if read.defined[0][0] else None


def touches(node: Node, point: Mapping[str, Fraction], names: Sequence[str], root: Ends) -> bool:
    """Return whether interval arithmetic shows an expression and its gradient to be exactly 0 at a point.

    An expression that is shown to be 0 only roughly cannot be proved to be ≤ 0 on any box that contains the point.

    Args:
        node: the expression.
        point: values of some variables; the others take the middle of their range.
        names: names of the variables.
        root: lower and upper bounds (n, 1).
    """
    at = _point(point, names, (root[0] + root[1]) / 2)
    jet = build_tape(tuple(names), [node]).run((at, at), order=1).jets[0]
    assert jet.slope is not None
    moving = [k for k, name in enumerate(names) if name in point]
    return bool(jet.value[1][0] <= 0) and not any(end[k].any() for end in jet.slope for k in moving)


def excluded(constraints: Sequence[Node], point: Mapping[str, Fraction], names: Sequence[str], root: Ends) -> bool:
    """Return whether a constraint is positive at a point, for all values of the variables that the point lacks.

    The arguments are those of `touches`, with the constraints instead of an expression.
    """
    box = _point(point, names, root[0]), _point(point, names, root[1])
    return any(jet.value[0][0] > 0 for jet in build_tape(tuple(names), constraints).run(box).jets)


def _point(point: Mapping[str, Fraction], names: Sequence[str], others: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[float(point[name])] if name in point else others[k] for k, name in enumerate(names)])


def touching_form(algebra: Algebra, written: Written, over: Polynomial, point: Mapping[str, Fraction]) -> Node | None:
    """Return a polynomial as expression in differences of atoms to their values at a point.

    If the value and the gradient of the polynomial are 0 at the point, interval arithmetic then shows exactly this,
    also where the values of the atoms are not 0: as for cos x − 1.

    Args:
        algebra: the algebra of the polynomial.
        written: converter of this algebra.
        over: the polynomial.
        point: values of some variables.

    Returns:
        The expression; None if a value is not known, a term is not of second order, or no atom has to be moved.
    """
    moved = _Moved(algebra, written, point)
    orders: dict[int, int] = {}
    for at in {k for m in over.terms for k, _ in m}:
        if moved.varies(at):
            value = moved.value(at)
            if value is None:
                return None
            # the cosine of 0 has a maximum there
            orders[at] = 2 if algebra.atoms[at][0] == "cos" and value == Polynomial.constant(1) else 1
    if not any(moved.value(at) for at in orders):
        return None
    total = moved.polynomial(over)
    if any(sum(orders.get(k, 0) * e for k, e in m) < 2 for m in total.terms):
        return None
    return moved.poly(total)


class _Moved(Written):
    """Converter of polynomials in the differences of atoms to their values at a point."""

    def __init__(self, algebra: Algebra, written: Written, point: Mapping[str, Fraction]) -> None:
        super().__init__(algebra)
        self._plain, self._point = written, point
        self._values: dict[int, Polynomial | None] = {}
        self._moved: dict[int, Node] = {}

    def varies(self, at: int) -> bool:
        """Return whether an atom depends on a variable that the point names."""
        return any(n.op == "var" and n.name in self._point for n in ordered(self._plain.atom(at)))

    def value(self, at: int) -> Polynomial | None:
        """Return the value of an atom at the point, as a polynomial in atoms without its variables, if it is known."""
        if at not in self._values:
            self._values[at] = self._value(self._plain.atom(at))
        return self._values[at]

    def _value(self, node: Node) -> Polynomial | None:
        fixed = substitute(node, {name: number(x) for name, x in self._point.items()})
        try:
            if node.op in VALUES and not self._algebra.of(fixed.args[0]).over:
                return Polynomial.constant(VALUES[node.op][1])
            value = self._algebra.of(fixed)
        except (TooLarge, ArithmeticError):
            return None
        return None if value.under else value.over

    def polynomial(self, a: Polynomial) -> Polynomial:
        """Return a polynomial in the atoms as polynomial in the differences."""
        among = {k for m in a.terms for k, _ in m if self.varies(k)}
        by = {k: Polynomial.variable(k) + (self.value(k) or 0) for k in among}
        apart: dict[Monomial, dict[Monomial, Fraction]] = {}
        for m, c in a.substituted(by).terms.items():
            own, fixed = (tuple((k, e) for k, e in m if (k in among) == part) for part in (True, False))
            apart.setdefault(own, {})[fixed] = c
        parts = [Polynomial.monomial(m) * self._algebra.reduced(Polynomial(part)) for m, part in apart.items()]
        return sum(parts, Polynomial({}))

    def atom(self, at: int) -> Node:
        """Return the difference of an atom to its value, as an expression."""
        if at in self._moved:
            return self._moved[at]
        node, value = self._plain.atom(at), self.value(at) if self.varies(at) else None
        kind, args = self._algebra.atoms[at]
        if value and kind in VALUES and isinstance(args[0], Ratio):
            # the argument is exactly 0 at the point as well
            inside = self.poly(self.polynomial(args[0].over))
            for factor, exponent in args[0].under:
                inside = inside / power(self._plain.factor(factor), exponent)
            node = Node(kind, (inside,))
        self._moved[at] = node - self._plain.poly(value) if value else node
        return self._moved[at]
