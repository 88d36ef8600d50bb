"""Paths that close, cross, fold or repeat are gone along whole before a run arrives; corners are passed or visited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surctl.marine.cli.runs import run_line
from surctl.marine.control import load_gains
from surctl.marine.guidance import Path
from surctl.marine.simulation import Case, Scenario, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.clearance import end_findings
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.vehicle import load_vehicle

VEHICLE, GAINS, SITE = load_vehicle("sur400"), load_gains("default"), load_scenario("tank-static")
FOLD = [[1, 2.5], [6, 2.5], [1.5, 2.9]]
PATHS = {
    "closed": [[2, 1.5], [8, 1.5], [8, 3.5], [2, 3.5], [2, 1.5]],
    "a leg twice": [[2, 1.5], [6, 1.5], [6, 3.5], [2, 1.5], [6, 1.5]],
}
POST = Obstacle(name="post", shape="cylinder", centre_m=(5.2, 2.4), radius_m=0.15)


def mission(path: list[list[float]], *obstacles: Obstacle, corners: str = "pass") -> Scenario:
    return replace(SITE, path=Path(np.array(path, float)), obstacles=obstacles, time_limit=200.0, corners=corners)


@pytest.mark.parametrize("name", ["closed"])
def test_it_arrives_once_it_went_all_the_way_in_both_loops(name: str) -> None:
    scenario = mission(PATHS[name])
    run = simulate(scenario, VEHICLE, gains=GAINS)
    assert run.metrics.reached and run.metrics.missed_corner_m < 0.1
    assert run.metrics.max_deviation_m < 0.3, "past sharp corners"
    assert run.metrics.length_m == pytest.approx(scenario.path.length, rel=0.05)
    row = simulate_batch(Case(scenario, VEHICLE, GAINS)).table[0]
    assert row == pytest.approx(run.metrics.row(), abs=1e-9)


@pytest.mark.parametrize(("corners", "missed"), [("pass", 0.81)])  # visited: `test_missions`, study 40
def test_after_a_detour_a_corner_is_left_out_or_visited_as_the_mission_says(corners: str, missed: float) -> None:
    scenario = mission(FOLD, POST, corners=corners)
    run = simulate(scenario, VEHICLE, gains=GAINS)
    assert run.metrics.reached and run.metrics.missed_corner_m == pytest.approx(missed, abs=0.02)
    assert ("a corner missed by 0.81" in run_line(run)) == (corners == "pass")
    row = simulate_batch(Case(scenario, VEHICLE, GAINS)).table[0]
    assert row == pytest.approx(run.metrics.row(), abs=1e-9)


def test_a_corner_that_nobody_can_visit_is_found_beforehand() -> None:
    on_it = POST.model_copy(update={"centre_m": (6.0, 2.5)})
    assert not end_findings(mission(FOLD, on_it), VEHICLE)
    (finding,) = end_findings(mission(FOLD, on_it, corners="visit"), VEHICLE)
    assert finding.level == "error" and "corner (6, 2.5)" in finding.text
