"""One compiled step for each priority mode, which computes a finite velocity from any tasks and limits.

nsb: the NSB law, equation (16) of the paper, as projections from the lowest level to level 1, without limits.
filter: the velocity that satisfies the limits and is nearest to the velocity of nsb.
projected: the projections of nsb from the lowest level to level 2, then the projection on level 1 within the limits.
lexicographic: strict priority within the limits, by the kernel in package `hierarchy`, which also completes the steps
of filter and projected that the search of package `solver` does not.

`PriorityStep` runs it in Python: one compiled call per control period, with named arrays for inputs and outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, cast, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.ir import Call, Program, Routine, Step, compile_block, lower, lower_named, replay
from surctl.ir.native import warn_slower
from surctl.priority.compiled.sweep import HUGE, gate, into, sweep, swept
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.problem import PriorityProblem
from surctl.priority.settings import ZERO_ROW, Fallback, Mode, Settings, check_fallback
from surctl.priority.shapes import LevelShape, StackShape
from surctl.priority.solver.elimination import FLOAT64, Precision
from surctl.priority.solver.fallback import CLAMPED, MET, Sizes, limited_step

OUTPUTS = ("v", "active", "multipliers", "opening", "status", "count", "target")
"""Names of the outputs of a step, in order."""

_MOST_BOUNDED = 8

_RAW = tuple(f"{name}_raw" for name in OUTPUTS)
_STACK = ("J", "lower", "upper")


def priority_step(
    mode: Mode,
    *,
    n: int,
    levels: tuple[LevelShape, ...],
    rows: int,
    damping: float = 0.0,
    precision: Precision = FLOAT64,
    fallback: Fallback = "exact",
) -> Routine:
    """Return the routine that computes the velocity v of one control period for a priority mode.

    Inputs: J (K·n,), the Jacobians of all levels, K rows together, stored row by row, highest priority first; lower,
    upper (K,), the bounds of J v, equal for a level with one desired value; rows (m·(n + 3),), m constraint rows lower
    ≤ a·v ≤ upper of any length, the bounds of the box included, each stored as a (n,), lower, upper, soft (1 if the row
    may be relaxed when rows contradict each other); box (2n,), lower and upper bounds to which v is clipped at the end.
    An unused row is all zeros with infinite bounds.

    Outputs: v (n,), the velocity; active (n,), signed numbers of the active constraint rows, from 1 (+ at the upper
    bound, − at the lower bound, 0 for an unused entry), the rows that limit a task first; multipliers (n,), Lagrange
    multipliers of the active rows, for rows of length 1, in min ½‖J v − x‖² if the row limits a task, otherwise in min
    ½‖v − target‖²; opening (1,), the amount by which the bounds of soft rows are moved outwards; status (1,): MET
    (level 1 is met as well as its Jacobian allows), LIMITED (level 1 is met as well as the constraint rows allow),
    RELAXED (soft rows are relaxed), CLAMPED (v is only clipped to the box), BOUNDED (the bounded fallback was used; no
    active rows are reported), or UNCONFIRMED (see below); count (1,), number of iterations; target (n,), the velocity
    that v approaches as far as level 1 and the limits allow.

    The projection on a set-based level leaves a velocity w unchanged if J w is inside the bounds, and otherwise moves w
    to the nearest bound; so v does not jump. In mode lexicographic, the numbers m + 1, m + 2, … in `active` denote
    set-based levels at their bounds, in the order of the levels. In mode nsb, the status is MET if v is finite, v
    ignores limits and box, and target is v.

    UNCONFIRMED replaces MET, LIMITED and RELAXED if v satisfies the limits but was not shown to be optimal: the
    residual of a strict level, the distance to the target, or the opening may be more than `optimality.LOSS`·(1 +
    value) above the least possible. The check is part of the kernel (module `hierarchy.search`); a step that the search
    of package `solver` completes is checked there. Mode nsb has no such check.

    With damping λ, every projection of a velocity w on a level minimises λ²‖z − w‖² + ‖J z − x‖² over z; in mode
    projected this includes the last projection, within the limits. The result is exact while ‖J‖ of the first level is
    below 1e6·λ; for a larger ‖J‖, rounding errors may exceed the terms with λ.

    The status is CLAMPED, with v = 0 clipped to the box, if J, lower or upper contains a NaN or a number above 1e300
    (J: above 1e140), if lower ≠ upper for a level with one desired value, or, in all modes but nsb, if a constraint row
    is longer than 1e150.

    Args:
        mode: the priority law, as described in the module docstring.
        n: number of velocities.
        levels: number of Jacobian rows and kind of each level.
        rows: number of constraint rows m, at least 1.
        damping: λ [unit of J]; 0 in mode lexicographic.
        precision: tolerances of the solver for the number type with which the routine runs.
        fallback: "exact", or "bounded" for modes filter and projected without damping and up to 8 velocities. If limits
            and task 1 are incompatible, or need more than 4 iterations, "bounded" computes a velocity that is not
            optimal, at constant cost; see module `solver.fallback`.

    Raises:
        InputError: the mode is unknown, or n, `rows`, a level or a setting is out of range; the message names the
            level.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import replay
        >>> from surctl.priority import LevelShape, priority_step
        >>> step = priority_step("projected", n=2, levels=(LevelShape(2),), rows=1)
        >>> wall, box = [1.0, 0.0, -np.inf, 0.1, 1.0], [-1.0, -1.0, 1.0, 1.0]
        >>> v, active, *_ = replay(step, [1.0, 0.0, 0.0, 1.0], [0.3, 0.4], [0.3, 0.4], wall, box)
        >>> v.round(3).tolist(), active.tolist()  # held back by row 1 at its upper bound
        ([0.1, 0.4], [1.0, 0.0])
    """
    shape, settings = StackShape(n, levels), Settings(mode, damping)
    check_fallback(fallback, mode=mode, damping=damping)
    if fallback == "bounded" and n > _MOST_BOUNDED:
        problem = f"is for at most {_MOST_BOUNDED} velocities, whose search has code without loops"
        raise InputError(problem, key="fallback", value=fallback, remedy="use the exact fallback")
    if not isinstance(rows, int | np.integer) or rows < 1:
        raise InputError("must be a whole number of at least 1", key="rows", value=rows, remedy="give 1 or more")
    inputs = (*shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n))
    if mode == "lexicographic":
        kernel = hierarchy(shape, rows, precision)
        return Routine(f"{mode}_step", inputs, (Call(kernel, tuple(name for name, _ in inputs), OUTPUTS),), OUTPUTS)
    sizes = Sizes(n, rows, precision=precision, fallback=fallback)
    start = Call(gate(shape), _STACK, ("sound", "zero", "none"))
    if mode == "projected":
        steps = _projected(shape, replace(sizes, level=shape.levels[0], damping=damping), settings)
    else:
        last = Call(_unlimited(n), ("swept",), _RAW)
        if mode == "filter":
            last = Call(limited_step(sizes), ("swept", "rows", "box"), _RAW[:-1])
        steps = (*swept(shape, settings), last)
    raw = _RAW if mode != "filter" else (*_RAW[:-1], "swept")
    finish = Call(_finish(n, boxed=mode != "nsb"), (*raw, "sound", "box"), OUTPUTS)
    return Routine(f"{mode}_step", inputs, (start, *steps, finish), OUTPUTS)


def _projected(shape: StackShape, sizes: Sizes, settings: Settings) -> tuple[Step, ...]:
    """Return the steps of mode projected: projections on the levels from the lowest to 2, then on level 1."""
    n, fixed = shape.n, (*_STACK, "rows", "box")
    carried = (*sizes.solution, ("target", n))
    after = tuple(f"{name}_next" for name in OUTPUTS)
    flat, levels = shape.symbols()
    first = lower_named(
        "level_1",
        dict(zip(_STACK, flat, strict=True)),
        {"J_1": ca.vec(levels[0].J.T), "lower_1": levels[0].lower, "upper_1": levels[0].upper},
    )
    count, spent = ca.SX.sym("count"), ca.SX.sym("spent")
    turn = Routine(
        "sweep_within",
        (*carried, *shape.inputs, ("rows", sizes.rows), ("box", 2 * n)),
        (
            Call(sweep(shape, damping=settings.damping, highest=1), ("v", *_STACK), (after[-1],)),
            Call(first, _STACK, ("J_1", "lower_1", "upper_1")),
            Call(limited_step(sizes), (after[-1], "J_1", "lower_1", "upper_1", "rows", "box"), (*after[:5], "spent")),
            Call(
                lower_named("sum", {"count": count, "spent": spent}, {"s": count + spent}),
                ("count", "spent"),
                after[5:6],
            ),
        ),
        after,
    )
    state = ("zero", "zero", "zero", "none", "none", "none", "zero")
    return (Call(turn, (*state, *fixed), _RAW),)


def _unlimited(n: int) -> Program:
    v = ca.SX.sym("v", n)
    empty, none = ca.SX.zeros(n), ca.SX.zeros(1)
    return lower(ca.Function("unlimited", [v], [v, empty, empty, none, ca.SX(MET), none, v]))


def _finish(n: int, *, boxed: bool) -> Program:
    # if v is not finite, the result is 0 moved into the box
    flat = [ca.SX.sym(name, size) for name, size in zip(OUTPUTS, (n, n, n, 1, 1, 1, n), strict=True)]
    v, active, multipliers, opening, status, count, target = flat
    sound, box = ca.SX.sym("sound"), ca.SX.sym("box", 2 * n)
    good = sound
    for entry in [*ca.vertsplit(v), *ca.vertsplit(target)]:
        good = ca.if_else(ca.fabs(entry) <= HUGE, good, 0)
    rest = into(ca.SX.zeros(n), box[:n], box[n:])
    inside = into(v, box[:n], box[n:]) if boxed else v
    solved = ca.logic_and(good, status != CLAMPED)
    outputs = [
        ca.if_else(good, inside, rest),
        ca.if_else(solved, active, 0),
        ca.if_else(solved, multipliers, 0),
        ca.if_else(solved, opening, 0),
        ca.if_else(good, status, CLAMPED),
        count,
        ca.if_else(good, target, 0),
    ]
    return lower(ca.Function("solution", [*flat, sound, box], list(map(ca.densify, outputs))))


Array: TypeAlias = NDArray[np.float64]
Stage: TypeAlias = Literal["met", "limited", "relaxed", "clamped", "bounded", "unconfirmed"]
"""met: v meets the task and satisfies all constraint rows. limited: the task is met as well as the rows allow. relaxed:
soft rows are relaxed. clamped: v is only clipped to the box. bounded: v comes from the bounded fallback, see module
`solver.fallback`. unconfirmed: v was not shown to be optimal."""

_VIEWS = frozenset(("J", "lower", "upper", "rows", "box", *OUTPUTS))


class PriorityStep:
    """A compiled `priority_step` with its own arrays: write the input arrays, call `solve`, read the output arrays.

        step = PriorityStep.of(problem, mode="projected")
        step.J[...], step.lower[...], step.upper[...] = J, x, x
        step.solve()
        step.v, step.stage, step.binding()

    Every call of `solve` reads the input arrays and overwrites the output arrays. Copy outputs that you need later.
    Write into the elements of an input array; the replacement of an array raises an InputError, because `solve` would
    never read the new array. Do not share a step between threads. Without a C compiler, `replay` interprets the step
    slowly, with equal results.

    Attributes:
        J (K, n), lower (K,), upper (K,): the Jacobians of all levels and the bounds of J v, stacked, highest priority
            first; upper = lower for a level with one desired value.
        rows (m, n + 3): constraint rows, the bounds of the box included; each is normal, lower, upper, soft (1 if the
            row may be relaxed).
        box (2, n): lower and upper bounds to which v is clipped at the end.
        v (n,), active, multipliers (n,), opening, status, count (1,), target (n,): outputs of `priority_step`.
        solve: function without arguments that computes one step and returns None.
        level_names, row_names: names of levels and constraint rows; set by `load`, otherwise "level 1", … and "row 0",
            …
        levels: number of Jacobian rows and kind of each level.
        compiled: whether the step runs as C code.
    """

    def __init__(
        self,
        mode: Mode,
        *,
        n: int,
        levels: Sequence[LevelShape],
        rows: int,
        damping: float = 0.0,
        fallback: Fallback = "exact",
    ) -> None:
        """Compile a priority step; arguments and errors are those of `priority_step`.

        Initially all constraint rows are zero with infinite bounds, and the box is unbounded.
        """
        shapes = tuple(levels)
        routine = priority_step(mode, n=n, levels=shapes, rows=rows, damping=damping, fallback=fallback)
        inputs, outputs, self.solve, self.compiled = bound(routine)
        self._take(mode, n, shapes, inputs, outputs)
        self.rows[:] = idle_row(n)
        self.box[:] = [[-np.inf], [np.inf]]

    def __setattr__(self, name: str, value: object) -> None:
        """Raise an InputError if an array is replaced; `step.J += 1` is allowed, because it changes elements only."""
        if name in _VIEWS and name in self.__dict__ and value is not self.__dict__[name]:
            raise InputError("is a view of the step's buffer", key=name, remedy=f"write into it: step.{name}[...] = …")
        super().__setattr__(name, value)

    def _take(
        self, mode: Mode, n: int, levels: tuple[LevelShape, ...], inputs: Sequence[Array], outputs: Sequence[Array]
    ) -> None:
        self.mode, self.levels = mode, levels
        J, self.lower, self.upper, rows, box = inputs
        self.J, self.rows, self.box = J.reshape(-1, n), rows.reshape(-1, n + 3), box.reshape(2, n)
        self.v, self.active, self.multipliers, self.opening, self.status, self.count, self.target = outputs
        self.level_names = tuple(f"level {place}" for place in range(1, len(self.levels) + 1))
        self.row_names = tuple(f"row {place}" for place in range(len(self.rows)))
        self._moved: Mapping[str, float] = {}
        self._idle = idle_row(n)

    @staticmethod
    def of(
        problem: PriorityProblem,
        mode: Mode = "projected",
        *,
        rows: int | None = None,
        damping: float = 0.0,
        fallback: Fallback = "exact",
    ) -> PriorityStep:
        """Compile a step for problems with the levels of `problem`, and write `problem` into its arrays.

        rows: number of constraint rows; None means the number of limits in `problem`.
        """
        places = max(1, len(problem.rows)) if rows is None else rows
        step = PriorityStep(
            mode,
            n=problem.width,
            levels=level_shapes(problem),
            rows=places,
            damping=damping,
            fallback=fallback,
        )
        step.load(problem)
        return step

    def load(self, problem: PriorityProblem) -> None:
        """Write a problem into the input arrays: levels, limits with their names, and velocity bounds as the box.

        Limits of kind "barrier" and "set" may be relaxed.

        Raises:
            InputError: a level has a different number of Jacobian rows or a different kind (the message names the
                level), or the problem has more limits than the step has constraint rows.
        """
        self._check(problem)
        self.write(problem)
        self.level_names = tuple(level.name for level in problem.levels)
        self.row_names = tuple(row.name for row in problem.rows)
        self._moved = dict(problem.moved)

    def write(self, problem: PriorityProblem) -> None:
        """Write the numbers of a problem whose shape is that of the step."""
        levels = problem.levels
        np.concatenate([level.J for level in levels], out=self.J)
        np.concatenate([level.lower for level in levels], out=self.lower)
        np.concatenate([level.lower if level.upper is None else level.upper for level in levels], out=self.upper)
        used = len(problem.rows)
        self.rows[:used] = problem.table
        if used < len(self.rows):
            self.rows[used:] = self._idle
        self.box[:] = problem.box

    @property
    def stage(self) -> Stage:
        """Return which fallback stage computed the last v; raise an InputError before the first `solve`."""
        if self.status[0] == 0.0:
            raise InputError("has no solution yet", key="step", remedy="call solve() first")
        stages: tuple[Stage, ...] = get_args(Stage)
        stage = stages[int(self.status[0]) - 1]
        return "relaxed" if self._moved and self.mode != "nsb" and stage in ("met", "limited") else stage

    def binding(self) -> tuple[tuple[str, float], ...]:
        """Return (name, Lagrange multiplier) of the active limits, in their units; positive at an upper bound.

        First come the limits that restrict a task, with multipliers of min ½‖J v − x‖². Then come the limits that are
        active when v approaches `target`, with multipliers of min ½‖v − target‖². A set-based level at its bound is
        listed under the name of the level.
        """
        pairs = []
        for number, multiplier in zip(self.active, self.multipliers, strict=True):
            if number != 0.0:
                name, a = self._row(int(abs(number)) - 1)
                length = float(np.sqrt(a @ a))
                signed = float(np.copysign(multiplier, number))
                pairs.append((name, signed / length if length > ZERO_ROW else signed))
        return tuple(pairs)

    def _row(self, place: int) -> tuple[str, Array]:
        # places after the constraint rows refer to set-based levels
        if place < len(self.rows):
            name = self.row_names[place] if place < len(self.row_names) else f"row {place}"
            return name, self.rows[place, :-3]
        sets = [i for i, level in enumerate(self.levels) if level.is_set]
        which = sets[place - len(self.rows)]
        start = sum(level.rows for level in self.levels[:which])
        return self.level_names[which], self.J[start]

    def _check(self, problem: PriorityProblem) -> None:
        if problem.width != self.v.size:
            raise InputError(f"has {problem.width} velocities, but the step has {self.v.size}", key="problem")
        if len(problem.levels) != len(self.levels):
            raise InputError(f"has {len(problem.levels)} levels, but the step has {len(self.levels)}", key="problem")
        for level, shape in zip(problem.levels, self.levels, strict=True):
            if level.lower.size != shape.rows:
                raise InputError(f"has {level.lower.size} rows, the step has {shape.rows}", key=f"task {level.name}")
            if not (shape.is_set or level.is_goal):
                raise InputError("is set-based, unlike its level in the step", key=f"task {level.name}")
        if len(problem.rows) > len(self.rows):
            text = f"has {len(problem.rows)} rows, but the step has {len(self.rows)} places"
            raise InputError(text, key="problem", remedy="build the step with more rows")


def level_shapes(problem: PriorityProblem) -> tuple[LevelShape, ...]:
    """Return the shape of each level; a level is set-based if its lower and upper bounds differ."""
    return tuple(LevelShape(level.lower.size, not level.is_goal) for level in problem.levels)


def idle_row(n: int) -> Array:
    """Return a constraint row (n + 3,) that every velocity satisfies."""
    return np.concatenate([np.zeros(n), [-np.inf, np.inf, 0.0]])


def bound(routine: Routine) -> tuple[list[Array], list[Array], Callable[[], None], bool]:
    """Return input arrays, output arrays, the function that computes the outputs, and whether it is C code."""
    try:
        workspace = compile_block(routine).workspace()
    except ToolMissing as missing:
        warn_slower(missing)
        inputs, outputs = ([np.zeros(size) for _, size in ports] for ports in (routine.inputs, routine.outputs))

        def run() -> None:
            for array, value in zip(outputs, replay(routine, *inputs), strict=True):
                array[:] = cast("Array", value)

        return inputs, outputs, run, False
    return list(workspace.inputs), list(workspace.outputs), workspace.run, True
