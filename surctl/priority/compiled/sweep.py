"""The sweep of projections as instruction lists, and a check that all inputs of a step are finite."""

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
    """The point nearest to w (n, 1) among those that meet the level best; if w meets the bounds, that is w itself.

    With damping the formula is that of `symbolic.projection`. Without damping, several rows are decomposed, so that
    dependent and contradicting rows are met in the least-squares sense, as with the pseudo-inverse.
    """
    if level.J.shape[0] == 1 or damping > 0.0:
        return projection(w, level.J, level.desired(w), damping=damping)
    parts = decompose(level.J)
    return w + parts.directions().T @ parts.coordinates(level.lower - level.J @ w)


def sweep(shape: StackShape, *, damping: float, highest: int = 0) -> Program:
    """(w (n,), J, lower, upper) → w after one sweep from the lowest level up to number `highest` (0 is the first)."""
    flat, levels = shape.symbols()
    start = ca.SX.sym("w", shape.n)
    w = start
    for level in reversed(levels[highest:]):
        w = project(w, level, damping=damping)
    return lower(ca.Function("sweep", [start, *flat], [ca.densify(w)]))


def swept(shape: StackShape, settings: Settings) -> tuple[Step, ...]:
    """Steps that compute `swept` from `zero`, J, lower, upper, with the set number of sweeps one after another."""
    one, fixed = sweep(shape, damping=settings.damping), ("J", "lower", "upper")
    if settings.sweeps == 1:
        return (Call(one, ("zero", *fixed), ("swept",)),)
    return (Loop(one, settings.sweeps, ("zero",), ("swept",), fixed=fixed),)


def gate(shape: StackShape) -> Program:
    """(J, lower, upper) → sound (1,), zero (n,), none (1,).

    sound: 1 if all numbers are finite, lower = upper for levels with one value, and lower ≤ upper for the others. The
    test states what must hold, because every comparison with a NaN is false.
    """
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
    """The value moved between the bounds, entry by entry; 0 where the result would not be finite."""
    moved = []
    for i in range(value.numel()):
        above = ca.if_else(value[i] >= low[i], value[i], low[i])
        inside = ca.if_else(above <= high[i], above, high[i])
        moved.append(ca.if_else(ca.fabs(inside) <= HUGE, inside, 0))
    return ca.vertcat(*moved)
