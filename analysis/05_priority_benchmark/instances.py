"""The problems of the benchmark: the toolkit's task stack at random poses, a box, and eight rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.priority import Level, PriorityProblem, Row, build_problem
from surctl.tasks import Stack, clearance_task, depth_task, heading_task, position_task

__all__ = ["BOX", "HARD", "LEVELS", "ROWS", "Instance", "N", "draw_instances"]

Array: TypeAlias = NDArray[np.float64]

N = 4
"""Velocities u, v, w, r."""

NAMES = ("clearance", "depth", "heading", "position")
LEVELS = (1, 1, 1, 2)
"""Rows of each task, highest priority first: five in all for four velocities, so that they conflict."""

ROWS = 8
"""Inequality rows beside the box: four two-sided ones of the thrust, four one-sided ones of barriers."""

HARD = 4
"""The first of these rows must not be relaxed when rows contradict each other."""

BOX = np.array([[-0.6, -0.5, -0.4, -0.8], [0.6, 0.5, 0.4, 0.8]])
"""Lower and upper bounds of the velocities [m/s, rad/s]."""

_BEYOND = 0.2  # share of instances whose first task cannot be fulfilled within the rows


@dataclass(frozen=True, eq=False)
class Instance:
    """One step.

    Attributes:
        J: (5, 4), the tasks' rows under one another. x: (5,) [m/s, rad/s].
        A: (8, 4), rows of length 1; lower, upper: (8,), −inf where there is none.
        problem: the same, with names.
    """

    J: Array
    x: Array
    A: Array
    lower: Array
    upper: Array
    problem: PriorityProblem

    @property
    def table(self) -> Array:
        """Return (8, 7): A, lower, upper, and 1 for rows that may be relaxed."""
        soft = np.arange(ROWS) >= HARD
        return np.column_stack([self.A, self.lower, self.upper, soft])

    @property
    def tasks(self) -> list[tuple[Array, Array]]:
        """Return (J, x) of each task."""
        return [(level.J, level.x) for level in self.problem.levels]


def draw_instances(count: int, *, seed: int) -> list[Instance]:
    """Return `count` random steps; in four of five the first task can be fulfilled within the rows."""
    rng = np.random.default_rng(seed)
    evaluate = _stack()
    return [_draw(rng, evaluate) for _ in range(count)]


def _stack() -> ca.Function:
    """Return the function (η, waypoint (3,), heading, echo (2,)) → J, x of the four tasks."""
    eta, goal, psi, echo = ca.SX.sym("eta", 4), ca.SX.sym("goal", 3), ca.SX.sym("psi"), ca.SX.sym("echo", 2)
    tasks = (
        clearance_task(eta, echo, margin=0.3),
        depth_task(eta, goal[2]),
        heading_task(eta, psi),
        position_task(eta, goal[:2]),
    )
    levels = Stack(tasks).levels()
    J, x = (ca.vertcat(*parts) for parts in zip(*levels, strict=True))
    return ca.Function("stack", [eta, goal, psi, echo], [J, x])


def _draw(rng: np.random.Generator, evaluate: ca.Function) -> Instance:
    eta = np.append(rng.uniform(-2, 2, 3), rng.uniform(-np.pi, np.pi))
    bearing = rng.uniform(-np.pi, np.pi)
    echo = eta[:2] + rng.uniform(0.25, 0.6) * np.array([np.cos(bearing), np.sin(bearing)])
    goal, psi = eta[:3] + 0.4 * rng.normal(size=3), eta[3] + 0.6 * rng.normal()
    J, x = (np.array(part) for part in evaluate(eta, goal, psi, echo))
    x = x.reshape(-1)
    A, lower, upper, inside = _rows(rng)
    x[0] = J[0] @ inside if rng.random() >= _BEYOND else np.copysign(2.0, x[0])
    return Instance(J, x, A, lower, upper, _problem(J, x, A, lower, upper))


def _rows(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return A, lower, upper, and a point that fulfils all rows; 0 fulfils them too."""
    A = rng.normal(size=(ROWS, N))
    A[:HARD] = np.eye(N) + 0.3 * A[:HARD]  # a thruster acts along one axis, mostly
    A[HARD:, 3] = 0.0  # turning on the spot changes no distance
    A /= np.linalg.norm(A, axis=1)[:, None]
    inside = 0.5 * BOX[1] * rng.uniform(-1, 1, N)
    value = A @ inside
    upper = np.maximum(value, 0.0) + rng.uniform(0.02, 0.3, ROWS)
    lower = np.where(np.arange(ROWS) < HARD, np.minimum(value, 0.0) - rng.uniform(0.02, 0.3, ROWS), -np.inf)
    return A, lower, upper, inside


def _problem(J: Array, x: Array, A: Array, lower: Array, upper: Array) -> PriorityProblem:
    starts = np.cumsum([0, *LEVELS])
    levels = [Level(name, J[a:b], x[a:b]) for name, a, b in zip(NAMES, starts, starts[1:], strict=False)]
    rows = [Row(f"box.{'uvwr'[i]}", "actuator", np.eye(N)[i], BOX[0, i], BOX[1, i]) for i in range(N)]
    for i in range(ROWS):
        name, kind = (f"thrust.{i}", "actuator") if i < HARD else (f"barrier.{i}", "barrier")
        rows.append(Row(name, kind, A[i], lower[i], upper[i]))  # type: ignore[arg-type]
    return build_problem(levels, rows)
