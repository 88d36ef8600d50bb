"""Study 45: kinematics of robots against Pinocchio, and robots on their way to drawn targets, beside pink and mink.

    python analysis/45_robots/run.py [--quick] [--only TABLE]

The full run needs the packages pin, pin-pink, mink and example-robot-data; --quick does without.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
from reach import Run, Target, drawn_targets, judge, reach
from robots import CASES, DAMPING, QUICK, Case, Subject, folder_of_robots, subject

from surctl.errors import InputError
from surctl.robot import Robot, load_urdf

CONFIGURATIONS, PIECE = 1000, 100
TABLES = ("kinematics", *(case.name.split(",")[0] for case in CASES), "peers")
COLUMNS = (
    "robot", "rate Hz", "who", "drawn motions: reached, local, short", "beyond: reached, local, short", "position",
    "speed", "acceleration", "gap − margin mm", "median error mm", "statuses of the steps", "µs median, p99",
)  # fmt: skip
SURCTL, UNDAMPED, PINK, MINK = "surctl", "surctl, damping 0", "pink", "mink"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="an arm with 2 joints, 5 targets, no comparison")
    parser.add_argument("--only", choices=TABLES, help="one table alone")
    options = parser.parse_args()
    if options.only in (None, "kinematics") and not options.quick:
        compare()
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for case, rate, who, count in _rows(options.only, quick=options.quick):
        with tempfile.TemporaryDirectory() as folder:
            print(row(subject(case, Path(folder)), rate, who, count), flush=True)


def _rows(only: str | None, *, quick: bool) -> Iterator[tuple[Case, int, str, int]]:
    """Yield robot, rate [Hz], controller and number of targets of each row."""
    if quick:
        yield QUICK, 100, SURCTL, 5
        return
    for case in CASES:
        if only in (None, case.name.split(",")[0]):
            yield case, 100, SURCTL, 100
            yield case, 1000, SURCTL, 100
    if only in (None, "peers"):
        for who in (SURCTL, UNDAMPED, PINK, MINK):
            for case in CASES:
                yield case, 100, who, 100 if case is CASES[0] else 20
        for who in (SURCTL, UNDAMPED, PINK, MINK):
            yield CASES[0], 1000, who, 10


def row(robot: Subject, rate: int, who: str, count: int) -> str:
    """Return the row of one robot, rate and controller."""
    targets = drawn_targets(robot, count, 45)
    run = _run(robot, targets, 1.0 / rate, who)
    verdicts = [judge(robot, target, end, k)[0] for k, (target, end) in enumerate(zip(targets, run.ends, strict=True))]
    counts = Counter((target.beyond, verdict) for target, verdict in zip(targets, verdicts, strict=True))
    found = [", ".join(str(counts[beyond, word]) for word in ("reached", "local", "short")) for beyond in (False, True)]
    over = " | ".join("holds" if by <= 1e-12 else f"{by:.1e}" for by in run.over)
    error = 1e3 * np.median([e for e, target in zip(run.errors, targets, strict=True) if not target.beyond])
    stages = ", ".join(f"{name} {number:,}" for name, number in sorted(run.stages.items()))
    median, late = 1e6 * np.percentile(run.seconds, (50, 99))
    return (
        f"| {robot.case.name} | {rate} | {who} | {' | '.join(found)} | {over} | {1e3 * run.gap:.3f} | {error:.2g} | "
        f"{stages} | {median:.0f}, {late:.0f} |"
    )


def _run(robot: Subject, targets: list[Target], dt: float, who: str) -> Run:
    if who in (PINK, MINK):
        from peers import mink_step, pink_step

        return reach(robot, targets, (pink_step if who == PINK else mink_step)(robot, dt), dt, lambda: None)
    control = robot.controller(dt, DAMPING if who == SURCTL else 0.0)
    return reach(
        robot,
        targets,
        lambda q, _, poses: (control.step(q, **{f"tool{k}": pose for k, pose in enumerate(poses)}), control.stage),
        dt,
        control.reset,
    )


def compare() -> None:
    """Print the largest difference from Pinocchio for one URDF file of each robot."""
    from pinocchio_poses import poses

    print("| file | base | velocities | links | poses | Jacobians |\n|---|---|---|---|---|---|")
    first: dict[str, Path] = {}
    for path in sorted(folder_of_robots().rglob("*.urdf")):
        first.setdefault(path.relative_to(folder_of_robots()).parts[0], path)
    worst = 0.0
    for path in first.values():
        robot, base = _with_base(path)
        links = [name for name in robot.links if name != "world"]
        frames = [robot.frame(name) for name in links]
        places = ca.vertcat(*(ca.vertcat(f.position, ca.vec(f.rotation.T)) for f in frames))
        jacobians = ca.vertcat(*(ca.vec(f.jacobian.T) for f in frames))
        own = ca.Function("own", [robot.q], [ca.densify(places), ca.densify(jacobians)]).map(PIECE)
        q = np.random.default_rng(0).uniform(-3.0, 3.0, (CONFIGURATIONS, robot.nq))
        if base == "floating":
            q[:, 3:7] /= np.sqrt((q[:, 3:7] ** 2).sum(axis=1, keepdims=True))
        errors = [0.0, 0.0]
        for start in range(0, CONFIGURATIONS, PIECE):
            ours = [np.array(part) for part in own(q[start : start + PIECE].T)]
            for k, theirs in enumerate(poses(robot, path, q[start : start + PIECE])):
                for i in range(2):
                    errors[i] = max(errors[i], float(abs(ours[i][:, k] - theirs[i].reshape(-1)).max()))
        worst = max(worst, *errors)
        print(f"| {path.name} | {base} | {robot.nv} | {len(links)} | {errors[0]:.1e} | {errors[1]:.1e} |", flush=True)
    print(f"\n{len(first)} robots; largest difference: {worst:.1e}\n")


def _with_base(path: Path) -> tuple[Robot, str]:
    """Return the robot with a floating base, or with a fixed one if its root is named world already."""
    try:
        return load_urdf(path, base="floating"), "floating"
    except InputError:
        return load_urdf(path), "fixed"


if __name__ == "__main__":
    main()
