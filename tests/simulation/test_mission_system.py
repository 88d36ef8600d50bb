"""A mission as a system moves as `simulate` does, and is swept, compiled and refused as any system."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import Disturbance, Obstacle, load_scenario, mission_system, simulate
from surctl.marine.vehicle import load_vehicle
from surctl.system import run_system, simulate_system
from tests.tools import need_compiler

GAINS, LAW = load_gains("default"), build_law("closed_form")
ROUGH = Disturbance(
    wave_force_n=0.2, drift_force_n=0.1, thrust_error=0.1, thrust_bias=0.02, current_m_per_s=(0.02, 0.01)
)


@pytest.mark.parametrize("name", ["pool-behind", "pool-static"])
def test_it_moves_as_a_run(name: str, seconds: float = 14.0) -> None:
    scenario = replace(load_scenario(name), time_limit=seconds, disturbance=ROUGH)
    vehicle = load_vehicle(scenario.vehicle)
    run = simulate(scenario, vehicle, gains=GAINS, law=LAW, seed=4)
    record = run_system(mission_system(scenario, vehicle, gains=GAINS, law=LAW, seed=4), seconds)
    assert len(record.time) == len(run.record.time)
    for got, expected in ((record["eta"], run.record.eta), (record["nu"], run.record.nu)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-8)
    assert (record.stopped == "collision") == (run.metrics.stopped_because == "collision")
    figures = {name: getattr(run.metrics, name) for name in ("deviation_m", "max_deviation_m", "effort_n")}
    assert {name: record.figures[name] for name in figures} == pytest.approx(figures, abs=1e-7)


def test_gains_and_surroundings_are_numbers_of_its_compiled_runs() -> None:
    need_compiler()
    scenario = replace(load_scenario("pool-behind"), time_limit=4.0)
    vehicle = load_vehicle(scenario.vehicle)
    loop = mission_system(scenario, vehicle, gains=GAINS, law=LAW)
    runs = simulate_system(loop, 4.0, {"k_v": [1.0, 2.0], "surroundings.world_hull": [0.2, 0.25]})
    for k, k_v in enumerate((1.0, 2.0)):
        single = simulate(scenario, vehicle, gains=GAINS.with_values({"k_v": k_v}), law=LAW)
        assert runs["deviation_m"][k] == pytest.approx(single.metrics.deviation_m, abs=1e-7)
    wider = run_system(loop, 4.0, {"k_v": 2.0, "surroundings.world_hull": 0.25})
    assert runs["min_clearance_m"][1] == pytest.approx(wider.figures["min_clearance_m"], abs=1e-9)
    assert wider.figures["min_clearance_m"] < run_system(loop, 4.0, {"k_v": 2.0}).figures["min_clearance_m"]


def test_what_it_cannot_hold_is_refused() -> None:
    scenario = load_scenario("pool-behind")
    vehicle = load_vehicle(scenario.vehicle)
    sonar = build_law(sonar=True, equipment=scenario.sensors.on(vehicle["radius"]))
    with pytest.raises(InputError, match=r"law.*sonars"):
        mission_system(scenario, vehicle, gains=GAINS, law=sonar)
    with pytest.raises(InputError, match="is not that of the law's command"):
        mission_system(scenario, load_vehicle("bluerov2-heavy"), gains=GAINS, law=LAW)
    ahead = Obstacle(name="post", shape="cylinder", centre_m=(0.5, 1.0), radius_m=0.5)
    with pytest.raises(InputError, match="inside obstacle 'post'"):
        mission_system(replace(scenario, obstacles=(ahead,)), vehicle, gains=GAINS, law=LAW)
