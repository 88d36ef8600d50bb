"""This toolkit's fast path: a compiled step of each mode, with buffers that Python writes and reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Program, Routine, lower
from surctl.priority import LevelShape, Mode, PriorityStep, nsb_symbolic, priority_step

__all__ = ["fast_tick", "sweep_block", "sweep_function", "tick_block"]

Array: TypeAlias = NDArray[np.float64]


def tick_block(mode: Mode, n: int, levels: tuple[int, ...], m: int) -> Routine:
    """The compiled step of a mode for levels with the given numbers of rows, and m limit rows."""
    return priority_step(mode, n=n, levels=tuple(map(LevelShape, levels)), rows=m)


def fast_tick(mode: Mode, levels: tuple[int, ...], *, box: Array, rows: int) -> Callable[[Array, Array, Array], Array]:
    """(J (K, n), x (K,), rows (m, n + 3)) → v: new numbers in, a view out that the next call writes over.

    box: (2, n), written once, as bounds and as rows.
    """
    n = box.shape[1]
    tick = PriorityStep(mode, n=n, levels=tuple(map(LevelShape, levels)), rows=n + rows)
    tick.rows[:n] = np.column_stack([np.eye(n), *box, np.zeros(n)])
    tick.box[:] = box
    jacobian, lower, upper, limits, solve, v = tick.J, tick.lower, tick.upper, tick.rows[n:], tick.solve, tick.v

    def run(J: Array, x: Array, table: Array) -> Array:
        jacobian[:] = J
        lower[:] = x
        upper[:] = x
        limits[:] = table
        solve()
        return v

    return run


def sweep_function(n: int, levels: tuple[int, ...]) -> ca.Function:
    """Return (J, x) → v of the law (16) as a CasADi function, from which CasADi and surctl generate C."""
    J, x, parts, at = ca.SX.sym("J", n * sum(levels)), ca.SX.sym("x", sum(levels)), [], 0
    for k in levels:
        parts.append((ca.reshape(J[at * n : (at + k) * n], n, k).T, x[at : at + k]))
        at += k
    return ca.Function("sweep", [J, x], [nsb_symbolic(parts)], ["J", "x"], ["v"])


def sweep_block(n: int, levels: tuple[int, ...]) -> Program:
    """Return the same law as an instruction list."""
    return lower(sweep_function(n, levels))
