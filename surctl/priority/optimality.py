"""An independent check that a velocity v is optimal, computed from v and the priority problem alone.

Each optimality condition states that a vector is a combination, with weights ≥ 0, of the outward normals of the
constraint rows. Constraints that are not active at v must have weight 0. One more equation ensures this: the sum of
weight times distance from v, which is the duality gap, must be 0. The check finds the weights as a non-negative
least-squares problem (Lawson and Hanson 1974) and shares no code with the QP solvers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.problem import Level, Limits, PriorityProblem
from surctl.priority.reference import target_of
from surctl.priority.settings import Settings

Array: TypeAlias = NDArray[np.float64]

LOSS = 1e-7
"""A residual r counts as optimal if it is at most LOSS·(s + r) above its minimum, with s = max(1, max |entry of J|).

For the distance to the target, s is 1; the opening of limits t may be LOSS·(1 + t) above its minimum."""

ROUNDING = 1e-15
"""Relative error of the limits and Jacobians that this bound takes into account."""


def is_optimal(v: Array, problem: PriorityProblem, *, settings: Settings, target: Array, tol: float = 1e-6) -> bool:
    """Return whether v (n,) is optimal for the priority mode, within `tol`·(1 + size of the compared quantities).

    In mode nsb, v must equal the NSB law, equation (16) of the paper. In the other modes, four conditions must hold.
    (a) v violates no actuator limit. (b) The largest violation of barrier and set limits, for rows of length 1, cannot
    be smaller. (c) For every strict level, no other velocity that satisfies the relaxed limits and preserves the higher
    levels meets this level better. (d) No velocity that preserves all strict levels is nearer to `target` (n,), the
    velocity that the mode approaches last. The function also computes this target from the problem and compares.
    """
    if v.shape != (problem.width,) or not np.isfinite(v).all():
        return False
    if not _close(target, target_of(problem, settings), tol):
        return False
    if settings.mode == "nsb":
        return _close(v, target, tol)
    return is_least(v, problem, settings=settings, target=target, tol=tol)


def is_least(v: Array, problem: PriorityProblem, *, settings: Settings, target: Array, tol: float) -> bool:
    """Return whether conditions (a) to (d) of `is_optimal` hold for this target; the mode is not nsb."""
    rows = problem.limits
    slack = tol * (1.0 + float(np.abs(v).max(initial=0.0)))
    missed = rows.violation(v)
    if missed[~rows.soft].max(initial=0.0) > slack:
        return False
    by = float(missed[rows.soft].max(initial=0.0))
    rows = rows.relaxed(by)
    if by > slack and not _conflict(v, rows)[1] <= tol:
        return False
    return all(
        _is_least(one.pull, one.square, v, one.faces.normals, one.faces.gaps, tol)
        for one in _objectives(v, problem, settings, target, _bounds(rows, v), tol)
    )


@dataclass(frozen=True, eq=False)
class _Faces:
    """Outward normals (p, n) of bounds, the distances (p,) of v from them, and their names and signed lengths (p,)."""

    normals: Array
    gaps: Array
    names: tuple[str, ...]
    lengths: Array  # of the row as written, positive at an upper bound

    def near(self, most: float) -> _Faces:
        """Return the faces that v is at most this far from."""
        at = np.flatnonzero(self.gaps <= most)
        return _Faces(self.normals[at], self.gaps[at], tuple(self.names[i] for i in at), self.lengths[at])


@dataclass(frozen=True, eq=False)
class _Objective:
    """One objective ½r² of a mode at v: the level (None for the distance to the target), −∇(½r²), r², the bounds.

    `scale` is the factor between the objective and the one in the units of the level.
    """

    level: Level | None
    pull: Array
    square: float
    faces: _Faces
    scale: float


def _objectives(
    v: Array, problem: PriorityProblem, settings: Settings, target: Array, faces: _Faces, tol: float
) -> Iterator[_Objective]:
    """Yield the objectives of the mode in their order; each is minimised with the values of those above fixed."""
    first = problem.levels[0]
    if settings.mode == "projected" and settings.damping > 0.0:
        size = _size(first)
        weight, rest = (settings.damping / size) ** 2, first.miss(v) / size
        pull = weight * (target - v) + first.J.T @ rest / size
        square = weight * ((target - v) ** 2).sum() + (rest**2).sum()
        yield _Objective(None, pull, float(square), faces, size * size)
        return
    for level in problem.levels[: {"filter": 0, "projected": 1}.get(settings.mode)]:
        size = _size(level)
        rest = level.miss(v) / size
        yield _Objective(level, level.J.T @ rest / size, float((rest**2).sum()), faces, size * size)
        faces = _frozen(level, v, faces, tol)
    yield _Objective(None, target - v, float(((target - v) ** 2).sum()), faces, 1.0)


_NEAR = 1e-7  # times 1 + max |v|: a limit whose bound is this near may be active
_FELT = 1e-9


def restrictions(
    v: Array, problem: PriorityProblem, *, settings: Settings, target: Array
) -> list[tuple[str | None, dict[str, float]]]:
    """Return, for each objective of the mode, the limits that restrict it, with their Lagrange multipliers.

    The objective is the name of a strict level, for min ½‖J v − x‖² of this level, or None for min ½‖v − target‖². The
    multipliers are those of the rows as written, positive at an upper bound and negative at a lower one.
    """
    if settings.mode == "nsb":
        return []
    rows = problem.limits
    rows = rows.relaxed(float(rows.violation(v)[rows.soft].max(initial=0.0)))
    size = 1.0 + float(np.abs(v).max())
    result: list[tuple[str | None, dict[str, float]]] = []
    for one in _objectives(v, problem, settings, target, _bounds(rows, v), _FELT):
        faces, largest = one.faces.near(_NEAR * size), float(np.abs(one.pull).max())
        if not largest > _FELT * size:
            continue
        weights, _ = _cone(one.pull / largest, faces.normals, faces.gaps)
        weights = weights * largest
        held = {
            faces.names[i]: float(weights[i] * one.scale / faces.lengths[i])
            for i in np.flatnonzero(weights > _FELT * size)
            if faces.names[i]
        }
        result.append((one.level.name if one.level else None, held))
    return result


def conflicting(v: Array, problem: PriorityProblem) -> tuple[str, ...]:
    """Return the names of limits that contradict each other, so that barrier and set limits must be relaxed as by v."""
    rows = problem.limits
    by = float(rows.violation(v)[rows.soft].max(initial=0.0))
    if by <= _NEAR * (1.0 + float(np.abs(v).max())):
        return ()
    names = _conflict(v, rows.relaxed(by))[0]
    return tuple(row.name for row in problem.rows if row.name in names)


def _close(v: Array, expected: Array, tol: float) -> bool:
    return bool(np.abs(v - expected).max() <= tol * (1.0 + np.abs(expected).max()))


def _size(level: Level) -> float:
    return float(np.abs(level.J).max(initial=1.0))


def _frozen(level: Level, v: Array, faces: _Faces, tol: float) -> _Faces:
    """Append the level's outward normals (both signs for a fixed entry of J v) and the distances of v from them."""
    size = _size(level)
    J, value = level.J / size, level.J @ v
    fixed = level.exact | (np.abs(level.miss(v)) > tol * (1.0 + np.abs(value)))
    above, below = ~fixed & np.isfinite(level.high), ~fixed & np.isfinite(level.lower)
    slack = np.concatenate([level.high[above] - value[above], value[below] - level.lower[below]]) / size
    place = [*np.flatnonzero(above), *np.flatnonzero(below)]
    one = level.lower.size == 1
    return _Faces(
        np.vstack([faces.normals, J[fixed], -J[fixed], J[above], -J[below]]),
        np.concatenate([faces.gaps, np.zeros(2 * int(fixed.sum())), np.maximum(slack, 0.0)]),
        (*faces.names, *("",) * 2 * int(fixed.sum()), *(level.name if one else f"{level.name}.{i}" for i in place)),
        np.concatenate(
            [faces.lengths, np.ones(2 * int(fixed.sum())), np.full(above.sum(), size), np.full(below.sum(), -size)]
        ),
    )


def _conflict(v: Array, rows: Limits) -> tuple[set[str], float]:
    """Return limits that show that no velocity violates the soft limits less than v does, and the error of this proof.

    By Farkas' lemma, normals of soft limits, with weights of sum 1, must balance normals of hard ones.
    """
    pushing, holding = _bounds(rows, v, rows.soft), _bounds(rows, v, ~rows.soft)
    weight = np.append(np.ones(pushing.gaps.size), np.zeros(holding.gaps.size))
    goal = np.append(np.zeros(v.size), 1.0)
    normals = np.column_stack([np.vstack([pushing.normals, holding.normals]), weight])
    gaps = np.append(pushing.gaps, holding.gaps)
    weights, rest = _cone(goal, normals, gaps)
    radius = 2.0 * (1.0 + float(np.abs(v).max()))
    names = pushing.names + holding.names
    used = {names[i] for i in np.flatnonzero(weights > _FELT)}
    return used, float(np.abs(rest).max()) * radius + float(weights @ (gaps + ROUNDING * radius))


def _bounds(rows: Limits, v: Array, chosen: NDArray[np.bool_] | None = None) -> _Faces:
    """Return all finite bounds of the chosen limits."""
    value = rows.A @ v
    above, below = (
        np.isfinite(ends) if chosen is None else np.isfinite(ends) & chosen for ends in (rows.upper, rows.lower)
    )
    gaps = np.append((rows.upper - value)[above], (value - rows.lower)[below])
    return _Faces(
        np.vstack([rows.A[above], -rows.A[below]]),
        np.maximum(gaps, 0.0),
        tuple(rows.names[i] for i in (*np.flatnonzero(above), *np.flatnonzero(below))),
        np.append(rows.length[above], -rows.length[below]),
    )


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
