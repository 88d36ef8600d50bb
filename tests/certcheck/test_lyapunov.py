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
        ("van-der-pol", ("claim", "level"), -1.0, "inequality"),
        ("van-der-pol", ("claim", "dynamics", "x"), "y", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "dynamics", "x"), "-y + 0*select(x, 0, 1, 2)", "select, which may jump"),
        ("van-der-pol", ("claim", "dynamics", "x"), "-y*x/x", "may be undefined"),
        ("van-der-pol", ("claim", "dynamics", "x"), "atan2(-y, x)", "atan2 that may jump"),
        ("van-der-pol", ("claim", "function"), "1.5*x^2 - x*y + y^2 + 0*abs(x)", "abs, which has kinks"),
        ("van-der-pol", ("claim", "function"), "x^2 + y^2", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "function"), "(1.5*x^2) - (x*y) + (y^2", "not closed"),
        ("van-der-pol", ("claim", "rate"), 0.1, "a claim with a rate states a decrease"),
        ("van-der-pol", ("claim", "equilibrium", "x"), 0.5, "inequality"),
        ("van-der-pol", ("claim", "states", 0, "upper"), 1.0, "inequality"),
        ("van-der-pol", ("claim", "time"), "discrete", "does not follow from the dynamics"),
        ("van-der-pol", ("claim", "property"), "bound", "missing or unknown keys"),
        ("van-der-pol", ("change",), "-(x^2 + y^2)", "does not follow from the dynamics"),
        ("van-der-pol", ("positive", "factor"), 0.0, "no positive factor"),
        ("van-der-pol", ("positive", "factor"), 10.0, "inequality 1"),
        ("van-der-pol", ("positive", "power"), 2.5, "not an integer"),
        ("van-der-pol", ("positive", "power"), 10**9, "not an integer"),
        ("van-der-pol", ("decrease", "factor"), -1.0, "no positive factor"),
        ("van-der-pol", ("scales",), [0.0, 1.0], "scales"),
        ("van-der-pol", ("scales",), [1.0], "scales"),
        ("van-der-pol", ("proofs",), [], "0 proofs"),
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
