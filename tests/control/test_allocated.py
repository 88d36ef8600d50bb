"""A law with allocation: the thrust that the thrusters achieve, what the law keeps of it, and its precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surctl.ir import replay
from surctl.marine.allocation import allocate
from surctl.marine.control import SATURATED, WORKING, Law, build_law, load_gains
from surctl.marine.control.build import in_real
from surctl.marine.control.law import with_allocation
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.vehicle import Actuators, Vehicle, load_vehicle

VEHICLE = load_vehicle("bluerov2-heavy")


def _actuators(vehicle: Vehicle = VEHICLE) -> Actuators:
    assert vehicle.actuators is not None
    return vehicle.actuators


def _law(name: str = "closed_form") -> Law:
    return build_law(name, actuators=VEHICLE.actuators)


def _numbers(vehicle: Vehicle = VEHICLE) -> np.ndarray:
    path = Path([[0.0, 0.0], [20.0, 0.0]])
    walls = (-5.0, 25.0, -5.0, 5.0)
    return law_parameters(
        load_gains("default").with_values({"k_i": 0.2}),
        vehicle,
        path=path,
        depth=-1.0,
        cruise=0.3,
        cap=0.5,
        walls=walls,
    )


def _inputs(law: Law, **ports: object) -> np.ndarray:
    return law.inputs.pack({"eta": [1.0, 0.1, -1.0, 0.05], "nu": [0.2, 0.0, 0.0, 0.0], **ports})


def test_tau_is_what_the_thrusters_achieve() -> None:
    law, base = _law(), build_law("closed_form")
    p = _numbers()
    step = law.step(law.initial_state(), _inputs(law), p)
    alone = base.step(base.initial_state(), _inputs(base), p)
    assert step.tau == pytest.approx(alone.tau, abs=1e-12)
    assert step.telemetry[law.telemetry_slice("tau_desired")] == pytest.approx(alone.tau)
    assert step.x_next == pytest.approx(alone.x_next)
    found = allocate(_actuators(), alone.tau)
    assert step.telemetry[law.telemetry_slice("thruster_force")] == pytest.approx(found.forces, abs=1e-12)
    assert step.telemetry[law.telemetry_slice("thruster_command")] == pytest.approx(found.commands, abs=1e-12)
    assert step.status == alone.status


def test_a_missed_command_holds_the_integral_and_is_reported() -> None:
    law, base, p = _law(), build_law("closed_form"), _numbers()
    ports = {"eta": [1.0, 1.5, -1.0, 0.8], "nu": [0.2, 0.0, 0.0, 0.0]}
    working = np.ones(8)
    working[[1, 2]] = 0.0  # the other two give no sway force without a yaw moment
    step = law.step(law.initial_state(), _inputs(law, **ports, working=working), p)
    alone = base.step(base.initial_state(), _inputs(base, **ports), p)
    missed = np.abs(step.tau - alone.tau) > 1e-6
    assert missed.any() and not missed.all()
    held = law.state.slice("integral")
    assert (step.x_next[held][missed] == 0.0).all()
    assert (alone.x_next[held][missed] != 0.0).any()
    assert step.x_next[held][~missed] == pytest.approx(alone.x_next[held][~missed])
    assert step.status & SATURATED
    assert (step.telemetry[law.telemetry_slice("thruster_force")][[1, 2]] == 0.0).all()


def test_the_priority_problem_is_that_of_the_law_without_allocation() -> None:
    law, base, p = _law("guarded"), build_law("guarded"), _numbers()
    found = law.explained(law.initial_state(), _inputs(law), p)
    expected = base.explained(base.initial_state(), _inputs(base), p)
    assert found.v.tolist() == expected.v.tolist()


def test_single_precision_is_close_to_double() -> None:
    law, p = _law(), _numbers()
    x, u = law.initial_state(), _inputs(law)
    double = replay(law.block, x, u, p)
    single = replay(in_real(law, "float32").block, x, u, p, real=np.float32)
    assert single[0] == pytest.approx(double[0], abs=1e-3)
    assert single[3][law.telemetry_slice("thruster_command")] == pytest.approx(
        double[3][law.telemetry_slice("thruster_command")], abs=1e-3
    )


def test_the_law_is_built_once_for_one_set_of_thrusters() -> None:
    assert _law() is _law()
    other = replace(_actuators(), order=("force", "yaw", "effort"))
    assert with_allocation(build_law("closed_form"), other) is not _law()
    assert _law().inputs.port(WORKING).default == 1.0
