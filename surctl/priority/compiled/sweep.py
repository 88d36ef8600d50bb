"""The NSB law, equation (16) of the paper, as compiled projections, and a check that all inputs are finite."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Step, lower
from surctl.priority.compiled.decomposition import decompose
from surctl.priority.compiled.level_shape import StackShape, SymbolicLevel
from surctl.priority.settings import Settings
from surctl.priority.solver.precision import LONGEST
from surctl.priority.symbolic import projection

__all__ = ["HUGE", "gate", "into", "project", "sweep", "swept"]

HUGE = 1e300
"""Numbers larger than this count as infinite."""


def project(w: ca.SX, level: SymbolicLevel, *, damping: float) -> ca.SX:
    """Return the velocity nearest to w (n, 1) among those that meet the level best; w itself if w meets the level.

    With damping, the formula is that of `symbolic.projection`. Without damping, linearly dependent or contradicting
    rows of the Jacobian are met in the least-squares sense, as with the pseudo-inverse.
    """
    if level.J.shape[0] == 1 or damping > 0.0:
        return projection(w, level.J, level.desired(w), damping=damping)
    parts = decompose(level.J)
    return w + parts.directions().T @ parts.coordinates(level.lower - level.J @ w)


def sweep(shape: StackShape, *, damping: float, highest: int = 0) -> Program:
    """Return a program that projects w (n,) on one level after another, from the lowest up to level index `highest`.

    The inputs are w and the arrays J, lower, upper of all levels; the output is the projected w.
    """
    flat, levels = shape.symbols()
    start = ca.SX.sym("w", shape.n)
    w = start
    for level in reversed(levels[highest:]):
        w = project(w, level, damping=damping)
    return lower(ca.Function("sweep", [start, *flat], [ca.densify(w)]))


def swept(shape: StackShape, settings: Settings) -> tuple[Step, ...]:
    """Return the steps that compute the velocity after `settings.sweeps` sweeps over all levels, from v = 0."""
    one, fixed = sweep(shape, damping=settings.damping), ("J", "lower", "upper")
    if settings.sweeps == 1:
        return (Call(one, ("zero", *fixed), ("swept",)),)
    return (Loop(one, settings.sweeps, ("zero",), ("swept",), fixed=fixed),)


def gate(shape: StackShape) -> Program:
    """Return a program that checks the levels of a step, from the arrays J, lower and upper.

    Outputs: sound (1,), which is 1 if all numbers are finite, lower = upper for levels with one desired value, and
    lower ≤ upper for set-based levels; zero (n,) and none (1,), which are 0.
    """
    # each test is the condition that must hold, because every comparison with a NaN is false
    flat, levels = shape.symbols()
    sound = ca.SX(1)
    for level in levels:
        for entry in ca.vertsplit(ca.vec(level.J)):
            sound = ca.if_else(ca.fabs(entry) <= LONGEST, sound, 0)
        for low, high in zip(ca.vertsplit(level.lower), ca.vertsplit(level.upper), strict=True):
            if level.is_set:
                sound = ca.if_else(low <= high, ca.if_else(low <= HUGE, ca.if_else(high >= -HUGE, sound, 0), 0), 0)
            else:
                sound = ca.if_else(ca.fabs(low) <= HUGE, ca.if_else(ca.eq(low, high), sound, 0), 0)
    return lower(ca.Function("gate", flat, [sound, ca.SX.zeros(shape.n), ca.SX.zeros(1)]))


def into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return the value with each entry clipped to its bounds; an entry is 0 if it would not be finite."""
    moved = []
    for i in range(value.numel()):
        above = ca.if_else(value[i] >= low[i], value[i], low[i])
        inside = ca.if_else(above <= high[i], above, high[i])
        moved.append(ca.if_else(ca.fabs(inside) <= HUGE, inside, 0))
    return ca.vertcat(*moved)
