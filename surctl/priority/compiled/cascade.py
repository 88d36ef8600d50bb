"""Priority mode lexicographic as compiled code: strict priority subject to the limits, one level after another.

The velocities that do not change the higher levels are v = base + N y, where N is an orthogonal projector, base is
orthogonal to the range of N, and y is arbitrary. So the feasible velocity nearest to base, which the least-distance
solver finds, is also the feasible velocity nearest to 0. For each level J v = x, one of two cases applies:

1. The level is reachable within the limits. Then the value of J v is fixed by elimination: base moves, and the
   directions of the level are removed from N. A set-based level becomes a constraint row instead.
2. The level is not reachable. Then it is met as well as the limits allow (`_limited_level`), and the resulting value of
   J v is fixed.

The value of J v is never fixed by a constraint row with a tolerance, so consistent constraint rows stay consistent. If
the limits contradict each other, the soft limits are relaxed before the first level, as in `safe_step`.

Let v be a velocity that satisfies the limits, and v + N y the velocities that do not change the higher levels.
`safe_step` minimises the residual ‖J (v + N y) − x‖ of the level over y within the limits; y = 0 is always feasible.
Nearly dependent constraint rows can reduce the accuracy, so `safe_step` is repeated from the resulting velocity until
the optimality conditions hold (module `tangent`). The value of J v is then fixed by elimination.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.compiled.decomposition import decompose
from surctl.priority.compiled.level_shape import StackShape, SymbolicLevel
from surctl.priority.compiled.sweep import HUGE, holding, holding_row, largest, merged, opened_row, reduced_row
from surctl.priority.rowspace import ZERO_ROW
from surctl.priority.solver.dual_step import OPTIMAL, Space
from surctl.priority.solver.elimination import as_matrix
from surctl.priority.solver.fallback import CLAMPED, LIMITED, safe_step
from surctl.priority.solver.kernel import certificate, kernel, row_by_row

__all__ = ["cascade"]

_TURNS = 6
_CONVERGED = 1e-15  # allowed remainder of the gradient, relative to 1 + its largest entry
_STILL = 1e-13  # a step of at most this length, relative to 1 + max |v|, counts as no step


def _limited_level(n: int, k: int, m: int) -> Routine:
    """Return the routine that meets one level as well as the limits allow and then fixes its value of J v.

    The routine updates these variables: skip, nonzero to do nothing; v, a velocity that satisfies the constraint rows,
    afterwards the one nearest to 0; base and N of the velocities base + N y that are still free; rows (m·(n + 3),), the
    constraint rows, of length 1; held and hold, numbers and multipliers of the rows that limit levels; active and
    multipliers, numbers and multipliers of the rows active at v; count, number of iterations. Further inputs: N with
    and N without the directions of the level; Q, T Q and Pᵀ·scale from the `Decomposition` of J N; J and x; square =
    1/scale², which scales the multipliers.
    """
    row, space = n + 3, Space(n, n)
    state = (
        ("skip", 1), ("v", n), ("base", n), ("N", n * n), ("rows", m * row), ("held", n), ("hold", n), ("active", n),
        ("multipliers", n), ("count", 1),
    )  # fmt: skip
    fixed = (
        ("N_before", n * n), ("N_less", n * n), ("Q", k * n), ("task", k * n), ("turn", k * k), ("J", k * n), ("x", k),
        ("square", 1),
    )  # fmt: skip
    best = ("v_best", "numbers", "u", "count_best", "converged")
    after = (
        "yes",
        "v_next",
        "base_next",
        "N_less",
        "rows_next",
        "held_next",
        "hold_next",
        "active_next",
        "multipliers_next",
    )
    steps = (
        Call(_nothing(n), ("skip",), ("none", "numbers_0", "u_0", "yes")),
        Loop(
            _again(n, k, m),
            _TURNS,
            carried=("v", "numbers_0", "u_0", "count", "none"),
            results=best,
            fixed=("rows", "N_before", "task", "turn", "J", "x", "square"),
            until=4,
        ),
        Loop(holding_row(n), m, (), ("rows_next",), sliced=("rows",), fixed=("v_best",)),
        Call(_frozen(n, k), ("v_best", "base", "Q"), ("base_held",)),
        Call(
            row_by_row(kernel(space, m), m),
            ("rows_next", "base_held", "none", "N_less"),
            ("point", "act", "press", "end", "spent"),
        ),
        Call(row_by_row(certificate(space, m), m), ("rows_next", "point"), ("feasible",)),
        Call(
            _chosen(n),
            ("v_best", "base_held", "N_less", "point", "act", "press", "end", "feasible", "count_best", "spent"),
            ("v_next", "base_next", "active_next", "multipliers_next", "count_next"),
        ),
        Call(merged(n), ("held", "hold", "numbers", "u"), ("held_next", "hold_next")),
    )
    return Routine("limited_level", (*state, *fixed), steps, (*after, "count_next"))


def _nothing(n: int) -> Program:
    skip, zero = ca.SX.sym("skip"), ca.SX.zeros(n)
    return lower(ca.Function("nothing", [skip], [ca.SX.zeros(1), zero, zero, ca.SX(1)]))


def _again(n: int, k: int, m: int) -> Routine:
    """Return a routine for one repetition: `safe_step` from v, the rows that limit the level, a test of optimality."""
    state = (("v", n), ("numbers", n), ("u", n), ("count", 1), ("converged", 1))
    fixed = (
        ("rows", m * (n + 3)), ("N", n * n), ("task", k * n), ("turn", k * k), ("J", k * n), ("x", k), ("square", 1),
    )  # fmt: skip
    after = tuple(f"{name}_next" for name, _ in state)
    solution = ("y", "active", "multipliers", "opening", "status", "spent")
    steps = (
        Loop(reduced_row(n), m, (), ("reduced",), sliced=("rows",), fixed=("v", "N")),
        Call(_lack(n, k), ("v", "turn", "J", "x"), ("lack", "zero", "anywhere", "none")),
        Call(safe_step(n, k, m), ("zero", "task", "lack", "reduced", "anywhere"), solution),
        Call(_moved(n), ("v", "N", "y", "status"), ("point",)),
        Call(row_by_row(certificate(Space(n, n), m), m), ("rows", "point"), ("feasible",)),
        Call(
            _pulled(n, k),
            ("v", "point", "feasible", "task", "turn", "J", "x"),
            ("v_next", "pull", "moved"),
        ),
        Call(holding(n, m), ("rows", "none", "v_next", "pull", "N"), ("numbers_next", "part", "rest", "more")),
        Call(
            _converged(n),
            ("rest", "pull", "part", "square", "moved", "count", "spent", "more"),
            ("u_next", "count_next", "converged_next"),
        ),
    )
    return Routine("limited_level_again", (*state, *fixed), steps, after)


def _lack(n: int, k: int) -> Program:
    # lack: desired value of T Q y
    v, turn, J, x = ca.SX.sym("v", n), ca.SX.sym("turn", k * k), ca.SX.sym("J", k * n), ca.SX.sym("x", k)
    lack = as_matrix(turn, k) @ (x - as_matrix(J, n) @ v)
    anywhere = ca.vertcat(-HUGE * ca.SX.ones(n), HUGE * ca.SX.ones(n))
    return lower(ca.Function("lack", [v, turn, J, x], [lack, ca.SX.zeros(n), anywhere, ca.SX.zeros(1)]))


def _moved(n: int) -> Program:
    # v does not change if `safe_step` found no point
    v, N, y, status = ca.SX.sym("v", n), ca.SX.sym("N", n * n), ca.SX.sym("y", n), ca.SX.sym("status")
    step = ca.if_else(status <= LIMITED, as_matrix(N, n) @ y, 0)
    return lower(ca.Function("moved", [v, N, y, status], [ca.vertcat(v + step, 0)]))


def _pulled(n: int, k: int) -> Program:
    v, point, feasible = ca.SX.sym("v", n), ca.SX.sym("point", n + 1), ca.SX.sym("feasible")
    task, turn, J, x = ca.SX.sym("task", k * n), ca.SX.sym("turn", k * k), ca.SX.sym("J", k * n), ca.SX.sym("x", k)
    chosen = ca.if_else(feasible, point[:n], v)
    lack = as_matrix(turn, k) @ (x - as_matrix(J, n) @ chosen)
    pull = as_matrix(task, n).T @ lack
    moved = largest(chosen - v) > _STILL * (1 + largest(v))
    return lower(ca.Function("pulled", [v, point, feasible, task, turn, J, x], [chosen, pull, moved]))


def _converged(n: int) -> Program:
    rest, pull, part = (ca.SX.sym(name, n) for name in ("rest", "pull", "part"))
    square, moved = ca.SX.sym("square"), ca.SX.sym("moved")
    counts = [ca.SX.sym(name) for name in ("count", "spent", "more")]
    still = ca.logic_or(largest(rest) <= _CONVERGED * (1 + largest(pull)), ca.logic_not(moved))
    outputs = [part * square, sum(counts, ca.SX(0)), still]
    return lower(ca.Function("converged", [rest, pull, part, square, moved, *counts], list(map(ca.densify, outputs))))


def _frozen(n: int, k: int) -> Program:
    """Return a program for the base of the velocities that are still free once the level's value of J v is fixed."""
    v, base, Q = ca.SX.sym("v", n), ca.SX.sym("base", n), ca.SX.sym("Q", k * n)
    directions = as_matrix(Q, n)
    return lower(ca.Function("frozen", [v, base, Q], [ca.vertcat(base + directions.T @ (directions @ (v - base)), 0)]))


def _chosen(n: int) -> Program:
    # the point nearest to 0 with the level's value of J v; v if rounding leaves no such point
    v, base, N = ca.SX.sym("v", n), ca.SX.sym("base", n + 1), ca.SX.sym("N", n * n)
    point, act, press = ca.SX.sym("point", n + 1), ca.SX.sym("act", n), ca.SX.sym("press", n)
    end, feasible, count, spent = (ca.SX.sym(name) for name in ("end", "feasible", "count", "spent"))
    good = ca.logic_and(ca.eq(end, OPTIMAL), feasible)
    own = v - as_matrix(N, n) @ v
    outputs = [
        ca.if_else(good, point[:n], v),
        ca.if_else(good, base[:n], own),
        ca.if_else(good, act, 0),
        ca.if_else(good, press, 0),
        count + spent,
    ]
    inputs = [v, base, N, point, act, press, end, feasible, count, spent]
    return lower(ca.Function("chosen", inputs, list(map(ca.densify, outputs))))


_STATE = ("stop", "v", "base", "N", "rows", "held", "hold", "active", "multipliers", "limited", "count")


class _Sizes:
    # n: velocities; k: rows of the largest J; m: constraint rows, with the rows of set-based levels last
    def __init__(self, shape: StackShape, rows: int) -> None:
        self.shape, self.n, self.k, self.limit_rows = shape, shape.n, shape.tallest, rows
        self.sets = sum(level.is_set for level in shape.levels)
        self.m = rows + self.sets
        self.row = shape.n + 3

    @property
    def state(self) -> tuple[tuple[str, int], ...]:
        """Return (name, number of entries) of each variable that one level passes to the next."""
        # held, hold: numbers and multipliers of the constraint rows that limit levels. active, multipliers: numbers and
        # multipliers of the active constraint rows in the last projection. limited: whether level 1 was not reachable.
        n = self.n
        sizes = (1, n, n, n * n, self.m * self.row, n, n, n, n, 1, 1)
        return tuple(zip(_STATE, sizes, strict=True))

    @property
    def level(self) -> tuple[tuple[str, int], ...]:
        # every level is padded to the largest level; slot: position of the constraint row of a set-based level
        return (
            ("J_i", self.k * self.n),
            ("lower_i", self.k),
            ("upper_i", self.k),
            ("is_set", 1),
            ("first", 1),
            ("slot", self.sets),
        )


def cascade(shape: StackShape, rows: int) -> Routine:
    """Return the routine of mode lexicographic, which solves all levels within the limits.

    Inputs: J, lower, upper, rows and box as in `priority_step`; sound is 0 if an input is not finite, and the routine
    then stops before the first level. Outputs: v, active, multipliers, opening, status, count and target as in
    `priority_step`; target is 0.
    """
    sizes = _Sizes(shape, rows)
    n, start = shape.n, tuple(f"{name}_0" for name in _STATE)
    last, initial = (
        tuple(f"{name}_last" for name in _STATE),
        ("v_t", "active_t", "multipliers_t", "opening", "status_t", "spent"),
    )
    levels = tuple(f"{name}_all" for name, _ in sizes.level if name != "slot" or sizes.sets)
    steps: tuple[Step, ...] = (
        Call(_arrange(sizes), ("J", "lower", "upper", "rows"), (*levels, "zero", "no_J", "no_x", "rows_all")),
        # this call has no task, but has the size of one: the levels can then call the same routine
        Call(safe_step(n, sizes.k, sizes.m), ("zero", "no_J", "no_x", "rows_all", "box"), initial),
        Loop(opened_row(n), sizes.m, (), ("rows_0",), sliced=("rows_all",), fixed=("opening", "v_t")),
        Call(_begin(sizes), (*initial[:3], *initial[4:], "sound"), tuple(s for s in start if s != "rows_0")),
        Loop(_level(sizes), len(shape.levels), start, last, sliced=levels, until=0),
        Call(merged(n), ("held_last", "hold_last", "active_last", "multipliers_last"), ("active", "multipliers")),
        Call(_end(sizes), ("v_last", "limited_last", "status_t"), ("v", "status", "target")),
    )
    inputs = (*shape.inputs, ("rows", rows * sizes.row), ("box", 2 * n), ("sound", 1))
    outputs = ("v", "active", "multipliers", "opening", "status", "count_last", "target")
    return Routine("cascade", inputs, steps, outputs)


def _arrange(sizes: _Sizes) -> Program:
    """Return a program that pads all levels to equal size and appends an empty row for each set-based level."""
    shape, n, k = sizes.shape, sizes.n, sizes.k
    flat, levels = shape.symbols()
    rows = ca.SX.sym("rows", sizes.limit_rows * sizes.row)
    zeros = [ca.SX.zeros(k - level.J.shape[0]) for level in levels]
    J = [ca.vertcat(ca.vec(lv.J.T), ca.SX.zeros(z.numel() * n)) for lv, z in zip(levels, zeros, strict=True)]
    place, slots = 0, []
    for level in levels:
        slots += [ca.SX(int(level.is_set and j == place)) for j in range(sizes.sets)]
        place += level.is_set
    idle = ca.vertcat(ca.SX.zeros(n), -HUGE, HUGE, 0)
    outputs = [
        ca.vertcat(*J),
        ca.vertcat(*(ca.vertcat(lv.lower, z) for lv, z in zip(levels, zeros, strict=True))),
        ca.vertcat(*(ca.vertcat(lv.upper, z) for lv, z in zip(levels, zeros, strict=True))),
        ca.vertcat(*(ca.SX(int(lv.is_set)) for lv in levels)),
        ca.vertcat(*(ca.SX(int(i == 0)) for i in range(len(levels)))),
        *([ca.vertcat(*slots)] if slots else []),
        ca.SX.zeros(n),
        ca.SX.zeros(k * n),
        ca.SX.zeros(k),
        ca.vertcat(rows, *([idle] * sizes.sets)),
    ]
    return lower(ca.Function("arrange", [*flat, rows], list(map(ca.densify, outputs))))


def _begin(sizes: _Sizes) -> Program:
    # the outputs are the initial values of `_STATE` without `rows`
    n = sizes.n
    v, active, multipliers = (ca.SX.sym(name, n) for name in ("v", "active", "multipliers"))
    status, count, sound = (ca.SX.sym(name) for name in ("status", "count", "sound"))
    zero = ca.SX.zeros(n)
    stop = ca.logic_or(ca.eq(status, CLAMPED), ca.logic_not(sound))
    outputs = [stop, v, zero, ca.vec(ca.SX.eye(n)), zero, zero, active, multipliers, ca.SX.zeros(1), count]
    return lower(
        ca.Function("begin_levels", [v, active, multipliers, status, count, sound], list(map(ca.densify, outputs)))
    )


def _level(sizes: _Sizes) -> Routine:
    """Return a routine that meets one level, exactly if possible, otherwise as well as the limits allow."""
    n, k, m = sizes.n, sizes.k, sizes.m
    space = Space(n, n)
    level = tuple(pair for pair in sizes.level if pair[1])
    slot = ("slot",) if sizes.sets else ()
    freedom = ("base_c", "N_c", "N_less", "directions", "task", "turn", "x_i", "square")
    after = tuple(f"{name}_next" for name in _STATE)
    tried = ("skip", "v_1", "base_1", "N_1", "rows_1", "held_1", "hold_1", "active_1", "multipliers_1", "count_1")
    solved = ("skip_2", *after[1:9], "count_next")
    steps: tuple[Step, ...] = (
        Call(_free(sizes), ("v", "base", "N", "J_i", "lower_i", "upper_i", "is_set"), (*freedom, "row_i")),
        Call(_added(sizes), ("rows", "row_i", *slot), ("rows_c",)),
        Call(_zero(), ("stop",), ("go",)),
        Call(
            row_by_row(kernel(space, m), m),
            ("rows_c", "base_c", "go", "N_c"),
            ("point", "numbers", "u", "end", "spent"),
        ),
        Call(row_by_row(certificate(space, m), m), ("rows_c", "point"), ("feasible",)),
        Call(
            _tried(sizes),
            ("point", "numbers", "u", "end", "feasible", "base_c", "N_c", "rows_c", *_STATE, "spent", "first"),
            (*tried, "limited_next"),
        ),
        Loop(
            _limited_level(n, k, m),
            1,
            carried=tried,
            results=solved,
            fixed=("N", "N_less", "directions", "task", "turn", "J_i", "x_i", "square"),
            until=0,
        ),
    )
    results = tuple("stop" if name == "stop_next" else name for name in after)
    return Routine("level", (*sizes.state, *level), steps, results)


def _zero() -> Program:
    stop = ca.SX.sym("stop")
    return lower(ca.Function("go", [stop], [ca.SX.zeros(1)]))


def _free(sizes: _Sizes) -> Program:
    """Return a program that computes which velocities a level leaves free, and the inputs of `_limited_level`.

    Outputs: base (n + 1) and projector N for the case that the level is reachable; N without the directions of the
    level; Q, T Q and Pᵀ·scale from the `Decomposition` of J N; the desired value of J v; 1/scale²; the constraint row
    of a set-based level.
    """
    n, k = sizes.n, sizes.k
    v, base, N, J = ca.SX.sym("v", n), ca.SX.sym("base", n), ca.SX.sym("N", n * n), ca.SX.sym("J", k * n)
    low, high, is_set = ca.SX.sym("low", k), ca.SX.sym("high", k), ca.SX.sym("is_set")
    matrix, projector = as_matrix(J, n), as_matrix(N, n)
    slab = SymbolicLevel(matrix, low, high, is_set=True)
    x = ca.if_else(is_set, slab.desired(v), low)
    parts = decompose(matrix, projector)
    less = projector - parts.directions().T @ parts.directions()
    reached = base + parts.directions().T @ parts.coordinates(x - matrix @ base)
    length = ca.sqrt(ca.sumsqr(matrix[0, :]))
    off = length <= ZERO_ROW  # a task that is switched off puts no bound on v
    unit = 1 / ca.if_else(off, 1, length)
    bounds = [ca.if_else(off, -HUGE, low[0] * unit), ca.if_else(off, HUGE, high[0] * unit)]
    row = ca.vertcat(matrix[0, :].T * unit, *bounds, 0)
    turn = ca.vertcat(*(parts.scale * p.T for p in parts.P))
    outputs = [
        ca.vertcat(ca.if_else(is_set, base, reached), 0),
        ca.vec(ca.if_else(is_set, projector, less)),
        ca.vec(less),
        ca.vec(parts.directions().T),
        ca.vec(parts.task().T),
        ca.vec(turn.T),
        x,
        ca.if_else(parts.scale > 0, 1 / ca.if_else(parts.scale > 0, parts.scale, 1) ** 2, 0),
        row,
    ]
    inputs = [v, base, N, J, low, high, is_set]
    return lower(ca.Function("free", inputs, list(map(ca.densify, outputs))))


def _added(sizes: _Sizes) -> Program:
    rows, row = ca.SX.sym("rows", sizes.m * sizes.row), ca.SX.sym("row", sizes.row)
    slot = ca.SX.sym("slot", sizes.sets)
    first = sizes.limit_rows * sizes.row
    places = [rows[first + j * sizes.row : first + (j + 1) * sizes.row] for j in range(sizes.sets)]
    filled = [ca.if_else(slot[j], row, place) for j, place in enumerate(places)]
    inputs = [rows, row, *([slot] if sizes.sets else [])]
    return lower(ca.Function("added", inputs, [ca.densify(ca.vertcat(rows[:first], *filled))]))


def _tried(sizes: _Sizes) -> Program:
    # the first output is 1 if the level was reached; `_limited_level` is then skipped
    n = sizes.n
    point, numbers, u = ca.SX.sym("point", n + 1), ca.SX.sym("numbers", n), ca.SX.sym("u", n)
    end, feasible, spent, first = (ca.SX.sym(name) for name in ("end", "feasible", "spent", "first"))
    base_c, N_c, rows_c = ca.SX.sym("base_c", n + 1), ca.SX.sym("N_c", n * n), ca.SX.sym("rows_c", sizes.m * sizes.row)
    state = {name: ca.SX.sym(name, size) for name, size in sizes.state}
    good = ca.logic_and(ca.eq(end, OPTIMAL), feasible)
    outputs = [
        good,
        ca.if_else(good, point[:n], state["v"]),
        ca.if_else(good, base_c[:n], state["base"]),
        ca.if_else(good, N_c, state["N"]),
        ca.if_else(good, rows_c, state["rows"]),
        state["held"],
        state["hold"],
        ca.if_else(good, numbers, state["active"]),
        ca.if_else(good, u, state["multipliers"]),
        state["count"] + spent,
        ca.if_else(first, ca.logic_not(good), state["limited"]),
    ]
    inputs = [point, numbers, u, end, feasible, base_c, N_c, rows_c, *state.values(), spent, first]
    return lower(ca.Function("tried", inputs, list(map(ca.densify, outputs))))


def _end(sizes: _Sizes) -> Program:
    # the last output is the target of the last projection, which is 0 in this mode
    v, limited, status = ca.SX.sym("v", sizes.n), ca.SX.sym("limited"), ca.SX.sym("status")
    outcome = ca.if_else(limited, ca.fmax(status, LIMITED), status)
    return lower(ca.Function("end_levels", [v, limited, status], [v, outcome, ca.SX.zeros(sizes.n)]))
