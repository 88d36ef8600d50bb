"""Least-squares solution of one priority level subject to the velocity limits, by a primal active-set method.

The method starts at a velocity v that satisfies all constraint rows lower ≤ a·v ≤ upper. Every later v satisfies these
rows too, so the method can be stopped after any step. Each step goes to the minimiser on the active constraints, or
ends at the first constraint that the step would violate (Nocedal and Wright 2006, 16.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.priority.freedom import Freedom
from surctl.priority.polyhedron import Polyhedron
from surctl.priority.problem import Level
from surctl.priority.rowspace import row_space

__all__ = ["LevelSolution", "solve_level"]

Array: TypeAlias = NDArray[np.float64]

_CAP = 100
_PATIENT = 20
"""After this many steps, drop the first constraint with a wrong sign, not the worst; this cannot cycle (Bland 1977)."""

_STILL = 1e-14
_WRONG_SIGN = 1e-11


@dataclass(frozen=True, eq=False)
class LevelSolution:
    """A velocity at which the residual of the priority level is as small as the constraint rows allow.

    Attributes:
        v: the velocity (n,).
        multipliers: (m,) Lagrange multiplier of each constraint row in min ½‖residual of the level‖², positive at an
            upper bound, negative at a lower bound.
        iterations: number of active-set steps.
        converged: whether the multipliers have the signs that optimality requires; if not, v satisfies the constraint
            rows but may not be optimal.
    """

    v: Array
    multipliers: Array
    iterations: int
    converged: bool


def solve_level(level: Level, start: Array, rows: Polyhedron, *, freedom: Freedom, cutoff: float) -> LevelSolution:
    """Minimise the residual of a priority level over all velocities in `freedom` that satisfy the constraint rows.

    start: (n,), a velocity in `freedom` that satisfies the constraint rows.
    """
    goal = level.exact
    if goal.all():
        return _least_squares(level.J, level.lower, start, rows, Z=freedom.Z, cutoff=cutoff)
    # a set-based row gets a slack variable: J v + s lies inside the bounds, and the desired s is 0
    slack, n = np.flatnonzero(~goal), start.size
    q = slack.size
    J = np.block([[level.J[goal], np.zeros((int(goal.sum()), q))], [np.zeros((q, n)), np.eye(q)]])
    wide = rows.widened(level.J[slack], level.lower[slack], level.high[slack])
    Z = np.block([[freedom.Z, np.zeros((n, q))], [np.zeros((q, freedom.Z.shape[1])), np.eye(q)]])
    x = np.append(level.lower[goal], np.zeros(q))
    solution = _least_squares(J, x, np.append(start, level.miss(start)[slack]), wide, Z=Z, cutoff=cutoff)
    return LevelSolution(
        solution.v[:n], solution.multipliers[: len(rows.names)], solution.iterations, solution.converged
    )


def _least_squares(J: Array, x: Array, start: Array, rows: Polyhedron, *, Z: Array, cutoff: float) -> LevelSolution:
    """Return the minimiser of ‖J v − x‖ over all v = start + Z y that satisfy the rows, by an active-set method."""
    rows = rows.holding(start)
    scale = float(np.linalg.norm(J, 2))
    v, active, multipliers = start, np.zeros(len(rows.names)), np.zeros(len(rows.names))
    for count in range(1, _CAP + 1):
        held = np.flatnonzero(active)
        A = rows.A[held] @ Z
        basis = Z @ row_space(A, cutoff=1e-13).null.T if held.size else Z
        step = basis @ row_space(J @ basis, cutoff=cutoff, scale=scale).particular(x - J @ v)
        length, blocking = _as_far_as(v, step, rows, active)
        v = v + length * step
        if blocking is not None:
            active[blocking] = np.sign(rows.A[blocking] @ step)
            continue
        gradient = Z.T @ (J.T @ (x - J @ v))
        multipliers = np.zeros(active.size)
        multipliers[held] = np.linalg.lstsq(A.T, gradient, rcond=None)[0] if held.size else 0.0
        wrong = np.flatnonzero(multipliers * active < -_WRONG_SIGN * scale * max(scale, float(np.abs(x - J @ v).max())))
        if wrong.size == 0:
            return LevelSolution(v, multipliers, count, True)
        active[wrong[0] if count > _PATIENT else wrong[np.argmin((multipliers * active)[wrong])]] = 0.0
    return LevelSolution(v, multipliers, _CAP, False)


def _as_far_as(v: Array, step: Array, rows: Polyhedron, active: Array) -> tuple[float, int | None]:
    """Return the largest fraction ≤ 1 of the step that violates no row, and the index of the limiting row, if any."""
    rate = rows.A @ step
    with np.errstate(invalid="ignore"):
        slack = np.where(rate > 0.0, rows.upper, rows.lower) - rows.A @ v
    moving = (active == 0.0) & (np.abs(rate) > _STILL * np.abs(step).max(initial=0.0)) & np.isfinite(slack)
    if not moving.any():
        return 1.0, None
    part = np.full(rate.size, np.inf)
    part[moving] = np.maximum(slack[moving] / rate[moving], 0.0)
    first = int(np.argmin(part))
    return (float(part[first]), first) if part[first] < 1.0 else (1.0, None)
