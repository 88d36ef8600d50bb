"""The linear model: names, and agreement with the plant for small perturbations."""

from __future__ import annotations

import re

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import expm

from surctl.errors import InputError
from surctl.marine.cli.gains import derive
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, linearise, load_vehicle, plant_parameters, trim_thrust
from surctl.marine.vehicle.linearise import check_cruise

STATES = ["x", "y", "z", "psi", "u", "v", "w", "r", "Fu", "Fv", "Fw", "Fr"]


def test_signals_have_names() -> None:
    system = linearise(load_vehicle("sur540-flooded"), np.array([0.15, 0, 0, 0]))
    assert list(system.state_labels) == STATES
    assert list(system.output_labels) == STATES
    assert list(system.input_labels) == ["Fu_cmd", "Fv_cmd", "Fw_cmd", "Fr_cmd"]
    assert system.name == "sur540-flooded"
    np.testing.assert_array_equal(system.C, np.eye(12))
    np.testing.assert_array_equal(system.D, np.zeros((12, 4)))


def test_surge_pole_by_hand() -> None:
    vehicle = load_vehicle("sur540-flooded")
    system = linearise(vehicle, np.array([0.15, 0, 0, 0]))
    u, thrust = STATES.index("u"), STATES.index("Fu")
    assert system.A[u, u] == pytest.approx(-(2.0 + 2 * 60 * 0.15) / 95, rel=1e-12)
    assert system.A[u, thrust] == pytest.approx(1 / 95, rel=1e-12)
    assert system.A[thrust, thrust] == pytest.approx(-1 / 0.3, rel=1e-12)
    assert system.B[thrust, 0] == pytest.approx(1 / 0.3, rel=1e-12)


@pytest.mark.parametrize("name", ["sur540-flooded", "bluerov2-wu"])
@pytest.mark.parametrize("psi", [0.0, 1.1])
def test_small_perturbations_follow_the_plant(name: str, psi: float) -> None:
    vehicle = load_vehicle(name)
    nu = np.array([0.15, 0.02, 0.03, 0.0])
    system = linearise(vehicle, nu, psi=psi)
    tau = trim_thrust(vehicle, nu)
    small = 1e-5 * np.random.default_rng(4).uniform(-1, 1, 12)
    trim = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": nu, "tau": tau})
    step, p, d = advance(), plant_parameters(vehicle), PLANT_DISTURBANCE.pack()
    base, moved = trim, trim + small
    for _ in range(40):
        base = np.asarray(step(base, tau, d, p)).reshape(-1)
        moved = np.asarray(step(moved, tau, d, p)).reshape(-1)
    linear = expm(system.A * 1.0) @ small
    np.testing.assert_allclose(moved - base, linear, atol=5e-9)  # second order: 1e-5 squared, times the curvature
    assert np.abs(linear - small).max() > 1e-6


def test_without_lag_the_thrust_states_are_gone() -> None:
    vehicle = load_vehicle("sur540-flooded").with_values({"thrust_lag": 0.0})
    system = linearise(vehicle, np.array([0.15, 0, 0, 0]))
    assert list(system.state_labels) == STATES[:8]
    np.testing.assert_allclose(system.B[4:8], np.diag(1 / vehicle.mass), rtol=1e-12)


def test_a_speed_that_the_thrust_cannot_hold_is_refused() -> None:
    with pytest.raises(InputError, match=r"operating point nu.*needs thrust.*slower"):
        linearise(load_vehicle("sur540-flooded"), np.array([0.4, 0, 0, 0]))
    with pytest.raises(InputError, match=r"^cruise = 5: needs thrust .*; otter holds at most 3\.\d+ m/s$") as caught:
        check_cruise(otter := load_vehicle("otter"), 5)
    held = float(str(caught.value).split()[-2])
    check_cruise(otter, held)
    with pytest.raises(InputError):
        check_cruise(otter, held + 0.002)
    assert not re.search(r"\d\.\d{3}", str(caught.value).partition(";")[0]), "numbers of at most two decimals"
    result = CliRunner().invoke(derive, ["otter", "--cruise", "5"])
    assert str(result.exception).startswith("otter: --cruise = 5.0: needs thrust")
