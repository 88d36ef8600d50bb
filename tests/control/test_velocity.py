"""Velocity controller: trim, limits, anti-windup, integral action."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from surctl.marine.control.closing import velocity_control
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, Vehicle, load_vehicle, plant_parameters, trim_thrust

Array = NDArray[np.float64]
DT, K_V, K_R = 0.05, 1.5, 1.2


@cache
def _control(name: str, k_i: float) -> ca.Function:
    vehicle = load_vehicle(name)
    model = {
        "mass": ca.SX(vehicle.mass),
        "linear_drag": ca.SX(vehicle.linear_drag),
        "quadratic_drag": ca.SX(vehicle.quadratic_drag),
        "thrust_limit": ca.SX(vehicle.thrust_limit),
    }
    wanted, nu, integral = (ca.SX.sym(n, 4) for n in ("nu_reference", "nu", "integral"))
    gains = {"k_v": ca.SX(K_V), "k_r": ca.SX(K_R), "k_i": ca.SX(k_i)}
    return ca.Function(
        "control", [wanted, nu, integral], list(velocity_control(wanted, nu, integral, model, **gains, dt=DT))
    )


def _step(
    wanted: ArrayLike, nu: ArrayLike, integral: ArrayLike = (0, 0, 0, 0), *, k_i: float = 0.0
) -> tuple[Array, Array, int]:
    tau, held, saturated = (
        np.asarray(m).reshape(-1) for m in _control("sur540-flooded", k_i)(*map(np.asarray, (wanted, nu, integral)))
    )
    return tau, held, int(saturated[0])


@pytest.mark.parametrize("name", ["sur540-flooded", "bluerov2-wu"])
@pytest.mark.parametrize(
    "nu", [(0.15, 0, 0, 0), (0, -0.1, 0, 0), (0, 0, 0.05, 0), (0.1, 0, -0.05, 0.0), (0, 0, 0, 0.2)]
)
def test_at_the_wanted_speed_it_holds_trim_exactly(name: str, nu: tuple[float, ...]) -> None:
    """Motions without Coriolis force; that one is not cancelled on purpose."""
    tau = np.asarray(_control(name, 0.0)(nu, nu, np.zeros(4))[0]).reshape(-1)
    np.testing.assert_allclose(tau, trim_thrust(load_vehicle(name), np.array(nu)), atol=1e-14)


def test_coriolis_is_not_cancelled() -> None:
    nu = [0.2, 0.0, 0.0, 0.5]
    tau, _, _ = _step(nu, nu)
    assert tau[1] == 0.0  # cancelling m u r would ask 9.5 N


def test_the_law_by_hand() -> None:
    tau, _, saturated = _step([0.10, 0, 0, 0.05], [0.08, 0.01, 0, 0], [0.001, 0, 0, 0])
    assert tau[0] == pytest.approx(2.0 * 0.1 + 60 * 0.01 + 95 * (1.5 * 0.02 + 0.001), rel=1e-12)
    assert tau[1] == pytest.approx(95 * 1.5 * -0.01, rel=1e-12)
    assert tau[3] == pytest.approx(0.3 * 0.05 + 0.0025 + 1.5 * 1.2 * 0.05, rel=1e-12)
    assert saturated == 0


speeds = st.tuples(*[st.floats(-1e3, 1e3)] * 4)


@settings(derandomize=True, deadline=None)
@given(speeds, speeds, speeds)
def test_thrust_stays_within_the_limits_and_the_flag_says_when(
    wanted: tuple[float, ...], nu: tuple[float, ...], integral: tuple[float, ...]
) -> None:
    limit = load_vehicle("sur540-flooded").thrust_limit
    tau, _, saturated = _step(wanted, nu, integral)
    assert np.all(np.abs(tau) <= limit)
    if saturated:
        assert np.any(np.abs(tau) == limit)


def test_each_axis_is_limited_by_itself() -> None:
    alone, _, _ = _step([0, 0, 0, 0], [0.2, 0, 0, 0])
    with_sway, _, _ = _step([0, 1.0, 0, 0], [0.2, 0, 0, 0])
    assert alone[0] == with_sway[0] == -5.0


def test_the_integral_stands_still_only_on_the_axis_that_saturates() -> None:
    _, held, saturated = _step([1.0, 0.01, 0, 0], [0, 0, 0, 0], [0.1, 0.002, 0, 0], k_i=0.5)
    assert saturated == 1
    assert held[0] == 0.1
    assert held[1] == pytest.approx(0.002 + DT * 0.5 * 0.01)
    _, held, saturated = _step([0.01, 0.02, 0, 0], [0, 0, 0, 0], k_i=0.5)
    assert saturated == 0
    np.testing.assert_allclose(held, [DT * 0.5 * 0.01, DT * 0.5 * 0.02, 0, 0], atol=1e-15)


def _fly(k_i: float, *, wanted: ArrayLike, force: ArrayLike, seconds: float) -> tuple[Array, Array]:
    """Closed loop with a constant disturbance force; the last ν and ξ."""
    vehicle: Vehicle = load_vehicle("sur540-flooded")
    control, plant, p = _control("sur540-flooded", k_i), advance(), plant_parameters(vehicle)
    d = PLANT_DISTURBANCE.pack({"force": force})
    x, integral = PLANT_STATE.pack(), np.zeros(4)
    for _ in range(round(seconds / DT)):
        tau, integral, _ = control(np.asarray(wanted), x[4:8], integral)
        for _ in range(2):
            x = plant(x, tau, d, p)
        x = np.asarray(x).reshape(-1)
        integral = np.asarray(integral).reshape(-1)
    return x[4:8], integral


def test_integral_action_removes_the_offset_of_a_constant_force() -> None:
    wanted, force = [0.1, 0, 0, 0], [1.0, -0.5, 0.3, 0]
    plain, _ = _fly(0.0, wanted=wanted, force=force, seconds=60)
    integral, _ = _fly(0.2, wanted=wanted, force=force, seconds=120)
    assert np.abs(plain - wanted).max() > 0.002
    np.testing.assert_allclose(integral, wanted, atol=1e-6)


def test_no_windup_under_a_wish_that_the_thrust_cannot_hold() -> None:
    """2 m/s is far beyond 5 N: the integral must not grow with the time spent in saturation."""
    short = _fly(0.2, wanted=[2.0, 0, 0, 0], force=np.zeros(4), seconds=10)[1]
    long = _fly(0.2, wanted=[2.0, 0, 0, 0], force=np.zeros(4), seconds=60)[1]
    assert short[0] == long[0] == 0.0
