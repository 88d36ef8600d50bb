"""Fast priority steps in Python: one compiled call per control period, with named arrays for inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.ir import Routine, compile_block, replay, warn_slower
from surctl.priority.compiled.level_shape import LevelShape
from surctl.priority.compiled.step import OUTPUTS, priority_step
from surctl.priority.problem import PriorityProblem
from surctl.priority.settings import ZERO_ROW, Fallback, Mode

__all__ = ["PriorityStep", "Stage", "bound", "idle_row", "level_shapes"]

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

    J: Array
    lower: Array
    upper: Array
    rows: Array
    box: Array
    v: Array
    active: Array
    multipliers: Array
    opening: Array
    status: Array
    count: Array
    target: Array
    solve: Callable[[], None]

    def __init__(
        self,
        mode: Mode,
        *,
        n: int,
        levels: Sequence[LevelShape],
        rows: int,
        sweeps: int = 1,
        damping: float = 0.0,
        fallback: Fallback = "exact",
    ) -> None:
        """Compile a priority step; arguments and errors are those of `priority_step`.

        Initially all constraint rows are zero with infinite bounds, and the box is unbounded.
        """
        shapes = tuple(levels)
        routine = priority_step(mode, n=n, levels=shapes, rows=rows, sweeps=sweeps, damping=damping, fallback=fallback)
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
        sweeps: int = 1,
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
            sweeps=sweeps,
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
            raise InputError(
                f"has {len(problem.rows)} rows, but the step has {len(self.rows)} places",
                key="problem",
                remedy="build the step with more rows",
            )


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
