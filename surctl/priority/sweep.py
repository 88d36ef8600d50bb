"""The NSB law, equation (16) of the paper, as one projection per level, extended to set-based tasks and damping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.active_set import LevelSolution, solve_level
from surctl.priority.cascade import solve_cascade
from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level
from surctl.priority.rowspace import ZERO_ROW, project
from surctl.priority.settings import Settings

__all__ = ["damped_point", "nsb_sweep", "without_rows"]

Array: TypeAlias = NDArray[np.float64]

_PLAIN = Settings()
_NOTHING = 1e-15  # a damped problem has full rank, so no direction is cut off


def nsb_sweep(levels: Sequence[Level], *, start: Array, settings: Settings = _PLAIN) -> Array:
    """Return the velocity after one sweep, which projects `start` (n,) on every level, from lowest to highest priority.

    The projection of a velocity w on a level J v = x is the velocity nearest to w among those that minimise ‖J v − x‖,
    which is J⁺x + (I − J⁺J) w. If `start` is 0, the result is therefore the NSB law, equation (16) of the paper. If w
    satisfies a set-based task, the projection on this task is w itself. Of `settings`, the function uses only the
    damping and the cut-off.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, Settings, nsb_sweep
        >>> away = Level("away", np.array([[1.0, 0.0]]), np.array([0.0]))
        >>> goal = Level("goal", np.eye(2), np.array([0.3, 0.4]))
        >>> damped = Settings(damping=0.5)
        >>> [nsb_sweep([away, goal], start=np.zeros(2), settings=s).round(3).tolist() for s in (Settings(), damped)]
        [[0.0, 0.4], [0.048, 0.32]]
    """
    w = start
    for level in reversed(levels):
        w = _onto(level, w, settings)
    return w


def without_rows(levels: Sequence[Level], *, width: int, settings: Settings = _PLAIN) -> Array:
    """Return the velocity (width,) of the priority mode without limits: sweeps of the NSB law, or strict priority.

    Strict priority is v ← v + (J N)⁺(x − J v) for one level after another, with its Jacobian J, its desired rate x, and
    the null-space projector N of all levels above (Siciliano and Slotine 1991). Small singular values of J N relative
    to ‖J‖ count as 0.
    """
    v = np.zeros(width)
    if settings.mode == "lexicographic":
        reached = solve_cascade(levels, v, Polyhedron.none(width), backend="daqp", cutoff=settings.cutoff)
        return v if reached is None else reached.v
    for _ in range(settings.sweeps):
        v = nsb_sweep(levels, start=v, settings=settings)
    return v


def _onto(level: Level, w: Array, settings: Settings) -> Array:
    damping = settings.damping
    if level.is_goal and damping == 0.0:
        return project(w, level.J, x=level.x, cutoff=settings.cutoff)
    if level.is_goal or level.J.shape[0] == 1:
        # not by the Gram matrix: after squaring, λ would be lost next to a Jacobian 1e8 times as large
        left, s, right = np.linalg.svd(level.J, full_matrices=False)
        if damping == 0.0 and s[0] <= ZERO_ROW:
            return w
        moved: Array = w + right.T @ (left.T @ level.miss(w) * (s / (s**2 + damping**2)))
        return moved
    rows = Polyhedron.none(w.size)
    if damping == 0.0:
        reached = solve_cascade([level], w, rows, backend="daqp", cutoff=settings.cutoff)
        return w if reached is None else reached.v
    return damped_point(level, w, rows, damping=damping, inside=w).v


def damped_point(level: Level, w: Array, rows: Polyhedron, *, damping: float, inside: Array) -> LevelSolution:
    """Minimise λ²‖v − w‖² + ‖residual of the level‖² over v subject to the limits; λ = `damping` > 0, w (n,).

    `inside` (n,) is a velocity that satisfies the limits. The returned Lagrange multipliers are those of half this
    cost.
    """
    n, pull = w.size, damping * w
    both = Level(
        level.name,
        np.vstack([level.J, damping * np.eye(n)]),
        np.append(level.lower, pull),
        np.append(level.high, pull),
    )
    return solve_level(both, inside, rows, freedom=Freedom.whole(n), cutoff=_NOTHING)
