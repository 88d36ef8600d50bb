"""Time of a step of mode `lexicographic` beside DAQP's hierarchy, on the same problems along motions of robots.

    python analysis/45_robots/times.py

Both are called from Python with matrices that are stacked already, in turns of 25 problems. DAQP's rows have length 1.
The cold build is that of the whole controller, kinematics included, in a process of its own with an empty cache.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import daqp
import numpy as np
from numpy.typing import NDArray
from reach import drawn_targets
from robots import ACCELERATION, CASES, SPEED, folder_of_robots, subject

from surctl.priority import PriorityProblem, PriorityStep
from surctl.robot import StackController, load_urdf

Array = NDArray[np.float64]

SIZES = (4, 7, 14, 35)
COLUMNS = (
    "n", "levels", "limits", "surctl µs: median, p99", "DAQP µs: median, p99", "ratio of medians",
    "DAQP without solution", "cold build: processor s, MB",
)  # fmt: skip
_PROBLEMS, _TURN, _ROUNDS, _DT, _FAR = 300, 25, 6, 0.01, 1e30
_COLD = """
import resource, sys
sys.path.insert(0, {folder!r})
import times
control, q, targets = times.subject_of({n})
control.step(q, **targets[0])
use = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
print(sum(u.ru_utime + u.ru_stime for u in use), max(u.ru_maxrss for u in use) / 1e3)
"""


def main() -> None:
    """Print the table."""
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for n in SIZES:
        problems = _problems(n)
        own, other, failed = _timed(problems)
        numbers = [f"{np.percentile(times, 50):.1f}, {np.percentile(times, 99):.1f}" for times in (own, other)]
        shape = f"{len(problems[0].levels)} | {len(problems[0].rows)}"
        ratio = float(np.median(own) / np.median(other))
        print(f"| {n} | {shape} | {' | '.join(numbers)} | {ratio:.2f} | {failed} | {_cold(n)} |", flush=True)


def subject_of(n: int) -> tuple[StackController, Array, list[dict[str, Array]]]:
    """Return a controller for n velocities, where its runs start, and their targets."""
    if n == 35:
        return _humanoid()
    case = CASES[1] if n == 14 else CASES[0]
    if n == 4:
        case = replace(case, joints=case.joints[:4], home=case.home[:4])
    with tempfile.TemporaryDirectory() as folder:
        robot = subject(case, Path(folder))
    targets = [{f"tool{k}": pose for k, pose in enumerate(target.poses)} for target in drawn_targets(robot, 10, 7)]
    return robot.controller(_DT, damping=0.0), robot.home, targets


def _humanoid() -> tuple[StackController, Array, list[dict[str, Array]]]:
    """Return a humanoid on a free base: centre of mass, then both hands, then posture."""
    robot = load_urdf(folder_of_robots() / "g1_description" / "urdf" / "g1_29dof_rev_1_0.urdf", base="floating")
    hands = [
        robot.frame_task(f"{side}_rubber_hand", target=side, gain=5.0, max_speed=SPEED) for side in ("right", "left")
    ]
    tasks = [robot.com_task("com", gain=5.0), *(hand.position for hand in hands), robot.posture_task("home", gain=5.0)]
    limits = [
        robot.joint_limits(acceleration=ACCELERATION, velocity={place.joint.name: 2.0 for place in robot.coordinates})
    ]
    draws, targets = np.random.default_rng(7), []
    for _ in range(10):
        q = robot.neutral()
        q[7:] = draws.uniform(-0.8, 0.8, robot.nq - 7)
        poses = [robot.pose(f"{side}_rubber_hand", q) for side in ("right", "left")]
        targets.append({"right": poses[0], "left": poses[1], "com": draws.uniform(-0.1, 0.1, 3)})
    return StackController(tasks, limits=limits, dt=_DT), robot.neutral(), targets


def _problems(n: int) -> list[PriorityProblem]:
    """Return problems along runs to the targets."""
    control, start, targets = subject_of(n)
    each, problems = _PROBLEMS // len(targets), list[PriorityProblem]()
    for target in targets:
        control.reset()
        q = start
        for k in range(4 * each):
            v = control.step(q, **target)
            if k % 4 == 3:
                problems.append(control.problem())
            q = control.robot.integrate(q, v, _DT)
    return problems


def _timed(problems: list[PriorityProblem]) -> tuple[Array, Array, int]:
    """Return the median times [µs] of each problem in surctl and in DAQP, and how many DAQP does not solve."""
    step = PriorityStep.of(problems[0], "lexicographic")
    own = []
    for problem in problems:
        step.write(problem)
        own.append(tuple(part.copy() for part in (step.J, step.lower, step.upper, step.rows, step.box)))
    stacks = [_stacked(problem) for problem in problems]

    def ours(k: int) -> bool:
        for to, value in zip((step.J, step.lower, step.upper, step.rows, step.box), own[k], strict=True):
            to[:] = value
        step.solve()
        return True

    def theirs(k: int) -> bool:
        A, upper, lower, sense, breaks = stacks[k]
        return bool(daqp.solve(None, None, A, upper, lower, sense, breaks, primal_tol=1e-10)[2] > 0)

    times, failed = np.zeros((2, _ROUNDS, len(problems))), set()
    for lap in range(_ROUNDS):
        for first in range(0, len(problems), _TURN):
            for who, solve in enumerate((ours, theirs)):
                for k in range(first, min(first + _TURN, len(problems))):
                    start = time.perf_counter()
                    solved = solve(k)
                    times[who, lap, k] = 1e6 * (time.perf_counter() - start)
                    if not solved:
                        failed.add(k)
    middle = np.median(times, axis=1)
    return middle[0], middle[1], len(failed)


def _stacked(problem: PriorityProblem) -> tuple[Array, Array, Array, NDArray[np.intc], NDArray[np.intc]]:
    """Return the rows with length 1, their bounds, and the ends of the levels, as DAQP takes them."""
    rows, levels = problem.rows, problem.levels
    A = np.vstack([*(row.a for row in rows), *(level.J for level in levels)])
    lower = np.concatenate([[row.lower for row in rows], *(level.lower for level in levels)])
    upper = np.concatenate([[row.upper for row in rows], *(level.high for level in levels)])
    length = np.linalg.norm(A, axis=1)
    kept = length > 0.0
    A, lower, upper = A[kept] / length[kept, None], lower[kept] / length[kept], upper[kept] / length[kept]
    ends = np.cumsum([len(rows), *(level.lower.size for level in levels)])
    breaks = np.array([kept[:end].sum() for end in ends], dtype=np.intc)
    return np.ascontiguousarray(A), np.minimum(upper, _FAR), np.maximum(lower, -_FAR), np.zeros(len(A), np.intc), breaks


def _cold(n: int) -> str:
    with tempfile.TemporaryDirectory() as cache:
        program = _COLD.format(folder=str(Path(__file__).parent), n=n)
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        done = subprocess.run(
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
    seconds, size = map(float, done.stdout.split())
    return f"{seconds:.1f}, {size:.0f}"


if __name__ == "__main__":
    main()
