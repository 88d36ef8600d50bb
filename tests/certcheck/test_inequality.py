"""Parts of the proof of an inequality: cases, the tree of boxes and its rules, each the only one that decides."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.inequality import Inequality, _atom_range, halves
from surctl.certcheck.rules import bends_down as bends_down_on

CASE: dict[str, Any] = {"choice": "", "denominators": [], "multipliers": [], "tree": "n", "points": []}
UNIT = ((-1.0, 1.0), (-1.0, 1.0))


def check(left: str, *constraints: str, box: Any = UNIT, cases: Any = None, **case: Any) -> None:
    """The inequality left ≤ 0 in x and y; one case, or the given cases."""
    table = ExpressionTable(["x", "y"])
    claim = Inequality(table, [table.read(text) for text in (left, "0", *constraints)], box)
    own = {"numerator": f"({left}) - 0", "multipliers": ["0"] * len(constraints)}
    claim.check([CASE | own | case] if cases is None else cases)


def rejected(says: str, left: str, *constraints: str, **case: Any) -> None:
    with pytest.raises(Rejected, match=says):
        check(left, *constraints, **case)


CASES = [CASE | {"choice": "0", "numerator": "x - 1", "multipliers": ["0"]},
         CASE | {"choice": "1", "numerator": "-x - 1", "multipliers": ["0"]}]  # fmt: skip


@pytest.mark.parametrize("cases", [CASES[:1], CASES[1:], [CASES[0]] * 2, [*CASES, CASES[0]], []])
def test_each_case_occurs_once(cases: list[dict[str, Any]]) -> None:
    check("abs(x) - 1", cases=CASES)
    rejected("the cases do not cover every choice exactly once", "abs(x) - 1", cases=cases)


def test_the_number_of_cases_is_limited() -> None:
    left = " + ".join(f"abs(x - {k})" for k in range(13))
    rejected("too many cases", left, cases=[CASES[0]])


@pytest.mark.parametrize(
    ("case", "says"),
    [
        ({"more": 1}, "a case must have exactly the keys"),
        ({"tree": ["n"]}, "is not a text"),
        ({"multipliers": []}, "the numbers of multipliers and constraints differ"),
        ({"tree": "0" * 11_000}, "the tree is too deep"),
    ],
)
def test_a_malformed_case_is_named(case: dict[str, Any], says: str) -> None:
    check("x - 1", "y")
    rejected(says, "x - 1", "y", **case)


def test_squares_do_not_prove_what_is_not_defined() -> None:
    squares = {"symbols": ["x"], "facts": [], "blocks": [], "relations": []}
    for box, defined in ((((1.0, 2.0), (0.0, 1.0)), True), (UNIT, False)):
        table = ExpressionTable(["x", "y"])
        claim = Inequality(table, [table.read("x/x - 1"), table.read("0")], box)
        case = {"choice": "", "numerator": "0", "denominators": [], "multipliers": [], "squares": squares}
        if defined:
            claim.check([case])
        else:
            with pytest.raises(Rejected, match="not defined everywhere"):
                claim.check([case])


@pytest.mark.parametrize(("rule", "away"), [("i", "x + 2"), ("j", "x^2 - x + 0.3")])
def test_one_positive_constraint_leaves_a_box_out(rule: str, away: str) -> None:
    box = ((0.4, 0.6), (-1.0, 1.0))
    for constraints in ((away, "y"), ("y", away), (away,)):
        check("1", *constraints, box=box, tree=rule)
    rejected("does not decide a box", "1", "y", "y - 1", box=box, tree=rule)
    if rule == "j":
        rejected("does not decide a box", "1", away, box=box, tree="i")


@pytest.mark.parametrize("rule", "ij")
def test_a_constraint_that_is_not_defined_leaves_no_box_out(rule: str) -> None:
    rejected("does not decide a box", "1", "log(x) + 9", tree=rule)


@pytest.mark.parametrize("point", [[0.0], [0.0, 0.0, 0.0], [0.0, 2.0], [2.0, 0.0], [0.0, -2.0], [-2.0, 0.0]])
def test_a_tangent_point_lies_in_its_box(point: list[float]) -> None:
    check("-x^2 - y^2", tree="c", points=[[0.0, 0.0]])
    rejected("a tangent point does not lie in its box", "-x^2 - y^2", tree="c", points=[point])


def test_a_function_is_concave_if_its_hessian_is_negative_definite_but_for_zero_rows() -> None:
    def bends_down(*rows: list[float | None]) -> bool:
        bend = np.array([[0.0 if entry is None else entry for entry in row] for row in rows])[:, :, None]
        return bool(bends_down_on((bend, bend), np.ones((len(rows), 1), dtype=bool))[0])

    assert bends_down([-1, 0], [0, -1]) and bends_down([-2, 1], [1, -1]) and bends_down([-1, None], [None, None])
    assert bends_down([0, 0], [0, -1]) and bends_down([None, None], [None, None])
    for rows in (
        ([-1, 0], [0, 1]), ([1, 0], [0, -1]), ([None, 1], [1, None]), ([-1, 1], [1, -1]), ([-1, 2], [2, -1]),
        ([-1, 1], [1, None]), ([None, 1], [1, -1]), ([-1, 0, 1], [0, -1, 1], [1, 1, -1]),
    ):  # fmt: skip
        assert not bends_down(*rows), rows


def test_the_range_of_an_unknown_is_not_known() -> None:
    table = ExpressionTable(["x", "y"])
    with pytest.raises(Rejected, match="cannot be checked"):
        _atom_range("b7", Exact(table), list(UNIT))


def test_a_box_is_halved_where_it_is_widest_relative_to_the_whole() -> None:
    whole = [(0.0, 100.0), (0.0, 1.0), (2.0, 2.0)]
    for part, cuts in (
        ([(0.0, 40.0), (0.0, 0.5), (2.0, 2.0)], [[(0.0, 40.0), (0.0, 0.25)], [(0.0, 40.0), (0.25, 0.5)]]),
        ([(0.0, 60.0), (0.0, 0.5), (2.0, 2.0)], [[(0.0, 30.0), (0.0, 0.5)], [(30.0, 60.0), (0.0, 0.5)]]),
    ):
        assert halves(part, whole) == [[*cut, (2.0, 2.0)] for cut in cuts]
