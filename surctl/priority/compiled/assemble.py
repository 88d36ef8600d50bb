"""Compile a symbolic task stack and its limits to the inputs of a priority step; crossing bounds are moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir import Call, Program, Routine, lower, lower_named
from surctl.priority.compiled.step import PriorityStep, bound, priority_step
from surctl.priority.problem import CROSSING, Level, PriorityProblem, Row, build_problem
from surctl.priority.settings import Fallback, Mode
from surctl.priority.shapes import LevelShape
from surctl.priority.solver.fallback import RELAXED
from surctl.tasks import Limit, LimitRow, SetTask, Stack
from surctl.tasks.task import checked_kind

Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Assembly:
    """A task stack and its limits as one function of named inputs; build it with `assemble`.

    Attributes:
        stack: the tasks. limits: the linear constraints of all limits.
        sizes: number of entries of each input (such as the pose), by name.
        function: CasADi function of the inputs in the order of `sizes`. The outputs are the inputs of `priority_step`:
            J (K·n,), the Jacobians of all levels with K rows together, row by row; lower (K,) and upper (K,), the
            bounds of J v for the velocity v; rows (m·(n + 3),), the m constraint rows; box (2n,), the bounds of v.
            Without limits, the function returns one constraint row that is always satisfied. The box contains the
            actuator limits that bound a single velocity for all values of the inputs. The last output, moved (m,), is 0
            for a row that stands as written. If its bounds cross (see `assemble`), it is by how much a velocity within
            the returned bounds violates the row as written.
    """

    stack: Stack
    limits: tuple[LimitRow, ...]
    sizes: Mapping[str, int]
    function: ca.Function

    def problem(self, values: Mapping[str, ArrayLike]) -> PriorityProblem:
        """Evaluate tasks and limits for these values of the inputs, and return the priority problem.

        Raises:
            InputError: an input is missing, unknown, or of the wrong size, or a task or a limit is not finite at these
                values; the message names the task and the row of its Jacobian, or the limit.
        """
        arguments = self._checked(values)
        J, lower, upper, rows, _, moved = (np.array(part).reshape(-1) for part in self.function.call(arguments))
        levels, start, n = [], 0, self.stack.velocities
        for task, shape in zip(self.stack.tasks, self.shapes, strict=True):
            end = start + shape.rows
            # an equal pair stays one value, so that a NaN in it is reported as a NaN and not as a set
            high = upper[start:end] if shape.is_set else None
            levels.append(
                Level(task.name, J[n * start : n * end].reshape(-1, n), lower[start:end], high, task.rate_unit)
            )
            start = end
        table = rows.reshape(-1, n + 3)
        limits = [
            Row(row.name, row.kind, entry[:n], float(entry[n]), float(entry[n + 1]))
            for row, entry in zip(self.limits, table, strict=False)
        ]
        amounts = {row.name: float(by) for row, by in zip(self.limits, moved, strict=False) if by > 0.0}
        return build_problem(levels, limits, moved=amounts)

    def step(self, mode: Mode = "projected", *, damping: float = 0.0, fallback: Fallback = "exact") -> AssembledStep:
        """Compile a priority step that first evaluates tasks and limits, and return it with its own arrays.

        Raises:
            InputError: the Jacobian of a set-based task has more than one row; `priority_step` lists the other errors.
        """
        return AssembledStep(self, mode, damping=damping, fallback=fallback)

    @property
    def shapes(self) -> tuple[LevelShape, ...]:
        """Return the number of Jacobian rows and the kind of each level."""
        return tuple(LevelShape(task.size, isinstance(task, SetTask)) for task in self.stack.tasks)

    def _checked(self, values: Mapping[str, ArrayLike]) -> list[Array]:
        for name in values:
            if name not in self.sizes:
                raise InputError("no such input", key=name, remedy=nearest(name, self.sizes))
        arguments = []
        for name, size in self.sizes.items():
            if name not in values:
                raise InputError("is missing", key=name, remedy=f"give {size} numbers")
            try:
                value = np.array(values[name], dtype=np.float64).reshape(-1)
            except (TypeError, ValueError):
                raise InputError("is not an array of numbers", key=name, value=values[name]) from None
            if value.size != size:
                raise InputError(f"has {value.size} entries, expected {size}", key=name)
            arguments.append(value)
        return arguments


class AssembledStep(PriorityStep):
    """Evaluation of tasks and limits and a priority step in one compiled call: write `inputs`, call `solve`, read `v`.

    The arrays J, lower, upper, rows and box are computed from `inputs`, so `load` is not available. If a number is not
    finite, the status is CLAMPED, and v is 0 moved into the velocity bounds; `Assembly.problem` then names the task and
    the row of its Jacobian.

    Attributes:
        inputs: one array for each input, by name. The mapping is read-only; write the values into the arrays.
        moved (m,): output; by how much v must violate each limit, because its bounds cross those of a harder one.
    """

    def __init__(self, assembly: Assembly, mode: Mode, *, damping: float = 0.0, fallback: Fallback = "exact") -> None:
        """Compile the step; the arguments are those of `Assembly.step`."""
        for task in assembly.stack.tasks:
            if isinstance(task, SetTask) and task.size > 1:
                problem = f"is set-based and has {task.size} rows; a compiled level has 1"
                raise InputError(problem, key=f"task {task.name}", remedy="put its split() into the stack")
        n, places = assembly.stack.velocities, max(1, len(assembly.limits))
        step = priority_step(mode, n=n, levels=assembly.shapes, rows=places, damping=damping, fallback=fallback)
        inputs, outputs, self.solve, self.compiled = bound(_fused(lower(assembly.function), step, mode))
        places = len(step.inputs)
        self._take(mode, n, assembly.shapes, outputs[:places], outputs[places + 1 :])
        self.moved = outputs[places]
        self.level_names = assembly.stack.names
        self.row_names = tuple(row.name for row in assembly.limits)
        self.inputs = MappingProxyType(dict(zip(assembly.sizes, inputs, strict=True)))

    def load(self, problem: PriorityProblem) -> None:
        """Raise an InputError, because `solve` computes the arrays from `inputs` and would overwrite the problem."""
        del problem
        raise InputError(
            "cannot load a problem", key="step", remedy="write into its inputs, or use PriorityStep.of(problem)"
        )


def _fused(stack: Program, step: Routine, mode: Mode) -> Routine:
    inputs = tuple(name for name, _ in stack.inputs)
    between = tuple(name for name, _ in step.inputs)
    outputs = tuple(name for name, _ in step.outputs)
    raw = tuple("status_found" if name == "status" else name for name in outputs)
    moved, status = ca.SX.sym("moved", dict(stack.outputs)["moved"]), ca.SX.sym("status")
    eased = ca.logic_and(ca.mmax(moved) > 0, status < RELAXED)
    outcome = status if mode == "nsb" else ca.if_else(eased, RELAXED, status)
    return Routine(
        f"assembled_{step.name}",
        stack.inputs,
        (
            Call(stack, inputs, (*between, "moved")),
            Call(step, between, raw),
            Call(
                lower_named("moved_rows", {"moved": moved, "status": status}, {"outcome": outcome}),
                ("moved", "status_found"),
                ("status",),
            ),
        ),
        (*between, "moved", *outputs),
    )


def assemble(stack: Stack, limits: Sequence[Limit] = (), *, inputs: Mapping[str, ca.SX]) -> Assembly:
    """Build one function that evaluates the tasks of a stack and the limits.

    Bounds that cross are moved, by the same rule in `Assembly.problem` and in the compiled step, and the limit is named
    as relaxed. (1) If lower > upper in one row, as for a damper outside its joint limit, both bounds become the value
    between them that is nearest to 0. So a velocity never exceeds a bound that allows 0. (2) If actuator limits on a
    single velocity exclude each other, the earlier limit in `limits` is harder: the later one becomes the point of the
    earlier ones that is nearest to it. Write physical limits first, then limits such as dampers.

    Args:
        stack: tasks and set-based tasks.
        limits: limits on the velocity.
        inputs: all symbols that tasks and limits contain, as SX columns, by the name under which their values are
            passed later, for example "eta".

    Raises:
        InputError: an input is not a symbol or occurs twice; a task or limit contains a symbol that is not an input
            (the message names the symbol); a limit has the wrong number of columns; two limit rows have the same name.

    Example:
        >>> import casadi as ca
        >>> from surctl.priority import assemble, solve
        >>> from surctl.tasks import Stack, VelocityBox, depth_task, heading_task
        >>> eta = ca.SX.sym("eta", 4)  # x, y, z, heading
        >>> stack = Stack((depth_task(eta, -0.5), heading_task(eta, 0.0)))
        >>> box = VelocityBox([-0.2, -0.2, -0.1, -0.5], [0.2, 0.2, 0.1, 0.5])
        >>> assembly = assemble(stack, [box], inputs={"eta": eta})
        >>> found = solve(assembly.problem({"eta": [1.0, 0.5, -0.2, 0.1]}))
        >>> found.v.round(3).tolist(), found.explain()
        ([0.0, 0.0, -0.1, -0.1], 'Task `depth` gave up 0.2 m/s because `velocity.w` binds.')
    """
    for name, symbol in inputs.items():
        if not (isinstance(symbol, ca.SX) and symbol.shape[1] == 1 and symbol.numel() and symbol.is_valid_input()):
            raise InputError("is not a column of SX symbols", key=f"inputs.{name}", remedy='as in ca.SX.sym("eta", 4)')
    known = _known(inputs)
    rows = tuple(
        replace(row, a=ca.SX(row.a), lower=ca.SX(row.lower), upper=ca.SX(row.upper))
        for limit in limits
        for row in limit.rows()
    )
    slabs = stack.slabs()
    for task, parts in zip(stack.tasks, slabs, strict=True):
        _check_symbols(f"task {task.name}", parts, known)
    for i, row in enumerate(rows):
        _check_symbols(f"limit {row.name}", (row.a, row.lower, row.upper), known)
        for field, size in (("a", stack.velocities), ("lower", 1), ("upper", 1)):
            entries = getattr(row, field).numel()
            if entries != size:
                raise InputError(f"has {entries} entries, expected {size}", key=f"limit {row.name}: {field}")
        checked_kind(row.name, row.kind)
        if row.name in (other.name for other in rows[:i]):
            raise InputError("names two limits", key=f"limit {row.name}", remedy="rename one of them")
    agreed, box, moved = _agreed(rows, stack.velocities)
    outputs = [*_stacked(slabs), _table(agreed, stack.velocities), box, moved]
    names = ["J", "lower", "upper", "rows", "box", "moved"]
    dense = [ca.densify(output) for output in outputs]
    function = ca.Function("assembly", list(inputs.values()), dense, [f"in_{k}" for k in range(len(inputs))], names)
    return Assembly(stack, rows, {name: int(symbol.numel()) for name, symbol in inputs.items()}, function)


def _known(inputs: Mapping[str, ca.SX]) -> set[int]:
    known: set[int] = set()
    for name, symbol in inputs.items():
        for scalar in ca.vertsplit(symbol):
            if scalar.element_hash() in known:
                raise InputError("belongs to two inputs", key=f"inputs.{name}", value=str(scalar))
            known.add(scalar.element_hash())
    return known


def _check_symbols(key: str, parts: Sequence[ca.SX], known: set[int]) -> None:
    every = ca.vertcat(*(ca.vec(ca.SX(part)) for part in parts))
    missing = [str(symbol) for symbol in ca.symvar(every) if symbol.element_hash() not in known]
    if missing:
        problem = f"depends on {', '.join(missing)}, which {'is' if len(missing) == 1 else 'are'} not among the inputs"
        raise InputError(problem, key=key, remedy="add the symbol to inputs")


def _stacked(slabs: Sequence[tuple[ca.SX, ca.SX, ca.SX]]) -> list[ca.SX]:
    return [
        ca.vertcat(*(ca.vec(ca.densify(J).T) for J, _, _ in slabs)),
        ca.vertcat(*(lower for _, lower, _ in slabs)),
        ca.vertcat(*(upper for _, _, upper in slabs)),
    ]


def _table(rows: Sequence[LimitRow], n: int) -> ca.SX:
    lines = [ca.vertcat(ca.vec(row.a), row.lower, row.upper, ca.SX(0 if row.kind == "actuator" else 1)) for row in rows]
    return ca.vertcat(*lines) if lines else ca.vertcat(ca.SX.zeros(n), -ca.inf, ca.inf, 0)


def _agreed(rows: Sequence[LimitRow], n: int) -> tuple[list[LimitRow], ca.SX, ca.SX]:
    """Return the rows with bounds that do not cross, the box (2n,), and by how much each row had to be moved (m,)."""
    low, high = [ca.SX(-ca.inf)] * n, [ca.SX(ca.inf)] * n
    agreed, moved = [], []
    for row in rows:
        crossed, between = row.lower > row.upper, ca.fmin(ca.fmax(0, row.upper), row.lower)
        lower, upper = ca.if_else(crossed, between, row.lower), ca.if_else(crossed, between, row.upper)
        entries = [j for j in range(n) if not row.a[j].is_zero()]
        if row.kind == "actuator" and len(entries) == 1:
            (j,) = entries
            a = row.a[j]
            used = a != 0
            by = ca.if_else(used, a, 1)
            first, last = ca.if_else(a > 0, lower / by, upper / by), ca.if_else(a > 0, upper / by, lower / by)
            apart = ca.logic_and(used, ca.logic_or(first > high[j], last < low[j]))
            ends = [ca.fmin(ca.fmax(end, low[j]), high[j]) for end in (first, last)]
            low[j], high[j] = ca.if_else(used, ends[0], low[j]), ca.if_else(used, ends[1], high[j])
            lower, upper = ca.if_else(apart, low[j] * a, lower), ca.if_else(apart, low[j] * a, upper)
            crossed = ca.logic_or(crossed, apart)
        agreed.append(replace(row, lower=lower, upper=upper))
        by = ca.fmax(row.lower - lower, upper - row.upper)
        moved.append(ca.if_else(ca.logic_and(crossed, by > CROSSING * (1 + ca.fabs(lower))), by, 0))
    return agreed, ca.vertcat(*low, *high), ca.vertcat(*moved) if moved else ca.SX.zeros(1)
