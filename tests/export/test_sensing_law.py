"""The law with its senses as exported C, against Python: a flight by sonar with faults, and far from any flight."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.export import Controller, Records, build_controller, compare_runs
from surctl.ir import memory
from surctl.marine.control import DEGRADED, SATURATED, SWITCHED, build_law, load_gains
from surctl.marine.control.build import in_real
from surctl.marine.export import build_bundle
from surctl.marine.sensing import Fault
from surctl.marine.simulation import Run, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from tests.tools import need_compiler

Vector = NDArray[np.float64]

FAULTS = (
    Fault(kind="dropout", sensor=0, start_s=2.0, duration_s=2.0),
    Fault(kind="stuck", sensor=1, start_s=5.0, duration_s=2.0),
)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Run, Controller]]:
    """A flight towards the cylinders, and the C of the law that flew it."""
    need_compiler()
    mission = load_scenario("pool-static")
    scenario = replace(mission, sensors=replace(mission.sensors, faults=FAULTS), time_limit=9.0)
    vehicle = load_vehicle(scenario.vehicle)
    law = build_law(sonar=True, equipment=scenario.sensors.on(vehicle["radius"]))
    run = simulate(scenario, vehicle, gains=load_gains("default"), law=law, sensing="sonar", seed=0)
    bundle = build_bundle(law, law.gains.unpack(run.record.law_parameters))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SURCTL_CFLAGS", "-O0")
        yield run, build_controller(law, bundle, tmp_path_factory.mktemp("c") / "bundle")


def test_a_flight_with_faults_agrees_to_the_last_bit(flown: tuple[Run, Controller]) -> None:
    run, controller = flown
    law, record = run.law, run.record
    (report,) = compare_runs(controller, [Records(record.law_state, record.law_input, record.law_parameters)])
    assert report.conclusive, report.summary()
    assert report.tau.absolute == report.state.absolute == report.telemetry.absolute == 0.0
    assert report.steps == 180
    # each number NaN and infinite; a repeated and an older sample; no state, gains, input, output
    assert report.fault_cases == 3 * (law.state.size + law.inputs.size + law.gains.size) + 6
    struck = (record.time > 2.0) & (record.time < 4.0)
    assert np.ptp(run.telemetry("healthy")[struck, 0]) == 1.0  # the fault reached the law
    cells = record.law_state[:, law.state.slice("map_cells")]
    assert cells.shape[1] == 2304 and cells.min() == -1.0 and cells.max() > 3.0  # and the map was drawn on


def test_in_floats_it_keeps_its_senses_and_its_tick() -> None:
    """That of the law with limits, which is another one in floats, is compared in `analysis/40_long_checks`."""
    law = build_law(sonar=True)
    assert in_real(law, "float32") is law
    numbers = law.inputs.size + law.gains.size + law.outputs.size + 7 + memory(law.block)
    assert 4 * numbers + 1280 <= 1024 * 30  # what the compiler counts of the other mode


def test_single_steps_far_from_any_flight_agree_to_the_last_bit(flown: tuple[Run, Controller]) -> None:
    """A flight comes through few of the courses that the law weighs; obstacles on all sides come through most."""
    run, controller = flown
    X, U, p = scattered_steps(run, 200)
    (report,) = compare_runs(controller, [Records(X, U, p)])
    assert report.passed, report.summary()
    assert report.tau.absolute == report.state.absolute == report.telemetry.absolute == 0.0
    found = {run.law.step(x, u, p).status for x, u in zip(X, U, strict=True)}
    for bit in (SATURATED, SWITCHED, DEGRADED):
        assert {status & bit for status in found} == {0, bit}


def test_the_readme_counts_what_it_takes(flown: tuple[Run, Controller]) -> None:
    """What a small processor's compiler tells of the stack is a check of `analysis/40_long_checks`."""
    run, controller = flown
    law, files = run.law, controller.bundle.files
    words = "bytes in the state", "bytes in the caller's other structs", "bytes in arrays"
    counts = [int(n) for word in words for n in re.findall(rf"(\d+) {word}", files["README.md"])]
    state, structs, arrays = (n // 8 for n in counts)
    assert state == 2 * law.state.size + 3  # six counters of 4 bytes
    assert structs == law.inputs.size + law.gains.size + law.outputs.size + 1  # padding of the output
    assert arrays == memory(law.block) - 2 * law.state.size


def scattered_steps(run: Run, count: int) -> tuple[Vector, Vector, Vector]:
    """States and inputs of the flight, shaken, among obstacles that were never there."""
    rng, law = np.random.default_rng(3), run.law
    at = rng.integers(0, len(run.record.time), count)
    X, U = run.record.law_state[at].copy(), run.record.law_input[at].copy()
    contacts = np.zeros((count, 8, 6))
    contacts[:, :, :2] = run.record.eta[at][:, None, :2] + rng.uniform(-1.5, 1.5, (count, 8, 2))
    contacts[:, :, 2] = rng.uniform(0.05, 0.4, (count, 8))
    contacts[:, :, 3:5] = rng.uniform(-0.2, 0.2, (count, 8, 2))
    contacts[:, :, 5] = rng.random((count, 8)) < 0.5
    U[:, law.inputs.slice("contacts")] = contacts.reshape(count, -1)
    U[:, law.inputs.slice("contacts_fresh")] = rng.random((count, 1)) < 0.7
    U[:, law.inputs.slice("fresh")] = rng.random((count, 4)) < 0.6
    U[:, law.inputs.slice("fix")] += rng.normal(0.0, 0.02, (count, 3))
    samples = law.inputs.slice("samples")
    U[:, samples] = np.abs(U[:, samples] + rng.normal(0.0, 0.3, U[:, samples].shape))
    cells = law.state.slice("map_cells")
    drawn = rng.uniform(-1.0, 1.0, X[:, cells].shape)
    X[:, cells] = np.where(rng.random(drawn.shape) < 0.05, drawn, X[:, cells])
    X[:, :10] += rng.normal(0.0, 0.3, (count, 10))  # what the decision remembers
    X[:, law.state.slice("side")] = rng.integers(-1, 2, (count, 1))
    return X, U, run.record.law_parameters
