"""Stack of tasks in order of priority; tasks that keep σ between bounds; limits of the rate of σ."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from surctl.errors import InputError
from surctl.tasks.task import (
    Expression,
    Kind,
    LimitRow,
    Task,
    TaskBase,
    checked_column,
    checked_kind,
    wrap,
)

# Set-based task: a quantity σ of the robot's pose that may have any value between two bounds


_TURN = 2.0 * math.pi


@dataclass(frozen=True, kw_only=True, eq=False)
class SetTask(TaskBase):
    """A task that keeps σ between two bounds by K(lower − σ) ≤ σ̇ − σ̇_set ≤ K(upper − σ) (Escande et al. 2014).

    K is the gain, and σ̇_set is the rate at which the bounds move. While σ is between its bounds, σ̇ may have both
    signs. At a bound, σ cannot cross the bound. Outside the bounds, σ converges to the nearer bound with gain K. The
    bounds on σ̇ change continuously with σ, so the task needs no switching.

    Attributes:
        name, eta, sigma, gain, unit, kinematics: as in `Task`.
        lower, upper: bounds of the k entries of σ, (k,) or one number for all [unit of σ]; −inf or inf for no bound.
        rate: rate σ̇_set at which both bounds move, (k,) or one number [unit of σ per second].
        angular: σ is an angle [rad], and the allowed values form the arc from lower to upper, shorter than a turn.
            Outside the arc, σ returns through the smaller angle, so the bounds on σ̇ jump opposite the middle of the
            arc.

    Raises:
        InputError: `Task` rejects an attribute, a bound is NaN, lower > upper, or an arc has an infinite bound or is a
            whole turn or longer. The message names the task.
    """

    lower: Expression
    upper: Expression

    def __post_init__(self) -> None:
        """Check the attributes and convert every number to a column with one entry for each entry of σ."""
        super().__post_init__()
        self.set_columns("lower", "upper", finite=False)
        for i in range(self.size):
            self._check_pair(i)

    def error(self) -> ca.SX:
        """Return the change, (k, 1), that takes each entry of σ to its nearer bound; 0 between the bounds."""
        below, above = self._distances()
        return ca.fmax(below, 0.0) + ca.fmin(above, 0.0)

    def slab(self) -> tuple[ca.SX, ca.SX]:
        """Return the lower and the upper bound on σ̇, (k, 1) each [unit of σ per second]; ±inf for an absent bound."""
        below, above = self._distances()
        lower = [self._rate_of(i, below[i], -math.inf) for i in range(self.size)]
        upper = [self._rate_of(i, above[i], math.inf) for i in range(self.size)]
        return ca.densify(ca.vertcat(*lower)), ca.densify(ca.vertcat(*upper))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return the bounds on σ̇ as limit rows of kind "set", named NAME.set (one row) or NAME.set0, NAME.set1, …"""
        J, (lower, upper) = self.jacobian(), self.slab()
        return tuple(LimitRow(name, "set", J[i, :], lower[i], upper[i]) for i, name in enumerate(self.row_names("set")))

    def split(self) -> tuple[SetTask, ...]:
        """Return one set-based task for each entry of σ, named NAME0, NAME1, …; the task itself if σ has one entry."""
        if self.size == 1:
            return (self,)
        names = ("sigma", "lower", "upper", "rate", "gain")
        rows: list[dict[str, Any]] = [{name: getattr(self, name)[i] for name in names} for i in range(self.size)]
        return tuple(replace(self, name=f"{self.name}{i}", **row) for i, row in enumerate(rows))

    def _distances(self) -> tuple[ca.SX, ca.SX]:
        # for an angle, along the shorter arc
        lower, upper = ca.SX(self.lower), ca.SX(self.upper)
        if not self.angular:
            return lower - self.sigma, upper - self.sigma
        error, half = wrap(0.5 * (lower + upper) - self.sigma), 0.5 * (upper - lower)
        return error - half, error + half

    def _rate_of(self, i: int, distance: ca.SX, absent: float) -> ca.SX:
        """Return the bound on σ̇ from the distance of σ to its bound, or `absent` if σ has no such bound."""
        if distance.is_constant() and math.isinf(float(distance)):
            return ca.SX(absent)
        return ca.SX(self.rate)[i] + ca.SX(self.gain)[i] * distance

    def _check_pair(self, i: int) -> None:
        # expressions are not checked
        lower, upper = ca.SX(self.lower)[i], ca.SX(self.upper)[i]
        if not (lower.is_constant() and upper.is_constant()):
            return
        low, high = float(lower), float(upper)
        key, value = f"task {self.name}: row {i}", [low, high]
        if not low <= high or low == math.inf or high == -math.inf:
            raise InputError("allows no value", key=key, value=value, remedy="give lower <= upper, or inf for none")
        if self.angular and not high - low < _TURN:
            raise InputError(
                "is not an arc", key=key, value=value, remedy="give two angles less than a turn apart, or omit the task"
            )


@dataclass(frozen=True, eq=False)
class RateLimit:
    """The limit |σ̇_i| ≤ limit_i on every entry of a task's quantity σ, expressed as constraints on the velocity.

    Attributes:
        task: the task whose quantity σ is limited; it also provides the Jacobian J in σ̇ = J v.
        limit: largest rate of each of the k entries of σ, (k,) or one number for all, at least 0 [unit of σ per
            second].
        kind: kind of limit; see `Kind`.

    Raises:
        InputError: a shape is wrong, a number is negative or not finite, or the kind is unknown; the message names the
            task.
    """

    task: TaskBase
    limit: Expression
    kind: Kind = "set"

    def __post_init__(self) -> None:
        """Check the attributes and convert a limit that is one number to a column."""
        name, k = f"{self.task.name}.rate", self.task.size
        checked_kind(name, self.kind)
        column = checked_column(f"limit {name}: limit", self.limit, 1, k, sign="not negative")
        object.__setattr__(self, "limit", ca.repmat(column, k // column.numel(), 1))

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row per entry of σ, named TASK.rate for one entry, otherwise TASK.rate0, TASK.rate1, …"""
        J, limit = self.task.jacobian(), ca.SX(self.limit)
        return tuple(
            LimitRow(name, self.kind, J[i, :], -limit[i], limit[i])
            for i, name in enumerate(self.task.row_names("rate"))
        )


@dataclass(frozen=True, eq=False)
class Stack:
    """Tasks (with one desired value or set-based) in order of priority, highest priority first.

    Raises:
        InputError: there is no task, two tasks have the same name, or tasks have different configurations or
            kinematics.
    """

    tasks: tuple[Task | SetTask, ...]

    def __post_init__(self) -> None:
        """Check the names of the tasks and that all tasks use the same pose symbol."""
        object.__setattr__(self, "tasks", tuple(self.tasks))
        if not self.tasks:
            raise InputError("contains no task", key="stack", remedy="give at least one task")
        places: dict[str, int] = {}
        for place, task in enumerate(self.tasks, start=1):
            if task.name in places:
                problem = f"names both task {places[task.name]} and task {place}"
                raise InputError(problem, key="stack", value=task.name, remedy="rename one of them")
            places[task.name] = place
            if not ca.is_equal(task.eta, self.tasks[0].eta):
                problem = f"uses another eta symbol than task {self.tasks[0].name}"
                raise InputError(problem, key=f"task {task.name}", remedy="build all tasks of a stack from one eta")
            first = self.tasks[0].mapping
            if task.mapping.shape != first.shape or not ca.is_equal(ca.densify(task.mapping), ca.densify(first), 9):
                problem = f"has different kinematics from task {self.tasks[0].name}"
                remedy = "give all tasks of a stack the same kinematics"
                raise InputError(problem, key=f"task {task.name}", remedy=remedy)

    @property
    def eta(self) -> ca.SX:
        """Return the symbol of the configuration (m, 1) that all tasks share."""
        return self.tasks[0].eta

    @property
    def velocities(self) -> int:
        """Return n, the number of velocities."""
        return int(self.tasks[0].mapping.shape[1])

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the tasks, highest priority first."""
        return tuple(task.name for task in self.tasks)

    def levels(self) -> list[tuple[ca.SX, ca.SX]]:
        """Return the Jacobian J (k, n) and the reference rate x (k, 1) of each task, highest priority first.

        Raises:
            InputError: a task is set-based, so it has no reference rate; use `slabs`.
        """
        return [(task.jacobian(), _equality(task).reference()) for task in self.tasks]

    def slabs(self) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
        """Return the Jacobian J (k, n) and the lower and upper bound (k, 1) of σ̇ of each task, highest priority first.

        For a `Task` with one desired value, both bounds are the reference rate x, equation (14) of the paper.
        """
        return [(task.jacobian(), *_slab(task)) for task in self.tasks]


def _slab(task: Task | SetTask) -> tuple[ca.SX, ca.SX]:
    if isinstance(task, SetTask):
        return task.slab()
    reference = task.reference()
    return reference, reference


def _equality(task: Task | SetTask) -> Task:
    if isinstance(task, SetTask):
        raise InputError(
            "is set-based, so it has no single reference", key=f"task {task.name}", remedy="use `slabs` of the stack"
        )
    return task
