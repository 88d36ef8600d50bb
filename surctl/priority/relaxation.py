"""Relaxation of limits that contradict each other, by the smallest amount that makes them consistent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.active_set import LevelSolution, solve_level
from surctl.priority.backends import Backend
from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level
from surctl.priority.rowspace import CUTOFF
from surctl.tasks.limits import Kind

__all__ = ["Relaxed", "least_violation"]

Array: TypeAlias = NDArray[np.float64]

_OPEN = 1e-9
"""Limits that are relaxed by at most this amount count as consistent."""


@dataclass(frozen=True, eq=False)
class Relaxed:
    """Result of `least_violation`: constraint rows that were relaxed until they are consistent.

    Attributes:
        rows: the constraint rows, with the bounds of the relaxed ones moved outwards.
        inside: a velocity (n,) that satisfies `rows`.
        iterations: number of iterations of all solvers together.
        opened: whether any limit had to be relaxed; False if a solver reported infeasibility by mistake.
        conflict: names of the limits that contradict each other.
        least: whether the search showed that no smaller relaxation is possible.
    """

    rows: Polyhedron
    inside: Array
    iterations: int
    opened: bool
    conflict: tuple[str, ...]
    least: bool


def least_violation(rows: Polyhedron, start: Array, *, backend: Backend) -> Relaxed | None:
    """Relax barrier limits, then limits of set-based tasks, each kind by the smallest uniform amount.

    The amount applies to constraint rows scaled to length 1. Return None if the actuator limits contradict each other,
    or if no solver finds a solution. `start` is a velocity (n,).
    """
    firm = rows.only(rows.mask("actuator"))
    solution = Freedom.whole(start.size).nearest(start, firm, backend=backend)
    if solution.x is None:
        return None
    inside, iterations, least = solution.x, solution.iterations, True
    conflict: dict[str, None] = {}
    hard: tuple[Kind, ...] = ("actuator",)
    kinds: tuple[Kind, ...] = ("barrier", "set")
    for kind in kinds:
        inside, by, search, names = _least_uniform(rows, kind, hard, inside)
        iterations += search.iterations
        least &= search.converged
        if by > _OPEN:
            conflict |= dict.fromkeys(names)
        rows = rows.relaxed(rows.mask(kind), by)
        hard = (*hard, kind)
    return Relaxed(rows.holding(inside), inside, iterations, bool(conflict), tuple(conflict), least)


def _least_uniform(
    rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...], inside: Array
) -> tuple[Array, float, LevelSolution, tuple[str, ...]]:
    """Return v, the least t ≥ 0 by which limits of `kind` must be relaxed, the solution, and the limits that set t.

    The minimisation of t is solved as a task in the variables (v, t) with desired value t = 0. `inside` is a velocity
    that satisfies the limits of the kinds `hard`.
    """
    n = inside.size
    close = Level("opening", np.eye(1, n + 1, n), np.zeros(1))
    start = np.append(inside, rows.violation(inside)[rows.mask(kind)].max(initial=0.0))
    opening = _opening(rows, kind, hard)
    solution = solve_level(close, start, opening, freedom=Freedom.whole(n + 1), cutoff=CUTOFF)
    names = tuple(opening.names[i] for i in np.flatnonzero(solution.multipliers))
    return solution.v[:n], max(float(solution.v[n]), 0.0), solution, names


def _opening(rows: Polyhedron, kind: Kind, hard: tuple[Kind, ...]) -> Polyhedron:
    """Return constraints on (v, t): limits of the kinds `hard`, and limits of `kind` with both bounds widened by t."""
    keep, soft = np.flatnonzero(rows.mask(*hard)), np.flatnonzero(rows.mask(kind))
    order = np.concatenate([keep, soft, soft])
    none = np.full(soft.size, np.inf)
    slope = np.concatenate([np.zeros(keep.size), -np.ones(soft.size), np.ones(soft.size)])
    lower = np.concatenate([rows.lower[keep], -none, rows.lower[soft]])
    upper = np.concatenate([rows.upper[keep], rows.upper[soft], none])
    unbounded = np.full(rows.A.shape[1] + 1, np.inf)
    return Polyhedron(
        A=np.column_stack([rows.A[order], slope]),
        lower=lower,
        upper=upper,
        length=np.ones(order.size),
        kinds=tuple(rows.kinds[i] for i in order),
        names=tuple(rows.names[i] for i in order),
        box=(-unbounded, unbounded),
    )
