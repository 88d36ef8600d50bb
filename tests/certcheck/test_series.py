"""Signs by Taylor expansion: every coefficient against 60 digits, and statements that are false."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath
import pytest
from flint import arb, ctx
from mpmath import libmp, mp

from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import PRECISION, Undefined
from surctl.certcheck.enclosure import span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.series import _ORDER, _series, same_sign

TEXTS: dict[str, Callable[[Any], Any]] = {
    "3/7 + pi*t": lambda t: mp.mpf(3) / 7 + mp.pi * t,
    "t - 2*t^2": lambda t: t - 2 * t**2,
    "-t*(t + 1)": lambda t: -t * (t + 1),
    "1/(2 + t)": lambda t: 1 / (2 + t),
    "(t + 1)/(t - 3)": lambda t: (t + 1) / (t - 3),
    "t^3": lambda t: t**3,
    "(t + 2)^(-2)": lambda t: (t + 2) ** -2,
    "sin(t + 1)": lambda t: mp.sin(t + 1),
    "cos(2*t)": lambda t: mp.cos(2 * t),
    "exp(t - t^2)": lambda t: mp.exp(t - t**2),
    "tan(t/2)": lambda t: mp.tan(t / 2),
    "tanh(t)": mp.tanh,
    "sqrt(2 + t)": lambda t: mp.sqrt(2 + t),
    "log(2 + t)": lambda t: mp.log(2 + t),
    "atan(3*t)": lambda t: mp.atan(3 * t),
    "asin(t/3)": lambda t: mp.asin(t / 3),
    "acos(t/3)": lambda t: mp.acos(t / 3),
}


def table_of(*texts: str) -> tuple[ExpressionTable, list[int]]:
    table = ExpressionTable(["t"])
    return table, [table.read(text) for text in texts]


@pytest.mark.parametrize("text", TEXTS)
def test_coefficients_hold_the_derivatives_and_are_narrow(text: str) -> None:
    table, [root] = table_of(text)
    low = 0.375
    with mp.workprec(150):
        values = mpmath.taylor(TEXTS[text], low, _ORDER)
        for high in (low, 0.5):
            with ctx.workprec(PRECISION):
                found = _series(table, root, arb(low).union(arb(high)))
            assert len(found) == _ORDER + 1
            for ball, value in zip(found, values, strict=True):
                below, above = (mp.mpf(tuple(map(int, end.man_exp()))) for end in (ball.lower(), ball.upper()))
                slack = abs(value) * mp.mpf(2) ** -40 + mp.mpf(2) ** -50
                assert below <= value + slack and value - slack <= above
                if low == high:
                    assert above - below <= slack


@pytest.mark.parametrize(
    ("texts", "low", "high"),
    [
        (["t - 0.5"], 0.25, 0.75),  # a zero of odd order inside the interval
        (["(t - 0.5)^3"], 0.25, 0.75),
        (["0.5 - t"], 0.25, 0.75),
        (["sin(t)", "-t"], -1.0, 1.0),
        (["t"], -1.0, 1.0),
        (["t"], -1.0, 0.0),
        (["t^3"], -2.0, 0.0),
        (["-t"], 0.0, 1.0),
        (["-(t^2)"], 0.5, 1.0),
        (["t^2 - 0.3"], 0.5, 1.0),  # at its lower end alone
        (["0.9 - t^2"], 0.5, 1.0),  # at its upper end alone
        (["t - 1.25", "t - 1.5"], 1.0, 2.0),
        (["cos(t)"], 0.0, 1.6),
        (["cos(t) - 1 + t^2/2.1"], -1.0, 1.0),
        (["t - sin(t)", "-1"], 0.0, 1.0),
    ],
)
def test_a_false_sign_is_not_shown(texts: list[str], low: float, high: float) -> None:
    table, roots = table_of(*texts)
    assert not same_sign(table, roots, span(low, high))


def test_an_end_that_is_no_double_is_rounded_outward() -> None:
    less = libmp.from_man_exp((1 << 56) - 1, -57)  # 0.5 − 2^-57
    for text, ends in (("t - 0.5", (less, libmp.fone)), ("-t - 0.5", (libmp.fnone, libmp.mpf_neg(less)))):
        table, roots = table_of(text)
        assert not same_sign(table, roots, ends)


@pytest.mark.parametrize(
    ("texts", "low", "high"),
    [
        (["(t - 0.5)^2"], 0.25, 0.75),
        (["sin(t)", "t"], -1.0, 1.0),
        (["t"], 0.5, 1.0),
        (["t^2"], -2.0, 1.0),
        (["t^4", "1"], -2.0, 0.0),
        (["-t", "-t^3"], -2.0, 1.0),
        (["-1 - t^2", "cos(t) - 2"], -1.0, 3.0),
        (["cos(t) - 1 + t^2/2"], -1.0, 1.0),
        (["t - sin(t)", "t"], -1.0, 1.0),
        (["exp(t) - 1 - t"], -2.0, 2.0),
    ],
)
def test_a_true_sign_is_shown_also_at_a_zero(texts: list[str], low: float, high: float) -> None:
    table, roots = table_of(*texts)
    assert same_sign(table, roots, span(low, high))


@pytest.mark.parametrize("text", ["1/t", "sqrt(t)", "log(t)", "t^(-2)", "1/(t - 0.5)"])
def test_no_sign_is_shown_where_an_expression_is_not_defined(text: str) -> None:
    table, roots = table_of(text, text)
    assert not same_sign(table, roots, span(0.0, 0.5))
    with pytest.raises(Undefined):
        _series(table, roots[0], arb(0.25, 0.25))


def test_what_the_expansion_does_not_know_is_rejected() -> None:
    table, roots = table_of("abs(t)")
    with pytest.raises(Rejected, match="may not use the operation"):
        same_sign(table, roots, span(0.5, 1.0))
    table, roots = table_of("t^2")
    for ends in ((libmp.fninf, libmp.fzero), (libmp.fzero, libmp.finf)):
        with pytest.raises(Rejected, match="unbounded"):
            same_sign(table, roots, ends)


def test_a_cap_on_flints_series_proves_nothing_false(monkeypatch: pytest.MonkeyPatch) -> None:
    table, roots = table_of("1 - 0.6*t^5 - t^6")  # negative at 1
    monkeypatch.setattr(ctx, "cap", 3)  # of the whole process: another package may have set it
    assert not same_sign(table, roots, span(0.0, 1.0))
