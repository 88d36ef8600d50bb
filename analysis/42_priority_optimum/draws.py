"""Random priority problems of n velocities in five classes, from well conditioned to contradictory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.priority import Level, LevelShape, PriorityProblem, Row, build_problem

Array = NDArray[np.float64]

CLASSES = ("plain", "saturated", "degenerate", "near_singular", "infeasible")
"""plain: well conditioned, few limits bind. saturated: references far outside the limits. degenerate: dependent rows of
Jacobians within and between levels, repeated limits, many limits through one point. near_singular: the same, but
dependent only up to 1e-12 to 1e-3. infeasible: barrier limits contradict each other or the actuator limits."""


@dataclass(frozen=True)
class Size:
    """Number of velocities, Jacobian rows of each level (0 for a set-based level), and number of barrier limits."""

    n: int
    levels: tuple[int, ...]
    barriers: int

    @property
    def shapes(self) -> tuple[LevelShape, ...]:
        """Return the shapes of the levels."""
        return tuple(LevelShape(max(k, 1), k == 0) for k in self.levels)

    @property
    def rows(self) -> int:
        """Return the number of limit rows: box, two rows of actuators, barriers."""
        return self.n + 2 + self.barriers


QUICK = Size(4, (2, 1), 18)
"""Small enough for the suite, which compiles steps of this size anyway."""

SIZES = {
    4: Size(4, (1, 0, 2, 4), 6),
    6: Size(6, (2, 0, 3, 6), 7),
    7: Size(7, (3, 0, 3, 7), 7),
    10: Size(10, (4, 0, 3, 10), 8),
    14: Size(14, (6, 0, 6, 14), 8),
    20: Size(20, (6, 0, 6, 20), 10),
    29: Size(29, (6, 0, 9, 29), 12),
    35: Size(35, (6, 0, 12, 35), 12),
}


def draw(rng: np.random.Generator, size: Size, kind: str) -> PriorityProblem:
    """Return one problem of the class `kind`; Jacobian rows have length 1 (some 0), the box is ±0.3 to ±2."""
    n, scale = size.n, {"plain": 0.2, "infeasible": 1.0}.get(kind, 10.0 ** rng.uniform(-0.5, 1.0))
    half = rng.uniform(0.3, 2.0, n)
    tilt = 0.0 if kind == "degenerate" else 10.0 ** rng.uniform(-12, -3)
    Js = [_unit(rng.normal(size=(max(k, 1), n))) for k in size.levels]
    if size.levels[-1] == n and rng.random() < 0.7:
        Js[-1] = np.eye(n)
    if kind in ("degenerate", "near_singular"):
        Js = [_spoiled(J, Js[:i], tilt, rng) for i, J in enumerate(Js)]
    levels = [_level(f"task{i}", J, size.levels[i] == 0, scale, rng) for i, J in enumerate(Js)]
    A = _unit(rng.normal(size=(2 + size.barriers, n)))
    point = np.where(rng.random(n) < 0.5, half, 0.3 * half) * rng.choice([-1.0, 1.0], n)
    upper = np.abs(rng.normal(size=len(A))) * rng.choice([0.1, 0.5, 1.0])
    if kind in ("degenerate", "near_singular"):
        for i in range(3, len(A)):
            if rng.random() < 0.4:  # parallel or opposed to the row before
                A[i] = _unit((rng.choice([-1.0, 1.0]) * A[i - 1] + tilt * A[i])[None])[0]
        A[rng.random(len(A)) < 0.2] = np.eye(n)[rng.integers(0, n)]
        meet = rng.random(len(A)) < 0.5
        upper = np.where(meet, A @ point, upper)  # many rows through one point of the box
        upper[:2] = np.maximum(upper[:2], 0.0)
    if kind == "infeasible":
        worst = np.abs(A) @ half  # no velocity in the box moves further along a row
        against = rng.random(len(A)) < 0.3
        upper = np.where(against, -rng.uniform(0.2, 1.5, len(A)) * worst, upper)
        upper[:2] = np.abs(upper[:2])
        if rng.random() < 0.5:
            A[-1], upper[-1] = -A[-2], -upper[-2] - rng.choice([0.0, 0.1, 1e-6])
    rows = [Row(f"box{j}", "actuator", np.eye(n)[j], -half[j], half[j]) for j in range(n)]
    rows += [Row(f"thrust{i}", "actuator", A[i], -1.0 - upper[i], float(upper[i])) for i in range(2)]
    rows += [Row(f"wall{i}", "barrier", A[i], -np.inf, float(upper[i])) for i in range(2, len(A))]
    return build_problem(levels, rows)


def _level(name: str, J: Array, is_set: bool, scale: float, rng: np.random.Generator) -> Level:
    x = scale * rng.normal(size=len(J))
    return Level(name, J, x, x + rng.choice([0.1, 0.5, 2.0]) if is_set else None)


def _unit(A: Array) -> Array:
    return np.asarray(A / np.linalg.norm(A, axis=1, keepdims=True))


def _spoiled(J: Array, above: list[Array], tilt: float, rng: np.random.Generator) -> Array:
    """Make some rows of J dependent, up to `tilt`, on other rows of J or of a level above, and some columns tiny."""
    J = J.copy()
    for i in range(len(J)):
        others = [*J[:i], *(row for level in above for row in level)]
        if others and rng.random() < 0.4:
            picked = [others[k] for k in rng.integers(0, len(others), rng.integers(1, 3))]
            mix = sum(rng.normal() * row for row in picked)
            if np.linalg.norm(mix) > 0.1:
                J[i] = mix / np.linalg.norm(mix) + tilt * J[i]
    if rng.random() < 0.3:  # as for a stretched arm: some velocities hardly act
        J[:, rng.random(J.shape[1]) < 0.4] *= tilt
    if rng.random() < 0.05:
        J[0] = 0.0
    length = np.linalg.norm(J, axis=1, keepdims=True)
    return np.asarray(J / np.where(length > 1e-14, length, 1.0))
