"""The closed loop: all scenarios, seeds 0–9, and what a run must be."""

from __future__ import annotations

from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import NONFINITE, build_law, load_gains
from surctl.marine.sensing import Fault, FaultChances
from surctl.marine.simulation import (
    SENSING,
    STOPS,
    BatchResult,
    Case,
    Run,
    Scenario,
    Sensing,
    Sensors,
    load_scenario,
    simulate,
    simulate_batch,
)
from surctl.marine.vehicle import load_vehicle
from tests.tools import need_compiler

SCENARIOS = ("tank-static", "pool-static", "pool-behind", "tank-speed-015")
SEEDS = 10


@cache
def _run(name: str, sensing: Sensing, seed: int) -> Run:
    scenario = load_scenario(name)
    return simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), sensing=sensing, seed=seed)


def _check(run: Run) -> None:
    metrics, paper = run.metrics, run.scenario.paper.time_s
    assert metrics.stopped_because == "reached"
    assert metrics.reached
    assert metrics.min_clearance_m > 0
    assert np.hypot(*(run.record.eta[-1, :2] - run.scenario.target)) <= run.scenario.arrival_radius
    if paper is not None:
        assert metrics.time_s == pytest.approx(paper, rel=0.25)


@pytest.mark.parametrize("name", SCENARIOS)
def test_with_true_positions_every_scenario_arrives_unharmed_and_in_time(name: str) -> None:
    _check(_run(name, "truth", 0))


@pytest.mark.parametrize("name", ["pool-static"])  # waves, drift and thrust are drawn; in the others nothing is
def test_so_it_does_with_other_seeds(name: str) -> None:
    """Through the compiled loop, which `test_batch` compares with the other one."""
    need_compiler()
    scenario = load_scenario(name)
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"))
    flown = simulate_batch(case, seeds=np.arange(SEEDS))
    assert np.all(flown.column("stopped") == STOPS.index("reached"))
    assert np.all(flown.column("reached") == 1)
    assert np.all(flown.column("min_clearance_m") > 0)
    if scenario.paper.time_s is not None:
        np.testing.assert_allclose(flown.column("time_s"), scenario.paper.time_s, rtol=0.25)


def _flown(scenario: Scenario, seeds: int = 1) -> BatchResult:
    need_compiler()
    case = Case(scenario, load_vehicle(scenario.vehicle), load_gains("default"), sensing="sonar")
    return simulate_batch(case, seeds=np.arange(seeds), threads=2)


def test_through_the_sonars_it_arrives_and_touches_nothing() -> None:
    """Studies 12 and 22 fly the other scenarios."""
    # with faults that never begin it flies the same, through the compiled loop of the tests with dead sonars
    flown = _flown(replace(load_scenario("tank-static"), sensors=_dead()))
    assert np.all(flown.column("reached") == 1)
    assert np.all(flown.column("min_clearance_m") > 0)


def _dead(*which: int, lost: float = 1e-9) -> Sensors:
    """These sonars dead, the others after any flight, and this share of readings lost: one compiled loop for all.

    Each sonar has two faults, as in `test_stop_reason`, which flies the same loop.
    """
    faults = tuple(Fault(sensor=k % 4, kind="dead", start_s=0.0 if k in which else 1e5) for k in range(8))
    return Sensors(faults=faults, chances=FaultChances(dropout=lost))


def test_with_a_dead_sonar_it_touches_nothing() -> None:
    flown = _flown(replace(load_scenario("tank-static"), sensors=_dead(0), time_limit=60.0))
    assert np.all(flown.column("collided") == 0)


def test_with_one_reading_in_ten_lost_it_touches_nothing_and_mostly_arrives() -> None:
    """Study 12 flies the other troubles, other beams and drifting cylinders."""
    flown = _flown(replace(load_scenario("tank-static"), sensors=_dead(lost=0.1)))
    assert np.all(flown.column("collided") == 0)
    assert flown.column("reached").mean() > 0.6


def test_with_no_sonar_at_all_it_stays_where_it_is() -> None:
    scenario = replace(load_scenario("tank-static"), sensors=_dead(0, 1, 2, 3), time_limit=20.0)
    flown = _flown(scenario)
    assert np.all(flown.column("collided") == 0)
    assert np.all(flown.column("length_m") < 0.2)  # in 20 s, with the jitter of its estimate
    assert np.all(flown.column("max_deviation_m") < 0.03)


@pytest.mark.parametrize(("name", "sensing"), [("pool-static", "truth"), ("pool-behind", "sonar")])
def test_one_seed_one_run(name: str, sensing: Sensing) -> None:
    scenario = replace(load_scenario(name), time_limit=4.0)
    vehicle, gains = load_vehicle(scenario.vehicle), load_gains("default")
    first, other, again = (simulate(scenario, vehicle, gains=gains, sensing=sensing, seed=k) for k in (0, 1, 0))
    for field in ("time", "eta", "nu", "tau", "clearance", "law_state", "law_input", "status", "telemetry"):
        np.testing.assert_array_equal(getattr(first.record, field), getattr(again.record, field), err_msg=field)
    np.testing.assert_equal(asdict(first.metrics), asdict(again.metrics))  # a NaN equals a NaN
    rows = min(len(first.record.eta), len(other.record.eta))
    assert np.abs(first.record.eta[:rows] - other.record.eta[:rows]).max() > 1e-4


@pytest.mark.parametrize("sensing", SENSING)
def test_the_record_replays_through_the_law(sensing: Sensing) -> None:
    """Each row holds what the law was told and what it answered: τ and the next state follow from it alone."""
    run = _run("pool-behind", sensing, 0)
    record, law = run.record, run.law
    for k in range(0, len(record.time) - 1, 7):
        step = law.step(record.law_state[k], record.law_input[k], record.law_parameters)
        np.testing.assert_array_equal(step.tau, record.tau[k])
        np.testing.assert_array_equal(step.x_next, record.law_state[k + 1])
        assert step.status == record.status[k]
        np.testing.assert_array_equal(step.telemetry, record.telemetry[k])


def test_a_tick_is_50_ms_and_the_metrics_follow_from_the_record() -> None:
    run = _run("tank-static", "truth", 0)
    record, metrics = run.record, run.metrics
    np.testing.assert_allclose(np.diff(record.time), 0.05, atol=1e-12)
    assert metrics.time_s == round(float(record.time[-1]), 9)
    assert metrics.min_clearance_m <= record.clearance.min()
    assert metrics.min_clearance_m == pytest.approx(record.clearance.min(), abs=0.01)
    assert metrics.length_m == pytest.approx(np.linalg.norm(np.diff(record.eta[:, :2], axis=0), axis=1).sum())
    assert metrics.effort_n == pytest.approx(np.hypot(record.tau[:, 0], record.tau[:, 1]).mean())
    assert np.all(np.abs(record.tau) <= run.vehicle.thrust_limit)
    assert not np.any(record.status == NONFINITE)


def test_telemetry_by_name() -> None:
    run = _run("tank-static", "truth", 0)
    assert run.telemetry("nu_reference").shape == (len(run.record.time), 4)
    assert set(np.unique(run.telemetry("avoiding"))) == {0.0, 1.0}
    # the law knows of nothing nearer than there is
    np.testing.assert_allclose(run.telemetry("nearest")[:, 0], run.record.clearance, atol=1e-6)


def test_with_truth_the_law_is_told_the_truth_and_with_sonar_it_estimates() -> None:
    run = _run("pool-behind", "truth", 0)
    np.testing.assert_array_equal(run.record.law_input[:, run.law.inputs.slice("eta")], run.record.eta)
    run = _run("pool-behind", "sonar", 0)
    assert "eta" not in run.law.inputs
    told = run.record.law_input[2:, run.law.inputs.slice("fix")]  # 0.1 s late, 10 Hz
    fresh = run.record.law_input[2:, run.law.inputs.slice("fix_fresh")].ravel() > 0.5
    assert fresh.mean() == pytest.approx(0.5, abs=0.01)
    error = told[fresh] - run.record.eta[:-2, :3][fresh]
    assert 0.005 < np.sqrt(np.mean(error**2)) < 0.015


def test_a_law_with_sonars_needs_them() -> None:
    scenario = load_scenario("pool-behind")
    with pytest.raises(InputError, match="law that uses sonars"):
        simulate(scenario, load_vehicle("sur400"), gains=load_gains("default"), law=build_law(sonar=True))
    with pytest.raises(InputError, match="law that uses no sonars"):
        simulate(scenario, load_vehicle("sur400"), gains=load_gains("default"), law=build_law(), sensing="sonar")


def test_the_controller_may_believe_in_another_vehicle() -> None:
    scenario = load_scenario("tank-speed-015")
    flown, believed = load_vehicle("sur540-flooded"), load_vehicle("sur540-light")
    run = simulate(scenario, flown, gains=load_gains("default"), model=believed)
    law = run.law
    np.testing.assert_array_equal(run.record.law_parameters[law.gains.slice("mass")], believed.mass)
    assert run.vehicle is flown
    assert run.metrics.time_s != _run("tank-speed-015", "truth", 0).metrics.time_s


def test_a_collision_ends_the_run() -> None:
    """The printed stack knows no braking distance: the heavy robot slides into the head-on obstacle."""
    scenario = load_scenario("tank-speed-015")
    run = simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), law=build_law("paper"))
    assert run.metrics.stopped_because == "collision"
    assert not run.metrics.reached
    assert run.metrics.min_clearance_m <= 0
    assert run.record.clearance[-1] <= 0


def test_the_time_limit_ends_the_run() -> None:
    scenario = replace(load_scenario("tank-static"), time_limit=3.0)
    run = simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"))
    assert run.metrics.stopped_because == "time limit"
    assert not run.metrics.reached
    assert run.record.time.size == 60


def test_what_cannot_be_flown_is_refused() -> None:
    scenario, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
    with pytest.raises(InputError, match="did you mean 'sonar'"):
        simulate(scenario, vehicle, gains=gains, sensing="sonnar")
    near = scenario.obstacles[0].model_copy(update={"centre_m": (0.9, 0.8)})
    with pytest.raises(InputError, match=r"starts .* inside obstacle 'OM1'"):
        simulate(replace(scenario, obstacles=(near,)), vehicle, gains=gains)
