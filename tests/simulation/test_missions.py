"""Missions of any length in both loops: many waypoints, arcs, speeds and depths of legs, corners to visit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.guidance import Path
from surctl.marine.simulation import (
    METRICS,
    Case,
    Scenario,
    load_scenario,
    mission_system,
    simulate,
    simulate_batch,
)
from surctl.marine.simulation.batch.case import fed_ranges
from surctl.marine.simulation.batch.engines import structure_of
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.scenario import scenario_from_table
from surctl.marine.vehicle import load_vehicle
from tests.oracles.mission_loop import simulate as reference
from tests.oracles.missions import difference
from tests.oracles.path_follower import PlainFollower

VEHICLE, GAINS, SITE = load_vehicle("sur400"), load_gains("default"), load_scenario("tank-static")


def written(path: list[list[float]], *legs: dict[str, Any], **more: Any) -> Scenario:
    table = {
        "kind": "scenario",
        "name": "own",
        "title": "own",
        "provenance": "made up",
        "vehicle": "sur400",
        "path_m": path,
        "leg": list(legs),
        "depth_m": -1.0,
        "cruise_m_per_s": 0.2,
        "cap_m_per_s": 0.25,
        "site": {"length_m": 20.0, "width_m": 20.0, "depth_m": 5.0},
    }
    return scenario_from_table(table | more, source="own.toml")


def same(case: Case, row: np.ndarray) -> np.ndarray:
    """The metrics of the batch, which must be those of a single run."""
    found = simulate_batch(case).table[0]
    for name, a, b in zip(METRICS, found, row, strict=True):
        assert a == b or abs(a - b) <= 1e-9, (name, a, b)
    return found


def loops(count: int, spacing: float) -> np.ndarray:
    """Points of a figure that crosses itself many times, evenly spaced."""
    t = np.linspace(0, 2 * np.pi, 20001)
    dense = np.stack([5 + 3.4 * np.sin(3 * t), 2.5 + 1.5 * np.sin(2 * t + 0.4)], axis=1)
    arcs = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))])
    at = np.arange(count) * spacing
    return np.stack([np.interp(at, arcs, dense[:, k]) for k in (0, 1)], axis=1)


def test_the_work_of_a_step_does_not_depend_on_the_number_of_waypoints() -> None:
    steps = []
    for count in (20, 1000):
        scenario = replace(SITE, path=Path(loops(count, 0.03)), obstacles=())
        structure = structure_of(Case(scenario, VEHICLE, GAINS, law="closed_form"), {})
        loop = build_loop(structure)
        assert loop.parameters.port("mission").shape == (structure.points, 5) and structure.points >= count
        steps.append(loop.step)
    assert steps[0].operations == steps[1].operations
    plain = replace(SITE, path=Path(loops(8, 0.03)), obstacles=())
    without = build_loop(structure_of(Case(plain, VEHICLE, GAINS, law="closed_form"), {})).step.operations
    assert steps[0].operations < 1.7 * without


def test_legs_with_speeds_depths_and_visits() -> None:
    legs = (
        {"to_m": [8, 5], "speed_m_per_s": 0.1, "depth_m": -1.3},
        {"to_m": [8, 8], "corner": "visit"},
        {"to_m": [8.5, 7.5], "radius_m": 0.5, "turn": "right"},
        {"to_m": [8.5, 5.5], "depth_m": -1.0},
    )
    scenario = written([[2, 5], [5, 5]], *legs)
    run = simulate(scenario, VEHICLE, gains=GAINS)
    eta, leg = run.record.eta, PlainFollower(scenario.path, visit=scenario.visit).legs(run.record.eta[:, :2])
    speeds = np.hypot(*run.record.nu[:, :2].T)
    first, slow = (leg == 0) & (eta[:, 0] > 4), (leg == 2) & (eta[:, 0] < 7.8)
    assert speeds[first].mean() == pytest.approx(0.2, rel=0.03)
    assert speeds[slow].mean() == pytest.approx(0.1, rel=0.03)
    assert np.abs(eta[first, 2] + 1.0).max() < 0.01 and np.abs(eta[leg == 3, 2] + 1.3).max() < 0.02
    assert np.linalg.norm(eta[:, :2] - [8, 8], axis=1).min() <= scenario.arrival_radius
    assert run.metrics.reached and abs(eta[-1, 2] + 1.0) < scenario.arrival_radius
    assert run.metrics.path_error_m < 0.1
    assert difference(scenario, VEHICLE) <= 1e-9
    same(Case(scenario, VEHICLE, GAINS), np.array(run.metrics.row()))
    for name, (low, high) in fed_ranges(scenario).items():
        fed = run.record.step_parameters[:, run.law.gains.slice(name)]
        assert low - 1e-12 <= fed.min() and fed.max() <= high + 1e-12, name


@pytest.mark.parametrize(("corner", "missed"), [("visit", 0.0)])  # passed: `test_corners`
def test_each_corner_is_passed_or_visited_as_its_leg_says(corner: str, missed: float) -> None:
    """A post stands beside the corner, so a robot that may pass it turns back on its detour."""
    post = {"name": "post", "shape": "cylinder", "centre_m": [5.2, 2.4], "radius_m": 0.15}
    legs = ({"to_m": [6, 2.5], "corner": corner}, {"to_m": [1.5, 2.9]})
    other = "pass" if corner == "visit" else "visit"
    scenario = written([[1, 2.5]], *legs, obstacles=[post], corners=other, cruise_m_per_s=0.2, cap_m_per_s=0.22)
    run = simulate(scenario, VEHICLE, gains=GAINS)
    assert run.metrics.reached and run.metrics.missed_corner_m == pytest.approx(missed, abs=0.06)


def test_parameters_of_a_batch_hold_on_legs_that_do_not_say() -> None:
    scenario = written([[2, 5], [3, 5]], {"to_m": [4, 5], "speed_m_per_s": 0.1}, {"to_m": [5, 5], "corner": "visit"})
    case = Case(scenario, VEHICLE, GAINS, law="closed_form")
    values = {"scenario.cruise": [0.2, 0.15], "scenario.depth": [-1.0, -2.0], "scenario.arrival_radius": [0.1, 0.05]}
    for row, cruise, depth, near in zip(simulate_batch(case, values).table, *values.values(), strict=True):
        changed = replace(scenario, cruise=cruise, depth=depth, arrival_radius=near)
        run = reference(changed, VEHICLE, gains=GAINS, law=case.build())
        assert row == pytest.approx(run.metrics.row(), abs=1e-9)


def test_in_casadis_machine() -> None:
    scenario = replace(written([[2, 5], [3, 5]], {"to_m": [4, 5], "depth_m": -1.1, "speed_m_per_s": 0.2}), time_limit=2)
    exact = Case(scenario, VEHICLE, GAINS, law="closed_form")
    wanted = reference(scenario, VEHICLE, gains=GAINS, law=exact.build()).metrics.row()
    assert simulate_batch(exact, engine="vm").table[0] == pytest.approx(wanted, abs=1e-9)


def test_what_has_no_window_says_so() -> None:
    scenario = replace(SITE, path=Path(loops(20, 0.1)), obstacles=())
    with pytest.raises(InputError, match=r"path_m: has more than 8 points.*; give at most 8 points, or use simulate"):
        mission_system(scenario, VEHICLE, gains=GAINS)


def test_points_too_close_for_the_window_are_refused_in_both_loops() -> None:
    scenario = replace(SITE, path=Path(loops(20, 0.01)), obstacles=(), cap=0.3)
    case = Case(scenario, VEHICLE, GAINS, law="closed_form")
    fragment = (
        r"path_m = .*: is 0.01 m from the next point of the path, but at the cap of 0.3 m/s the robot moves 0.015 m"
    )
    for loop in (lambda: simulate(scenario, VEHICLE, gains=GAINS, law=case.build()), lambda: simulate_batch(case)):
        with pytest.raises(InputError, match=fragment):
            loop()
