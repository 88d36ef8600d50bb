"""A stack as a controller: steps, closed loops, margins and C."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import replay
from surctl.robot import Robot, StackController, load_urdf
from surctl.robot.robot import flat_pose
from surctl.system import NONFINITE, linearise, run_system
from surctl.system.linear import unresponsive
from surctl.tasks import SetTask, Task
from tests.robot.robots import ARM, joint, link, written
from tests.tools import need_compiler

ACCELERATION, DT = 8.0, 0.02


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return load_urdf(written(tmp_path_factory.mktemp("arm"), *ARM), lock=["wrist"])


@pytest.fixture(scope="module")
def control(arm: Robot) -> StackController:
    need_compiler()
    tool = arm.frame_task("link3", target="tool", gain=8.0, max_speed=1.5)
    reach = SetTask(
        name="height", eta=arm.q, sigma=arm.frame("link3").position[1], lower=-0.6, upper=np.inf,
        kinematics=arm.rate_map,
    )  # fmt: skip
    return StackController(
        [tool.position, reach, arm.posture_task("home", {"elbow": 1.0})],
        limits=[arm.joint_limits(acceleration=ACCELERATION), arm.self_collision(margin=0.05)],
        dt=DT,
        mode="projected",
    )


def test_limits_hold_on_the_way_to_drawn_targets(arm: Robot, control: StackController) -> None:
    draws, q, before = np.random.default_rng(5), np.array([0.2, 1.0]), np.zeros(2)
    gap = ca.Function("gap", [arm.q], [arm.self_collision().distance(pair)[0] for pair in arm.self_collision().pairs])
    control.reset()
    reached = 0
    for _ in range(8):
        goal = draws.uniform([-1.0, 0.4], [1.0, 1.8])
        target = arm.pose("link3", goal) if draws.random() < 0.7 else np.array([*draws.normal(size=2), 0, 0, 0, 0, 1])
        for _ in range(100):
            v = control.step(q, tool=target)
            assert abs(v - before).max() <= ACCELERATION * DT + 1e-12 and abs(v).max() <= 2.0
            q, before = arm.integrate(q, v, DT), v
            assert abs(q).max() <= 2.5 + 1e-12
            assert min(float(value) for value in gap(q)) > 0.05 - 1e-4
        reached += np.size(target) == 16 and abs(arm.pose("link3", q)[:3, 3] - target[:3, 3]).max() < 1e-4
    assert reached >= 3


def test_a_step_says_what_binds_and_what_it_costs(arm: Robot, control: StackController) -> None:
    control.reset()
    v = control.step([0.2, 1.0], tool=[9, 0, 0, 0, 0, 0, 1])
    assert control.stage == "limited" and set(control.binding()) == {"joint.shoulder", "joint.elbow"}
    assert "tool_position" in control.explain()
    assert control.solution().v == pytest.approx(v)
    free = control.step([0.2, 1.0], tool=arm.pose("link3", [0.2, 1.0]), home=[0.2, 1.0])
    assert abs(free).max() <= 2 * ACCELERATION * DT


@pytest.mark.parametrize(
    ("q", "before", "shoulder"),
    [
        (0.2, 0.0, "upper acceleration limit 8 rad/s²"),
        (0.2, 1.95, "upper speed limit 2 rad/s"),
        (2.4, 1.2, "upper position limit 2.5 rad"),
        (2.4, 1.9, "lower acceleration limit -8 rad/s²"),  # too fast: it brakes as fast as it may
    ],
)
def test_a_bound_of_a_joint_is_that_of_its_position_speed_or_acceleration(
    arm: Robot, q: float, before: float, shoulder: str
) -> None:
    need_compiler()
    limits = [arm.joint_limits(acceleration=ACCELERATION)]
    control = StackController([arm.posture_task("home", gain=9.0)], limits=limits, dt=DT, mode="projected")
    control.reset([before, 0.0])
    control.step([q, 0.5], home=[9.0, 0.5])
    assert control.binding()["joint.shoulder"] == shoulder
    assert f"`joint.shoulder` ({shoulder})" in control.explain()


@pytest.mark.parametrize("beyond", [[1.5, 0.6], [0.05, 1.4], [-0.8, 0.9]])
def test_a_damped_arm_rests_at_the_point_nearest_to_a_target_out_of_reach(arm: Robot, beyond: list[float]) -> None:
    need_compiler()
    tool = arm.frame_task("link3", target="tool", gain=8.0, max_speed=1.5).position
    limits, c = [arm.joint_limits(acceleration=ACCELERATION)], 0.1
    damped, strict = (
        StackController([tool, arm.posture_task("home")], limits=limits, dt=DT, damping=by) for by in (c, 0.0)
    )
    far, target = float(np.linalg.norm(beyond)), [*beyond, 0, 0, 0, 0, 1]
    short = {}
    for control in (damped, strict):
        q, speeds = np.array([0.2, 1.0]), []
        for _ in range(400):
            v = control.step(q, tool=target)
            q = arm.integrate(q, v, DT)
            speeds.append(v)
        short[control] = float(np.linalg.norm(arm.pose("link3", q)[:2, 3] - beyond)) - (far - 1.0)
        if control is damped:
            assert short[control] < 1e-6 and np.ptp(speeds[-50:], axis=0).max() < 1e-3
            assert control.stage == "limited" and not control.binding(), "no limit, but the reach of the arm"
    assert short[strict] > 1e-4
    # close to the stretched arm, at rest: the bound of the damping
    for bend in (1e-2, 1e-5, 1e-9, 0.0):
        damped.reset()
        heading = np.arctan2(beyond[1], beyond[0]) + 0.5
        v = damped.step([heading, bend], tool=target)
        assert np.linalg.norm(v) <= np.sqrt(1.5 / c) + 1e-9


def test_tasks_below_one_out_of_reach_are_damped_by_what_it_misses(tmp_path: Path) -> None:
    need_compiler()
    links = ("base", *(f"link{k}" for k in range(1, 6)), "tip")
    limit = 'lower="-2.5" upper="2.5" velocity="2"'
    joints = [
        joint(f"j{k}", links[k - 1], links[k], xyz=(0.3 * (k > 1), 0, 0), axis=(0, 1 - k % 2, k % 2), limit=limit)
        for k in range(1, 6)
    ]
    tip = joint("tip", links[5], "tip", "fixed", xyz=(0.3, 0, 0))
    arm = load_urdf(written(tmp_path, *map(link, links), *joints, tip))
    tool = arm.frame_task("tip", target="tool", gain=5.0, max_speed=0.3, max_rate=1.0)
    limits = [arm.joint_limits(acceleration=ACCELERATION)]
    control = StackController(
        [tool.position, tool.orientation, arm.posture_task("home", [0.5] * 5, gain=5.0)],
        limits=limits, dt=DT, damping=0.05,
    )  # fmt: skip
    q, apart, stages = np.array([0.3, 0.8, -0.4, 0.5, 0.2]), [], []
    target = arm.pose("tip", [-0.5] * 5)
    target[:3, 3] = [2.25, 0.5, 0.3]
    for _ in range(750):
        q = arm.integrate(q, control.step(q, tool=target), DT)
        apart.append(np.linalg.norm(arm.pose("tip", q)[:3, 3] - target[:3, 3]))
        stages.append(control.stage)
    assert "met" in stages and set(stages[-100:]) == {"limited"}
    assert np.ptp(apart[-100:]) < 6e-5, "damped by its own desired rate alone: 1.4e-4"


@pytest.mark.parametrize("angle", [1e-1, 1e-3, 1e-6, 1e-9, 0.0])
def test_damping_bounds_each_task_and_keeps_the_tasks_above(arm: Robot, angle: float) -> None:
    need_compiler()
    c, q = 0.05, [0.3, angle - 0.3]  # the second link lies along x, so the elbow moves the tool across x alone
    turn = Task(name="turn", eta=arm.q, sigma=arm.q[0], target=0.4, unit="rad", kinematics=arm.rate_map)
    x = arm.frame("link3").position[0]
    along = Task(name="along", eta=arm.q, sigma=x, target=2.0, gain=0.5, unit="m", kinematics=arm.rate_map)
    near = SetTask(name="near", eta=arm.q, sigma=arm.q[1], lower=-2.0, upper=1.0, kinematics=arm.rate_map)
    v = StackController([near, turn, along], limits=[arm.joint_limits(velocity=1e3)], dt=DT, damping=c).step(q)
    J, rate = np.array(ca.Function("J", [arm.q], [ca.jacobian(x, arm.q)])(q)), 0.5 * (2.0 - arm.pose("link3", q)[0, 3])
    first = np.array([0.1 / (1.0 + c * 0.1), 0.0])
    missing = abs(rate - J @ first).item()
    assert abs(v[0] - first[0]) < 2e-6
    assert v @ v <= first @ first + missing**2 / (c * rate) + 1e-3
    size = np.hypot(rate, 10.0 * 0.1)  # at rest, the last v missed the whole desired rate of `turn`
    free = (c * size + J[0, 1] ** 2) * v[1] - J[0, 1] * (rate - J[0, 0] * v[0])
    assert abs(free) < 1e-5, "v minimises ‖J v − x‖² + c √(‖x‖² + 100 m²) ‖v‖²"


def test_nan_never_becomes_a_command(arm: Robot, control: StackController) -> None:
    control.reset([0.1, 0.0])
    for q, target in (([np.nan, 0], [0] * 6 + [1]), ([0, 1.0], [np.inf] + [0] * 5 + [1])):
        assert control.step(q, tool=target).tolist() == [0.0, 0.0]
    assert (
        control.controller.step([np.nan, 0.0], [0, 1.0] + [0] * 6 + [1], control.controller.gains.pack()).status
        == NONFINITE
    )


def test_a_mistake_gives_one_line(arm: Robot, control: StackController) -> None:
    other = load_urdf(arm.urdf.path)
    posture = arm.posture_task("home")
    for call, problem in (
        (lambda: control.step([0, 0]), "tool: is missing"),
        (lambda: control.step([0, 0], tol=[0] * 7), "tol: is no target or gain of the controller; did you mean 'tool'"),
        (lambda: control.step([0, 0], tool=[0] * 6), "tool: has 6 numbers"),
        (lambda: control.step([0, 0], tool=np.ones((4, 4))), "is not a pose"),
        (lambda: StackController([posture, other.posture_task("two")], dt=0.1), "are of different robots"),
        (lambda: StackController([posture, arm.com_task("home")], dt=0.1), "is the name of two inputs"),
        (lambda: StackController([posture], dt=0.0, mode="nsb"), "is not a control period"),
        (lambda: StackController([arm.frame_task("link3", target="tool")], dt=0.1), "take .position and .orientation"),
        (lambda: StackController(posture, dt=0.1), "tasks = 'RobotTask': is not a list; write [task]"),
        (lambda: StackController([posture], limits=arm.joint_limits(), dt=0.1), "is not a list; write [limit]"),
        (lambda: StackController([posture], dt=0.1, damping=-1.0), "damping = -1.0"),
        (lambda: StackController([posture], dt=0.1, damping=0.1, mode="nsb"), "mode = 'nsb': has no damping"),
        (lambda: StackController([posture], dt=0.1, budget=True), "budget = True: is not a whole number"),
        (lambda: StackController([posture], dt=0.1, budget=2**31), "budget = 2147483648: is too large; give less than"),
        (lambda: StackController([posture], dt=0.1, budget=9, mode="nsb"), "mode = 'nsb': has no budget"),
        (lambda: arm.frame_task("link9", target="tool"), "is not the name of a link"),
        (lambda: arm.frame_task("link3", target="my tool"), "is not a name for a target"),
        (lambda: arm.frame_task("link3", target="tool", gain=-1.0), "tool_gain = -1.0"),
        (lambda: arm.look_at_task("link3", target="point", axis=(0, 0, 0)), "is not a direction"),
        (lambda: StackController([posture], dt=0.1, mode="nsb").explain(), "has made no step"),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert problem in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_a_loop_with_it_is_linearised_through_the_loops_of_the_solver(arm: Robot, damping: float) -> None:
    q, gain = [0.3, 0.8], 3.0
    tool = arm.frame_task("link3", target="tool", gain=gain, max_speed=0.5).position
    control = StackController([tool], limits=[arm.joint_limits(acceleration=ACCELERATION)], dt=DT, damping=damping)
    pose = flat_pose(arm.pose("link3", q))
    loop = linearise(control.system(), {"start.q": [q], "reference.tool": pose[None]})
    assert sorted(abs(np.asarray(loop.poles())))[-2:] == pytest.approx([1 - gain * DT] * 2, rel=1e-3)
    moved = [
        (arm.pose("link3", np.array(q) + h) - arm.pose("link3", np.array(q) - h))[:2, 3] / 2e-6
        for h in np.eye(2) * 1e-6
    ]
    by_joints, by_target = np.asarray(loop.law[1]), np.asarray(loop.law[2])
    np.testing.assert_allclose(by_target[:, :2] @ np.transpose(moved), -by_joints, atol=1e-6)
    assert np.abs(by_target).max() > gain
    assert unresponsive(run_system(control.system(), 0.2)) == {"v[0]": 0.0, "v[1]": 0.0}


def test_a_budget_is_the_bound_of_a_step_and_one_that_suffices_is_named(arm: Robot) -> None:
    need_compiler()
    limits, draws = [arm.joint_limits(acceleration=ACCELERATION)], np.random.default_rng(7)
    tool, build = arm.frame_task("link3", target="tool").position, partial(StackController, limits=limits, dt=DT)
    with pytest.raises(InputError, match=r"is too small; give .* such as .*, which suffices") as caught:
        build([tool], budget=9)
    least, useful = map(int, re.findall(r"\d{2,}", str(caught.value)))
    block, short = build([tool], budget=useful).controller.block, build([tool], budget=least)
    assert block.operations == useful
    for _ in range(5):
        target = flat_pose(arm.pose("link3", draws.uniform(-1.5, 1.5, 2)))
        v, _, status, _ = replay(block, np.zeros(2), [*draws.uniform(-2.5, 2.5, 2), *target], [1.0])
        assert v.any() and status == 0.0
    assert not short.step([0.3, 0.8], tool=arm.pose("link3", [0.4, 1.0])).any()
    assert short.stage == "unconfirmed" and f"raise it: {useful} suffices" in short.explain()


def test_it_is_the_controller_of_a_system(arm: Robot, control: StackController) -> None:
    system = control.system()
    goal = [0.4, 1.3]
    pose = np.append(arm.pose("link3", goal)[:3, 3], [0, 0, 0, 1])
    run = run_system(system, 2.0, {"start.q": [[0.2, 1.0]], "reference.tool": pose[None]})
    assert run["q"][-1] == pytest.approx(goal, abs=1e-4) and (run.status == 0).all()
    assert run["tool_position"] == pytest.approx(np.linalg.norm(arm.pose("link3", run["q"][-1])[:3, 3] - pose[:3]))
    assert run["height"] == 0.0 and run["home_posture"] == pytest.approx(np.hypot(0.4, 0.3), abs=1e-4)


def test_its_c_code_computes_the_same_bytes(arm: Robot, tmp_path: Path) -> None:
    need_compiler()
    control = StackController([arm.frame_task("link3", target="tool").position], dt=DT, mode="nsb")
    report = control.export(tmp_path / "firmware", target="gcc-O0", name="arm_law")
    assert report.passed and report.builds[0].differing == 0
    readme = (tmp_path / "firmware" / "README.md").read_text(encoding="utf-8")
    assert "input.tool[0] = 1.0;" in readme and "input.tool[6] = 1.0;" in readme


def test_each_task_converges(tmp_path: Path) -> None:
    """Orientation, centre of mass, a frame relative to another, and the direction to a point."""
    need_compiler()
    turned = (
        *ARM,
        link("camera"),
        joint("pan", "link3", "camera", axis=(0, 1, 0), limit='lower="-3" upper="3" velocity="2"'),
    )
    robot = load_urdf(written(tmp_path, *turned))
    start = np.array([0.1, 0.8, -0.5, 0.2])
    look = robot.look_at_task("camera", target="point", gain=4.0)
    relative = robot.frame_task("camera", target="pose", relative_to="link1", gain=4.0)
    turn = robot.frame_task("camera", target="turn", gain=4.0, max_rate=1.0)
    goal = np.array([0.5, 0.4, 0.9, -0.6])
    pose, base = robot.pose("camera", goal), robot.pose("link1", goal)
    centre = ca.Function("centre", [robot.q], [robot.centre_of_mass[0]])
    for task, values in (
        (look, {"point": (pose @ [2.0, 0, 0, 1])[:3]}),
        (relative.position, {"pose": np.linalg.inv(base) @ pose}),
        (relative.orientation, {"pose": np.linalg.inv(base) @ pose}),
        (turn.orientation, {"turn": pose}),
        (robot.com_task("com", gain=4.0), {"com": np.array(centre(goal))[:, 0]}),
    ):
        control, q = StackController([task], dt=0.05, mode="nsb"), start
        errors = []
        for _ in range(90):
            q = robot.integrate(q, control.step(q, **values), 0.05)
            errors.append(control.solution().residuals[task.name])
        assert errors[-1] < 1e-5 * max(errors[0], 1.0)
