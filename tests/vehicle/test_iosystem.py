"""The plant in python-control: the same motion, and the same slope."""

from __future__ import annotations

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_STATE,
    linearise,
    load_vehicle,
    plant_parameters,
    plant_system,
    trim_thrust,
)

FINE = {"rtol": 1e-12, "atol": 1e-12}
FIRING = 0.025


@pytest.mark.parametrize("lag", [0.3, 0.0])
def test_it_moves_as_the_simulation_does(lag: float) -> None:
    vehicle = load_vehicle("sur540-flooded").with_values({"thrust_lag": lag})
    current = [0.03, -0.02, 0.0]
    thrust = np.array([1.5, -0.6, 0.4, 0.08])
    start = PLANT_STATE.pack({"eta": [0, 0, -0.5, 0.3], "nu": [0.1, 0, 0, 0.1]})
    x, d = start, PLANT_DISTURBANCE.pack({"current": current})
    for _ in range(400):
        x = np.asarray(advance()(x, thrust, d, plant_parameters(vehicle))).reshape(-1)
    size = 12 if lag else 8
    system = plant_system(vehicle, current=current)
    times = np.array([0.0, 400 * FIRING])
    found = control.input_output_response(
        system, times, np.tile(thrust[:, None], 2), start[:size], solve_ivp_kwargs=FINE
    )
    np.testing.assert_allclose(found.outputs[:, -1], x[:size], rtol=0, atol=1e-8)
    assert np.abs(x[:8] - start[:8]).max() > 0.5


def test_its_slope_about_trim_is_the_linear_model() -> None:
    vehicle, nu = load_vehicle("sur540-flooded"), np.array([0.15, 0.02, 0.03, 0.0])
    tau = trim_thrust(vehicle, nu)
    wanted = linearise(vehicle, nu, psi=0.4, units=True)
    found = control.linearize(plant_system(vehicle), np.concatenate([[0, 0, 0, 0.4], nu, tau]), tau)
    np.testing.assert_allclose(found.A, wanted.A, atol=1e-5)
    np.testing.assert_allclose(found.B, wanted.B, atol=1e-5)
    system = plant_system(vehicle)
    assert system.state_labels == wanted.state_labels and system.input_labels == wanted.input_labels
    assert system.state_labels[3:5] == ["psi [rad]", "u [m/s]"] and system.input_labels[3] == "Fr_cmd [N m]"


def test_a_current_of_two_numbers_is_refused() -> None:
    with pytest.raises(InputError, match=r"current.*three"):
        plant_system(load_vehicle("sur400"), current=[0.1, 0.0])
