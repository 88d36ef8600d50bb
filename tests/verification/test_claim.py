import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.verification import Claim, Counterexample, Motion, Variable, evaluate, falsify

X, Y = ca.SX.sym("x"), ca.SX.sym("y")


def box(**bounds: tuple[float, float]) -> tuple[Variable, ...]:
    symbols = {"x": X, "y": Y}
    return tuple(Variable(n, symbols[n], "m", low, high, "test") for n, (low, high) in bounds.items())


def make(left: ca.SX, *, right: ca.SX | float = 0.0, expected: str = "refuted", **other: object) -> Claim:
    fields = {
        "name": "test",
        "statement": "left ≤ right",
        "equation": "none",
        "errata": (),
        "expected": expected,
        "variables": box(x=(-1, 1), y=(-1, 1)),
        "left": left,
        "right": ca.SX(right),
        "unit": "m",
    }
    return Claim(**(fields | other))  # type: ignore[arg-type]


def test_margin_is_positive_where_the_claim_fails() -> None:
    claim = make(X + Y, right=0.5)
    assert evaluate(claim, {"x": 0.5, "y": 0.25}) == (0.25, True)
    assert evaluate(claim, {"x": 0.5, "y": 1.25})[1] is False


def test_constraints_bound_the_domain() -> None:
    claim = make(X, constraints=X - Y)
    assert evaluate(claim, {"x": 0.1, "y": 0.2})[1]
    assert not evaluate(claim, {"x": 0.2, "y": 0.1})[1]


def test_another_box_keeps_the_rest_and_drops_outer_witnesses() -> None:
    claim = make(X, witnesses=({"x": 0.9, "y": 0.0}, {"x": 0.1, "y": 0.0}))
    small = claim.on({"x": (0.0, 0.5)})
    assert small.upper.tolist() == [0.5, 1.0] and small.lower.tolist() == [0.0, -1.0]
    assert small.witnesses == ({"x": 0.1, "y": 0.0},)
    with pytest.raises(InputError, match="no such variable"):
        claim.on({"z": (0, 1)})


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"variables": box(x=(-1, 1))}, "not among its variables"),
        ({"variables": (*box(x=(-1, 1)), *box(x=(-1, 1)))}, "different names"),
        ({"variables": box(x=(1, -1), y=(0, 1))}, "lower one first"),
        ({"variables": box(x=(0, np.inf), y=(0, 1))}, "finite bounds"),
        ({"witnesses": ({"x": 1.0},)}, "has no value"),
        ({"witnesses": ({"x": 1.0, "y": 0.0, "q": 0.0},)}, "no such variable"),
        ({"motion": Motion({"q": X}, X, "x", "m")}, "not among its variables"),
        ({"motion": Motion({"x": ca.SX.sym("q")}, X, "x", "m")}, "not among its variables"),
    ],
)
def test_a_claim_that_cannot_be_checked_is_refused_by_name(change: dict[str, object], word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        make(X + Y, **change)
    assert "test" in str(caught.value)


def test_a_verdict_is_plain_data() -> None:
    verdict = falsify(make(X + Y, right=1.9), samples=64)
    table = json.loads(json.dumps(verdict.to_dict(), allow_nan=False))
    assert table["verdict"] == "refuted" and table["remaining"] is None
    back = Counterexample.from_dict(table["counterexample"])
    assert back == verdict.counterexample


def test_a_broken_counterexample_is_the_users_mistake() -> None:
    for table in (
        {},
        {"values": 3, "margin": 1, "unit": "m"},
        {"values": {"x": "a"}, "margin": 1, "unit": "m"},
    ):
        with pytest.raises(InputError, match="not a counterexample"):
            Counterexample.from_dict(table)


def test_not_refuted_says_what_is_left_and_never_proved() -> None:
    verdict = falsify(make(-(X**2), expected="proved"), samples=64)
    assert verdict.verdict == "not refuted" and verdict.as_expected
    assert verdict.remaining is not None and verdict.remaining.startswith("not proved")
    assert not replace(verdict, verdict="refuted").as_expected
