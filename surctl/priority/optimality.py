"""An independent check of a solution: the optimality conditions, evaluated from v and the problem alone.

Each condition states that a vector is a non-negative combination of the outward normals of the rows. Rows away from v
must have weight 0: the sum of weight times distance is the duality gap, which gives one more equation. The test is
a non-negative least-squares problem (Lawson and Hanson 1974), which shares no code with the QP solvers.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.nsb import nsb
from surctl.priority.polyhedron import Polyhedron, polyhedron_of
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.settings import Settings
from surctl.priority.sweep import nsb_sweep, without_rows
from surctl.tasks.limits import Kind

__all__ = ["is_optimal"]

Array: TypeAlias = NDArray[np.float64]


def is_optimal(v: Array, problem: PriorityProblem, *, settings: Settings, target: Array, tol: float = 1e-6) -> bool:
    """Whether v (n,) is optimal for the mode, within `tol` relative to 1 + the size of the compared values.

    In mode nsb, v must equal the printed law (16), or the result of its sweeps. In the other modes: (a) no actuator row
    is violated; (b) the violation of the barrier rows, then of the set rows, cannot be smaller; (c) for every strict
    level, no v in the relaxed set that preserves the higher levels meets the level better; (d) no v that preserves all
    of them is nearer to `target` (n,), the target of the mode (computed from the problem alone; for several sweeps of
    "projected" it is only checked to be finite).
    """
    if v.shape != (problem.width,) or not np.isfinite(v).all():
        return False
    if not _is_target(target, problem, settings, tol):
        return False
    if settings.mode == "nsb":
        return _close(v, target, tol)
    allowed = _least_relaxed(v, polyhedron_of(problem), tol)
    if allowed is None:
        return False
    normals, gaps = _bounds(allowed, v)
    first = problem.levels[0]
    if settings.mode == "projected" and settings.damping > 0.0:
        pull = settings.damping**2 * (target - v) + first.J.T @ first.miss(v)
        return _in_cone(pull / max(1.0, _size(first)) ** 2, normals, gaps, tol)
    for level in problem.levels[: {"filter": 0, "projected": 1}.get(settings.mode)]:
        if not _in_cone(level.J.T @ level.miss(v) / _size(level) ** 2, normals, gaps, tol):
            return False
        normals, gaps = _frozen(level, v, normals, gaps, tol)
    return _in_cone(target - v, normals, gaps, tol)


def _is_target(target: Array, problem: PriorityProblem, settings: Settings, tol: float) -> bool:
    """Whether the point is the start of the mode's last projection."""
    n = problem.width
    if settings.mode == "lexicographic":
        return not target.any()
    if settings.mode == "projected":
        if settings.sweeps > 1:
            return bool(np.isfinite(target).all())
        return _close(target, nsb_sweep(problem.levels[1:], start=np.zeros(n), settings=settings), tol)
    plain = settings.sweeps == 1 and settings.damping == 0.0 and all(level.is_goal for level in problem.levels)
    if plain:
        return _close(target, nsb(problem, cutoff=settings.cutoff), tol)
    return _close(target, without_rows(problem.levels, width=n, settings=settings), tol)


def _close(v: Array, expected: Array, tol: float) -> bool:
    return bool(np.abs(v - expected).max() <= tol * (1.0 + np.abs(expected).max()))


def _size(level: Level) -> float:
    return float(np.abs(level.J).max(initial=1.0))


def _frozen(level: Level, v: Array, normals: Array, gaps: Array, tol: float) -> tuple[Array, Array]:
    """Add the normals of the level's rows: both signs where the value is fixed, otherwise those of its bounds."""
    J = level.J / _size(level)
    fixed = level.exact | (np.abs(level.miss(v)) > tol * (1.0 + np.abs(level.J @ v)))
    value = level.J @ v
    above, below = ~fixed & np.isfinite(level.high), ~fixed & np.isfinite(level.lower)
    slack = np.concatenate([level.high[above] - value[above], value[below] - level.lower[below]]) / _size(level)
    return (
        np.vstack([normals, J[fixed], -J[fixed], J[above], -J[below]]),
        np.concatenate([gaps, np.zeros(2 * int(fixed.sum())), np.maximum(slack, 0.0)]),
    )


def _least_relaxed(v: Array, rows: Polyhedron, tol: float) -> Polyhedron | None:
    """The rows relaxed by their violation at v, if no smaller relaxation is feasible; None otherwise."""
    slack = tol * (1.0 + float(np.abs(v).max(initial=0.0)))
    missed = rows.violation(v)
    if missed[rows.mask("actuator")].max(initial=0.0) > slack:
        return None
    harder: tuple[Kind, ...] = ("actuator",)
    kinds: tuple[Kind, ...] = ("barrier", "set")
    for kind in kinds:
        chosen = rows.mask(kind)
        by = float(missed[chosen].max(initial=0.0))
        rows = rows.relaxed(chosen, by)
        if by > slack and not _cannot_be_less(v, rows, chosen, rows.mask(*harder), tol):
            return None
        harder = (*harder, kind)
    return rows


def _cannot_be_less(v: Array, rows: Polyhedron, soft: NDArray[np.bool_], hard: NDArray[np.bool_], tol: float) -> bool:
    """Farkas certificate: normals of soft rows, with weights that sum to 1, balance normals of hard rows."""
    pushing, near = _bounds(rows, v, soft)
    holding, far = _bounds(rows, v, hard)
    weight = np.append(np.ones(near.size), np.zeros(far.size))
    goal = np.append(np.zeros(v.size), 1.0)
    normals = np.column_stack([np.vstack([pushing, holding]), weight])
    return _in_cone(goal, normals, np.append(near, far), tol)


def _bounds(rows: Polyhedron, v: Array, chosen: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
    """Outward normals (p, n) of all finite bounds of the chosen rows, and the distance (p,) of v from each bound."""
    value = rows.A @ v
    above, below = np.isfinite(rows.upper), np.isfinite(rows.lower)
    if chosen is not None:
        above, below = above & chosen, below & chosen
    normals = np.vstack([rows.A[above], -rows.A[below]])
    gaps = np.append((rows.upper - value)[above], (value - rows.lower)[below])
    return normals, np.maximum(gaps, 0.0)


def _in_cone(goal: Array, normals: Array, gaps: Array, tol: float) -> bool:
    """Whether goal (d,) is a non-negative combination of normals (p, d) with the sum of weight · gap equal to 0."""
    from scipy.optimize import nnls

    size = float(np.abs(goal).max(initial=0.0))
    if size <= tol:
        return True
    if gaps.size == 0:
        return False
    _, distance = nnls(np.vstack([normals.T, gaps]), np.append(goal / size, 0.0))
    return bool(distance * size <= tol * (1.0 + size))
