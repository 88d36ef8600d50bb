"""Study 45: kinematics of robots against Pinocchio, and an arm on its way to drawn targets.

    python analysis/45_robots/run.py [--quick]

The comparison needs the packages pin and example-robot-data; without them, and with --quick, it is left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.robot import Robot, StackController, load_urdf

CONFIGURATIONS, PIECE, DT = 1000, 100, 0.01
JOINTS = (  # axis, offset from the joint before [m], lower and upper limit [rad], largest speed [rad/s]
    ("0 0 1", 0.2, -2.9, 2.9, 2.2),
    ("0 1 0", 0.14, -1.8, 1.8, 2.2),
    ("0 0 1", 0.2, -2.9, 2.9, 2.2),
    ("0 1 0", 0.2, -2.6, 0.2, 2.2),
    ("0 0 1", 0.2, -2.9, 2.9, 2.6),
    ("0 1 0", 0.19, -1.8, 1.8, 2.6),
    ("0 0 1", 0.09, -2.9, 2.9, 2.6),
)
CYLINDERS = {0: (0.15, 0.08), 3: (0.18, 0.06), 5: (0.12, 0.05), 7: (0.1, 0.04)}  # length and radius [m] by link
ACCELERATION, MARGIN = 15.0, 0.01


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="an arm with 2 joints, 5 targets, no comparison")
    quick = parser.parse_args().quick
    if quick or importlib.util.find_spec("pinocchio") is None:
        print("kinematics: not compared (needs pin and example-robot-data)\n")
    else:
        compare()
    reach(joints=JOINTS[1:4:2] if quick else JOINTS, targets=5 if quick else 100)


def compare() -> None:
    """Print the largest difference from Pinocchio for one URDF file of each robot."""
    from pinocchio_poses import folder_of_robots, poses

    print("| file | velocities | links | poses | Jacobians |\n|---|---|---|---|---|")
    first: dict[str, Path] = {}
    for path in sorted(folder_of_robots().rglob("*.urdf")):
        first.setdefault(path.relative_to(folder_of_robots()).parts[0], path)
    worst = 0.0
    for path in first.values():
        try:
            robot = load_urdf(path, base="floating")
        except InputError as error:
            print(f"| {path.name} | refused: {error.problem} | | | |")
            continue
        links = [name for name in robot.links if name != "world"]
        frames = [robot.frame(name) for name in links]
        places = ca.vertcat(*(ca.vertcat(f.position, ca.vec(f.rotation.T)) for f in frames))
        jacobians = ca.vertcat(*(ca.vec(f.jacobian.T) for f in frames))
        own = ca.Function("own", [robot.q], [ca.densify(places), ca.densify(jacobians)]).map(PIECE)
        q = np.random.default_rng(0).uniform(-3.0, 3.0, (CONFIGURATIONS, robot.nq))
        q[:, 3:7] /= np.sqrt((q[:, 3:7] ** 2).sum(axis=1, keepdims=True))
        errors = [0.0, 0.0]
        for start in range(0, CONFIGURATIONS, PIECE):
            ours = [np.array(part) for part in own(q[start : start + PIECE].T)]
            for k, theirs in enumerate(poses(robot, path, q[start : start + PIECE])):
                for i in range(2):
                    errors[i] = max(errors[i], float(abs(ours[i][:, k] - theirs[i].reshape(-1)).max()))
        worst = max(worst, *errors)
        print(f"| {path.name} | {robot.nv} | {len(links)} | {errors[0]:.1e} | {errors[1]:.1e} |", flush=True)
    print(f"\nlargest difference: {worst:.1e}\n")


def arm(joints: tuple[tuple[str, float, float, float, float], ...], path: Path) -> Robot:
    """Write the URDF file of the arm, and return the robot."""
    parts = ['<robot name="arm">']
    for k in range(len(joints) + 1):
        inside = ""
        if k in CYLINDERS:
            length, radius = CYLINDERS[k]
            shape = f'<cylinder radius="{radius}" length="{length}"/>'
            inside = f'<collision><origin xyz="0 0 {length / 2}"/><geometry>{shape}</geometry></collision>'
        parts.append(f'<link name="link{k}">{inside}</link>')
    for k, (axis, offset, lower, upper, speed) in enumerate(joints, 1):
        ends = f'<parent link="link{k - 1}"/><child link="link{k}"/><origin xyz="0 0 {offset}"/><axis xyz="{axis}"/>'
        limit = f'<limit lower="{lower}" upper="{upper}" velocity="{speed}"/>'
        parts.append(f'<joint name="joint{k}" type="revolute">{ends}{limit}</joint>')
    path.write_text("\n".join([*parts, "</robot>"]), encoding="utf-8")
    return load_urdf(path)


def reach(joints: tuple[tuple[str, float, float, float, float], ...], targets: int) -> None:
    """Print how well limits hold, and how near the arm comes to drawn targets."""
    with tempfile.TemporaryDirectory() as folder:
        robot = arm(joints, Path(folder, "arm.urdf"))
    tool = robot.frame_task(robot.links[-1], target="tool", gain=5.0, max_speed=0.3, max_rate=1.0)
    limits = [robot.joint_limits(acceleration=ACCELERATION)]
    gaps = ca.Function("gaps", [robot.q], [ca.SX(1.0)])
    if len(joints) > 2:
        barriers = robot.self_collision(margin=MARGIN)
        gaps = ca.Function("gaps", [robot.q], [ca.vertcat(*(barriers.distance(pair)[0] for pair in barriers.pairs))])
        limits.append(barriers)
    home = robot.posture_task("home", robot.neutral() + 0.5 * np.array([row[2] + row[3] for row in joints]) * 0.4)
    tasks = [tool.position, tool.orientation, home] if len(joints) > 2 else [tool.position, home]
    mode = "lexicographic" if len(joints) > 2 else "projected"
    control = StackController(tasks, limits=limits, dt=DT, mode=mode)
    draws = np.random.default_rng(45)
    ends = np.array([robot.range_of(place) for place in robot.coordinates])
    speeds = np.array([row[4] for row in joints])
    q, before, over = robot.neutral(), np.zeros(robot.nv), np.full(3, -np.inf)
    least, errors, stages = np.inf, [], {}
    for _ in range(targets):
        while True:
            goal = draws.uniform(ends[:, 0], ends[:, 1])
            if np.array(gaps(goal)).min() > 2 * MARGIN:
                break
        target = robot.pose(robot.links[-1], goal)
        for _ in range(400):
            v = control.step(q, tool=target)
            q, change, before = robot.integrate(q, v, DT), abs(v - before).max() / DT, v
            over = np.maximum(
                over,
                [max((ends[:, 0] - q).max(), (q - ends[:, 1]).max()), (abs(v) - speeds).max(), change - ACCELERATION],
            )
            least = min(least, float(np.array(gaps(q)).min()) - MARGIN)
            stages[control.stage] = stages.get(control.stage, 0) + 1
        errors.append(1e3 * float(np.linalg.norm(robot.pose(robot.links[-1], q)[:3, 3] - target[:3, 3])))
    reached = sum(error < 1.0 for error in errors)
    median = float(np.median(errors))
    print(f"targets at drawn configurations: {targets}, within 1 mm after 4 s: {reached}, median {median:.2g} mm")
    numbers = ", ".join(
        f"{name} {by:.1e}" for name, by in zip(("position", "speed", "acceleration"), over, strict=True)
    )
    print(f"beyond the limits at most (rad, s): {numbers}")
    if len(joints) > 2:
        print(f"least gap minus margin: {1e3 * least:.3f} mm")
    print("stages of the steps: " + ", ".join(f"{name} {count}" for name, count in sorted(stages.items())))


if __name__ == "__main__":
    main()
