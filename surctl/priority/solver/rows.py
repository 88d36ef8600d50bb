"""Numbers of variables and constraint rows in the safe step, and routines that several of its stages call."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.solver.dual_step import Space
from surctl.priority.solver.kernel import certificate, kernel, lanes_of
from surctl.priority.solver.precision import FLOAT64, Precision

__all__ = ["Sizes", "into", "unit_rows"]


class Sizes:
    """Numbers for which a safe step is compiled: n velocities, p rows of the task Jacobian J, m constraint rows.

    Attributes:
        precision: tolerances of the solver.
        cap: largest number of iterations in a search for v; None means the limit in module `kernel`.
        general: search with n unknowns. fast: search with n − p unknowns, after elimination of p independent rows of J
            (None if p ≥ n). opening: search in which v and the opening of the soft rows are unknown.
        rows: number of entries that store all constraint rows. lanes: number of rows in a block (see module `kernel`).
            blocks: number of blocks.
        general_kernel, opening_kernel: solver routines for the searches `general` and `opening`. certificate,
            opening_certificate: routines that test whether a point satisfies all constraint rows.
    """

    def __init__(self, n: int, p: int, m: int, precision: Precision = FLOAT64, *, cap: int | None = None) -> None:
        self.n, self.p, self.m, self.precision, self.cap = n, p, m, precision, cap
        self.general = Space(n, n, precision=precision)
        self.fast = Space(n, n - p, precision=precision) if p < n else None
        self.opening = Space(n, n + 1, opening=True, precision=precision)
        self.rows = m * (n + 3)
        self.lanes = lanes_of(m, precision)
        self.blocks = m // self.lanes
        self.general_kernel = kernel(self.general, m, cap)
        self.opening_kernel = kernel(self.opening, m)
        self.certificate = certificate(self.general, m)
        self.opening_certificate = certificate(self.opening, m)


def unit_rows(sizes: Sizes) -> tuple[Step, ...]:
    """Return the steps that scale each constraint row to length 1 and store the rows in blocks.

    The steps convert the variable `rows` (m·(n + 3),), stored row by row, to the variable `unit`. A row with normal 0
    is not scaled; all velocities satisfy this row, or none does. No velocity satisfies a row whose squared length
    exceeds `precision.huge`.
    """
    if sizes.lanes == 1:
        look: tuple[Step, ...] = (
            Call(_one(), (), ("unit_so_far",)),
            Loop(_look(sizes), sizes.m, ("unit_so_far",), ("all_unit",), sliced=("rows",)),
        )
        begun = "rows"
    else:
        look = (
            Loop(_one(), 1, (), ("unit_so_far",), lanes=sizes.lanes),
            Loop(
                _load(sizes), sizes.blocks, ("unit_so_far",), ("each", "loaded"), spread=("rows",), lanes=sizes.lanes
            ),
            Call(_every(sizes.lanes), ("each",), ("all_unit",)),
        )  # fmt: skip
        begun = "loaded"
    return (*look, Loop(_scaling(sizes), 1, (begun, "all_unit"), ("unit", "scaled"), until=1))


def _one() -> Program:
    return lower(ca.Function("one", [], [ca.SX.ones(1)]))


def _load(sizes: Sizes) -> Program:
    # yes: 1 if all rows of this lane so far have length 1 or 0
    yes, row = ca.SX.sym("yes"), ca.SX.sym("row", sizes.n + 3)
    return lower(ca.Function("load", [yes, row], [ca.if_else(_is_unit(sizes, row), yes, 0), row]))


def _look(sizes: Sizes) -> Program:
    # yes: 1 if all constraint rows so far have length 1 or 0
    yes, row = ca.SX.sym("yes"), ca.SX.sym("row", sizes.n + 3)
    return lower(ca.Function("look", [yes, row], [ca.if_else(_is_unit(sizes, row), yes, 0)]))


def _is_unit(sizes: Sizes, row: ca.SX) -> ca.SX:
    square = ca.sumsqr(row[: sizes.n])
    return ca.logic_or(ca.fabs(square - 1) <= sizes.precision.unit, ca.eq(square, 0))


def _every(lanes: int) -> Program:
    each, yes = ca.SX.sym("each", lanes), ca.SX(1)
    for k in range(lanes):
        yes = ca.logic_and(yes, each[k])
    return lower(ca.Function("every", [each], [yes]))


def _scaling(sizes: Sizes) -> Routine:
    """Return the body of a loop that scales the rows once, if some row has a length other than 0 or 1."""
    n = sizes.n
    row = ca.SX.sym("row", n + 3)
    square = ca.sumsqr(row[:n])
    length = ca.sqrt(square)
    inverse = 1 / ca.if_else(length <= sizes.precision.short, 1, length)
    scaled = ca.vertcat(row[: n + 2] * inverse, row[n + 2])
    # its square overflows, so scaling would give a row of zeros that always holds; this row never holds instead
    never = ca.vertcat(ca.SX.zeros(n), 1, 1, 0)
    far = square > sizes.precision.huge
    scale = lower(ca.Function("unit_row", [row], [ca.if_else(far, never, scaled)]))
    one = lower(ca.Function("scaled", [], [ca.SX.ones(1)]))
    steps = (
        Loop(scale, sizes.blocks, (), ("unit",), sliced=("rows",), lanes=sizes.lanes),
        Call(one, (), ("yes",)),
    )
    return Routine("scale", (("rows", sizes.rows), ("done", 1)), steps, ("unit", "yes"))


def into(value: ca.SX, low: ca.SX, high: ca.SX) -> ca.SX:
    """Return the value clipped to the bounds; a NaN becomes the lower bound."""
    above = ca.if_else(low <= value, value, low)
    return ca.if_else(above <= high, above, high)
