"""Stage 2 of the safe step: minimise the task residual ‖J v − x‖ subject to the constraint rows, exact to rounding.

A proximal step from c minimises ‖v − c‖² + ‖J v − x‖²/δ² over v subject to the constraint rows (Rockafellar 1976). This
is a least-distance problem in v and the scaled residuals (J v − x)/δ. The proximal step finds the active constraint
rows. Then the least-squares problem is solved directly with these rows as equalities. If this direct solution satisfies
every constraint row and its multipliers have the right signs, it is the minimiser. Otherwise the next proximal step
starts from the v of this step, with a smaller δ, because v hardly moves in a direction in which J is shorter than δ.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Gather, Loop, Program, Routine, Step, lower
from surctl.priority.solver.dual_step import OPTIMAL, STUCK
from surctl.priority.solver.elimination import (
    LOOPED,
    Precision,
    as_matrix,
    corrected,
    eliminate,
    elimination,
    flat,
    product,
    pseudo_inverse,
    pseudo_inverse_of,
    split_basis,
)
from surctl.priority.solver.kernel import Sizes

__all__ = ["least_squares"]

_STEPS = 5


def least_squares(sizes: Sizes) -> Routine:
    """Return the routine that minimises ‖J v − x‖ subject to the constraint rows.

    Inputs: open (m·(n + 3),), constraint rows whose soft bounds are already moved outwards by opening (1,); near (n,),
    the initial v; J and x. Outputs: point (n + 1,), the minimiser v and the opening; active (n,), signed numbers of the
    active rows; multipliers (n,), which are 0 because no distance to a target is minimised; status, 1 if a minimiser
    was found; count, number of iterations.
    """
    n, p = sizes.n, sizes.p
    inputs = (("open", sizes.rows), ("near", n), ("opening", 1), ("J", p * n), ("x", p))
    state = ("point", "active", "delta", "status", "count")
    last = tuple(f"{name}_last" for name in state)
    steps = (
        Call(_begin(sizes), ("near", "opening", "J", "x"), (*state, "matrix", "pull", "none")),
        Loop(_turn(sizes), _STEPS, carried=state, results=last, fixed=("open", "matrix", "pull"), until=3),
        Call(sizes.certificate, ("open", "point_last"), ("feasible",)),
        Call(_end(sizes), ("status_last", "delta_last", "feasible"), ("solved",)),
    )
    return Routine("least_squares", inputs, steps, ("point_last", "active_last", "none", "solved", "count_last"))


def _begin(sizes: Sizes) -> Program:
    # J and x are divided by the length of the longest row of J
    n, p = sizes.n, sizes.p
    near, opening = ca.SX.sym("near", n), ca.SX.sym("opening")
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    matrix, longest = as_matrix(J, n), ca.SX(0)
    for k in range(p):
        longest = ca.fmax(longest, ca.sqrt(ca.sumsqr(matrix[k, :])))
    none = longest <= sizes.precision.short
    scale = ca.if_else(none, 0, 1 / ca.if_else(none, 1, longest))
    zeros = ca.densify(ca.SX.zeros(n, 1))
    state = [ca.vertcat(near, opening), zeros, ca.SX(sizes.precision.delta), ca.SX.zeros(1), ca.SX.zeros(1)]
    return lower(ca.Function("begin", [near, opening, J, x], [*map(ca.densify, state), J * scale, x * scale, zeros]))


def _turn(sizes: Sizes) -> Routine:
    """Return a routine for one proximal step and the direct solution with the active rows of this step."""
    n, p = sizes.n, sizes.p
    state = (("point", n + 1), ("active", n), ("delta", 1), ("status", 1), ("count", 1))
    fixed = (("open", sizes.rows), ("matrix", p * n), ("pull", p))
    weigh = _weigh(sizes) if n < LOOPED else _weigh_in_loops(sizes)
    steps = (
        Call(weigh, ("point", "delta", "matrix", "pull"), ("base", "rest", "go")),
        Call(sizes.general_kernel, ("open", "base", "go", "rest"), ("candidate", "numbers", "u", "end", "spent")),
        Call(_unsolved(), ("end",), ("none", "stop")),
        Loop(
            _polish(sizes), 1,
            carried=("candidate", "none", "none", "stop"), results=("direct", "good", "feasible", "over"),
            fixed=("open", "matrix", "pull", "numbers"), until=3,
        ),
        Call(
            _decide(sizes),
            (*(name for name, _ in state), "candidate", "numbers", "end", "spent", "direct", "good", "feasible"),
            tuple(f"{name}_next" for name, _ in state),
        ),
    )  # fmt: skip
    return Routine("proximal_step", (*state, *fixed), steps, tuple(f"{name}_next" for name, _ in state))


def _unsolved() -> Program:
    end = ca.SX.sym("end")
    return lower(ca.Function("unsolved", [end], [ca.SX.zeros(1), ca.logic_not(ca.eq(end, OPTIMAL))]))


def _polish(sizes: Sizes) -> Routine:
    """Return the body of a loop that computes the direct solution once, if the proximal step succeeded."""
    n, p = sizes.n, sizes.p
    state = (("candidate", n + 1), ("good", 1), ("feasible", 1), ("stop", 1))
    fixed = (("open", sizes.rows), ("matrix", p * n), ("pull", p), ("numbers", n))
    rows = tuple(f"row{j}" for j in range(n))
    one = lower(ca.Function("done", [ca.SX.sym("ends")], [ca.SX.ones(1)]))
    steps: tuple[Step, ...] = (
        Call(_indices(n), ("numbers",), tuple(f"at{j}" for j in range(n))),
        *(Gather("open", f"at{j}", n + 3, rows[j], lanes=sizes.lanes) for j in range(n)),
        Call(
            _direct(sizes) if n < LOOPED else _direct_in_loops(sizes),
            ("candidate", "numbers", "matrix", "pull", *rows),
            ("direct", "good_next"),
        ),
        Call(sizes.certificate, ("open", "direct"), ("feasible_next",)),
        Call(one, ("stop",), ("stop_next",)),
    )
    return Routine("polish", (*state, *fixed), steps, ("direct", "good_next", "feasible_next", "stop_next"))


def _weigh(sizes: Sizes) -> Program:
    """Return a program for the inputs base and Z of `kernel`, for the least-distance problem of a proximal step."""
    n, p = sizes.n, sizes.p
    point, delta = ca.SX.sym("point", n + 1), ca.SX.sym("delta")
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    matrix = as_matrix(J, n)
    left = eliminate(ca.horzcat(matrix, -delta * ca.SX.eye(p)), sizes.precision)
    base = point[:n] + left.lift[:n, :] @ (x - matrix @ point[:n])
    outputs = [ca.vertcat(base, point[n]), flat(left.basis[:n, p:]), ca.SX.zeros(1)]
    return lower(ca.Function("weigh", [point, delta, J, x], list(map(ca.densify, outputs))))


def _weigh_in_loops(sizes: Sizes) -> Routine:
    """Return `_weigh` with the elimination as a loop."""
    n, p = sizes.n, sizes.p
    point, delta = ca.SX.sym("point", n + 1), ca.SX.sym("delta")
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    lift, basis = ca.SX.sym("lift", (n + p) * p), ca.SX.sym("basis", (n + p) ** 2)
    matrix = as_matrix(J, n)
    wide = [flat(ca.horzcat(matrix, -delta * ca.SX.eye(p)))]
    base = point[:n] + as_matrix(lift, p)[:n, :] @ (x - matrix @ point[:n])
    outputs = [ca.vertcat(base, point[n]), flat(as_matrix(basis, n + p)[:n, p:]), ca.SX.zeros(1)]
    end = ca.Function("weighed", [point, J, x, lift, basis], list(map(ca.densify, outputs)))
    steps = (
        Call(lower(ca.Function("wide", [delta, J], wide)), ("delta", "J"), ("wide",)),
        Call(elimination(p, n + p, sizes.precision), ("wide",), ("lift", "basis", "rank")),
        Call(lower(end), ("point", "J", "x", "lift", "basis"), ("base", "rest", "go")),
    )
    return Routine("weigh", (("point", n + 1), ("delta", 1), ("J", p * n), ("x", p)), steps, ("base", "rest", "go"))


def _indices(n: int) -> Program:
    # −1 for an empty slot
    numbers = ca.SX.sym("numbers", n)
    return lower(ca.Function("indices", [numbers], [ca.fabs(numbers[j]) - 1 for j in range(n)]))


def _direct(sizes: Sizes) -> Program:
    """Return a program for the minimiser of ‖J v − x‖ with the active rows as equalities, and a test of optimality.

    The minimiser is optimal if Jᵀ(x − J v) is a combination of the active normals with coefficients of the right sign.
    """
    n, p = sizes.n, sizes.p
    candidate, numbers = ca.SX.sym("candidate", n + 1), ca.SX.sym("numbers", n)
    J, x = ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    rows = [ca.SX.sym(f"row{j}", n + 3) for j in range(n)]
    matrix, v = as_matrix(J, n), candidate[:n]
    active, edge = _equalities(numbers, rows)
    held = eliminate(active, sizes.precision)
    free = ca.horzcat(*(ca.if_else(held.rank > i, 0, held.basis[:, i]) for i in range(n)))
    v = v + held.lift @ (edge - active @ v)
    projected = ca.vertcat(*(_without_noise(row @ free, row, sizes.precision) for row in ca.vertsplit(matrix)))
    inverse = free @ pseudo_inverse(projected, sizes.precision)
    v = v + inverse @ (x - matrix @ v)
    v = v + held.lift @ (edge - active @ v)
    v = v + inverse @ (x - matrix @ v)
    good = _optimal(v, matrix, x, active, held.lift, sizes.precision)
    return lower(ca.Function("direct", [candidate, numbers, J, x, *rows], [ca.vertcat(v, candidate[n]), good]))


def _equalities(numbers: ca.SX, rows: list[ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return the normals of the active rows, as a matrix, and the bounds at which they are active."""
    n, normals, bounds = len(rows), [], []
    for j, row in enumerate(rows):
        bound = ca.if_else(numbers[j] < 0, -row[n], row[n + 1])
        sign = ca.if_else(numbers[j] < 0, -1, ca.if_else(numbers[j] > 0, 1, 0))
        normals.append((sign * row[:n]).T)
        bounds.append(ca.if_else(ca.eq(numbers[j], 0), 0, bound))
    return ca.vertcat(*normals), ca.vertcat(*bounds)


def _optimal(v: ca.SX, matrix: ca.SX, x: ca.SX, active: ca.SX, lift: ca.SX, precision: Precision) -> ca.SX:
    slope = matrix.T @ (x - matrix @ v)
    multipliers = lift.T @ slope
    outside = slope - active.T @ multipliers
    size = ca.SX(1)
    for entry in ca.vertsplit(v):
        size = ca.fmax(size, ca.fabs(entry))
    noise = ca.fmax(precision.noise * size, precision.sign * ca.sqrt(ca.sumsqr(x - matrix @ v)))
    good = ca.SX(1)
    for entry in (*ca.vertsplit(multipliers), *ca.vertsplit(outside), *ca.vertsplit(-outside)):
        good = ca.logic_and(good, -noise <= entry)
    return good


def _direct_in_loops(sizes: Sizes) -> Routine:
    """Return `_direct` with its eliminations and products as loops."""
    n, p, precision = sizes.n, sizes.p, sizes.precision
    names = tuple(f"row{j}" for j in range(n))
    candidate, numbers = ca.SX.sym("candidate", n + 1), ca.SX.sym("numbers", n)
    rows = [ca.SX.sym(name, n + 3) for name in names]
    row, free = ca.SX.sym("row", n), ca.SX.sym("free", n * n)
    normals, edge = _equalities(numbers, rows)
    begin = lower(ca.Function("equalities", [candidate, numbers, *rows], [candidate[:n], flat(normals), edge]))
    projected = _without_noise(row.T @ as_matrix(free, n), row.T, precision).T
    project = lower(ca.Function("projected", [row, free], [ca.densify(projected)]))
    v, J, x = ca.SX.sym("v", n), ca.SX.sym("J", p * n), ca.SX.sym("x", p)
    active, lift = ca.SX.sym("active", n * n), ca.SX.sym("lift", n * n)
    good = _optimal(v, as_matrix(J, n), x, as_matrix(active, n), as_matrix(lift, n), precision)
    test = ca.Function("optimal", [candidate, v, J, x, active, lift], [ca.vertcat(v, candidate[n]), good])
    edges, task = ("lift", "active", "edge"), ("inverse", "J", "x")
    steps = (
        Call(begin, ("candidate", "numbers", *names), ("v0", "active", "edge")),
        Call(elimination(n, n, precision), ("active",), ("lift", "basis", "rank")),
        Call(split_basis(n), ("basis", "rank"), ("span", "free")),
        Loop(project, p, (), ("projected",), sliced=("J",), fixed=("free",)),
        Call(pseudo_inverse_of(p, n, precision), ("projected",), ("reduced",)),
        Loop(product(n, p), n, (), ("inverse",), sliced=("free",), fixed=("reduced",)),
        Call(corrected(n, n), ("v0", *edges), ("v1",)),
        Call(corrected(n, p), ("v1", *task), ("v2",)),
        Call(corrected(n, n), ("v2", *edges), ("v3",)),
        Call(corrected(n, p), ("v3", *task), ("v4",)),
        Call(lower(test), ("candidate", "v4", "J", "x", "active", "lift"), ("direct", "good")),
    )
    inputs = (("candidate", n + 1), ("numbers", n), ("J", p * n), ("x", p), *((name, n + 3) for name in names))
    return Routine("direct", inputs, steps, ("direct", "good"))


def _without_noise(projected: ca.SX, row: ca.SX, precision: Precision) -> ca.SX:
    # a row of J restricted to the free directions may be only rounding noise
    return ca.if_else(ca.sumsqr(projected) > precision.cutoff**2 * ca.sumsqr(row), projected, 0)


def _decide(sizes: Sizes) -> Program:
    n = sizes.n
    point, active, delta = ca.SX.sym("point", n + 1), ca.SX.sym("active", n), ca.SX.sym("delta")
    status, count = ca.SX.sym("status"), ca.SX.sym("count")
    candidate, numbers, end = ca.SX.sym("candidate", n + 1), ca.SX.sym("numbers", n), ca.SX.sym("end")
    spent, direct = ca.SX.sym("spent"), ca.SX.sym("direct", n + 1)
    good, feasible = ca.SX.sym("good"), ca.SX.sym("feasible")
    solved = ca.eq(end, OPTIMAL)
    done = ca.logic_and(solved, ca.logic_and(good, feasible))
    outputs = [
        ca.if_else(solved, ca.if_else(done, direct, candidate), point),
        ca.if_else(solved, numbers, active),
        ca.if_else(solved, sizes.precision.shrink * delta, delta),
        ca.if_else(done, OPTIMAL, ca.if_else(solved, 0, STUCK)),
        count + spent,
    ]
    inputs = [point, active, delta, status, count, candidate, numbers, end, spent, direct, good, feasible]
    return lower(ca.Function("decide", inputs, list(map(ca.densify, outputs))))


def _end(sizes: Sizes) -> Program:
    # the point must be optimal or the result of a proximal step
    status, delta, feasible = ca.SX.sym("status"), ca.SX.sym("delta"), ca.SX.sym("feasible")
    stepped = ca.logic_or(ca.eq(status, OPTIMAL), delta < sizes.precision.delta)
    return lower(ca.Function("least_squares_end", [status, delta, feasible], [ca.logic_and(stepped, feasible)]))
