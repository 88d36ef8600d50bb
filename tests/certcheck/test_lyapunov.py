"""The checker of claims about solutions: what it derives itself, and what it refuses."""

from __future__ import annotations

import copy
import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from surctl.certcheck import check_document, seal

NAMES = ("van-der-pol", "decay", "map")
VECTORS = dict.fromkeys(("plant_state", "controller_state", "parameters", "reference", "disturbance"), ())
LOOP = {key: list(value) for key, value in VECTORS.items()} | {
    "plant": "a", "controller": "b", "period_s": 0.1, "gains": {},
}  # fmt: skip


@cache
def _proved(name: str) -> dict[str, Any]:
    path = Path(__file__).with_name(f"lyapunov-{name}.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _sealed(document: dict[str, Any]) -> dict[str, Any]:
    evidence = {k: v for k, v in document.items() if k not in ("format", "version", "kind", "claim", "sha256")}
    return seal(document["kind"], document["claim"], evidence)


def _changed(name: str, *path: str | int, to: Any) -> dict[str, Any]:
    document = copy.deepcopy(_proved(name))
    place: Any = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = to
    return _sealed(document)


@pytest.mark.parametrize("name", NAMES)
def test_a_proof_is_accepted(name: str) -> None:
    checked = check_document(_proved(name))
    assert checked.accepted, checked.reason
    assert checked.proves


@pytest.mark.parametrize(
    ("name", "path", "to", "reason"),
    [
        # claims that are false
        ("van-der-pol", ("claim", "level"), 2.4, "inequality"),
        ("van-der-pol", ("claim", "level"), -1.0, "below the level at the equilibrium"),
        ("van-der-pol", ("claim", "dynamics", "x"), "y", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "dynamics", "x"), "-y + 0*select(x, 0, 1, 2)", "select, which may jump"),
        ("van-der-pol", ("claim", "dynamics", "x"), "-y*x/x", "may be undefined"),
        ("van-der-pol", ("claim", "dynamics", "x"), "atan2(-y, x)", "atan2 that may jump"),
        ("van-der-pol", ("claim", "function"), "1.5*x^2 - x*y + y^2 + 0*abs(x)", "abs, which has kinks"),
        ("van-der-pol", ("claim", "function"), "x^2 + y^2", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "function"), "(1.5*x^2) - (x*y) + (y^2", "not closed"),
        ("van-der-pol", ("claim", "rate"), 0.1, "'decrease' must be null because the claim has a rate"),
        ("van-der-pol", ("claim", "equilibrium", "x"), 0.5, "inequality"),
        ("van-der-pol", ("claim", "states", 0, "upper"), 1.0, "inequality"),
        ("van-der-pol", ("claim", "time"), "discrete", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "property"), "bound", "claim must have exactly the keys"),
        ("van-der-pol", ("change",), "-(x^2 + y^2)", "does not follow from the dynamics"),
        ("van-der-pol", ("positive", "factor"), 0.0, "no positive factor"),
        ("van-der-pol", ("positive", "factor"), 10.0, "inequality 1"),
        ("van-der-pol", ("positive", "power"), 2.5, "not an integer"),
        ("van-der-pol", ("positive", "power"), 10**9, "not an integer"),
        ("van-der-pol", ("decrease", "factor"), -1.0, "no positive factor"),
        ("van-der-pol", ("scales",), [0.0, 1.0], "scales"),
        ("van-der-pol", ("scales",), [1.0], "scales"),
        ("van-der-pol", ("proofs",), [], "0 proofs"),
        ("van-der-pol", ("claim", "about"), ["plant"], "claim.about must have exactly the keys"),
        ("van-der-pol", ("claim", "about"), LOOP | {"gains": []}, "gains by name"),
        ("van-der-pol", ("claim", "about"), LOOP | {"period_s": 0.0}, "state the period"),
        ("van-der-pol", ("claim", "about"), LOOP | {"controller": []}, "can be printed"),
        ("van-der-pol", ("claim", "about"), LOOP | {"gains": {"k": 1.0}}, "list is missing"),
        ("van-der-pol", ("claim", "about"), LOOP | {"reference": [None]}, "finite number"),
        ("decay", ("claim", "function"), "x - 2.5", "inequality"),
        ("decay", ("claim", "initial"), ["x^2 - 4"], "inequality"),
        ("decay", ("claim", "initial"), ["1) - (0"], "cannot be read"),
        ("decay", ("claim", "unsafe"), ["1 - x"], "inequality"),
        ("decay", ("claim", "multiplier"), "0) + (5*x", "cannot be read"),
        ("decay", ("claim", "multiplier"), None, "not a text"),
        ("decay", ("claim", "parameters", 0, "lower"), -0.5, "inequality"),
        ("decay", ("margin",), 0.0, "margin"),
        ("decay", ("margin",), 1.0, "inequality 2"),
        ("map", ("claim", "rate"), 0.9, "inequality"),
        ("map", ("claim", "rate"), 1.5, "exceeds 1"),
        ("map", ("claim", "dynamics", "x"), "3*x", "does not follow from the dynamics"),
        ("map", ("claim", "states", 0, "upper"), 0.1, "inequality"),
    ],
)
def test_what_is_not_proved_is_rejected(name: str, path: tuple[str | int, ...], to: Any, reason: str) -> None:
    checked = check_document(_changed(name, *path, to=to))
    assert not checked.accepted
    assert reason in checked.reason
    assert len(checked.reason.splitlines()) == 1


def test_a_function_of_a_parameter_is_rejected() -> None:
    document = _changed("decay", "claim", "function", to="x - 1.5 + 0*k")
    assert "'k' is not one of the claim's variables" in check_document(document).reason


def _state(name: str, lower: float, upper: float) -> dict[str, Any]:
    return {"name": name, "unit": "1", "lower": lower, "upper": upper}


def _case(numerator: str, choice: str = "", tree: str = "n", multipliers: tuple[str, ...] = ("0",)) -> dict[str, Any]:
    texts = {"choice": choice, "numerator": numerator, "denominators": [], "multipliers": list(multipliers)}
    return {**texts, "tree": tree, "points": []}


def _forged(claim: dict[str, Any], change: str, proofs: list[Any]) -> str:
    """Return why a claim whose inequalities all hold is rejected."""
    common = {"name": "forged", "parameters": [], "about": None, "level": 1.0, "rate": None}
    evidence: dict[str, Any] = {"change": change, "proofs": proofs}
    if claim["property"] == "stability":
        power = {"factor": 0.5, "power": 1}
        evidence |= {"scales": [1.0] * len(claim["states"]), "positive": power, "decrease": power}
    return check_document(seal("lyapunov", common | claim, evidence)).reason


def test_an_empty_region_proves_nothing_about_the_equilibrium() -> None:
    claim = {
        "time": "continuous", "property": "stability", "states": [_state("x", -1.0, 1.0)], "dynamics": {"x": "x + 1"},
        "function": "x^2 + 2", "equilibrium": {"x": 0.0},
    }  # fmt: skip
    nowhere = "0.5*((x - 0)/1)^2"
    proofs = [
        [_case(f"{nowhere} - (x^2 + 2)", tree="i")], [_case("1 - 3", multipliers=())], [_case("1 - 3", multipliers=())],
        [_case(f"2*x*(x + 1) + {nowhere}", tree="i")],
    ]  # fmt: skip
    assert "below the level at the equilibrium" in _forged(claim, "2*x*(x + 1)", proofs)
    assert "inside the box" in _forged(claim | {"equilibrium": {"x": 1.0}}, "2*x*(x + 1)", proofs)
    assert "a logarithm" in _forged(claim | {"function": "x^2 + 2 + log(0)"}, "2*x*(x + 1)", proofs)


def test_an_equilibrium_on_the_boundary_of_the_box_is_rejected() -> None:
    # x grows for x < 0, outside the box
    claim = {
        "time": "discrete", "property": "stability", "states": [_state("x", 0.0, 1.0)],
        "dynamics": {"x": "x - 0.5*abs(x)"}, "function": "x^2", "equilibrium": {"x": 0.0},
    }  # fmt: skip
    proofs = [
        [_case("-0.5*x^2")],
        [_case("-0.5*x", "0", "n", ("0", "0")), _case("-1.5*x", "1", "n", ("0", "0"))],
        [_case("0.5*x - 1", "0", "n", ("0", "0")), _case("-1", "1", "n", ("0", "1.5"))],
        [_case("-0.25*x^2", "0", "n", ("0", "0")), _case("0", "1", "n", ("0", "1.75*x"))],
    ]
    assert "inside the box" in _forged(claim, "(x - 0.5*abs(x))^2", proofs)


def test_a_function_that_jumps_is_rejected() -> None:
    # V < 1 holds on the line y = 0 only, and y stays constant
    jump = "select(y^2, 0, 0, 10)"
    claim = {
        "time": "discrete", "property": "stability", "states": [_state("x", -2.0, 2.0), _state("y", -1.0, 1.0)],
        "dynamics": {"x": "x/2", "y": "y"}, "function": f"x^2 + {jump}", "equilibrium": {"x": 0.0, "y": 0.0},
    }  # fmt: skip
    stays = ["-2 - x/2", "x/2 - 2", "-1 - y", "y - 1"]
    proofs = [
        [_case("-0.5*x^2", "0", "n", ("0", "0.5")), _case("0", "1", "i", ("0", "0"))],
        *[[_case(text, choice, "n", ("0", "0")) for choice in "01"] for text in stays],
        [_case("-0.25*x^2", "0", "n", ("0", "0.5")), _case("0", "1", "i", ("0", "0"))],
    ]
    proofs[0][1]["numerator"] = "0.5*(x^2 + y^2) - (x^2 + 10)"
    proofs[-1][1]["numerator"] = "-0.75*x^2 + 0.5*(x^2 + y^2)"
    assert "select, which may jump" in _forged(claim, f"(x/2)^2 + {jump}", proofs)


def test_a_bound_that_one_step_may_reach_is_below_the_level() -> None:
    claim = {
        "time": "discrete", "property": "bound", "states": [_state("x", -2.0, 2.0)], "dynamics": {"x": "1"},
        "function": "x^2", "rate": 1.0, "inner": 1.0, "gains": {},
    }  # fmt: skip
    proofs = [[_case("-2 - 1")], [_case("1 - 2")], [_case("0")]]
    assert "may reach the level in one step" in _forged(claim, "1", proofs)
    wider = [*proofs[:2], [_case("0")]]
    assert not _forged(claim | {"level": 1.5}, "1", wider)


def test_an_undefined_angle_is_a_reason() -> None:
    document = _changed("van-der-pol", "claim", "dynamics", "x", to="-atan2(1/x, 1)")
    assert "an atan2 that may be undefined in the box" in check_document(document).reason
