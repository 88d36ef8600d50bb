"""An undecided claim names a weaker one that is proved; limits that never act in a region are said not to."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.lyapunov import Dynamics, Problem, State, load_problem, solve
from surctl.lyapunov.solve import limits_sentence
from surctl.verification.formula import parse, variable
from tests.lyapunov.problems import written

X = {"x": variable("x")}
TEXT = """
kind = "lyapunov"
name = "drawn"
function = "x^2"
LEVEL
[states]
x = {{ rate = "-{a}*x + x^3", lower = -2, upper = 2 }}
"""


@pytest.mark.parametrize("seed", range(3))
def test_an_undecided_level_names_one_that_is_proved(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = round(float(np.random.default_rng(seed).uniform(0.5, 2.0)), 3)  # V' = 2 V (V - true)
    problem = load_problem(written(tmp_path, TEXT.format(a=true), ("LEVEL", f"level = {1.5 * true}")))
    module = sys.modules["surctl.lyapunov.solve"]
    decide = module.decide_motion
    monkeypatch.setattr(module, "decide_motion", lambda *a, **o: replace(decide(*a, **o), verdict="unknown"))
    found = solve(problem, time_limit=20.0)
    assert found.verdict == "unknown" and found.instead.startswith("level = ")
    assert 0 < float(found.instead.removeprefix("level = ")) < true
    assert f"  a region is proved with {found.instead}" in found.lines()
    assert "neither proved nor refuted" in found.lines()[0]


def test_an_undecided_claim_that_nothing_helps_names_its_time_limit(tmp_path: Path) -> None:
    found = solve(load_problem(written(tmp_path, TEXT.format(a=1), ("LEVEL", ""))), time_limit=1e-6)
    assert found.verdict == "unknown" and not found.instead
    assert found.reason.endswith("the time limit was 1e-06 s of processor time")


@pytest.mark.parametrize("seed", range(8))
def test_limits_are_said_not_to_act_exactly_where_they_do_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain, limit = rng.uniform(0.5, 3.0), rng.uniform(0.2, 0.9)
    rate = parse(f"max(-{limit}, min({limit}, -{gain}*x)) - 0.1*x", X)
    d = Dynamics("held", "continuous", (State("x", -2.0, 2.0),), (rate,))
    edge = (limit / gain) ** 2  # V at which the saturation begins
    inside = limits_sentence(d, parse("x^2", X), 0.9 * edge, d)
    assert "no limit (min, max) in the dynamics acts at" in inside
    assert float(inside.rpartition("V = ")[2]) == pytest.approx(edge, rel=0.02)
    assert limits_sentence(d, parse("x^2", X), 1.1 * edge, d) == ""
    idle = replace(d, rates=(parse("max(-9, min(9, -x))", X),))
    assert limits_sentence(idle, parse("x^2", X), edge, idle).endswith("of the region; nor at any sample of the box")
    free = replace(d, rates=(parse("-x", X),))
    assert limits_sentence(free, parse("x^2", X), edge, free) == ""


def test_a_proved_region_says_that_its_limit_never_acts() -> None:
    d = Dynamics("held", "continuous", (State("x", -2.0, 2.0),), (parse("max(-1, min(1, -2*x))", X),))
    small, large = (solve(Problem(d, "lyapunov", parse("x^2", X), level), time_limit=20.0) for level in (0.2, 1.0))
    assert small.verdict == large.verdict == "proved"
    assert f"  {small.limits}" in small.lines() and small.limits and not large.limits
    assert small.to_dict()["limits"] == small.limits and large.to_dict()["limits"] is None


@pytest.mark.parametrize("seed", range(3))
def test_a_barrier_that_is_not_found_names_what_was_tried_and_its_time_limit(seed: int, tmp_path: Path) -> None:
    speed, limit = np.random.default_rng(seed).uniform([0.1, 3.0], [1.0, 6.0]).round(3)  # x reaches the unsafe set
    text = f"""
    kind = "barrier"
    name = "drift"
    initial = ["x <= -0.5"]
    unsafe = ["x >= 0.5"]
    [states]
    x = {{ rate = "{speed}", lower = -1, upper = 1 }}
    """
    found = solve(load_problem(written(tmp_path, text)), time_limit=limit)
    assert found.verdict == "unknown"
    cause, said = found.reason.removeprefix("no barrier was found: ").rsplit("; ", 1)
    assert "degree" in cause and said == f"the time limit was {limit:g} s of processor time"
