"""Random priority problems, for tests, studies and conformance checks."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.problem import Level, PriorityProblem, Row, build_problem

__all__ = ["draw_levels", "draw_problem", "inequality_problem", "unit", "wide", "with_sets"]

Array: TypeAlias = NDArray[np.float64]

_N = 4


def draw_levels(
    rng: np.random.Generator, *, most: int = 5, conditioned: bool = False, deficient: bool = True
) -> list[Level]:
    """Return 1 to `most` random priority levels for 4 velocities, with 1–4 rows in each Jacobian, named task0, task1, …

    Args:
        most: largest number of levels. conditioned: if true, the singular values of each Jacobian J are between 0.3 and
            3.
        deficient: if true, some Jacobians repeat a row, have rank 1, are zero, or select single velocities.
    """
    levels = []
    for i in range(rng.integers(1, most + 1)):
        k = int(rng.integers(1, _N + 1))
        J = rng.normal(size=(k, _N))
        if conditioned:
            left, _, right = np.linalg.svd(J, full_matrices=False)
            J = left @ np.diag(rng.uniform(0.3, 3.0, k)) @ right
        if deficient:
            J = _spoiled(J, rng)
        levels.append(Level(f"task{i}", J, rng.normal(size=k)))
    return levels


def _spoiled(J: Array, rng: np.random.Generator) -> Array:
    k, kind = len(J), rng.random()
    if kind < 0.15 and k > 1:
        J[1] = J[0]
    elif kind < 0.25:
        J = rng.normal(size=(k, 1)) @ rng.normal(size=(1, _N))
    elif kind < 0.3:
        J = np.zeros_like(J)
    elif kind < 0.4:
        J = np.eye(_N)[rng.permutation(_N)[:k]]
    return J


def unit(rng: np.random.Generator) -> Array:
    """Return a random unit vector (4,)."""
    a = rng.normal(size=_N)
    return np.asarray(a / np.linalg.norm(a))


def draw_problem(rng: np.random.Generator, *, most: int = 5) -> PriorityProblem:
    """Return random levels, consistent velocity and thrust limits, and limits that often contradict these.

    The limits that may contradict the others are of kind "barrier" and "set". The normals of barrier limits have
    lengths between 0.1 and 10. Some limits are repeated, and some oppose each other.
    """
    half = rng.uniform(0.05, 1.0, _N)
    rows = [Row(f"box{i}", "actuator", np.eye(_N)[i], -half[i], half[i]) for i in range(_N)]
    rows += [
        Row(f"thrust{i}", "actuator", unit(rng), -rng.uniform(0.05, 1), rng.uniform(0.05, 1))
        for i in range(rng.integers(0, 4))
    ]
    for i in range(rng.integers(0, 6)):
        a, bound = unit(rng) * 10.0 ** rng.uniform(-1, 1), 0.5 * rng.normal()
        rows.append(Row(f"barrier{i}", "barrier", a, -np.inf, bound))
        if rng.random() < 0.2:
            rows.append(Row(f"double{i}", "barrier", a, -np.inf, bound))
        if rng.random() < 0.1:
            rows.append(Row(f"against{i}", "barrier", -a, -np.inf, -bound + rng.choice([0.0, 0.1, -0.1])))
    if rng.random() < 0.5:
        middle = 0.3 * rng.normal()
        rows.append(Row("set", "set", unit(rng), middle, middle + rng.choice([0.0, 0.2])))
    return build_problem(draw_levels(rng, most=most), rows)


def with_sets(problem: PriorityProblem, rng: np.random.Generator) -> PriorityProblem:
    """Return a copy of the problem with intervals in place of some desired values, in a third of the levels."""
    levels = []
    for level in problem.levels:
        k = level.lower.size
        width = np.where(rng.random(k) < 0.7, rng.choice([0.1, 0.5, 2.0], k), 0.0)
        if rng.random() < 0.65:
            width[:] = 0.0
        lower = np.where((width > 0.0) & (rng.random(k) < 0.2), -np.inf, level.lower)
        levels.append(Level(level.name, level.J, lower, level.lower + width))
    return build_problem(levels, problem.rows)


def wide(levels: list[Level] | tuple[Level, ...], *, span: float = 1e3) -> PriorityProblem:
    """Return a problem of these levels with limits that are never active: a velocity box of ± `span` and a barrier."""
    rows = [Row(f"box{i}", "actuator", np.eye(_N)[i], -span, span) for i in range(_N)]
    return build_problem(levels, [*rows, Row("wall", "barrier", np.ones(_N), -np.inf, span)])


def inequality_problem(rng: np.random.Generator, *, most: int = 5) -> PriorityProblem:
    """Return a problem with random levels whose Jacobian rows have length 1, and with limits that v = 0 satisfies.

    Some Jacobian rows occur twice in a level, some also occur in the level above, and some have an interval of allowed
    values.
    """
    levels: list[Level] = []
    for i in range(rng.integers(1, most + 1)):
        J = np.array([unit(rng) for _ in range(rng.integers(1, 4))])
        if len(J) > 1 and rng.random() < 0.2:
            J[1] = J[0]
        if levels and rng.random() < 0.2:
            J[0] = levels[-1].J[0]
        x = 0.5 * rng.normal(size=len(J))
        levels.append(Level(f"task{i}", J, x, x + rng.choice([0.0, 0.1, 0.5], len(J), p=[0.7, 0.15, 0.15])))
    rows = [Row(f"box{i}", "actuator", np.eye(_N)[i], -0.5, 0.5) for i in range(_N)]
    rows += [Row(f"wall{i}", "barrier", unit(rng), -np.inf, 0.3 * abs(rng.normal())) for i in range(rng.integers(0, 5))]
    return build_problem(levels, rows)
