"""Tasks: their Jacobians, references, and what is refused."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.tasks import (
    Task,
    clearance_task,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)
from surctl.tasks.task import wrap

ETA = ca.SX.sym("eta", 4)
POINT = (1.3, -0.4)
TASKS = [
    position_task(ETA, [1.0, 2.0]),
    position_task(ETA, [1.0, 2.0, -0.5]),
    depth_task(ETA, -0.15),
    heading_task(ETA, 0.7),
    velocity_task(ETA, [0.1, -0.2]),
    clearance_task(ETA, POINT, margin=0.4),
    distance_task(ETA, POINT, distance=0.5),
    line_of_sight_task(ETA, POINT),
    Task(name="own", eta=ETA, sigma=ca.vertcat(ETA[0] * ca.sin(ETA[3]), ETA[2] ** 2 + ETA[1]), kinematics="vehicle"),
]


def numeric(expression, *symbols):
    return ca.Function("f", list(symbols), [expression])


@pytest.mark.parametrize("task", TASKS, ids=lambda t: f"{t.name}{t.size}")
def test_jacobian_is_the_derivative_of_sigma_along_the_motion(task):
    sigma, jacobian = numeric(task.sigma, ETA), numeric(task.jacobian(), ETA)
    rng = np.random.default_rng(0)
    for _ in range(30):
        eta, nu = rng.uniform(-3, 3, 4), rng.uniform(-1, 1, 4)
        c, s = math.cos(eta[3]), math.sin(eta[3])
        rate = np.array([c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2], nu[3]])  # (1)-(2), written out
        h = 1e-6
        ahead, behind = np.array(sigma(eta + h * rate)), np.array(sigma(eta - h * rate))
        change = ahead - behind
        if task.angular:
            change = np.arctan2(np.sin(change), np.cos(change))
        assert np.abs(change[:, 0] / (2 * h) - np.array(jacobian(eta)) @ nu).max() < 1e-6


def test_clearance_jacobian_is_the_papers():
    jacobian = numeric(clearance_task(ETA, POINT, margin=0.4).jacobian(), ETA)
    eta = np.array([0.2, 0.1, -0.15, 0.6])
    angle = math.atan2(POINT[1] - eta[1], POINT[0] - eta[0]) - eta[3]
    assert np.allclose(np.array(jacobian(eta)), [[-math.cos(angle), -math.sin(angle), 0, 0]], atol=1e-14)


@pytest.mark.parametrize(
    "make", [lambda e: clearance_task(e, POINT, margin=0.4), lambda e: line_of_sight_task(e, POINT)]
)
def test_a_point_underneath_the_robot_gives_no_nan(make):
    task = make(ETA)
    at = np.array([*POINT, 0.0, 0.3])
    assert np.isfinite(np.array(numeric(task.jacobian(), ETA)(at))).all()
    assert np.isfinite(np.array(numeric(task.reference(), ETA)(at))).all()


def test_reference_is_rate_plus_gain_times_error():
    task = position_task(ETA, [1.0, 2.0], rate=[0.1, 0.2], gain=[0.5, 2.0])
    x = np.array(numeric(task.reference(), ETA)([0.4, 0.5, 0, 0])).ravel()
    assert np.allclose(x, [0.1 + 0.5 * 0.6, 0.2 + 2.0 * 1.5], atol=1e-15)


def test_velocity_task_asks_for_the_world_velocity_alone():
    gain = ca.SX.sym("v", 2)
    task = velocity_task(ETA, gain)
    assert not ca.depends_on(task.reference(), ETA)
    body = np.linalg.solve(np.array(numeric(task.jacobian(), ETA)([0, 0, 0, math.pi / 2]))[:, :2], [1.0, 0.0])
    assert np.allclose(body, [0.0, -1.0], atol=1e-15)  # facing y, the world's x is to starboard


def test_heading_turns_the_short_way():
    x = numeric(heading_task(ETA, 3.0).reference(), ETA)
    assert float(x([0, 0, 0, -3.0])) == pytest.approx(6.0 - 2 * math.pi, abs=1e-15)


@given(st.floats(-1e4, 1e4) | st.integers(-99, 99).map(lambda k: k * math.pi))
def test_wrap_stays_in_the_half_open_turn(angle):
    a = ca.SX.sym("a")
    for near in (angle, math.nextafter(angle, math.inf), math.nextafter(angle, -math.inf)):
        wrapped = float(ca.Function("w", [a], [wrap(a)])(near))
        assert -math.pi < wrapped <= math.pi
        assert math.cos(wrapped - near) == pytest.approx(1.0, abs=1e-12)


def test_wrap_is_exact_at_both_ends():
    a = ca.SX.sym("a")
    f = ca.Function("w", [a], [wrap(a)])
    assert float(f(math.pi)) == math.pi
    assert float(f(-math.pi)) == math.pi


def test_symbols_beside_eta_are_held_fixed():
    echo = ca.SX.sym("echo", 2)
    task = clearance_task(ETA, echo, margin=0.4)
    assert task.jacobian().shape == (1, 4)
    assert ca.depends_on(task.jacobian(), echo)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"name": "two words"}, "two words"),
        ({"name": "größe"}, "größe"),
        ({"eta": ca.SX.sym("eta", 3)}, "eta"),
        ({"eta": 2 * ETA}, "eta"),
        ({"sigma": ca.SX.sym("other")}, "does not depend on eta"),
        ({"sigma": ca.repmat(ETA[:2], 1, 2)}, "wrong shape"),
        ({"target": [1.0, 2.0, 3.0]}, "target"),
        ({"target": math.nan}, "target"),
        ({"rate": [0.0, math.inf]}, "rate"),
        ({"gain": 0.0}, "greater than 0"),
        ({"gain": [1.0, -2.0]}, "-2.0"),
        ({"target": "far"}, "target"),
        ({"target": np.eye(2)}, "target"),
    ],
)
def test_bad_tasks_are_refused_by_name(change, says):
    good = {"name": "reach", "eta": ETA, "sigma": ETA[:2], "kinematics": "vehicle"}
    with pytest.raises(InputError) as caught:
        Task(**(good | change))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    if "name" not in change:
        assert "reach" in str(caught.value)


def test_library_refuses_wrong_shapes_by_name():
    with pytest.raises(InputError, match="task clearance: echo_point"):
        clearance_task(ETA, [1.0, 2.0, 3.0], margin=0.1)
    with pytest.raises(InputError, match="task distance: distance"):
        distance_task(ETA, POINT, distance=[1.0, 2.0])
