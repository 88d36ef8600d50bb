"""An independent check that a velocity v is optimal, computed from v and the priority problem alone.

Each optimality condition states that a vector is a combination, with weights ≥ 0, of the outward normals of the
constraint rows. Constraints that are not active at v must have weight 0. One more equation ensures this: the sum of
weight times distance from v, which is the duality gap, must be 0. The check finds the weights as a non-negative
least-squares problem (Lawson and Hanson 1974) and shares no code with the QP solvers.
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
    """Return whether v (n,) is optimal for the priority mode, within `tol`·(1 + size of the compared quantities).

    In mode nsb, v must equal the NSB law, equation (16) of the paper, or the result of its repeated sweeps. In the
    other modes, four conditions must hold. (a) v violates no actuator limit. (b) The violation of the barrier limits,
    and then the violation of the set limits, cannot be smaller. (c) For every strict level, no other velocity that
    satisfies the relaxed limits and preserves the higher levels meets this level better. (d) No velocity that preserves
    all strict levels is nearer to `target` (n,), the velocity that the mode approaches last. The function also computes
    this target from the problem and compares; in mode projected with several sweeps, it only checks that `target` is
    finite.
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
    """Return whether `target` is the velocity that the mode in the settings approaches last."""
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
    """Append the level's outward normals (both signs for a fixed entry of J v) and the distances of v from them."""
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
    """Return the constraint rows relaxed so far that v satisfies them; None if a smaller relaxation is feasible."""
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
    """Return whether no velocity violates the soft constraint rows less than v does (by Farkas' lemma)."""
    # normals of soft rows, with weights of sum 1, must balance normals of hard rows
    pushing, near = _bounds(rows, v, soft)
    holding, far = _bounds(rows, v, hard)
    weight = np.append(np.ones(near.size), np.zeros(far.size))
    goal = np.append(np.zeros(v.size), 1.0)
    normals = np.column_stack([np.vstack([pushing, holding]), weight])
    return _in_cone(goal, normals, np.append(near, far), tol)


def _bounds(rows: Polyhedron, v: Array, chosen: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
    """Return the outward normals (p, n) of all finite bounds of the chosen rows, and the distances (p,) of v."""
    value = rows.A @ v
    above, below = np.isfinite(rows.upper), np.isfinite(rows.lower)
    if chosen is not None:
        above, below = above & chosen, below & chosen
    normals = np.vstack([rows.A[above], -rows.A[below]])
    gaps = np.append((rows.upper - value)[above], (value - rows.lower)[below])
    return normals, np.maximum(gaps, 0.0)


def _in_cone(goal: Array, normals: Array, gaps: Array, tol: float) -> bool:
    """Return whether `goal` (d,) is a sum of the normals (p, d) with weights ≥ 0 that satisfy Σ weight · gap = 0."""
    from scipy.optimize import nnls

    size = float(np.abs(goal).max(initial=0.0))
    if size <= tol:
        return True
    if gaps.size == 0:
        return False
    _, distance = nnls(np.vstack([normals.T, gaps]), np.append(goal / size, 0.0))
    return bool(distance * size <= tol * (1.0 + size))
