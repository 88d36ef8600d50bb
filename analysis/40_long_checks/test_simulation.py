"""Simulation: both loops with sensors of other kinds than the suite's, and the escape by depth by sonar."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np

from surctl.control import load_gains
from surctl.sensing import Equipment, SonarArray
from surctl.simulation import METRICS, STOPS, Case, Sensors, load_scenario, simulate, simulate_batch
from surctl.vehicle import load_vehicle
from tests.simulation.test_depth_escape import SCENES, _across, _box, _case, _flown
from tests.tools import need_compiler

SLOW = SonarArray(azimuths=(0.0, pi), order=(1, 0), firing_period=0.05, beam_angle=1.0)


def test_two_sonars_that_fire_at_every_other_instant_and_true_positions() -> None:
    need_compiler()
    scenario = replace(load_scenario("tank-moving"), sensors=Sensors(Equipment(array=SLOW, own=None)), time_limit=7.0)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")
    run = simulate(scenario, case.vehicle, gains=case.gains, sensing="sonar", seed=5)
    np.testing.assert_allclose(simulate_batch(case, seeds=[5]).table[0], run.metrics.row(), rtol=0, atol=1e-9)


def test_by_sonar_it_arrives_over_and_under() -> None:
    need_compiler()
    for scene, seed in (("a sill", 0), ("a curtain", 1)):
        table = simulate_batch(_case(SCENES[scene], "sonar"), seeds=seed).table
        stopped, least = (table[:, list(METRICS).index(name)] for name in ("stopped", "min_clearance_m"))
        assert np.all(stopped == STOPS.index("reached")) and least.min() > 0.05, scene


def test_by_sonar_no_depth_leads_on_through_a_wall() -> None:
    need_compiler()
    wall = (_across("wall", bottom_m=-5.0),)  # the floor: the same compiled loop
    table = simulate_batch(_case(wall, "sonar")).table
    assert np.all(table[:, list(METRICS).index("stopped")] == STOPS.index("dead end"))
    assert table[:, list(METRICS).index("min_clearance_m")].min() > 0.05


def test_both_loops_hear_what_crosses_the_fan_and_nothing_else() -> None:
    """A sill that is heard, one that is passed over, and a curtain passed under: one compiled loop, that of above."""
    need_compiler()
    heard, alone = {}, None
    for name, x, ends in (
        ("sill", 2.2, {"top_m": -2.25}),
        ("low", 1.6, {"top_m": -2.4}),
        ("high", 1.6, {"bottom_m": -1.6}),
    ):
        case = _case((_box(name, (x, 2.5), (0.3, 1.0), **ends),), "sonar")
        short = replace(case, scenario=replace(case.scenario, time_limit=2.5))
        run = _flown(short, 2)
        alone = alone or _flown(replace(short, scenario=replace(short.scenario, obstacles=())), 2)
        heard[name] = not np.array_equal(run.telemetry("ranges"), alone.telemetry("ranges"))
        (row,) = simulate_batch(short, seeds=[2]).table
        np.testing.assert_allclose(row, run.metrics.row(), rtol=0, atol=1e-9)
    assert heard == {"sill": True, "low": False, "high": False}
