"""Limits of joints and distances of links."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from surctl.errors import InputError
from surctl.robot import Capsule, StackController, load_urdf
from surctl.robot.limits import stopping_speed
from surctl.robot.urdf import closest_points
from tests.robot.robots import ARM, joint, link, written

_DISTANCE, _RATE, _PERIOD = ca.SX.sym("d"), ca.SX.sym("a"), ca.SX.sym("dt")
SPEED = ca.Function("speed", [_DISTANCE, _RATE, _PERIOD], [stopping_speed(_DISTANCE, _RATE, _PERIOD)])


def test_a_joint_at_the_stopping_speed_stops_before_its_limit() -> None:
    draws = np.random.default_rng(0)
    acceleration, dt = draws.uniform(0.1, 100.0, (1, 500)), draws.uniform(1e-3, 0.1, (1, 500))
    change = acceleration * dt
    distance = draws.uniform(0.0, 50.0, (1, 500)) ** 2 * change * dt / 2.0
    speed = draws.choice([0.3, 1.0, 1.0], (1, 500)) * np.array(SPEED(distance, acceleration, dt))
    for _ in range(60):
        distance = distance - dt * speed
        assert distance.min() >= -1e-12
        allowed = np.array(SPEED(distance, acceleration, dt))
        assert (allowed >= speed - change - 1e-9 * (1.0 + speed)).all()  # braking is always enough
        speed = np.minimum(speed + change, allowed)


def test_no_faster_speed_would_do() -> None:
    """From a speed above by one part in 1,000 and braking in every step, the joint passes its limit."""
    acceleration, dt = 10.0, 0.01
    for braking in (4, 17, 60):  # steps; the bound is the least one at whole multiples of a dt, minus half of it
        speed = (braking - 0.5) * acceleration * dt
        distance = (speed + 0.5 * acceleration * dt) ** 2 / (2.0 * acceleration)
        assert float(SPEED(distance, acceleration, dt)) == pytest.approx(speed)
        fast = 1.01 * speed
        while fast > 0.0:
            distance -= dt * fast
            fast -= acceleration * dt
        assert distance < 0.0


def test_limits_that_a_file_does_not_state_are_not_guessed(tmp_path: Path) -> None:
    ends = link("a") + link("b")
    for limit, arguments, problem in (
        ('lower="-1" upper="1"', {}, "joint j: has no velocity limit"),
        ('lower="-1" velocity="1"', {}, "joint j: has no upper limit"),
        ('lower="-1" upper="1" velocity="1"', {"acceleration": {"k": 1.0}}, "acceleration = 'k': no such joint"),
        ('lower="-1" upper="1" velocity="1"', {"acceleration": 0.0}, "acceleration: j = 0.0: must be greater than 0"),
        ('lower="-1" upper="1" velocity="0"', {}, "joint j: velocity = 0.0"),
    ):
        robot = load_urdf(written(tmp_path, ends, joint("j", "a", "b", limit=limit)))
        with pytest.raises(InputError) as caught:
            robot.joint_limits(**arguments)
        assert problem in str(caught.value)


@pytest.mark.parametrize("lengths", [(0.0, 0.0), (0.0, 1.2), (0.8, 0.0), (0.8, 1.2)])
def test_the_closest_points_are_those_of_a_search(lengths: tuple[float, float]) -> None:
    draws = np.random.default_rng(3)
    ends = [ca.SX.sym(name, 3) for name in ("p", "u", "o", "w")]
    both = ca.Function("both", ends, list(closest_points(*ends, lengths)))
    for k in range(10):
        start, other = draws.normal(size=(2, 3))
        along, beside = (size * (w := draws.normal(size=3)) / np.sqrt(w @ w) for size in lengths)
        if k >= 8:
            beside = -along * lengths[1] / max(lengths[0], 1e-9)  # parallel
        first, second = (np.array(point)[:, 0] for point in both(start, along, other, beside))
        between = lambda s: start + s[0] * along - other - s[1] * beside  # noqa: B023, E731
        best = min(
            (minimize(lambda s: between(s) @ between(s), at, bounds=[(0, 1)] * 2, tol=1e-15).fun for at in np.eye(2)),  # noqa: B023
        )
        assert (first - second) @ (first - second) == pytest.approx(best, abs=1e-8)


def test_the_gap_falls_at_the_rate_of_its_row(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM), base="floating")
    barriers = robot.self_collision(margin=0.02, gain=3.0)
    assert [(pair[0], pair[2]) for pair in barriers.pairs] == [("base", "link2"), ("base", "link3"), ("link1", "link3")]
    draws, h = np.random.default_rng(4), 1e-6
    for pair, row in zip(barriers.pairs, barriers.rows(), strict=True):
        distance, _ = barriers.distance(pair)
        gap = ca.Function("gap", [robot.q, robot.v, robot.dt], [distance, -row.a, row.upper])
        q, v = robot.integrate(robot.neutral(), draws.normal(size=robot.nv), 1.0), draws.normal(size=robot.nv)
        ends = [float(gap(robot.integrate(q, v, by), 0, 1)[0]) for by in (h, -h)]
        value, slope, upper = map(np.array, gap(q, 0, 0.02))
        assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(float(slope[0] @ v), abs=1e-7)
        assert upper.item() == pytest.approx(3.0 * (value.item() - 0.02))
        assert abs(slope[0, :6]).max() < 1e-15  # the base moves both links


def test_a_distance_that_curves_obeys_its_inequality_after_the_period(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM))
    barriers = robot.self_collision(margin=0.02, gain=3.0)
    draws, dt, losses = np.random.default_rng(4), 0.02, []
    for pair, row in zip(barriers.pairs, barriers.rows(), strict=True):
        gap = ca.Function("gap", [robot.q, robot.v, robot.dt], [barriers.distance(pair)[0], -row.a, row.upper])
        for _ in range(20):
            q, v = draws.uniform(-2.0, 2.0, 3), draws.uniform(-2.0, 2.0, 3)
            value, slope, upper = map(np.array, gap(q, 0, dt))
            loss = min(0.0, float(gap(robot.integrate(q, v, dt), 0, dt)[0]) - (value + dt * (slope @ v)).item())
            assert float(gap(q, v, dt)[2]) == pytest.approx(upper.item() + loss / dt, abs=1e-9)
            losses.append(loss)
    assert min(losses) < -1e-5


def test_an_srdf_file_disables_pairs_and_meshes_need_shapes(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM))
    srdf = written(tmp_path, '<disable_collisions link1="link3" link2="base" reason="Never"/>', name="arm.srdf")
    assert [(pair[0], pair[2]) for pair in robot.self_collision(srdf).pairs] == [("base", "link2"), ("link1", "link3")]
    wrong = written(tmp_path, '<disable_collisions link1="link9" link2="base"/>', name="wrong.srdf")
    with pytest.raises(InputError, match=r"wrong\.srdf: disable_collisions = 'link9'"):
        robot.self_collision(wrong)
    mesh = "<collision><geometry><mesh filename='a.stl'/></geometry></collision>"
    with_mesh = load_urdf(written(tmp_path, *ARM, link("tip", mesh), joint("tip", "link3", "tip", "fixed")))
    with pytest.raises(InputError, match="link tip: has a collision mesh"):
        with_mesh.self_collision()
    ball = Capsule([0.1, 0, 0], [0.1, 0, 0], 0.02)
    pairs = [(pair[0], pair[2]) for pair in with_mesh.self_collision(shapes={"tip": [ball]}).pairs]
    assert ("base", "tip") in pairs and ("link2", "tip") not in pairs  # link2 is the neighbour of its rigid body
    with pytest.raises(
        InputError, match=r'links base, link2: are less than the margin .* <disable_collisions link1="base"'
    ):
        robot.self_collision(shapes={"base": [Capsule((-1, 0, 0), (1, 0, 0), 2.0)], "link2": [ball], "link3": []})
    with pytest.raises(InputError, match="has no pair of links"):
        load_urdf(written(tmp_path, *ARM), lock=["elbow", "wrist"]).self_collision()


def test_a_start_beyond_the_limits_brakes_with_the_acceleration(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM), lock=["elbow", "wrist"])
    limits = robot.joint_limits(acceleration=4.0)
    [row] = limits.rows()
    bounds = ca.Function("bounds", [robot.q, robot.v, robot.dt], [row.lower, row.upper])
    assert [float(b) for b in bounds(2.4, 2.0, 0.1)] == pytest.approx([1.6, 1.6])  # too fast: it brakes
    lower, upper = (float(b) for b in bounds(2.7, 0.0, 0.1))  # beyond the limit: it returns
    assert lower == pytest.approx(-0.4) and upper == pytest.approx(-0.4)
    assert StackController([robot.posture_task("home")], limits=[limits], dt=0.1, mode="nsb").controller.state.size == 1
