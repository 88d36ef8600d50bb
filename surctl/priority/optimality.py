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

from surctl.errors import InputError
from surctl.priority.cascade import nsb_sweep, without_rows
from surctl.priority.polyhedron import Polyhedron, polyhedron_of
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.rowspace import CUTOFF, row_space
from surctl.priority.settings import Settings
from surctl.tasks.limits import Kind

__all__ = ["LOSS", "ROUNDING", "is_least", "is_optimal", "nsb"]


def nsb(problem: PriorityProblem, *, cutoff: float = CUTOFF) -> NDArray[np.float64]:
    """Return the velocity v (n,) of the NSB law, equation (16) of the paper: v = v_1 + N_1(v_2 + N_2(v_3 + …)).

    Here v_i = J_i⁺x_i is the velocity for task i alone, J_i is its Jacobian, x_i its desired rate, and N_i = I −
    J_i⁺J_i the projector on the null space of J_i. Singular values of J_i below `cutoff`·‖J_i‖ count as 0. The law
    ignores limits.

    Raises:
        InputError: a level is set-based; equation (16) has no set-based tasks.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, build_problem, nsb
        >>> away = Level("away", np.array([[1.0, 0.0]]), np.array([0.0]))
        >>> goal = Level("goal", np.eye(2), np.array([0.3, 0.4]))
        >>> [nsb(build_problem(order)).round(3).tolist() for order in ([away, goal], [goal, away])]
        [[0.0, 0.4], [0.3, 0.4]]
    """
    v = np.zeros(problem.width)
    for level in reversed(problem.levels):
        if not level.is_goal:
            raise InputError(
                "is set-based, and the printed law has no such task", key=f"task {level.name}", remedy="use solve"
            )
        J_plus = row_space(level.J, cutoff=cutoff).pinv()
        N = np.eye(problem.width) - J_plus @ level.J
        v = J_plus @ level.x + N @ v
    return v


Array: TypeAlias = NDArray[np.float64]

LOSS = 1e-7
"""A residual r counts as optimal if it is at most LOSS·(s + r) above its minimum, with s = max(1, max |entry of J|).

For the distance to the target, s is 1; the opening of limits t may be LOSS·(1 + t) above its minimum."""

ROUNDING = 1e-15
"""Relative error of the limits and Jacobians that this bound takes into account."""


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
    return is_least(v, problem, settings=settings, target=target, tol=tol)


def is_least(v: Array, problem: PriorityProblem, *, settings: Settings, target: Array, tol: float) -> bool:
    """Return whether conditions (a) to (d) of `is_optimal` hold for this target; the mode is not nsb."""
    allowed = _least_relaxed(v, polyhedron_of(problem), tol)
    if allowed is None:
        return False
    normals, gaps = _bounds(allowed, v)
    first = problem.levels[0]
    if settings.mode == "projected" and settings.damping > 0.0:
        weight, rest = (settings.damping / _size(first)) ** 2, first.miss(v) / _size(first)
        pull = weight * (target - v) + first.J.T @ rest / _size(first)
        return _is_least(pull, weight * ((target - v) ** 2).sum() + (rest**2).sum(), v, normals, gaps, tol)
    for level in problem.levels[: {"filter": 0, "projected": 1}.get(settings.mode)]:
        rest = level.miss(v) / _size(level)
        if not _is_least(level.J.T @ rest / _size(level), (rest**2).sum(), v, normals, gaps, tol):
            return False
        normals, gaps = _frozen(level, v, normals, gaps, tol)
    return _is_least(target - v, ((target - v) ** 2).sum(), v, normals, gaps, tol)


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
    gaps = np.append(near, far)
    weights, rest = _cone(goal, normals, gaps)
    radius = 2.0 * (1.0 + float(np.abs(v).max()))
    return bool(float(np.abs(rest).max()) * radius + weights @ (gaps + ROUNDING * radius) <= tol)


def _bounds(rows: Polyhedron, v: Array, chosen: NDArray[np.bool_] | None = None) -> tuple[Array, Array]:
    """Return the outward normals (p, n) of all finite bounds of the chosen rows, and the distances (p,) of v."""
    value = rows.A @ v
    above, below = np.isfinite(rows.upper), np.isfinite(rows.lower)
    if chosen is not None:
        above, below = above & chosen, below & chosen
    normals = np.vstack([rows.A[above], -rows.A[below]])
    gaps = np.append((rows.upper - value)[above], (value - rows.lower)[below])
    return normals, np.maximum(gaps, 0.0)


def _is_least(pull: Array, square: float, v: Array, normals: Array, gaps: Array, tol: float) -> bool:
    """Return whether r = √`square`, with −∇(½r²) = `pull` (n,), is at most tol·(1 + r) above its minimum.

    The weights u of any sum Σ u·normal bound the decrease of ½r² for velocities at a distance of at most D from v: by
    |pull − Σ u·normal|·D + Σ u·gap. What rounding may change, ε·D·Σ u, is added.
    """
    value, radius, size = float(np.sqrt(square)), 2.0 * (1.0 + float(np.abs(v).max())), float(np.abs(pull).max())
    allowed = 0.5 * tol * value * (1.0 + value)
    if value <= tol or size * radius <= allowed:
        return True
    weights, rest = _cone(pull / size, normals, gaps)
    return bool(size * (float(np.sqrt(rest @ rest)) * radius + weights @ (gaps + ROUNDING * radius)) <= allowed)


def _cone(goal: Array, normals: Array, gaps: Array) -> tuple[Array, Array]:
    """Return weights u (p,) ≥ 0 with Σ u·gap small, and the part of `goal` (d,) that Σ u·normal, (p, d), leaves."""
    from scipy.optimize import nnls

    if gaps.size == 0:
        return np.zeros(0), goal
    try:
        weights, _ = nnls(np.vstack([normals.T, gaps]), np.append(goal, 0.0))
    except RuntimeError:  # too many iterations
        return np.zeros(gaps.size), goal
    return weights, goal - normals.T @ weights
