"""An undecided claim names a weaker one that is proved."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.lyapunov import load_problem, solve
from tests.lyapunov.problems import written

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
    assert found.reason.endswith("the search may take 1e-06 s of processor time")


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
    assert "degree" in cause and said == f"the search may take {limit:g} s of processor time"
