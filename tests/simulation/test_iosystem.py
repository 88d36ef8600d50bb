"""The closed loop in python-control is the flight, to the last bit."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import closed_loop_system, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle


def test_python_control_flies_the_same_flight() -> None:
    scenario, gains, seed = load_scenario("tank-speed-015"), load_gains("default"), 1
    scenario = replace(scenario, time_limit=10.0)
    vehicle = load_vehicle(scenario.vehicle)
    record = simulate(scenario, vehicle, gains=gains, seed=seed).record
    system, initial = closed_loop_system(scenario, vehicle, gains=gains, seed=seed)
    found = control.input_output_response(system, record.time, 0, initial)
    flown = np.hstack([record.eta, record.nu, record.tau]).T
    np.testing.assert_array_equal(found.outputs, flown)


def test_thrust_that_is_added_is_felt() -> None:
    scenario, gains = load_scenario("pool-behind"), load_gains("default")
    vehicle = load_vehicle(scenario.vehicle)
    system, initial = closed_loop_system(scenario, vehicle, gains=gains)
    times = system.dt * np.arange(21)
    push = np.zeros((4, 21))
    push[1] = 0.2
    plain, pushed = (control.input_output_response(system, times, u, initial).outputs for u in (0, push))
    np.testing.assert_array_equal(plain[:, 0], pushed[:, 0])
    assert (pushed[5, 5:] > plain[5, 5:]).all()
    assert system.input_labels[0] == "Fu_cmd [N] added" and system.output_labels[8] == "Fu_cmd [N]"


def test_a_law_with_sonars_is_refused() -> None:
    scenario = load_scenario("pool-behind")
    vehicle = load_vehicle(scenario.vehicle)
    law = build_law(sonar=True, equipment=scenario.sensors.on(vehicle["radius"]))
    with pytest.raises(InputError, match=r"law.*sonars"):
        closed_loop_system(scenario, vehicle, gains=load_gains("default"), law=law)
