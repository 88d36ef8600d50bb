"""Dynamics (3): structure, conservation, equilibria, current, thrust."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    build_plant,
    load_vehicle,
    plant_parameters,
    steady_speed,
    trim_thrust,
)

Array = NDArray[np.float64]
STILL = PLANT_DISTURBANCE.pack()
ALL = ("sur540-flooded", "sur540-light", "sur400", "bluerov2-vonbenzon", "bluerov2-wu")
STEP = 0.025  # [s] of one call of advance()


def _fly(x: Array, tau: Array, *, d: Array = STILL, p: Array, seconds: float) -> list[Array]:
    count = round(seconds / STEP)
    held = (np.tile(value, (count, 1)).T for value in (tau, d, p))
    return [x, *np.asarray(_steps(count)(x, *held)).T]


@cache
def _steps(count: int) -> ca.Function:
    return advance().mapaccum(count)


def _state(eta: object = (0, 0, 0, 0), nu: object = (0, 0, 0, 0), tau: object = (0, 0, 0, 0)) -> Array:
    return PLANT_STATE.pack({"eta": eta, "nu": nu, "tau": tau})


def _free(mass: object) -> Array:
    """A body without drag."""
    return PLANT_PARAMETERS.pack({"mass": mass, "thrust_limit": [5, 5, 5, 0.5], "thrust_lag": 0.3})


def _rotated(psi: float, horizontal: Array) -> Array:
    c, s = np.cos(psi), np.sin(psi)
    return np.array([c * horizontal[0] - s * horizontal[1], s * horizontal[0] + c * horizontal[1]])


def _invariants(x: Array, mass: Array) -> Array:
    """E, p_x, p_y, angular momentum about the world's z axis."""
    eta, nu = x[:4], x[4:8]
    px, py = _rotated(eta[3], mass[:2] * nu[:2])
    return np.array([0.5 * mass @ nu**2, px, py, mass[3] * nu[3] + eta[0] * py - eta[1] * px])


# --- conservation -------------------------------------------------------------------------------------------------

WU = (17.0, 24.2, 26.07, 0.28)
VON_BENZON = (19.8567, 20.6206, 32.1863, 0.5915)
SKEWED = (85.0, 105.0, 95.0, 1.5)


@pytest.mark.parametrize(
    ("mass", "eta", "nu"),
    [
        (VON_BENZON, (1, 2, -0.15, 0.7), (0.22, 0.10, 0.05, 0.27)),
        (WU, (1, 2, -0.15, 0.7), (0.20, 0.05, 0.05, 0.10)),
        (SKEWED, (0, 0, -0.15, 0.0), (0.15, 0.02, 0.02, 0.05)),
    ],
    ids=["vonbenzon", "wu", "skewed sphere"],
)
def test_a_body_without_drag_conserves_energy_and_momenta(
    mass: tuple[float, ...], eta: tuple[float, ...], nu: tuple[float, ...]
) -> None:
    m = np.array(mass)
    states = _fly(_state(eta, nu), np.zeros(4), p=_free(m), seconds=50)
    drift = np.abs([_invariants(x, m) - _invariants(states[0], m) for x in states])
    assert drift.max() <= 1e-9
    # and not because nothing happened
    assert np.ptp([x[3] for x in states]) > 0.5
    assert np.ptp([x[4] for x in states]) > 0.01


def test_fast_bodies_conserve_relative_to_their_own_momentum() -> None:
    m = np.array(WU)
    states = _fly(_state((1, 2, 0, 0.7), (0.22, 0.1, 0.1, 0.5)), np.zeros(4), p=_free(m), seconds=50)
    start = _invariants(states[0], m)
    drift = np.abs([_invariants(x, m) - start for x in states]).max(axis=0)
    momentum = np.hypot(start[1], start[2])
    way = max(np.hypot(*x[:2]) for x in states)
    assert drift[0] <= 1e-9 * start[0]
    assert max(drift[1:3]) <= 1e-9 * momentum
    assert drift[3] <= 1e-9 * momentum * way


velocities = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.floats(-2, 2))


@settings(derandomize=True, deadline=None)
@given(velocities, st.floats(-4, 4), st.tuples(*[st.floats(1, 120)] * 4))
def test_inertial_terms_do_no_work_and_no_net_force(nu: tuple[float, ...], psi: float, mass: tuple[float, ...]) -> None:
    v, m = np.array(nu), np.array(mass)
    x = _state((0.3, -0.4, 0, psi), nu)
    rate = np.asarray(build_plant().ode(x, np.zeros(4), STILL, _free(m))).reshape(-1)
    scale = 1e-13 * (1 + m.max() * 16)
    assert abs((m * v) @ rate[4:8]) <= scale
    tilt = np.array([[0, -1], [1, 0]])
    force = _rotated(psi, m[:2] * rate[4:6] + v[3] * tilt @ (m[:2] * v[:2]))
    np.testing.assert_allclose(force, 0, atol=scale)
    torque = m[3] * rate[7] + v[0] * m[1] * v[1] - v[1] * m[0] * v[0]
    assert abs(torque) <= scale


def test_coriolis_signs_as_printed() -> None:
    m, nu = np.array([10.0, 20.0, 30.0, 2.0]), np.array([0.3, 0.2, 0.1, 0.5])
    rate = np.asarray(build_plant().ode(_state(nu=nu), np.zeros(4), STILL, _free(m))).reshape(-1)
    u, v, _, r = nu
    expected = np.array([20 * v * r, -10 * u * r, 0, (10 - 20) * u * v]) / m
    np.testing.assert_allclose(rate[4:8], expected, rtol=1e-14)


def test_drag_takes_energy_away() -> None:
    vehicle = load_vehicle("bluerov2-wu")
    states = _fly(_state(nu=(0.3, -0.2, 0.1, 0.8)), np.zeros(4), p=plant_parameters(vehicle), seconds=5)
    energy = [0.5 * vehicle.mass @ x[4:8] ** 2 for x in states]
    assert np.all(np.diff(energy) < 0)


# --- equilibria ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", range(4), ids=["surge", "sway", "heave", "yaw"])
@pytest.mark.parametrize("name", ALL[:2])
def test_steady_speeds(name: str, axis: int) -> None:
    vehicle = load_vehicle(name)
    force = 0.8 * vehicle.thrust_limit[axis]
    tau = np.zeros(4)
    tau[axis] = force
    X, X2 = vehicle.linear_drag[axis], vehicle.quadratic_drag[axis]
    closed = (-X + np.sqrt(X**2 + 4 * X2 * force)) / (2 * X2)
    final = _fly(_state(), tau, p=plant_parameters(vehicle), seconds=90)[-1]
    assert final[4 + axis] == pytest.approx(closed, rel=1e-9)
    assert steady_speed(force, X, X2) == pytest.approx(closed, rel=1e-15)
    np.testing.assert_allclose(np.delete(final[4:8], axis), 0, atol=1e-12)


@pytest.mark.parametrize("numbers", [(np.nan, 1.0, 1.0), (1.0, np.nan, 0.0), (1.0, 1.0, -10.0), (-1.0, 1.0, 1.0)])
def test_a_steady_speed_that_is_not_known_is_nan(numbers: tuple[float, float, float]) -> None:
    assert np.isnan(steady_speed(*numbers))


def test_linear_heave_drag_is_felt() -> None:
    """Z_w is no term of the paper; with it heave is slower, by the same formula."""
    vehicle = load_vehicle("sur400")
    damped = vehicle.with_values({"Zw": 30.0})
    final = [
        _fly(_state(), np.array([0, 0, 4.0, 0]), p=plant_parameters(v), seconds=60)[-1][6] for v in (vehicle, damped)
    ]
    assert final[0] == pytest.approx(np.sqrt(4 / 45), rel=1e-9)
    assert final[1] == pytest.approx((-30 + np.sqrt(900 + 4 * 45 * 4)) / 90, rel=1e-9)


def test_steady_speed_without_quadratic_or_any_drag() -> None:
    assert steady_speed(3.0, 2.0, 0.0) == 1.5
    assert steady_speed(3.0, 0.0, 0.0) == float("inf")


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("nu", [(0.15, 0, 0, 0), (0.1, -0.05, 0.03, 0.1), (0, 0.2, -0.1, -0.2)])
def test_trim_thrust_is_an_equilibrium(name: str, nu: tuple[float, ...]) -> None:
    vehicle = load_vehicle(name).with_values({})
    p = plant_parameters(vehicle)
    p[PLANT_PARAMETERS.slice("thrust_limit")] = 1e3
    tau = trim_thrust(vehicle, np.array(nu))
    rate = np.asarray(build_plant().ode(_state((1, 2, 3, 0.4), nu, tau), tau, STILL, p)).reshape(-1)
    np.testing.assert_allclose(rate[4:], 0, atol=1e-14)


# --- current ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("yaw_rate", [0.0, 0.4])
@pytest.mark.parametrize("name", ["bluerov2-wu", "sur540-flooded"])
def test_a_vehicle_that_drifts_with_the_current_goes_on_drifting_even_when_it_turns(name: str, yaw_rate: float) -> None:
    current = np.array([0.12, -0.07, 0.03])
    psi = 0.6
    x = _state((0, 0, 0, psi), [*_rotated(-psi, current[:2]), current[2], yaw_rate])
    d = PLANT_DISTURBANCE.pack({"current": current})
    states = _fly(x, np.zeros(4), d=d, p=plant_parameters(load_vehicle(name)), seconds=20)
    for state in states:
        np.testing.assert_allclose(_rotated(state[3], state[4:6]), current[:2], atol=1e-9)
        assert state[6] == pytest.approx(current[2], abs=1e-12)
    np.testing.assert_allclose(states[-1][:3], 20 * current, atol=1e-7)
    assert (np.ptp([s[3] for s in states]) > 0.3) == (yaw_rate > 0)


def test_a_vehicle_at_rest_is_carried_along_in_the_end() -> None:
    d = PLANT_DISTURBANCE.pack({"current": [0.1, 0.05, 0.0]})
    final = _fly(_state((0, 0, 0, 1.0)), np.zeros(4), d=d, p=plant_parameters(load_vehicle("sur400")), seconds=600)[-1]
    np.testing.assert_allclose(_rotated(final[3], final[4:6]), [0.1, 0.05], atol=1e-6)


def test_a_disturbance_force_acts_in_the_world_frame() -> None:
    vehicle, d = load_vehicle("sur400"), PLANT_DISTURBANCE.pack({"force": [1.0, 0, 0, 0.06]})
    rate = np.asarray(build_plant().ode(_state((0, 0, 0, np.pi / 2)), np.zeros(4), d, plant_parameters(vehicle)))
    np.testing.assert_allclose(rate.reshape(-1)[4:8], [0, -1 / 50, 0, 0.06 / 0.6], atol=1e-15)


# --- thrust -------------------------------------------------------------------------------------------------------


def test_thrust_follows_a_first_order_lag() -> None:
    vehicle = load_vehicle("sur540-flooded")
    command = np.array([2.0, -1.0, 0.5, 0.1])
    states = _fly(_state(), command, p=plant_parameters(vehicle), seconds=2)
    for k, x in enumerate(states):
        np.testing.assert_allclose(x[8:], command * (1 - np.exp(-k * STEP / 0.3)), atol=1e-8)


def test_thrust_stays_within_its_limits() -> None:
    vehicle = load_vehicle("sur540-flooded")
    for sign in (1, -1):
        states = _fly(_state(), np.full(4, sign * 1e3), p=plant_parameters(vehicle), seconds=6)
        assert np.all(np.abs([x[8:] for x in states]) <= vehicle.thrust_limit + 1e-12)
        np.testing.assert_allclose(states[-1][8:], sign * vehicle.thrust_limit, rtol=1e-7)


def test_without_lag_thrust_acts_at_once_within_its_limits() -> None:
    vehicle = load_vehicle("sur540-flooded").with_values({"thrust_lag": 0.0})
    command = np.array([2.0, -50.0, 50.0, 0.1])
    rate = np.asarray(build_plant().ode(_state(), command, STILL, plant_parameters(vehicle))).reshape(-1)
    np.testing.assert_allclose(rate[4:8], np.array([2.0, -5.0, 5.0, 0.1]) / vehicle.mass, rtol=1e-15)
    np.testing.assert_array_equal(rate[8:], 0)


# --- exact Jacobians ----------------------------------------------------------------------------------------------


@settings(derandomize=True, deadline=None, max_examples=25)
@given(st.integers(0, 10**6))
def test_jacobians_equal_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vehicle = load_vehicle("bluerov2-wu")
    p = plant_parameters(vehicle)
    x = rng.uniform(-1, 1, 12)
    x[4:8] += 0.05 * np.sign(x[4:8])  # |ν|ν has a kink in its second derivative at 0
    tau = rng.uniform(-8, 8, 4)  # inside the limits, whose corner has no derivative
    d = rng.uniform(-0.02, 0.02, PLANT_DISTURBANCE.size)
    plant = build_plant()

    def rate(x_: Array, tau_: Array) -> Array:
        return np.asarray(plant.ode(x_, tau_, d, p)).reshape(-1)

    a, b = (np.asarray(m) for m in plant.jacobians(x, tau, d, p))
    h = 1e-6
    a_fd = np.column_stack([(rate(x + h * e, tau) - rate(x - h * e, tau)) / (2 * h) for e in np.eye(12)])
    b_fd = np.column_stack([(rate(x, tau + h * e) - rate(x, tau - h * e)) / (2 * h) for e in np.eye(4)])
    np.testing.assert_allclose(a, a_fd, atol=1e-6)
    np.testing.assert_allclose(b, b_fd, atol=1e-6)
