"""Escape by depth: over a sill and under a curtain, by truth and by sonar; a dead end where no depth leads on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest

from surctl.marine.cli.runs import RunOutput
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, Obstacle, Run, Scenario, Sensing, load_scenario, simulate, simulate_batch
from surctl.marine.simulation.explanation import stop_reason
from surctl.marine.simulation.run import depth_changes
from surctl.marine.vehicle import load_vehicle
from tests.tools import need_compiler

SILL = load_scenario(str(FilePath(__file__).parent / "scenarios" / "tank-sill.toml"))
HULL, MARGIN = load_vehicle(SILL.vehicle)["radius"], load_gains("default")["margin"]
PITCH = 2 * HULL + MARGIN


def _across(name: str, **ends: float) -> Obstacle:
    return Obstacle(name=name, shape="box", centre_m=(5.0, 2.5), size_m=(0.3, 5.0), **ends)  # type: ignore[arg-type]


def _box(name: str, centre: tuple[float, float], size: tuple[float, float], **ends: float) -> Obstacle:
    return Obstacle(name=name, shape="box", centre_m=centre, size_m=size, **ends)  # type: ignore[arg-type]


def _u(**ends: float) -> tuple[Obstacle, ...]:
    arms = (_box("right", (3.9, 0.9), (1.8, 0.3), **ends), _box("left", (3.9, 4.1), (1.8, 0.3), **ends))
    return (_across("back", **ends), *arms)


SCENES = {
    "a sill": (_across("sill", top_m=-1.8),),
    "a curtain": (_across("curtain", bottom_m=-2.2),),
    "a low U": _u(top_m=-1.8),
}
BLOCKED = {"a wall with a hole too small": (_across("wall", top_m=-0.9),)}


def _scenario(obstacles: tuple[Obstacle, ...]) -> Scenario:
    return replace(SILL, obstacles=obstacles, time_limit=1000.0)


def _case(obstacles: tuple[Obstacle, ...], sensing: Sensing = "truth", patience: float = 2.5) -> Case:
    scenario, gains = _scenario(obstacles), load_gains("default").with_values({"patience": patience})
    return Case(scenario, load_vehicle(scenario.vehicle), gains, sensing=sensing)


def _flown(case: Case, seed: int = 0) -> Run:
    return simulate(case.scenario, case.vehicle, gains=case.gains, law=case.build(), sensing=case.sensing, seed=seed)


@cache
def _run(scene: str) -> Run:
    return _flown(_case((SCENES | BLOCKED)[scene]))


@pytest.mark.parametrize(
    ("scene", "layers"),
    [("a curtain", [1, 2, -1, 0])],
)
def test_where_only_another_depth_leads_on_it_is_found_and_left_again(scene: str, layers: list[int]) -> None:
    run = _run(scene)
    assert run.metrics.reached and run.metrics.min_clearance_m > 0.04
    assert [change.to_m for change in depth_changes(run)] == pytest.approx([-2.0 + k * PITCH for k in layers])
    assert [change.back for change in depth_changes(run)] == [k == 0 for k in layers]
    assert run.record.eta[-1, 2] == pytest.approx(-2.0, abs=0.1)
    told = run.to_dict()["depth_changes"]
    assert [change["to_m"] for change in told] == [change.to_m for change in depth_changes(run)]
    first, *_, last = RunOutput().further(run, {})
    assert "m from z -2.00 to -1.41 m: search for a passage at another depth" in first
    assert last.endswith("to -2.00 m: back to the path's depth")


@pytest.mark.parametrize("scene", ["a curtain"])
def test_it_changes_its_depth_in_place_and_within_the_water_that_is_allowed(scene: str) -> None:
    run = _run(scene)
    z, changing = run.record.eta[:, 2], _state(run, "changing") > 0.5
    assert SILL.depths is not None
    lowest, highest = SILL.depths
    assert np.all(z - HULL >= lowest + MARGIN - 0.01) and np.all(z + HULL <= highest - MARGIN + 0.01)
    speed, rising = np.hypot(*run.record.nu[:, :2].T), np.abs(run.record.nu[:, 2])
    assert np.all(rising[~changing] < 0.03) and rising[changing].max() > 0.08
    assert speed[changing & (rising > 0.03)].max() < 0.06
    depth = z + 2.0
    at_a_layer = np.abs(depth - PITCH * np.round(depth / PITCH)) < 0.05
    assert np.all(at_a_layer | changing)


def _state(run: Run, name: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(run.record.law_state[:, run.law.state.slice(name)][:, 0])


@pytest.mark.parametrize("scene", BLOCKED)
def test_where_no_depth_leads_on_it_is_a_dead_end_after_all_were_tried(scene: str) -> None:
    run = _run(scene)
    assert run.metrics.stopped_because == "dead end" and run.metrics.min_clearance_m > 0.04
    tried = [change.to_m for change in depth_changes(run)]
    assert tried == pytest.approx([-2.0 + k * PITCH for k in (1, 2, -1, -2)])
    assert stop_reason(run).endswith("depths tried besides the path's, z in m: -1.41, -0.82, -2.59, -3.18")
    assert np.ptp(run.record.eta[-100:, 2]) < 0.02


def test_without_other_depths_the_sill_is_a_dead_end_as_ever() -> None:
    case = _case(SCENES["a sill"])
    run = _flown(replace(case, scenario=replace(case.scenario, depths=None)))
    assert run.metrics.stopped_because == "dead end" and depth_changes(run) == []
    assert "depth_changes" not in run.to_dict() and "column" not in run.law.inputs
    assert np.ptp(run.record.eta[:, 2]) < 1e-6


@pytest.mark.parametrize("scene", ["a curtain"])
def test_the_compiled_loop_flies_the_same(scene: str) -> None:
    need_compiler()
    (row,) = simulate_batch(_case((SCENES | BLOCKED)[scene]), seeds=[0]).table
    np.testing.assert_allclose(row, _run(scene).metrics.row(), rtol=0, atol=1e-6)


def test_a_run_that_needs_no_other_depth_has_no_change() -> None:
    run = _flown(_case(()))
    assert run.metrics.reached and depth_changes(run) == [] == run.to_dict()["depth_changes"]
