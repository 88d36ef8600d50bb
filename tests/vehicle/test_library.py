"""The published vehicles of the library: steady speeds, turns and energies as their sources' equations give them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_STATE,
    Vehicle,
    load_vehicle,
    plant_parameters,
    steady_speed,
    trim_thrust,
)
from tests.vehicle.published import FLIP, PUBLISHED, Published

Array = NDArray[np.float64]
STILL, STEP = PLANT_DISTURBANCE.pack(), 0.025  # s
CRUISE = {"otter": 0.77, "remus100": 0.87, "lauv": 0.64, "eca-a9": 0.79, "rexrov": 0.66, "girona500": 0.51}  # m/s
WITHOUT_SWAY = {"otter", "remus100", "lauv", "eca-a9"}


def simulated(vehicle: Vehicle, x: Array, tau: Array, *, steps: int, pieces: int = 1) -> Array:
    """States (pieces + 1, 12) of the plant under constant thrust, after each piece of some steps of 25 ms."""
    states, piece, p = [x], advance(vehicle.form).fold(steps), plant_parameters(vehicle)
    for _ in range(pieces):
        states.append(np.asarray(piece(states[-1], tau, STILL, p)).reshape(-1))
    return np.array(states)


def integrated(source: Published, times: Array) -> Array:
    """Positions x, y, heading and velocity (7, n) of the source's equations at some times, by DOP853."""
    inverse, tau = np.linalg.inv(source.inertia), np.array(source.thrust)

    def rate(_t: float, s: Array) -> Array:
        u, v, _, r = s[3:]
        c, n = np.cos(s[2]), np.sin(s[2])
        return np.array([c * u - n * v, n * u + c * v, r, *(inverse @ (tau - source.load(s[3:])))])

    states = [np.array([0, 0, 0, *source.start])]
    for span in pairwise(times):  # interpolation within a step would have errors of 1e-7
        run = solve_ivp(rate, span, states[-1], method="DOP853", rtol=1e-11, atol=1e-12)
        states.append(run.y[:, -1])
    return np.stack(states, axis=1)


@pytest.mark.parametrize("name", PUBLISHED)
def test_inertia_and_load_are_those_of_the_source_in_other_axes(name: str) -> None:
    vehicle, source = load_vehicle(name), PUBLISHED[name]()
    np.testing.assert_allclose(vehicle.inertia, FLIP @ source.inertia @ FLIP, rtol=1e-12, atol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(20):
        nu = rng.uniform([0.0, -0.4, -0.3, -0.5], [1.5, 0.4, 0.3, 0.5])  # ahead, where |u| = u
        expected = FLIP @ source.load(nu)
        np.testing.assert_allclose(trim_thrust(vehicle, FLIP @ nu), expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_turn_equals_an_independent_integration(name: str) -> None:
    source = PUBLISHED[name]()
    vehicle = load_vehicle(name).with_values({"thrust_lag": 0.0})
    tau = FLIP @ source.thrust
    least, most = vehicle.thrust_range
    assert (least <= tau).all()
    assert (tau <= most).all()
    start, steps = PLANT_STATE.pack({"nu": FLIP @ source.start}), round(source.seconds / STEP / 5)
    turn = simulated(vehicle, start, tau, steps=steps, pieces=5)
    expected = integrated(source, np.linspace(0, 5 * steps * STEP, 6))
    place = np.stack([turn[:, 0], -turn[:, 1], -turn[:, 3]])
    np.testing.assert_allclose(place, expected[:3], rtol=1e-8, atol=1e-8)
    velocity = FLIP @ turn[:, 4:8].T
    np.testing.assert_allclose(velocity, expected[3:], rtol=1e-8, atol=1e-8)
    energies = [nu @ vehicle.inertia @ nu / 2 for nu in turn[:, 4:8]]
    np.testing.assert_allclose(energies, [nu @ source.inertia @ nu / 2 for nu in expected[3:].T], rtol=1e-8)
    curvature = [nu[3] / np.hypot(nu[0], nu[1]) for nu in (velocity[:, -1], expected[3:, -1])]
    assert curvature[0] == pytest.approx(curvature[1], abs=1e-8)
    np.testing.assert_allclose(trim_thrust(vehicle, turn[-1, 4:8]), tau, rtol=1e-6, atol=1e-6)  # the turn is steady


@pytest.mark.parametrize("name", sorted(set(PUBLISHED) - {"rexrov"}))  # RexROV needs sway thrust to go straight
def test_steady_speed_ahead(name: str) -> None:
    vehicle, source = load_vehicle(name).with_values({"thrust_lag": 0.0}), PUBLISHED[name]()
    force = 0.8 * vehicle["Fu_max"]
    expected = steady_speed(force, *source.surge)
    x = PLANT_STATE.pack({"nu": [0.99 * expected, 0, 0, 0]})
    final = simulated(vehicle, x, np.array([force, 0, 0, 0]), steps=4000)[-1]
    assert final[4] == pytest.approx(expected, rel=1e-8)
    np.testing.assert_array_equal(final[[5, 7]], 0)


def test_craft_without_sway_thrust_and_unequal_thrust() -> None:
    for name in PUBLISHED:
        assert (load_vehicle(name)["Fv_max"] == 0) == (name in WITHOUT_SWAY)
    assert load_vehicle("otter").thrust_range[0, 0] == -133.416
    for name, cruise in CRUISE.items():
        assert cruise < 0.8 * steady_speed(load_vehicle(name)["Fu_max"], *PUBLISHED[name]().surge)


@pytest.mark.parametrize("name", PUBLISHED)
def test_each_number_names_its_source(name: str) -> None:
    for key, parameter in load_vehicle(name).parameters.items():
        assert len(parameter.provenance) > 10, key
        assert "default of this toolkit" not in parameter.provenance, key
