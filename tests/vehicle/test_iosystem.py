"""The plant of a vehicle in python-control: the same motion, and the same slope."""

from __future__ import annotations

import control
import numpy as np

from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_STATE,
    linearise,
    load_vehicle,
    plant_parameters,
    trim_thrust,
    vehicle_plant,
)
from surctl.system import to_control

VEHICLE = load_vehicle("sur540-flooded")
SYSTEM = to_control(vehicle_plant(VEHICLE))
FIRING = 0.025


def test_it_moves_as_the_simulation_does() -> None:
    thrust = np.array([1.5, -0.6, 0.4, 0.08])
    start = PLANT_STATE.pack({"eta": [0, 0, -0.5, 0.3], "nu": [0.1, 0, 0, 0.1]})
    x, d = start, PLANT_DISTURBANCE.pack({"current": [0.03, -0.02, 0.0]})
    for _ in range(400):
        x = np.asarray(advance()(x, thrust, d, plant_parameters(VEHICLE))).reshape(-1)
    times, inputs = np.array([0.0, 400 * FIRING]), np.concatenate([thrust, d])
    fine = {"rtol": 1e-12, "atol": 1e-12}
    found = control.input_output_response(SYSTEM, times, np.tile(inputs[:, None], 2), start, solve_ivp_kwargs=fine)
    np.testing.assert_allclose(found.states[:, -1], x, rtol=0, atol=1e-8)
    assert np.abs(x[:8] - start[:8]).max() > 0.5


def test_its_slope_about_trim_is_the_linear_model() -> None:
    nu = np.array([0.15, 0.02, 0.03, 0.0])
    tau = trim_thrust(VEHICLE, nu)
    wanted = linearise(VEHICLE, nu, psi=0.4)
    found = control.linearize(
        SYSTEM, np.concatenate([[0, 0, 0, 0.4], nu, tau]), np.concatenate([tau, np.zeros(SYSTEM.ninputs - 4)])
    )
    np.testing.assert_allclose(found.A, wanted.A, atol=1e-5)
    np.testing.assert_allclose(found.B[:, :4], wanted.B, atol=1e-5)
