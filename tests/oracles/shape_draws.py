"""Random priority problems with given numbers of Jacobian rows, for tests of a compiled step."""

from __future__ import annotations

import numpy as np

from surctl.priority.problem import Level, PriorityProblem, build_problem
from surctl.priority.shapes import LevelShape
from tests.oracles.priority_draws import draw_levels, draw_problem

__all__ = ["draw_of_shape"]

_N = 4


def draw_of_shape(
    rng: np.random.Generator, shapes: tuple[LevelShape, ...], *, limits: bool = True, conditioned: bool = False
) -> PriorityProblem:
    """Return random levels of these shapes for 4 velocities, with actuator and barrier limits as in `draw_problem`.

    Some Jacobians are rank-deficient, repeat a row, or are 0, and some levels contradict the level above. Limits often
    contradict each other. There are at most 22 limits.

    Args:
        limits: whether the problem has limits.
        conditioned: if true, the singular values of each Jacobian are between 0.3 and 3, and none is rank-deficient.
    """
    levels: list[Level] = []
    while len(levels) < len(shapes):
        for level in draw_levels(rng, conditioned=conditioned, deficient=not conditioned):
            if len(levels) < len(shapes) and level.lower.size >= shapes[len(levels)].rows:
                levels.append(_cut(level, shapes[len(levels)], f"task{len(levels)}", rng))
    if len(levels) > 1 and not conditioned and rng.random() < 0.2:
        place = int(rng.integers(1, len(levels)))
        levels[place].J[0] = levels[place - 1].J[0]
    rows = draw_problem(rng).rows if limits else []
    return build_problem(levels, rows)


def _cut(level: Level, shape: LevelShape, name: str, rng: np.random.Generator) -> Level:
    J, lower = level.J[: shape.rows].copy(), level.lower[: shape.rows]
    if not shape.is_set:
        return Level(name, J, lower)
    upper = lower + rng.choice([0.1, 0.5, 2.0])
    return Level(name, J, np.where(rng.random(1) < 0.2, -np.inf, lower), upper)
