"""This toolkit's fast path: one compiled tick, its buffers written and read from Python.

`tick_block` is the one place that says which tick is meant: the sweep of the lower tasks, then the safe tick of the
first one, which together are the mode `projected`.
"""

from __future__ import annotations

from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Call, Program, Routine, compile_block, lower
from surctl.priority import nsb_symbolic, safe_tick

__all__ = ["FastTick", "sweep_block", "tick_block"]

Array: TypeAlias = NDArray[np.float64]


def tick_block(n: int, levels: tuple[int, ...], m: int) -> Routine:
    """(J, x, rows, box) → v and the other outputs of `safe_tick`; J and x of all levels, highest priority first."""
    first, rest = levels[0], levels[1:]
    steps = (
        Call(_split(n, levels), ("J", "x"), ("J_first", "x_first", "J_rest", "x_rest")),
        Call(sweep_block(n, rest), ("J_rest", "x_rest"), ("target",)),
        Call(
            safe_tick(n, first, m),
            ("target", "J_first", "x_first", "rows", "box"),
            ("v", "active", "multipliers", "opening", "status", "count"),
        ),
    )
    inputs = (("J", n * sum(levels)), ("x", sum(levels)), ("rows", m * (n + 3)), ("box", 2 * n))
    return Routine("projected_tick", inputs, steps, ("v", "active", "multipliers", "opening", "status", "count"))


def sweep_function(n: int, levels: tuple[int, ...]) -> ca.Function:
    """(J, x) → v of the law (16), as a CasADi function: what CasADi generates C from, and we."""
    J, x, parts, at = ca.SX.sym("J", n * sum(levels)), ca.SX.sym("x", sum(levels)), [], 0
    for k in levels:
        parts.append((ca.reshape(J[at * n : (at + k) * n], n, k).T, x[at : at + k]))
        at += k
    return ca.Function("sweep", [J, x], [nsb_symbolic(parts)], ["J", "x"], ["v"])


def sweep_block(n: int, levels: tuple[int, ...]) -> Program:
    """The same, as an instruction list."""
    return lower(sweep_function(n, levels))


def _split(n: int, levels: tuple[int, ...]) -> Program:
    total, first = sum(levels), levels[0]
    J, x = ca.SX.sym("J", n * total), ca.SX.sym("x", total)
    return lower(ca.Function("split", [J, x], [J[: n * first], x[:first], J[n * first :], x[first:]]))


class FastTick:
    """The compiled tick and its buffers: write `J`, `x` and `rows`, call `run`, read `v`.

    Args:
        levels: rows of each task.
        box: (2, n), written once, as bounds and as rows.
        rows: m, inequality rows beside the box.

    Attributes:
        J: (K, n). x: (K,). rows: (m, n + 3), of a (n,), lower, upper, soft. v: (n,). status: (1,).
    """

    def __init__(self, levels: tuple[int, ...], *, box: Array, rows: int) -> None:
        n = box.shape[1]
        work = compile_block(tick_block(n, levels, n + rows)).workspace()
        J, self.x, table, limits = work.inputs
        self.J, table = J.reshape(-1, n), table.reshape(n + rows, n + 3)
        table[:n, :n], table[:n, n], table[:n, n + 1] = np.eye(n), *box
        limits[:] = box.reshape(-1)
        self.rows, self.run, self.v, self.status = table[n:], work.run, work.outputs[0], work.outputs[4]

    def __call__(self, J: Array, x: Array, rows: Array) -> Array:
        """New numbers in, v out: a view that the next call writes over."""
        self.J[:] = J
        self.x[:] = x
        self.rows[:] = rows
        self.run()
        return self.v
