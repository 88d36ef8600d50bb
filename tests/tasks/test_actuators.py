"""Limits of acceleration and thrust."""

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    build_plant,
    load_vehicle,
    plant_parameters,
    plant_thrust_limit,
)
from surctl.tasks import AccelerationLimit, ThrustLimit
from tests.tasks.numbers import rows_at

VEHICLES = ("sur540-flooded", "sur540-light", "sur400", "bluerov2-vonbenzon", "bluerov2-wu")
DT = 0.05


def parameters_of(name):
    p = plant_parameters(load_vehicle(name).with_values({"thrust_lag": 0.0}))
    return p, PLANT_PARAMETERS.unpack(p)


def reached(nu, tau, *, p, d, psi, dt, steps=20):
    """The velocity of the plant after dt under a constant thrust: RK4, independent of the repo's own integrator."""
    ode = build_plant().ode
    x = PLANT_STATE.pack({"eta": [0, 0, 0, psi], "nu": nu})
    h = dt / steps

    def rate(state):
        return np.array(ode(state, tau, d, p)).reshape(-1)

    for _ in range(steps):
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
    return x[PLANT_STATE.slice("nu")]


def test_acceleration_rows():
    nu = ca.SX.sym("nu", 4)
    rows = rows_at(AccelerationLimit(nu, [0.1, 0.2, 0.3, 0.4], dt=0.5), [nu], [[1, 2, 3, 4]])
    assert [r.name for r in rows] == ["acceleration.u", "acceleration.v", "acceleration.w", "acceleration.r"]
    assert {r.kind for r in rows} == {"actuator"}
    assert np.array_equal([r.a for r in rows], np.eye(4))
    assert np.allclose([r.lower for r in rows], [0.95, 1.9, 2.85, 3.8])
    assert np.allclose([r.upper for r in rows], [1.05, 2.1, 3.15, 4.2])


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_a_thrust_on_its_bound_reaches_what_the_row_says(vehicle):
    """First order: halving dt divides the error by 4. With current, force and a turning vehicle."""
    p, numbers = parameters_of(vehicle)
    rng = np.random.default_rng(3)
    for _ in range(5):
        nu, psi = rng.uniform(-0.5, 0.5, 4), rng.uniform(-3, 3)
        current, push = rng.uniform(-0.2, 0.2, 3), rng.uniform(-1, 1, 4)
        d = PLANT_DISTURBANCE.pack({"current": current, "force": push})
        turn = np.array([[math.cos(psi), math.sin(psi)], [-math.sin(psi), math.cos(psi)]])
        water, force = np.append(turn @ current[:2], current[2]), np.append(turn @ push[:2], push[2:])
        tau = numbers["thrust_limit"] * rng.choice([-1, 1], 4)
        errors = []
        for dt in (2e-4, 1e-4):
            rows = rows_at(plant_thrust_limit(nu, numbers, dt=dt, water=water, force=force))
            assert [r.name for r in rows] == ["thrust.Fu", "thrust.Fv", "thrust.Fw", "thrust.Fr"]
            bound = [r.upper if t > 0 else r.lower for r, t in zip(rows, tau, strict=True)]
            predicted = np.linalg.solve(np.array([r.a for r in rows]), bound)
            errors.append(np.abs(predicted - reached(nu, tau, p=p, d=d, psi=psi, dt=dt)).max())
        assert errors[1] < 2e-3 * np.abs(predicted - nu).max()
        assert 3.95 < errors[0] / errors[1] < 4.05


def test_needed_thrust_holds_the_velocity():
    p, numbers = parameters_of("sur540-flooded")
    nu = np.array([0.1, -0.1, 0.05, 0.3])
    tau = np.array(ca.DM(plant_thrust_limit(nu, numbers, dt=DT).needed(ca.SX(nu)))).reshape(-1)
    x = PLANT_STATE.pack({"nu": nu})
    assert np.abs(np.array(build_plant().ode(x, tau, PLANT_DISTURBANCE.pack(), p))[4:8]).max() < 1e-12


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: AccelerationLimit([0] * 4, [1, 1, -1, 1], dt=0.1), "acceleration: limit = -1.0: must be at least 0"),
        (lambda: AccelerationLimit([0] * 3, [1] * 4, dt=0.1), "acceleration: limit"),
        (lambda: AccelerationLimit([0, 0, 0, math.nan], [1] * 4, dt=0.1), "acceleration: nu"),
        (lambda: AccelerationLimit([0] * 4, [1] * 4, dt=0.0), "acceleration: dt = 0.0: must be greater than 0"),
        (lambda: thrust(lower=[2, 0, 0, 0]), "thrust.Fu"),
        (lambda: thrust(mass=[1, 1, 0, 1]), "thrust: mass = 0.0"),
        (lambda: thrust(mass=np.diag([1, 1, -1, 1.0])), "symmetric positive definite"),
        (lambda: thrust(mass=np.eye(4) + np.eye(4, k=1)), "symmetric positive definite"),
        (lambda: thrust(mass=[1, 1, 1]), "thrust: mass"),
        (lambda: thrust(load=[1, 1, 1, math.inf]), "thrust: load"),
        (lambda: thrust(name="two words"), "is not a limit name"),
        (lambda: plant_thrust_limit([0] * 4, {"mass": [1] * 4}, dt=0.1), "thrust: linear_drag: is missing"),
    ],
)
def test_bad_limits_are_refused_by_name(make, says):
    with pytest.raises(InputError) as caught:
        make()
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def thrust(**change):
    given = {"mass": [1] * 4, "load": [0] * 4, "lower": [-1] * 4, "upper": [1] * 4, "dt": 0.1}
    return ThrustLimit([0] * 4, **(given | change))
