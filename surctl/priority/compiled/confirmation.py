"""A check, after the solver, that the velocity v of a compiled priority step is optimal for its mode.

The check uses only inputs and results of the step, so it serves any solver. It treats one objective after another: the
residual of each strict level (level 1 in mode projected, none in filter), then the distance to the target. Let g be the
negative gradient of half the squared objective at v, N the projector on the velocities that leave the levels above
unchanged, and d the vector nearest to ĝ = N g/|g| for which v + d satisfies the opened limits. Then ĝ − d is a
combination, with weights u ≥ 0, of the normals of limits that v + d reaches. So for every w = v + N y that satisfies
the opened limits and is at most D from v,

    g·(w − v) ≤ |g| (|d| D + (ĝ − d)·d + (1 + Σ u) κ ε D),

and half the squared objective is at most this much above its minimum, because it is convex. The last term bounds what
rounding ε may change: 1/κ is the shortest part of a Jacobian row, relative to the longest row, that fixed a direction
in a level above. So an objective that depends on rounding, as near singularities, is not confirmed either. If soft
limits are opened, the same bound, with the opening as a further unknown, shows that no smaller opening is feasible.
"""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Loop, Program, Routine, Step, lower_named
from surctl.priority.compiled.decomposition import StackShape, SymbolicLevel, decompose
from surctl.priority.compiled.sweep import HUGE, largest
from surctl.priority.optimality import LOSS, ROUNDING
from surctl.priority.settings import ZERO_ROW
from surctl.priority.solver.dual_step import OPTIMAL, Space
from surctl.priority.solver.elimination import FLOAT64, as_matrix
from surctl.priority.solver.fallback import RELAXED
from surctl.priority.solver.kernel import kernel, row_by_row

__all__ = ["UNCONFIRMED", "confirmation"]

UNCONFIRMED = 6
"""Status of a velocity within the limits that was not shown to be optimal."""

_GOAL = ("base", "skip", "size", "value")
_NEAREST = ("d", "numbers", "weights", "end", "count")
_STATE = ("sound", "N", "kappa", "near")


def confirmation(shape: StackShape, rows: int, *, strict: int, damping: float) -> Routine:
    """Return the routine that replaces the status of a step by `UNCONFIRMED` if v is not shown to be optimal.

    Inputs: J, lower, upper and rows as in `priority_step`; v, opening, status and target as it returns them. Output:
    the status. The status of a velocity that is not meant to be optimal (CLAMPED, BOUNDED) stays. `strict` is the
    number of levels that are met one after another. With damping λ > 0, the only objective is √(λ²‖v − target‖² +
    ‖J v − x‖²) of level 1.
    """
    n, strict = shape.n, 0 if damping > 0.0 else strict
    sets = sum(level.is_set for level in shape.levels[:strict])
    m, first, last = rows + sets, tuple(f"{k}_0" for k in _STATE), tuple(f"{k}_last" for k in _STATE)
    find = row_by_row(kernel(Space(n, n), m), m)
    steps: tuple[Step, ...] = (
        Call(_begin(n), ("opening",), ("zero", "closed", *first[1:3])),
        Loop(_row(n), rows, ("zero",), ("missed", "relative", "limits"), sliced=("rows",), fixed=("opening", "v")),
        Call(_feasible(n), ("missed", "v"), ("feasible",)),
        Loop(
            _least_opening(n, rows), 1, ("feasible", "closed"), (first[0], "over"),
            fixed=("relative", "v", "opening"), until=1,
        ),
        Call(_with_sets(n, rows, sets), ("limits",), (first[3],)),
    )  # fmt: skip
    if strict:
        level = ("J_all", "lower_all", "upper_all", "is_set_all", *(("slot_all",) if sets else ()))
        steps += (
            Call(_arranged(shape, strict, sets), ("J", "lower", "upper"), level),
            Loop(_level(shape, strict, m, sets, find), strict, first, last, sliced=level, fixed=("v",)),
        )
    sound, N, kappa, near = last if strict else first
    steps += (
        Call(_distance(shape, damping), ("J", "lower", "upper", "v", "target", N), _GOAL),
        Call(find, (near, *_GOAL[:2], N), _NEAREST),
        Call(_judged(n), (sound, *_GOAL, "d", "weights", "end", kappa, "v"), ("optimal",)),
        Call(_status(), ("optimal", "status"), ("status_next",)),
    )
    inputs = (*shape.inputs, ("rows", rows * (n + 3)), ("v", n), ("opening", 1), ("status", 1), ("target", n))
    return Routine("confirmation", inputs, steps, ("status_next",))


def _begin(n: int) -> Program:
    opening = ca.SX.sym("opening")
    outputs: dict[str, ca.SX | float] = {
        "zero": 0.0,
        "closed": ca.logic_not(opening > 0),
        "N": ca.vec(ca.SX.eye(n)),
        "kappa": 1.0,
    }
    return lower_named("confirm_begin", {"opening": opening}, outputs)


def _row(n: int) -> Program:
    """Return a program that converts a limit row to length 1 and to constraints on w − v.

    Outputs: the largest violation so far; the row with its own bounds; the row with opened bounds, which include w = v.
    """
    missed, row, opening, v = ca.SX.sym("missed"), ca.SX.sym("row", n + 3), ca.SX.sym("opening"), ca.SX.sym("v", n)
    length = ca.sqrt(ca.sumsqr(row[:n]))
    none = length <= ZERO_ROW
    inverse = 1 / ca.if_else(none, 1, length)
    a = ca.if_else(none, 0, row[:n] * inverse)
    low, high = (row[n + i] * inverse - ca.dot(a, v) for i in (0, 1))
    below, above = low - row[n + 2] * opening, high + row[n + 2] * opening
    outputs = {
        "missed_next": ca.fmax(missed, ca.fmax(below, -above)),
        "relative": ca.vertcat(a, low, high, row[n + 2]),
        "near": ca.vertcat(a, ca.fmin(below, 0), ca.fmax(above, 0), 0),
    }
    return lower_named("confirm_row", {"missed": missed, "row": row, "opening": opening, "v": v}, outputs)


def _feasible(n: int) -> Program:
    missed, v = ca.SX.sym("missed"), ca.SX.sym("v", n)
    return lower_named(
        "confirm_limits", {"missed": missed, "v": v}, {"sound": missed <= FLOAT64.feasibility * (1 + largest(v))}
    )


def _least_opening(n: int, rows: int) -> Routine:
    """Return the body of a loop that runs once, if soft rows are opened: no smaller opening is feasible."""
    opening, sound, end = (ca.SX.sym(name) for name in ("opening", "sound", "end"))
    point, weights, v = ca.SX.sym("point", n + 1), ca.SX.sym("weights", n + 1), ca.SX.sym("v", n)
    down = ca.vertcat(ca.SX.zeros(n), -1)
    begin = lower_named("confirm_down", {"opening": opening}, {"base": down * (1 - opening), "skip": 0.0})
    loss = _loss(down, ca.vertcat(point[:n], point[n] - opening), weights, ca.SX(1), v)
    good = ca.logic_and(ca.eq(end, OPTIMAL), loss <= LOSS * (1 + opening))
    inputs = {"sound": sound, "point": point, "weights": weights, "end": end, "v": v, "opening": opening}
    judge = lower_named("confirm_opening", inputs, {"sound_next": ca.logic_and(sound, good), "over": 1.0})
    find = row_by_row(kernel(Space(n, n + 1, opening=True), rows), rows)
    steps = (
        Call(begin, ("opening",), ("base", "skip")),
        Call(find, ("relative", "base", "skip"), ("point", "numbers", "weights", "end", "count")),
        Call(judge, tuple(inputs), ("sound_next", "over")),
    )
    ports = (("sound", 1), ("closed", 1), ("relative", rows * (n + 3)), ("v", n), ("opening", 1))
    return Routine("confirm_least_opening", ports, steps, ("sound_next", "over"))


def _with_sets(n: int, rows: int, sets: int) -> Program:
    limits = ca.SX.sym("limits", rows * (n + 3))
    return lower_named("confirm_table", {"limits": limits}, {"near": ca.vertcat(limits, *([_idle(n)] * sets))})


def _idle(n: int) -> ca.SX:
    return ca.vertcat(ca.SX.zeros(n), -HUGE, HUGE, 0)


def _arranged(shape: StackShape, strict: int, sets: int) -> Program:
    """Return a program that pads the strict levels to equal size; slot: which row a set-based level becomes."""
    flat, levels = shape.symbols()
    n, levels = shape.n, levels[:strict]
    k = max(level.J.shape[0] for level in levels)
    gaps = [k - level.J.shape[0] for level in levels]
    place = [sum(level.is_set for level in levels[:i]) for i in range(strict)]
    slots = [ca.SX(int(level.is_set and j == at)) for level, at in zip(levels, place, strict=True) for j in range(sets)]
    outputs = {
        "J": ca.vertcat(*(ca.vertcat(ca.vec(lv.J.T), ca.SX.zeros(z * n)) for lv, z in zip(levels, gaps, strict=True))),
        "lower": ca.vertcat(*(ca.vertcat(lv.lower, ca.SX.zeros(z)) for lv, z in zip(levels, gaps, strict=True))),
        "upper": ca.vertcat(*(ca.vertcat(lv.upper, ca.SX.zeros(z)) for lv, z in zip(levels, gaps, strict=True))),
        "is_set": ca.vertcat(*(ca.SX(int(lv.is_set)) for lv in levels)),
        **({"slot": ca.vertcat(*slots)} if sets else {}),
    }
    inputs = dict(zip(("J_in", "lower_in", "upper_in"), flat, strict=True))
    return lower_named("confirm_levels", inputs, outputs)


def _level(shape: StackShape, strict: int, m: int, sets: int, find: Routine) -> Routine:
    """Return the routine that checks one strict level and removes its directions from N, or adds its row."""
    n, k = shape.n, max(level.rows for level in shape.levels[:strict])
    state = (("sound", 1), ("N", n * n), ("kappa", 1), ("near", m * (n + 3)))
    level = (("J", k * n), ("lower", k), ("upper", k), ("is_set", 1), *((("slot", sets),) if sets else ()))
    steps: tuple[Step, ...] = (
        Call(
            _objective(n, k), ("J", "lower", "upper", "is_set", "v", "N", "kappa"),
            (*_GOAL, "N_next", "kappa_next", "row"),
        ),
        Call(find, ("near", *_GOAL[:2], "N"), _NEAREST),
        Call(_judged(n), ("sound", *_GOAL, "d", "weights", "end", "kappa", "v"), ("sound_next",)),
        *([Call(_added(n, m, sets), ("near", "row", "slot"), ("near_next",))] if sets else []),
    )  # fmt: skip
    after = ("sound_next", "N_next", "kappa_next", "near_next" if sets else "near")
    return Routine("confirm_level", (*state, *level, ("v", n)), steps, after)


def _objective(n: int, k: int) -> Program:
    J, low, high, is_set = ca.SX.sym("J", k * n), ca.SX.sym("low", k), ca.SX.sym("high", k), ca.SX.sym("is_set")
    v, N, kappa = ca.SX.sym("v", n), ca.SX.sym("N", n * n), ca.SX.sym("kappa")
    matrix, projector = as_matrix(J, n), as_matrix(N, n)
    rest = ca.if_else(is_set, SymbolicLevel(matrix, low, high, is_set=True).desired(v), low) - matrix @ v
    parts = decompose(matrix, projector)
    less = projector - parts.directions().T @ parts.directions()
    finest = ca.SX(1)
    for inverse in parts.inverse:
        finest = ca.fmax(finest, inverse)
    length = ca.sqrt(ca.sumsqr(matrix[0, :]))
    off = length <= ZERO_ROW
    unit = 1 / ca.if_else(off, 1, length)
    value = matrix[0, :] @ v
    bounds = [ca.fmin((low[0] - value) * unit, 0), ca.fmax((high[0] - value) * unit, 0)]
    scale = 1 / ca.fmax(1, largest(J))
    rest = rest * scale
    outputs = {
        **_goal((matrix.T @ rest) * scale, ca.sqrt(ca.sumsqr(rest)), projector, v),
        "N_next": ca.vec(ca.if_else(is_set, projector, less)),
        "kappa_next": ca.if_else(is_set, kappa, ca.fmax(kappa, finest)),
        "row": ca.vertcat(
            ca.if_else(off, 0, matrix[0, :].T * unit),
            ca.if_else(off, -HUGE, bounds[0]),
            ca.if_else(off, HUGE, bounds[1]),
            0,
        ),
    }
    inputs = {"J": J, "low": low, "high": high, "is_set": is_set, "v": v, "N": N, "kappa": kappa}
    return lower_named("confirm_objective", inputs, outputs)


def _distance(shape: StackShape, damping: float) -> Program:
    """Return a program for the last objective: the distance to the target, with damping that of the damped problem."""
    flat, levels = shape.symbols()
    v, target, N = ca.SX.sym("v", shape.n), ca.SX.sym("target", shape.n), ca.SX.sym("N", shape.n**2)
    pull, square = target - v, ca.sumsqr(target - v)
    if damping > 0.0:
        scale = 1 / ca.fmax(1, largest(ca.vec(levels[0].J)))
        rest, weight = (levels[0].desired(v) - levels[0].J @ v) * scale, (damping * scale) ** 2
        pull, square = weight * pull + (levels[0].J.T @ rest) * scale, weight * square + ca.sumsqr(rest)
    inputs = {**dict(zip(("J", "lower", "upper"), flat, strict=True)), "v": v, "target": target, "N": N}
    return lower_named("confirm_distance", inputs, _goal(pull, ca.sqrt(square), as_matrix(N, shape.n), v))


def _goal(pull: ca.SX, value: ca.SX, N: ca.SX, v: ca.SX) -> dict[str, ca.SX]:
    """Return the outputs `_GOAL`: ĝ with a 0 for the opening; whether the objective is met anyway; |g|; its value."""
    pull = N @ pull
    size = largest(pull)
    none = ca.logic_or(value <= LOSS, 2 * size * _radius(v) <= LOSS * value * (1 + value))
    unit = pull * ca.if_else(none, 0, 1 / ca.if_else(none, 1, size))
    return {"base": ca.vertcat(unit, 0), "skip": none, "size": size, "value": value}


def _judged(n: int) -> Program:
    """Return a program that updates `sound`: whether the objective cannot be much smaller."""
    sound, skip, size, value, end, kappa = (ca.SX.sym(k) for k in ("sound", "skip", "size", "value", "end", "kappa"))
    base, d, weights, v = ca.SX.sym("base", n + 1), ca.SX.sym("d", n + 1), ca.SX.sym("weights", n), ca.SX.sym("v", n)
    loss = size * _loss(base[:n], d[:n], weights, kappa, v)
    good = ca.logic_and(ca.eq(end, OPTIMAL), 2 * loss <= LOSS * value * (1 + value))
    inputs = {"sound": sound, "base": base, "skip": skip, "size": size, "value": value, "d": d, "weights": weights}
    inputs |= {"end": end, "kappa": kappa, "v": v}
    return lower_named("confirm_judged", inputs, {"sound_next": ca.logic_and(sound, ca.logic_or(skip, good))})


def _radius(v: ca.SX) -> ca.SX:
    return 2 * (1 + largest(v))


def _loss(pull: ca.SX, d: ca.SX, weights: ca.SX, kappa: ca.SX, v: ca.SX) -> ca.SX:
    rounding = ROUNDING * kappa * (1 + ca.sum1(ca.fabs(weights)))
    return (ca.sqrt(ca.sumsqr(d)) + rounding) * _radius(v) + ca.fmax(ca.dot(pull - d, d), 0)


def _added(n: int, m: int, sets: int) -> Program:
    near, row, slot = ca.SX.sym("near", m * (n + 3)), ca.SX.sym("row", n + 3), ca.SX.sym("slot", sets)
    start = (m - sets) * (n + 3)
    places = [near[start + j * (n + 3) : start + (j + 1) * (n + 3)] for j in range(sets)]
    filled = [ca.if_else(slot[j], row, place) for j, place in enumerate(places)]
    return lower_named(
        "confirm_added", {"near": near, "row": row, "slot": slot}, {"next": ca.vertcat(near[:start], *filled)}
    )


def _status() -> Program:
    sound, status = ca.SX.sym("sound"), ca.SX.sym("status")
    outcome = ca.if_else(ca.logic_or(sound, status > RELAXED), status, UNCONFIRMED)
    return lower_named("confirm_status", {"sound": sound, "status": status}, {"outcome": outcome})
