"""Ranges, derivatives and limits of the checker in cases in which one line decides."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from mpmath import libmp

from surctl.certcheck.derivative import along
from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import elementary
from surctl.certcheck.emptiness import is_empty
from surctl.certcheck.enclosure import Undefined, enclose, exact, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.certcheck.patience import PATIENCE, afford, go_on, patient

SQUARE = [(-1.0, 1.0), (-1.0, 1.0)]


@pytest.mark.parametrize(
    ("text", "box"),
    [("log(x)", (-2.0, -1.0)), ("log(x)", (-1.0, 1.0)), ("acos(x)", (-1.0000000000000002, 0.0)),
     ("acos(x)", (0.0, 1.0000000000000002)), ("asin(x)", (-1.0000000000000002, 0.0)),
     ("asin(x)", (0.0, 1.0000000000000002)), ("x^0.5", (-2.0, -1.0)),
     ("x^(-1/2)", (0.0, 1.0)), ("sqrt(x)", (-2.0, -1.0))],
)  # fmt: skip
def test_a_function_outside_its_domain_has_no_range(text: str, box: tuple[float, float]) -> None:
    table = ExpressionTable(["x"])
    with pytest.raises(Undefined):
        enclose(table, [table.read(text)], [span(*box)])


def test_an_operation_that_is_not_known_has_no_range_and_no_derivative() -> None:
    table = ExpressionTable(["x"])
    at = table.put("other", table.read("x"))
    with pytest.raises(Undefined, match="the operation 'other' is not known"):
        enclose(table, [at], [exact(1.0)])
    with pytest.raises(Undefined, match="the operation 'other' is not known"):
        elementary("other", exact(1.0), Fraction(0))
    with pytest.raises(Rejected, match="no derivative of other"):
        along(table, at, [table.read("1")])


@pytest.mark.parametrize(
    ("text", "expected"),
    [("3*x", 3), ("x*3", 3), ("x/3", Fraction(1, 3)), ("3/x", Fraction(-3, 4)), ("x + 3", 1), ("3 + x", 1),
     ("3 - x", -1), ("x - 3", 1), ("x*y", 7), ("x*y*3", 21), ("x", 1), ("5", 0), ("y^2", 10),
     ("x^3", 12), ("y/x", Fraction(1, 2) - Fraction(5, 4))],
)  # fmt: skip
def test_a_derivative_along_rates_is_exact(text: str, expected: Fraction) -> None:
    """At x = 2, y = 5 with the rates x' = y' = 1."""
    table = ExpressionTable(["x", "y"])
    one = table.read("1")
    (value,) = enclose(table, [along(table, table.read(text), [one, one])], [exact(2.0), exact(5.0)])
    low, high = (Fraction(*libmp.to_rational(end)) for end in value)
    assert low <= expected <= high and high - low < Fraction(1, 10**15)


@pytest.mark.parametrize("text", ["abs(x)", "max(x, 1)", "min(1, x)", "select(x, 0, 1, 2)", "atan2(x, 1)"])
def test_a_kink_is_named_though_the_state_is_at_rest(text: str) -> None:
    table = ExpressionTable(["x"])
    with pytest.raises(Rejected, match="which has kinks or jumps"):
        along(table, table.read(text), [table.read("0")])


@pytest.mark.parametrize(("text", "moving"), [("sin(x)", 0), ("sin(y)", 1), ("cos(y)^3", 1), ("exp(x)", 0)])
def test_slopes_in_arrays_are_those_of_the_variable_that_moves(text: str, moving: int) -> None:
    table = ExpressionTable(["x", "y"])
    root, low = table.read(text), np.array([[0.5], [0.5]])
    slope = Tape(table, (root,)).run((low, low + 0.25), order=1).jets[0].slope
    rates = [table.put("num", value=int(k == moving)) for k in (0, 1)]
    (exactly,) = enclose(table, [along(table, root, rates)], [span(0.5, 0.75)] * 2)
    assert slope is not None and not np.any([end[1 - moving] for end in slope])
    own = [libmp.to_float(end) for end in exactly]
    assert slope[0][moving, 0] <= own[0] + 1e-12 and own[1] - 1e-12 <= slope[1][moving, 0]


@pytest.mark.parametrize(
    ("text", "most"),
    [("max(x, y)", 1.0), ("min(x, y) - 9", -8.0), ("atan2(x, y + 9) - 9", -8.8757), ("select(x, y, 0, 0) - 9", -9.0),
     ("abs(x - y)", 2.0), ("select(x, y, -1, 5)", 5.0)],
)  # fmt: skip
def test_choices_and_angles_have_ranges_in_arrays(text: str, most: float) -> None:
    table = ExpressionTable(["x", "y"])
    ends = tuple(np.array(SQUARE)[:, k : k + 1] for k in (0, 1))
    (jet,) = Tape(table, (table.read(text),)).run((ends[0], ends[1])).jets
    assert jet.value[1][0] == pytest.approx(most, abs=0.01) and jet.value[1][0] >= most - 1e-12


# claims that say nothing

ABOVE = "y^2 - y + 0.6"  # at least 0.35, which is seen in boxes that are narrow in y


@pytest.mark.parametrize(
    ("constraints", "empty"),
    [([], False), (["x"], False), (["x + 2", "x"], True), (["x", "x + 2"], True), (["x + 2", "x", "y"], True),
     ([ABOVE, "-1"], True), (["-1", ABOVE], True), ([ABOVE], True), (["x^2 - x + 0.6"], True), (["x", "-x"], False),
     (["(x - 0.3)^2"], None), (["log(x) + 9", "x + 2"], True), (["log(x - 5)"], None)],
)  # fmt: skip
def test_a_claim_is_empty_only_if_no_point_satisfies_its_constraints(
    constraints: list[str], empty: bool | None
) -> None:
    assert is_empty(["x", "y"], [(-1.0, 1.0), (-1.0, 1.0)], constraints) is empty


# limits


def test_limits_end_with_their_block() -> None:
    go_on()
    afford(1e15)
    with pytest.raises(Rejected, match="more than 0 s of processor time"), patient(0.0):
        while True:
            go_on()
    with patient(PATIENCE), pytest.raises(Rejected, match="memory"):
        afford(1e15)
    go_on()
    afford(1e15)


def test_derivatives_of_many_operations_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    from surctl.certcheck import patience

    table: Any = ExpressionTable([f"x{k}" for k in range(20)])
    root = table.read("*".join(table.names))
    tape, box = Tape(table, (root,)), (np.ones((20, 1)), np.ones((20, 1)))
    monkeypatch.setattr(patience, "MEMORY", 15_000)
    with patient(9.0):
        tape.run(box, order=1)
        with pytest.raises(Rejected, match="memory"):
            tape.run(box, order=2)
    monkeypatch.setattr(patience, "MEMORY", 60_000)
    with patient(9.0):
        enclose(table, [root], [exact(1.0)] * 20)
    monkeypatch.setattr(patience, "MEMORY", 10_000)
    with patient(9.0), pytest.raises(Rejected, match="memory"):
        enclose(table, [root], [exact(1.0)] * 20)
