"""How much damping for what the tasks above miss: distance from a target out of reach, and how long a posture takes.

python analysis/45_robots/missed.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from reach import Target, drawn_targets
from robots import CASES, DAMPING, Case, Subject, subject

from surctl.robot import stack_controller

DT, SECONDS, SETTLED = 0.01, 20.0, 0.05
FACTORS = (0.0, 1.0, 3.0, 10.0, 30.0)
CHATTER, POSTURE = (CASES[2], (28,)), (CASES[0], (8, 13))  # targets out of reach, by robot


def main() -> None:
    """Print a row for each factor."""
    ends = ", ".join(map(str, POSTURE[1]))
    print(
        f"| factor | {CHATTER[0].name}, target 28: distance mm | {POSTURE[0].name}, targets {ends}: posture settled s |"
    )
    print("|---|---|---|")
    for factor in FACTORS:
        stack_controller._MISSED = factor
        far, late = (
            [_run(robot, target) for robot, target in _targets(case, numbers)] for case, numbers in (CHATTER, POSTURE)
        )
        print(
            f"| {factor:g} | {1e3 * far[0][0]:.3f} | {', '.join(f'{seconds:.2f}' for _, seconds in late)} |", flush=True
        )


def _targets(case: Case, numbers: tuple[int, ...]) -> list[tuple[Subject, Target]]:
    with tempfile.TemporaryDirectory() as folder:
        robot = subject(case, Path(folder))
        targets = drawn_targets(robot, max(numbers) + 1, 45)
    return [(robot, targets[number]) for number in numbers]


def _run(robot: Subject, target: Target) -> tuple[float, float]:
    """Return the largest distance from the target in the last second, and when the distance from home settles."""
    control, q, path = robot.controller(DT, DAMPING), target.start, []
    for _ in range(round(SECONDS / DT)):
        q = q + DT * control.step(q, **{f"tool{k}": pose for k, pose in enumerate(target.poses)})
        path.append(q)
    away: NDArray[np.float64] = np.linalg.norm(np.array(path) - robot.home, axis=1)
    unsettled = np.flatnonzero(abs(away - np.median(away[-200:])) > SETTLED * np.ptp(away))
    goal = target.poses[0][:3, 3]
    errors = [np.linalg.norm(np.array(robot.places(q))[:, 0] - goal) for q in path[-round(1.0 / DT) :]]
    return float(max(errors)), float(DT * unsettled.max())


if __name__ == "__main__":
    main()
