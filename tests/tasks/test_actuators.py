"""Acceleration, thrust, and the box that gives way to what the thrust can reach."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.simulation.physics import advance
from surctl.marine.vehicle import (
    PLANT_DISTURBANCE,
    PLANT_PARAMETERS,
    PLANT_STATE,
    build_plant,
    load_vehicle,
    plant_parameters,
    plant_thrust_limit,
)
from surctl.priority import Level, build_problem, solve
from surctl.tasks import AccelerationLimit, ActuatorLimits, ThrustLimit, VelocityBox
from tests.tasks.numbers import function, missed, rows_at

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


def matrix(rng, diagonal):
    """A random M > 0 of the size of a vehicle's, condition up to 1e3."""
    scale = np.diag(np.sqrt(10 ** rng.uniform(0, 2, 4)))
    if diagonal:
        return scale @ scale
    Q, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    made = scale @ Q @ np.diag(10 ** rng.uniform(-0.5, 0.5, 4)) @ Q.T @ scale
    return (made + made.T) / 2


def limits(seed, *, diagonal, spread):
    """Random actuator limits about a random ν; spread 0 for a ν inside its box that the thrust can hold."""
    rng = np.random.default_rng(seed)
    upper, lower = rng.uniform(0.05, 0.5, 4), -rng.uniform(0.05, 0.5, 4)
    nu = rng.uniform(lower, upper) if spread == 0 else rng.normal(size=4) * spread
    most, least = rng.uniform(0.5, 20, 4), -rng.uniform(0.5, 20, 4)
    load = rng.uniform(least, most) if spread == 0 else rng.normal(size=4) * 30
    M = matrix(rng, diagonal)
    box = VelocityBox(lower, upper)
    thrust = ThrustLimit(nu, np.diag(M) if diagonal else M, load=load, lower=least, upper=most, dt=DT)
    return ActuatorLimits(box, thrust, AccelerationLimit(nu, rng.uniform(0.01, 2, 4), dt=DT)), nu, rng


@pytest.mark.parametrize("diagonal", [True, False])
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 1.0, 30.0]))
@settings(max_examples=12)
def test_the_rows_always_hold_a_velocity(diagonal, seed, spread):
    made, nu, rng = limits(seed, diagonal=diagonal, spread=spread)
    rows = rows_at(made)
    point = np.array(ca.DM(made.reachable())).reshape(-1)
    assert missed(rows, point) <= 1e-12 * (1 + np.abs(point).max() + np.abs(nu).max())
    task = Level("any", rng.normal(size=(2, 4)), rng.normal(size=2))
    found = solve(build_problem([task], rows), backend="daqp")
    assert found.status in ("optimal", "limited")  # never relaxed, never clamped
    assert missed(rows, found.v) < 1e-9 * (1 + np.abs(found.v).max())


@pytest.mark.parametrize("diagonal", [True, False])
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=12)
def test_nothing_changes_for_a_velocity_that_is_inside_and_can_be_held(diagonal, seed):
    made, nu, _ = limits(seed, diagonal=diagonal, spread=0)
    assert np.array_equal(np.array(ca.DM(made.reachable())).reshape(-1), nu)
    plain = [*rows_at(made.box), *rows_at(made.acceleration), *rows_at(made.thrust)]
    for widened, row in zip(rows_at(made), plain, strict=True):
        assert (widened.name, widened.lower, widened.upper) == (row.name, row.lower, row.upper)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 1.0]))
@settings(max_examples=12)
def test_for_a_diagonal_mass_the_box_widens_no_more_than_it_must(seed, spread):
    made, nu, _ = limits(seed, diagonal=True, spread=spread)
    box, acceleration = rows_at(made.box), rows_at(made.acceleration)
    widened = rows_at(made)
    for i, thrust in enumerate(rows_at(made.thrust)):
        low, high = thrust.lower / thrust.a[i], thrust.upper / thrust.a[i]  # per axis: T is an interval
        meets_a = max(low, acceleration[i].lower) <= min(high, acceleration[i].upper)
        if meets_a:
            low, high = max(low, acceleration[i].lower), min(high, acceleration[i].upper)
        gap = max(0.0, low - box[i].upper, box[i].lower - high)  # what any widened box must bridge
        wide = widened[i]
        grown = max(wide.upper - box[i].upper, box[i].lower - wide.lower)
        if meets_a:
            assert grown == pytest.approx(gap, abs=1e-12 * (1 + abs(nu[i])))


def test_the_widened_limits_bring_a_runaway_vehicle_back():
    """Commanding any velocity that the rows allow, the plant comes back into its box, as fast as the thrust can."""
    p, numbers = parameters_of("sur540-flooded")
    nu = ca.SX.sym("nu", 4)
    box = VelocityBox([-0.3, -0.3, -0.1, -0.4], [0.3, 0.3, 0.1, 0.4])
    made = ActuatorLimits(box, plant_thrust_limit(nu, numbers, dt=DT), AccelerationLimit(nu, [0.5] * 4, dt=DT))
    v = ca.SX.sym("v", 4)
    thrust_for = function(made.thrust.needed(v), nu, v)
    x = PLANT_STATE.pack({"nu": [1.0, -0.8, 0.5, 1.5]})
    task = Level("hurry", np.eye(4)[:2], np.array([2.0, -2.0]))  # asks for more speed, not less
    for _ in range(120):
        now = x[PLANT_STATE.slice("nu")]
        found = solve(build_problem([task], rows_at(made, [nu], [now])), backend="daqp")
        assert found.status in ("optimal", "limited")
        tau = np.array(thrust_for(now, found.v)).reshape(-1)
        assert (np.abs(tau) <= numbers["thrust_limit"] * (1 + 1e-9)).all()
        for _ in range(2):
            x = np.array(advance()(x, tau, PLANT_DISTURBANCE.pack(), p)).reshape(-1)
        if (np.abs(x[PLANT_STATE.slice("nu")]) <= np.array([0.3, 0.3, 0.1, 0.4]) - 1e-3).all():
            break
    assert (np.abs(x[PLANT_STATE.slice("nu")]) <= np.array([0.3, 0.3, 0.1, 0.4]) + 1e-3).all()


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
        (
            lambda: ActuatorLimits(BOX, thrust(), AccelerationLimit([0, 0, 0, 1], [1] * 4, dt=0.1)),
            "acceleration: has another nu than limit thrust",
        ),
        (
            lambda: ActuatorLimits(BOX, thrust(), AccelerationLimit([0] * 4, [1] * 4, dt=0.2)),
            "acceleration: has another dt",
        ),
        (lambda: ActuatorLimits(BOX, thrust(name="velocity")), "limit velocity: names two"),
    ],
)
def test_bad_limits_are_refused_by_name(make, says):
    with pytest.raises(InputError) as caught:
        make()
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


BOX = VelocityBox([-1] * 4, [1] * 4)


def thrust(**change):
    given = {"mass": [1] * 4, "load": [0] * 4, "lower": [-1] * 4, "upper": [1] * 4, "dt": 0.1}
    return ThrustLimit([0] * 4, **(given | change))
