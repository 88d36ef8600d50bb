"""The linear loop of a craft with a rudder is that of its simulation, and that of its law with allocation or without"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from surctl.marine.assessment import Mission
from surctl.marine.cli.runs import linear_warning
from surctl.marine.control import Gains, Law, build_law, default_law, law_source
from surctl.marine.simulation import Case, vehicle_law
from surctl.marine.simulation.loop import SingleRun
from surctl.marine.simulation.scaling import mission_size, straight_mission
from surctl.marine.simulation.thruster_faults import Thrusters
from surctl.marine.tuning import build_cases, case_loop, derived_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import law_loop

Array = np.ndarray[Any, Any]

CRUISE = {"lauv": 1.0, "remus100": 0.8}


def craft(name: str) -> tuple[Vehicle, Gains]:
    vehicle = load_vehicle(name)
    return vehicle, derived_gains(vehicle, cruise=CRUISE[name]).with_own(law_source(default_law(vehicle)).gains)


def simulated_poles(vehicle: Vehicle, gains: Gains, law: Law, cruise: float) -> Array:
    # poles of one control period of the simulation in its steady cruise, with commands that act one period late
    far = 20 * mission_size(vehicle, gains, cruise=cruise)
    run = SingleRun(Case(straight_mission(vehicle, cruise=cruise, size=far), vehicle, gains), law, seed=0)
    thrusters, size = Thrusters.of(vehicle, law), run.plant.size

    def period(z: Array) -> Array:
        run.plant[:], run.law_state = z[:size], z[size:-4].copy()
        values = run.sense()
        step = law.step(values["x"], values["u"], values["p"])
        delivered, _ = run.thrust(step, thrusters, 0.0, run.plant)
        run.move(values, z[-4:])
        return np.concatenate([values["plant_next"], step.x_next, delivered])

    z = np.concatenate([run.plant, run.law_state, np.zeros(4)])
    for _ in range(1200):
        z = period(z)
    steps = 1e-6 * np.eye(len(z))
    poles: Array = np.linalg.eigvals(np.column_stack([(period(z + d) - period(z - d)) / 2e-6 for d in steps]))
    return poles


@pytest.mark.parametrize("name", CRUISE)
def test_every_pole_of_the_linear_loop_is_one_of_the_simulation(name: str) -> None:
    # the side force of the rudder lags behind its command, as the moment does
    vehicle, gains = craft(name)
    law = vehicle_law(vehicle)
    poles = simulated_poles(vehicle, gains, law, CRUISE[name])
    loop = law_loop(law, vehicle, gains, cruise=CRUISE[name])
    assert "Fv" in loop.linear.names.states and loop.linear.names.commands == ("surge", "yaw")
    assert max(np.abs(poles - pole).min() for pole in loop.poles) < 2e-6


def test_every_command_has_the_margins_of_the_law_that_runs() -> None:
    vehicle, gains = craft("lauv")
    law, cruise = vehicle_law(vehicle), CRUISE["lauv"]
    loop = law_loop(law, vehicle, gains, cruise=cruise)
    alone = law_loop(build_law(law.ref), vehicle, gains, cruise=cruise)
    assert alone.disk == pytest.approx(loop.disk, rel=1e-9)
    verified = Mission(vehicle, gains, cruise, 2 * cruise).parts()["loop"]()
    warned, _ = linear_warning(vehicle, gains, law, cruise=cruise)
    [figure] = [figure.value for figure in verified.figures if figure.name == "disk_margin"]
    assert warned is not None and warned["disk_margin"] == figure
    size = mission_size(vehicle, gains, cruise=cruise)
    [case] = build_cases([straight_mission(vehicle, cruise=cruise, size=size)], [vehicle], gains=gains)
    assert np.array_equal(case_loop(case, gains).transition, loop.linear.transition)
