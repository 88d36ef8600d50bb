"""Barriers: their rows against finite differences, and what they promise against simulated motion."""

import math
from functools import partial

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.priority import Level, Row, build_problem, solve
from surctl.tasks import Barrier, allowed_closing_speed
from tests.tasks.numbers import function, rows_at

ETA = ca.SX.sym("eta", 4)
WALL = 2.0 - ETA[0]
DISC = ca.norm_2(ETA[:2] - ca.DM([1.0, 0.5])) - 0.4
"""Clearance of a disc of radius 0.4 m: convex outside."""


def row_function(barrier, *symbols):
    """pose (and more) → (a (4,), upper), compiled once for a simulation."""
    (row,) = barrier.rows()
    f = ca.Function("row", [ETA, *symbols], [row.a, row.upper])

    def at(*values):
        a, upper = f(*values)
        return np.array(a).reshape(4), float(upper)

    return at


def body_to_world(psi):
    c, s = math.cos(psi), math.sin(psi)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def nearest_velocity(wanted, A, lower, upper):
    rows = [Row(f"row{i}", "actuator", *row) for i, row in enumerate(zip(A, lower, upper, strict=True))]
    go = Level("go", np.eye(len(wanted)), np.asarray(wanted))
    found = solve(build_problem([go], rows), mode="filter", backend="daqp")
    assert found.status == "optimal"
    return found.v


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_the_row_is_the_closing_speed(seed):
    rng = np.random.default_rng(seed)
    place, speed = ca.SX.sym("place", 2), ca.SX.sym("speed", 2)
    h = ca.norm_2(ETA[:2] - place) - 0.3 * ca.cos(ETA[3]) + 0.1 * ETA[2]
    drift = ca.dot(ca.jacobian(h, place).T, speed)
    (row,) = rows_at(
        Barrier("moving", ETA, h=h, alpha=0.7, drift=drift, kinematics="vehicle"),
        [ETA, place, speed],
        values := [
            rng.uniform(-2, 2, 4),
            rng.uniform(3, 5, 2),
            rng.uniform(-0.3, 0.3, 2),
        ],
    )
    eta, at, moves = values
    value, v, step = function(h, ETA, place), rng.uniform(-0.5, 0.5, 4), 1e-6
    rate = body_to_world(eta[3]) @ v
    ahead, behind = (float(value(eta + t * rate, at + t * moves)) for t in (step, -step))
    slack = (ahead - behind) / (2 * step) + 0.7 * float(value(eta, at))  # ḣ + α(h), which must not be negative
    assert row.upper - row.a @ v == pytest.approx(slack, abs=1e-8)
    assert (row.kind, row.name, row.lower) == ("barrier", "moving", -math.inf)


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1.0))
@settings(max_examples=6)
def test_a_velocity_held_over_each_step_keeps_a_convex_barrier(seed, share):
    """Sampled with gain·dt = share ≤ 1, at a constant heading: h never negative."""
    rng, dt = np.random.default_rng(seed), 0.05
    gain = share / dt
    at = row_function(Barrier("disc", ETA, h=DISC, alpha=gain, kinematics="vehicle"))
    value = function(DISC, ETA)
    angle = rng.uniform(-3, 3)
    eta = np.array([1.0, 0.5, 0, rng.uniform(-3, 3)])
    eta[:2] += (0.4 + rng.exponential(0.1)) * np.array([math.cos(angle), math.sin(angle)])
    wish = np.append(rng.normal(size=2) * 0.3, [0, 0])
    for _ in range(60):
        if rng.random() < 0.1:
            wish = np.append(rng.normal(size=2) * 0.3, [0, 0])
        a, upper = at(eta)
        v = nearest_velocity(body_to_world(eta[3]).T @ wish, [a], [-np.inf], [upper])
        eta = eta + dt * body_to_world(eta[3]) @ v
        assert float(value(eta)) >= -1e-12


def test_a_turning_vehicle_stays_within_the_stated_bound():
    """A yaw rate r turns v within the step: h ≥ −|r| ‖v‖ dt / (2 γ), and the bound is not idle."""
    dt, gain, r, speed = 0.05, 0.5, 1.0, 0.3
    at, value = row_function(Barrier("wall", ETA, h=WALL, alpha=gain, kinematics="vehicle")), function(WALL, ETA)
    eta, least, fastest = np.array([1.9, 0, 0, 0.0]), math.inf, 0.0
    for _ in range(1000):
        a, upper = at(eta)
        sweep = np.array([a[1], -a[0], 0, 0])  # along the wall, on the side from which turning points inwards
        v = nearest_velocity(speed * (sweep + a), [a], [-np.inf], [upper])
        fastest = max(fastest, float(np.linalg.norm(v)))
        c, s = math.cos(eta[3] + r * dt / 2), math.sin(eta[3] + r * dt / 2)  # the arc of one step, to O(dt³)
        eta = eta + dt * np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], 0, r])
        least = min(least, float(value(eta)))
    bound = r * fastest * dt / (2 * gain)
    assert -bound <= least < -0.5 * bound


def stopping(deceleration, reaction):
    return partial(allowed_closing_speed, deceleration=deceleration, reaction=reaction)


def braking_run(seed, h):
    """A double integrator in the plane: velocity moved by at most a·dt an axis and step, chosen by the rows."""
    rng, dt = np.random.default_rng(seed), 0.05
    a, psi = rng.uniform(0.05, 0.5), rng.uniform(-3, 3)
    reaction = 3 * dt
    barrier = Barrier("stop", ETA, h=h, alpha=stopping(a, reaction), kinematics="vehicle")
    at, value = row_function(barrier), function(h, ETA)
    R = body_to_world(psi)
    # a start that satisfies the stated relation: closing speed s with s²/(2a) + s(T − 2dt) ≤ h
    while True:
        eta = np.array([*rng.uniform(0, 2, 2), 0, psi])
        room = float(value(eta))
        if room < 0:
            continue
        nu = np.append(rng.normal(size=2) * 0.5, [0, 0])
        row, _ = at(eta)
        s = max(float(row @ nu), 0.0)
        if s * s / (2 * a) + s * (reaction - 2 * dt) <= room:
            break
    wish, least = np.append(rng.normal(size=2), [0, 0]), room
    for _ in range(80):
        if rng.random() < 0.05:
            wish = np.append(rng.normal(size=2), [0, 0])
        row, upper = at(eta)
        # as hard as it must be: a command that cannot be met in this step is approached as fast as it may
        upper = max(upper, float(row @ nu) - a * dt)
        A = np.vstack([row, np.eye(4)])
        v = nearest_velocity(wish, A, [-np.inf, *(nu - a * dt)], [upper, *(nu + a * dt)])
        for part in (0.25, 0.5, 0.75, 1.0):  # the velocity ramps from nu to v: look inside the step too
            least = min(least, float(value(eta + dt * R @ (part * nu + part**2 / 2 * (v - nu)))))
        eta, nu = eta + dt * R @ (nu + v) / 2, v
    return least


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=5)
def test_braking_before_a_wall_never_goes_through(seed):
    assert braking_run(seed, WALL) >= -1e-9


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=5)
def test_braking_around_a_disc_never_goes_through(seed):
    assert braking_run(seed, DISC) >= -1e-9


def test_a_plain_barrier_is_not_enough_for_a_vehicle_that_must_brake():
    """What the braking form is for: the same vehicle under the linear rule goes through the wall."""
    dt, a, gain = 0.05, 0.05, 1.0
    at, value = row_function(Barrier("wall", ETA, h=WALL, alpha=gain, kinematics="vehicle")), function(WALL, ETA)
    eta, nu = np.array([0.0, 0, 0, 0.0]), np.zeros(4)
    least = math.inf
    for _ in range(400):
        row, upper = at(eta)
        s = float(row @ nu)
        wanted = min(1.0, upper)
        nu = np.array([s + np.clip(wanted - s, -a * dt, a * dt), 0, 0, 0])
        eta = eta + dt * nu
        least = min(least, float(value(eta)))
    assert least < -0.1


def test_allowed_speed_is_continuous_and_lipschitz():
    h = ca.SX.sym("h")
    speed = function(stopping(0.2, 0.4)(h), h)
    at = np.linspace(-0.5, 2.0, 20001)
    values = np.array(speed(at.reshape(1, -1))).reshape(-1)
    slopes = np.diff(values) / np.diff(at)
    assert (slopes >= 0).all()
    assert slopes.max() <= 1 / 0.4 * (1 + 1e-9)
    assert values.min() == pytest.approx(-0.5 / 0.4)
    assert float(speed(0.0)) == pytest.approx(0.0, abs=1e-15)
    # from the allowed speed, reaction and braking take exactly h
    for distance in (0.01, 0.3, 1.7):
        s = float(speed(distance))
        assert s * 0.4 + s * s / (2 * 0.2) == pytest.approx(distance)


@pytest.mark.parametrize("alpha", [2.0, stopping(0.2, 0.5)], ids=["linear", "braking"])
def test_the_velocity_does_not_chatter_on_the_boundary(alpha):
    """Sliding along the disc towards a goal behind it: changes of v shrink in proportion to dt."""
    at, value = row_function(Barrier("disc", ETA, h=DISC, kinematics="vehicle", alpha=alpha)), function(DISC, ETA)
    jumps = []
    for dt in (0.08, 0.04, 0.02):
        eta, last, worst, touched = np.array([0.0, 0.45, 0, 0.3]), None, 0.0, False
        R = body_to_world(0.3)
        for k in range(round(12 / dt)):
            wish = np.append(0.5 * (np.array([2.2, 0.5]) - eta[:2]), [0, 0])
            a, upper = at(eta)
            v = nearest_velocity(R.T @ wish, [a], [-np.inf], [upper])
            touched = touched or float(a @ R.T @ wish) > upper + 1e-3
            if last is not None and k * dt > 0.5:
                worst = max(worst, float(np.linalg.norm(v - last)))
            last = v
            eta = eta + dt * R @ v
        assert touched
        assert float(value(eta)) > 0.2  # came around
        jumps.append(worst)
    assert jumps[0] / jumps[1] == pytest.approx(2.0, rel=0.15)
    assert jumps[1] / jumps[2] == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Barrier("deep", ETA, h=ca.SX.sym("z"), kinematics="vehicle"), "limit deep: h"),
        (lambda: Barrier("deep", ETA, h=ca.floor(ETA[2]), kinematics="vehicle"), "does not depend on eta"),
        (lambda: Barrier("deep", ETA, h=1.0, kinematics="vehicle"), "limit deep: h"),
        (lambda: Barrier("deep", 2 * ETA, h=ETA[0], kinematics="vehicle"), "limit deep: eta"),
        (lambda: Barrier("deep", ETA, h=ETA[:2], kinematics="vehicle"), "limit deep: h"),
        (lambda: Barrier("deep", ETA, h=ETA[2], alpha=-1.0, kinematics="vehicle"), "limit deep: alpha = -1.0"),
        (
            lambda: Barrier("deep", ETA, h=ETA[2], alpha=lambda s: s + 0.1, kinematics="vehicle"),
            "not of class K: alpha(-0.1",
        ),
        (
            lambda: Barrier("deep", ETA, h=ETA[2], alpha=lambda s: s**2, kinematics="vehicle"),
            "not of class K: alpha(-10)",
        ),
        (
            lambda: Barrier("deep", ETA, h=ETA[2], alpha=lambda s: s * ca.exp(-s), kinematics="vehicle"),
            "decreases between",
        ),
        (lambda: Barrier("deep", ETA, h=ETA[2], alpha=lambda s: s / 0, kinematics="vehicle"), "limit deep: alpha"),
        (lambda: Barrier("deep", ETA, h=ETA[2], drift=[1.0, 2.0], kinematics="vehicle"), "limit deep: drift"),
        (lambda: Barrier("deep", ETA, h=ETA[2], kind="wall", kinematics="vehicle"), "limit deep"),
        (lambda: Barrier("so deep", ETA, h=ETA[2], kinematics="vehicle"), "so deep"),
        (lambda: Barrier("deep", ETA, h=ETA[2], alpha=stopping(0.0, 1.0), kinematics="vehicle"), "not of class K"),
        (lambda: Barrier("deep", ETA, h=ETA[2], alpha=stopping(1.0, 0.0), kinematics="vehicle"), "deep: alpha"),
    ],
)
def test_bad_barriers_are_refused_by_name(make, says):
    with pytest.raises(InputError) as caught:
        make()
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_alpha_may_be_a_function_that_levels_off_and_may_hold_symbols():
    gain = ca.SX.sym("gain")
    s = ca.SX.sym("s")
    (row,) = rows_at(
        Barrier("deep", ETA, h=ETA[2], alpha=ca.Function("a", [s], [ca.fmin(s, 0.1)]), kinematics="vehicle"),
        [ETA],
        [[0, 0, 3, 0]],
    )
    assert row.upper == 0.1
    (row,) = rows_at(
        Barrier("deep", ETA, h=ETA[2], alpha=lambda h: gain * h**3, kinematics="vehicle"),
        [ETA, gain],
        [[0, 0, 2, 0], 0.25],
    )
    assert row.upper == 2.0
