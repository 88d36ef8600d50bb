"""Stack of tasks in order of priority."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from surctl.errors import InputError
from surctl.tasks.set_task import SetTask
from surctl.tasks.task import Task

__all__ = ["Stack"]


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
                raise InputError(
                    f"names both task {places[task.name]} and task {place}",
                    key="stack",
                    value=task.name,
                    remedy="rename one of them",
                )
            places[task.name] = place
            if not ca.is_equal(task.eta, self.tasks[0].eta):
                raise InputError(
                    f"uses another eta symbol than task {self.tasks[0].name}",
                    key=f"task {task.name}",
                    remedy="build all tasks of a stack from one eta",
                )
            first = self.tasks[0].mapping
            if task.mapping.shape != first.shape or not ca.is_equal(ca.densify(task.mapping), ca.densify(first), 9):
                raise InputError(
                    f"has different kinematics from task {self.tasks[0].name}",
                    key=f"task {task.name}",
                    remedy="give all tasks of a stack the same kinematics",
                )

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
