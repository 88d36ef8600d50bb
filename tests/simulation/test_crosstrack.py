"""Guidance with memory in closed loop: a steady push, the return to the path, and how often a side is changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from surctl.marine.control import Law, build_law, load_gains
from surctl.marine.guidance import Guidance, Path
from surctl.marine.simulation import Run, Scenario, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle

FREE = Path(np.array([[0.5, 2.5], [28.0, 2.5]]))


@cache
def _law(guidance: Guidance) -> Law:
    return build_law(guidance=guidance)


def _pushed(name: str, *, current: float = 0.0, force: float = 0.0, obstacles: bool = False) -> Scenario:
    """The scenario's vehicle and speed on 27.5 m of straight path, pushed all the way."""
    base = load_scenario(name)
    steady = {
        "current_m_per_s": (0.0, current),
        "drift_force_n": force,
        "drift_period_s": 1e6,  # as good as constant
        "wave_force_n": 0.0,
        "thrust_error": 0.0,
        "thrust_bias": 0.0,
    }
    return replace(
        base,
        path=FREE,
        site=(30.0, 5.0, 5.0),
        obstacles=load_scenario("tank-static").obstacles[3:] if obstacles else (),
        disturbance=base.disturbance.model_copy(update=steady),
        time_limit=90.0,
    )


@cache
def _flown(scenario: str, guidance: Guidance, current: float, force: float, obstacles: bool = False) -> Run:
    mission = _pushed(scenario, current=current, force=force, obstacles=obstacles)
    return simulate(mission, load_vehicle(mission.vehicle), gains=load_gains("default"), law=_law(guidance))


def _y(run: Run) -> np.ndarray:
    return run.record.eta[:, 1] - 2.5


def test_los_has_no_memory_and_the_others_keep_theirs_finite() -> None:
    assert "drift" not in _law("los").state and "drift" in _law("alos").state
    run = _flown("tank-static", "ilos", 0.05, 0.0)
    assert np.isfinite(run.record.law_state[:, run.law.state.slice("drift")]).all()
    assert run.law.guidance == "ilos"


def test_the_side_of_an_encounter_is_latched() -> None:
    """From 0 to a side and back is one encounter; within it the side turns over at most twice, and never in a tick."""
    scenario = load_scenario("tank-moving")
    run = simulate(scenario, load_vehicle(scenario.vehicle), gains=load_gains("default"), law=_law("los"))
    side = run.record.law_state[:, run.law.state.slice("side")].ravel()
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], (side != 0).astype(int), [0]])))
    assert len(bounds)
    for begin, end in zip(bounds[::2], bounds[1::2], strict=True):
        assert np.count_nonzero(np.diff(side[begin:end])) <= 2
