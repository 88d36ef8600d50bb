"""A robot on its way to drawn targets: limits, gaps, and how near it comes, judged without the priority solver."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from robots import ACCELERATION, MARGIN, Subject
from scipy.optimize import minimize

__all__ = ["Run", "Target", "drawn_targets", "judge", "reach"]

Array: TypeAlias = NDArray[np.float64]
Step: TypeAlias = Callable[[Array, Array, list[Array]], tuple[Array, str]]
"""From the configuration, the last velocity and the poses of the tools to velocity and status."""

LEAST, REST, STILL, STUCK = 20.0, 0.5, 1e-4, 1.0
"""A run ends after REST [s] with all speeds below STILL [rad/s, m/s]. After LEAST [s], it also ends once the first tool
has come less than NEAR closer to its target than ever before within STUCK [s]."""
NEAR = 1e-3
"""Distance [m] from the best point within which a target counts as reached."""
_STARTS, _AROUND = 8, 0.2  # of the search: drawn starts; distance [rad, m] of configurations around the end of a run


@dataclass(frozen=True, eq=False)
class Target:
    """Poses (4, 4) of the tools, and the configuration where the run to them starts, at rest.

    Attributes:
        beyond: False if the poses are those at the other end of a straight line of joint positions without collision;
            True if the positions are drawn in a box twice as large as that of the positions of drawn configurations.
    """

    start: Array
    poses: list[Array]
    beyond: bool


@dataclass
class Run:
    """What a robot did on its way to all targets.

    Attributes:
        errors: distance of the first tool, which has priority, from its target at the end (targets,) [m].
        ends: configurations at the end. over: how far position, speed and acceleration exceed their limits at most.
        gap: least gap − margin [m]. stages: number of steps by status. seconds: time of each step.
    """

    errors: list[float] = field(default_factory=list)
    ends: list[Array] = field(default_factory=list)
    over: Array = field(default_factory=lambda: np.full(3, -np.inf))
    gap: float = np.inf
    stages: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)


def drawn_targets(robot: Subject, count: int, seed: int) -> list[Target]:
    """Return targets, of which two of five are beyond."""
    draws = np.random.default_rng(seed)
    points = np.array([np.array(robot.places(draws.uniform(robot.lower, robot.upper))) for _ in range(400)])
    low, high = points.min(axis=0), points.max(axis=0)
    q, targets = robot.home, []
    for k in range(count):
        goal = draws.uniform(robot.lower, robot.upper)
        line = q + np.linspace(0.0, 1.0, 101)[:, None] * (goal - q)
        blocked = np.flatnonzero([np.array(robot.gaps(point)).min() <= 2.0 * MARGIN for point in line])
        end = line[blocked[0] - 1] if blocked.size else goal
        poses = [robot.robot.pose(link, end) for link in robot.case.tools]
        beyond = k % 5 >= 3
        if beyond:
            drawn = draws.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low)
            for pose, point in zip(poses, drawn.T, strict=True):
                pose[:3, 3] = point
        targets.append(Target(q, poses, beyond))
        q = q if beyond else end
    return targets


def reach(robot: Subject, targets: list[Target], step: Step, dt: float, reset: Callable[[], object]) -> Run:
    """Follow each target from its start with the velocities of `step`; the joints move as commanded."""
    run = Run()
    for target in targets:
        reset()
        q, v, quiet, path = target.start, np.zeros(robot.robot.nv), 0, [np.zeros(robot.robot.nv)]
        passed, nearest, since = [], np.inf, 0
        while len(passed) * dt < LEAST or since * dt < STUCK:
            start = time.thread_time()
            v, stage = step(q, v, target.poses)
            run.seconds.append(time.thread_time() - start)
            run.stages[stage] += 1
            q = q + dt * v
            path.append(v)
            passed.append(q)
            distance = _distance(robot, q, target)
            nearest, since = (distance, 0) if distance < nearest - NEAR else (nearest, since + 1)
            quiet = quiet + 1 if abs(v).max() < STILL else 0
            if quiet * dt > REST:
                break
        places, speeds = np.array(passed), np.array(path)
        position = max((robot.lower - places).max(), (places - robot.upper).max())
        over = [position, (abs(speeds) - robot.speed).max(), abs(np.diff(speeds, axis=0)).max() / dt - ACCELERATION]
        run.over = np.maximum(run.over, over)
        run.gap = min(run.gap, float(np.array(robot.gaps(places.T)).min()) - MARGIN)
        run.ends.append(q)
        run.errors.append(_distance(robot, q, target))
    return run


def judge(robot: Subject, target: Target, end: Array, seed: int) -> tuple[str, float]:
    """Return the verdict about the end of a run, and the least distance [m] that a search finds within the limits.

    "reached": the tool is within 1 mm of that point. "local": no configuration that differs by at most 0.2 rad or m in
    each joint is more than 1 mm nearer. "short": neither, as when the robot still moves.
    """
    error = _distance(robot, end, target)
    if not target.beyond and error <= NEAR:
        return "reached", 0.0
    draws = np.random.default_rng(seed)
    best = error
    for start in [end, *(draws.uniform(robot.lower, robot.upper) for _ in range(_STARTS))]:
        best = min(best, _least(robot, target, start, robot.lower, robot.upper))
    if error <= best + NEAR:
        return "reached", best
    around = _least(robot, target, end, np.fmax(robot.lower, end - _AROUND), np.fmin(robot.upper, end + _AROUND))
    return "local" if error <= around + NEAR else "short", best


def _distance(robot: Subject, q: Array, target: Target) -> float:
    return float(np.linalg.norm(np.array(robot.places(q))[:, 0] - target.poses[0][:3, 3]))


def _least(robot: Subject, target: Target, start: Array, lower: Array, upper: Array) -> float:
    """Return the least distance that sequential quadratic programming finds between the bounds; ∞ if it fails."""

    def error(q: Array) -> tuple[float, Array]:
        apart = np.array(robot.places(q))[:, 0] - target.poses[0][:3, 3]
        return float(apart @ apart), 2.0 * apart @ np.array(robot.places_by(q))[:3]

    gaps = {
        "type": "ineq",
        "fun": lambda q: np.array(robot.gaps(q))[:, 0] - MARGIN,
        "jac": lambda q: np.array(robot.gaps_by(q)),
    }
    bounds, options = list(zip(lower, upper, strict=True)), {"maxiter": 300, "ftol": 1e-12}
    with np.errstate(all="ignore"):
        found = minimize(error, start, jac=True, method="SLSQP", bounds=bounds, constraints=[gaps], options=options)
    q = np.clip(found.x, lower, upper)
    if not np.isfinite(q).all() or float(np.array(robot.gaps(q)).min()) < MARGIN - 1e-5:
        return np.inf
    return _distance(robot, q, target)
