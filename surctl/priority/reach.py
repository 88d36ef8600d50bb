"""What the rows leave: the best value of a task inside them, and the least violation when they contradict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.backends import solve_least_distance
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level
from surctl.priority.rowspace import row_space
from surctl.tasks.limits import Kind

__all__ = ["Attainable", "Relaxed", "least_violation", "nearest_attainable"]

Array: TypeAlias = NDArray[np.float64]

_DELTA = 1e-2
"""Weight of the distance term, relative to ‖J‖: makes the problem a least-distance one (see below)."""

_ROUNDS = 20
_SETTLED = 1e-12
_ROOM = 1e-8
"""Room [row of length 1] for a set that is not empty but has no inside."""

_OPEN = 1e-9
"""Rows that open by no more than this were consistent all along."""


@dataclass(frozen=True, eq=False)
class Attainable:
    """A point where a task is met as well as the rows allow; multipliers (m,) of ½‖J v − x‖²."""

    v: Array
    multipliers: Array
    iterations: int


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Rows that are consistent again, a point inside them, and whether any had to open (a solver may err)."""

    rows: Polyhedron
    inside: Array
    iterations: int
    opened: bool


def nearest_attainable(
    task: Level, start: Array, rows: Polyhedron, *, backend: str, inside: Array | None = None
) -> Attainable | None:
    """argmin ‖J v − x‖ over the rows, near `start` (n,); None if no v keeps the rows.

    Proximal-point iteration (Rockafellar 1976): min ‖J v − x‖² + δ²‖v − v_i‖² in the variables L Vᵀ v of the
    singular value decomposition, where it is a least-distance problem. The error falls by δ²/(σ² + δ²) a
    round. `inside` is a point known to keep the rows: with it the answer is never None. A set without inside
    is then still called empty now and then (by dual solvers), and gets a little room in rows that may give.
    """
    if inside is None:
        return _proximal(task, start, rows, backend)
    kept = rows.holding(inside)
    return (
        _proximal(task, start, kept, backend)
        or _proximal(task, start, kept.relaxed(rows.mask("barrier", "set"), _ROOM), backend)
        or Attainable(inside, np.zeros(len(rows.names)), 0)
    )


def _proximal(task: Level, start: Array, rows: Polyhedron, backend: str) -> Attainable | None:
    """The iteration; None if the solver calls the rows infeasible or fails in its first round."""
    scale, basis, pull, size = _axes(task)
    A = rows.A @ basis / scale
    best, centre, iterations = None, start, 0
    for _ in range(_ROUNDS):
        target = (pull + _DELTA**2 * (basis.T @ centre)) / scale
        answer = solve_least_distance(target, A=A, lower=rows.lower, upper=rows.upper, backend=backend)
        iterations += answer.iterations
        if answer.x is None:
            break
        v = basis @ (answer.x / scale)
        best = Attainable(v, answer.multipliers * np.square(size), iterations)
        if np.abs(task.J @ (v - centre)).max() <= _SETTLED * size * (1.0 + np.abs(v).max()):
            break
        centre = v
    return best


def _axes(task: Level) -> tuple[Array, Array, Array, float]:
    """Diagonal L (n,), basis V (n, n), VᵀJᵀx (n,), and ‖J‖ (1 for a task that is switched off).

    L and VᵀJᵀx are those of the task divided by ‖J‖.
    """
    space = row_space(task.J)
    size = float(space.s[0]) if space.s.size else 1.0
    basis = np.vstack([space.rows, space.null]).T
    singular = np.zeros(basis.shape[1])
    singular[: space.s.size] = space.s / size
    pull = np.zeros(basis.shape[1])
    pull[: space.s.size] = space.s / size * (space.left.T @ (task.x / size))
    return np.sqrt(singular**2 + _DELTA**2), basis, pull, size


def least_violation(rows: Polyhedron, start: Array, *, backend: str) -> Relaxed | None:
    """Relax barrier rows, then rows of set-based tasks, each by the least uniform amount [row of length 1].

    None if the actuator rows contradict each other, or no solver answers.
    """
    hard: tuple[Kind, ...] = ("actuator",)
    firm = rows.mask(*hard)
    answer = solve_least_distance(
        start, A=rows.A[firm], lower=rows.lower[firm], upper=rows.upper[firm], backend=backend
    )
    if answer.x is None:
        return None
    inside, iterations, opened = answer.x, answer.iterations, False
    kinds: tuple[Kind, ...] = ("barrier", "set")
    for kind in kinds:
        inside, by, spent = _least_uniform(rows, kind, hard, inside, backend)
        iterations += spent
        opened = opened or by > _OPEN
        rows = rows.relaxed(rows.mask(kind), by)
        hard = (*hard, kind)
    return Relaxed(rows.holding(inside), inside, iterations, opened)


def _least_uniform(
    rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...], inside: Array, backend: str
) -> tuple[Array, float, int]:
    """A point, the least t ≥ 0 by which the rows of `kind` must open so that it exists, and iterations.

    Itself a task over (v, t): t should be 0. `inside` keeps the hard rows.
    """
    n = inside.size
    close = Level("opening", np.eye(1, n + 1, n), np.zeros(1))
    wide = np.append(inside, rows.violation(inside)[rows.mask(kind)].max(initial=0.0))
    found = nearest_attainable(close, np.append(inside, 0.0), _opening(rows, kind, hard), backend=backend, inside=wide)
    if found is None:  # cannot be: `wide` keeps every row
        return inside, float(wide[n]), 0
    return found.v[:n], max(float(found.v[n]), 0.0), found.iterations


def _opening(rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...]) -> Polyhedron:
    """Rows over (v, t): hard ones as they are, those of `kind` open by t at both ends, and t ≥ 0."""
    keep, soft = np.flatnonzero(rows.mask(*hard)), np.flatnonzero(rows.mask(kind))
    order = np.concatenate([keep, soft, soft])
    none = np.full(soft.size, np.inf)
    slope = np.concatenate([np.zeros(keep.size), -np.ones(soft.size), np.ones(soft.size)])
    A = np.vstack([np.column_stack([rows.A[order], slope]), np.eye(1, rows.A.shape[1] + 1, rows.A.shape[1])])
    lower = np.concatenate([rows.lower[keep], -none, rows.lower[soft], [0.0]])
    upper = np.concatenate([rows.upper[keep], rows.upper[soft], none, [np.inf]])
    names = (*(rows.names[i] for i in order), "opening")
    kinds: tuple[Kind, ...] = (*(rows.kinds[i] for i in order), "actuator")
    unbounded = np.full(rows.A.shape[1] + 1, np.inf)
    return Polyhedron(A, lower, upper, np.ones(len(names)), kinds, names, (-unbounded, unbounded))
