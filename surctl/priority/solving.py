"""The function `solve`: its status (`unconfirmed`), what gave up how much for which limit, timeline of results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from threading import Lock
from typing import Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.priority.compiled.step import PriorityStep, Stage, level_shapes
from surctl.priority.optimality import LOSS, conflicting, is_least, is_optimal, restrictions
from surctl.priority.problem import Level, PriorityProblem
from surctl.priority.reference import reference_solution, target_of, without_rows
from surctl.priority.settings import Mode, Settings

Array: TypeAlias = NDArray[np.float64]

Outcome: TypeAlias = Literal["optimal", "limited", "relaxed", "unconfirmed", "clamped"]
"""optimal: v is the optimum of the mode, and the first task, where the mode considers it, is met as well as without
limits. limited: the first task is met as well as the limits allow. relaxed: the limits contradict each other, so some
were relaxed or moved. unconfirmed: v satisfies the limits as far as a solver could, but was not shown to be optimal, by
the tolerance `optimality.LOSS`. clamped: the actuator limits contradict each other (or no solver found a solution), and
v is only clipped to the velocity bounds."""

_LEAST_NAMED = 1e-7  # smallest loss of a task that `explain` names


@dataclass(frozen=True, eq=False)
class PrioritySolution:
    """The velocity from the priority law, which is always finite, with the limits and tasks that determine it.

    The explanation (all properties) is computed from v and the problem when it is first read.

    Attributes:
        problem: the problem that was solved.
        settings: settings of the priority law: mode, damping.
        v: (n,), velocity; for this vehicle (u, v, w, r) in the body frame {B} [m/s, rad/s].
        target: (n,), the velocity to which v is as near as limits and strict levels allow: for "projected", the result
            of the projections on all levels below the first; for "filter", the result of the NSB law, equation (16) of
            the paper; for "lexicographic", 0.
        status: see `Outcome`.
        iterations: number of iterations of the solver; 0 if no solver was needed.
    """

    problem: PriorityProblem
    settings: Settings
    v: Array
    target: Array
    status: Outcome
    iterations: int

    @property
    def mode(self) -> str:
        """Return the name of the priority mode."""
        return self.settings.mode

    @property
    def units(self) -> dict[str, str]:
        """Return the unit of each level's residual."""
        return {level.name: level.unit for level in self.problem.levels}

    @cached_property
    def residuals(self) -> Mapping[str, float]:
        """Return the residual ‖J v − x‖ of each level by name [unit of σ per second]; x is the desired rate."""
        return residuals_at(self.v, self.problem.levels)

    @cached_property
    def without_limits(self) -> Mapping[str, float]:
        """Return the residual of each level without limits; this residual is due to the higher levels alone."""
        with np.errstate(all="ignore"):
            v = without_rows(self.problem.levels, width=self.v.size, settings=self.settings)
        return residuals_at(v if np.isfinite(v).all() else self.v, self.problem.levels)

    @cached_property
    def _restrictions(self) -> list[tuple[str | None, dict[str, float]]]:
        if self.status == "clamped":
            return []
        return restrictions(self.v, self.problem, settings=self.settings, target=self.target)

    @cached_property
    def binding(self) -> tuple[tuple[str, float], ...]:
        """Return (name, Lagrange multiplier) of each active limit, in the unit of the limit.

        The multiplier is positive at the upper bound and negative at the lower bound. A set-based level at its bound is
        listed under the name of the level, with a dot and the row index if its Jacobian has several rows. The
        multiplier belongs to min ½‖v − target‖². If the limit restricts a strict level (the first level in "projected",
        any level in "lexicographic"), the multiplier belongs to min ½‖J v − x‖² of this level.
        """
        by_name: dict[str, float] = {}
        for _, held in self._restrictions:
            by_name = {**held, **by_name}
        order = dict.fromkeys((*(row.name for row in self.problem.rows), *by_name))
        return tuple((name, by_name[name]) for name in order if name in by_name)

    @cached_property
    def causes(self) -> Mapping[str, tuple[str, ...]]:
        """Return, for each strict level that limits restrict, the names of these limits."""
        return {name: tuple(held) for name, held in self._restrictions if name is not None and held}

    @cached_property
    def relaxed(self) -> Mapping[str, float]:
        """Return by how much v violates each limit, by name, in the unit of the limit.

        A limit that had to be moved because it crosses a harder one is listed too.
        """
        return {**self.problem.moved, **self.problem.limits.missed(self.v)}

    @cached_property
    def conflict(self) -> tuple[str, ...]:
        """Return the names of the limits that contradict each other; empty if no limit had to be relaxed."""
        apart = () if self.mode == "nsb" or self.status == "clamped" else conflicting(self.v, self.problem)
        return tuple(dict.fromkeys((*self.problem.moved, *apart)))

    def explain(self) -> str:
        """Return one or two sentences that state which task is not fully met, by how much, and due to which limit."""
        if self.status == "clamped":
            return "The actuator rows contradict each other, or all solvers failed: v is only moved into the box."
        text = self._losses()
        if self.status == "unconfirmed":
            text = f"{text} No solution passed the optimality check, so a better v may exist."
        if not self.relaxed:
            return text
        missed = ", ".join(f"`{name}` by {amount:.2g}" for name, amount in self.relaxed.items())
        if self.mode == "nsb":
            return f"{text} This mode ignores limits: v violates {missed}."
        who = f" ({_listed(self.conflict)})" if self.conflict else ""
        return f"{text} The limits contradict each other{who}, so the least violation was allowed: {missed}."

    def is_optimal(self, problem: PriorityProblem, tol: float = 1e-6) -> bool:
        """Return whether v is optimal for the priority mode and `problem`, by the check in module `optimality`."""
        return self.status != "clamped" and is_optimal(
            self.v, problem, settings=self.settings, target=self.target, tol=tol
        )

    def _losses(self) -> str:
        """Return a sentence that states which tasks are not fully met, by how much, and due to which limits."""
        bind = tuple(name for name, _ in self.binding)
        lost: dict[tuple[str, ...], list[str]] = {}
        for name, residual in self.residuals.items():
            amount = residual - self.without_limits[name]
            if amount > _LEAST_NAMED:
                unit = f" {self.units[name]}" if self.units[name] else ""
                lost.setdefault(self.causes.get(name, bind), []).append(f"task `{name}` gave up {amount:.2g}{unit}")
        if not lost:
            if bind:
                return f"{_listed(bind)} {_verb(bind)}, but no task gives up anything."
            known = "the null-space-based law" if self.mode != "lexicographic" else "that of strict priority"
            return f"v is {known}." if self.relaxed else f"No limit binds: v is {known}."
        because = [
            ", ".join(tasks) + (f" because {_listed(rows)} {_verb(rows)}" if rows else "")
            for rows, tasks in lost.items()
        ]
        text = "; ".join(because)
        return f"{text[0].upper()}{text[1:]}."


def _listed(names: Sequence[str]) -> str:
    return " and ".join(f"`{name}`" for name in names)


def _verb(names: Sequence[str]) -> str:
    return "bind" if len(names) > 1 else "binds"


def residuals_at(v: Array, levels: tuple[Level, ...]) -> dict[str, float]:
    """Return the residual ‖J v − x‖ of each level by name; for a set-based level, the distance to its interval."""
    return {level.name: level.residual(v) for level in levels}


NOTICEABLE = 1e-6
"""Smallest residual that counts, in any level's unit; smaller residuals are rounding errors."""


@dataclass(frozen=True, eq=False)
class PriorityTimeline:
    """The priority decisions of n control steps.

    Attributes:
        time: (n,) time of each control step [s].
        levels: names of the priority levels, highest priority first; `units` holds the units of the levels' residuals.
        to_levels: (n, levels) part of a level's residual that higher levels cause, that is, the residual without
            constraint rows.
        to_rows: (n, levels) part of each level's residual that the constraint rows cause in addition.
        rows: names of the constraint rows that bind or are violated in some control step, in the law's order.
        binding: (n, rows) whether a constraint row binds; missed: (n, rows) by how much the velocity violates the
            constraint row [m/s].
        causes: (n, levels, rows) whether a constraint row caused a residual of a level.
    """

    time: Array
    levels: tuple[str, ...]
    units: tuple[str, ...]
    to_levels: Array
    to_rows: Array
    rows: tuple[str, ...]
    binding: NDArray[np.bool_]
    missed: Array
    causes: NDArray[np.bool_]

    @property
    def eventful(self) -> bool:
        """Whether, in some control step, a level has a residual or a constraint row binds or is violated."""
        return bool(self.rows) or bool((self.to_levels > NOTICEABLE).any())

    @classmethod
    def of(
        cls,
        time: ArrayLike,
        solutions: Sequence[PrioritySolution],
        *,
        units: Mapping[str, str] | None = None,
        rows: Sequence[str] = (),
    ) -> PriorityTimeline:
        """Return the timeline of the solutions of one stack at successive times.

        Args:
            time: (n,) time of each solution [s].
            solutions: n solutions.
            units: names of all levels, highest priority first, with their units; default: those of the solutions.
            rows: names of constraint rows in the order of the timeline; other rows follow in alphabetical order.

        Raises:
            InputError: the numbers of times and solutions differ.

        Example:
            >>> import casadi as ca
            >>> from surctl.priority import PriorityTimeline, assemble, solve
            >>> from surctl.tasks import Stack, Task, VelocityBox
            >>> q = ca.SX.sym("q", 2)
            >>> go = Task(name="go", eta=q, sigma=q[0] + q[1], target=2.0, gain=1.0, unit="m")
            >>> step = assemble(Stack((go,)), [VelocityBox([-0.5, -0.5], [0.5, 0.5])], inputs={"q": q})
            >>> solutions = [solve(step.problem({"q": [x, 0.0]}), mode="projected") for x in (0.0, 1.5)]
            >>> timeline = PriorityTimeline.of([0.0, 1.0], solutions)
            >>> timeline.rows, timeline.to_rows[:, 0].round(2).tolist()
            (('velocity.0', 'velocity.1'), [1.0, 0.0])
        """
        at = np.asarray(time, dtype=float).reshape(-1)
        if len(at) != len(solutions):
            raise InputError(f"has {len(at)} times for {len(solutions)} solutions", key="time", remedy="give one each")
        known = units if units is not None else (solutions[0].units if solutions else {})
        names, order = tuple(known), {row: place for place, row in enumerate(rows)}
        missed = [{row: by for row, by in a.relaxed.items() if by > NOTICEABLE} for a in solutions]
        held = [{row for row, _ in a.binding} for a in solutions]
        active = sorted(set().union(*missed, *held), key=lambda row: (order.get(row, len(order)), row))
        shape = (len(solutions), len(names))
        to_levels = np.array([[a.without_limits[name] for name in names] for a in solutions]).reshape(shape)
        residual = np.array([[a.residuals[name] for name in names] for a in solutions]).reshape(shape)
        to_rows = np.maximum(residual - to_levels, 0.0)
        causes = np.zeros((*shape, len(active)), dtype=bool)
        for k, (solution, by) in enumerate(zip(solutions, held, strict=True)):
            for level, name in enumerate(names):
                if to_rows[k, level] > NOTICEABLE:
                    guilty = solution.causes.get(name, by)
                    causes[k, level] = [row in guilty for row in active]
        table = (len(solutions), len(active))
        return cls(
            time=at,
            levels=names,
            units=tuple(known.values()),
            to_levels=to_levels,
            to_rows=to_rows,
            rows=tuple(active),
            binding=np.array([[row in one for row in active] for one in held], dtype=bool).reshape(table),
            missed=np.array([[one.get(row, 0.0) for row in active] for one in missed]).reshape(table),
            causes=causes,
        )


_BUCKET = 8  # limits are padded to a multiple of this, so that fewer steps are compiled
_OUTCOMES: tuple[Outcome, ...] = ("optimal", "limited", "relaxed", "clamped", "clamped", "unconfirmed")
"""The outcome for each status of a compiled step; `solve` does not use the bounded fallback, status 5."""

_settings = lru_cache(maxsize=256, typed=True)(Settings)


class _Step:
    """A compiled step and the lock that one thread holds while it uses the arrays of the step."""

    def __init__(self, problem: PriorityProblem, settings: Settings, places: int) -> None:
        self.lock = Lock()
        self.step = PriorityStep(
            settings.mode,
            n=problem.width,
            levels=level_shapes(problem),
            rows=places,
            damping=settings.damping,
        )


_steps: dict[tuple[object, ...], _Step] = {}


def solve(
    problem: PriorityProblem,
    *,
    mode: Mode = "projected",
    damping: float = 0.0,
    backend: str | None = None,
) -> PrioritySolution:
    """Solve the priority problem of one control period; the returned velocity v is finite for any problem.

    (1) If possible, v meets the first task and satisfies all limits. (2) If no velocity does both, v satisfies all
    limits and meets the first task as well as they allow. (3) If the limits contradict each other, barrier limits and
    limits of set-based tasks are first relaxed together, by the smallest uniform amount for rows of length 1. Actuator
    limits are never relaxed (but see `build_problem` for limits that cross). If the result is not shown to be optimal
    afterwards, the status is "unconfirmed". If no limit is active, v is the velocity of the mode without limits.

    The solver is the compiled step of `priority_step`, so v equals that of a controller to the last bit. The first call
    for a shape (numbers of velocities and limits, rows of each level) compiles the step, which takes seconds; later
    processes load it from a cache. Without a C compiler, the instruction list of the step is interpreted: much slower,
    but v has the same bits. The properties of the solution that explain it are computed when they are first read.

    Args:
        problem: priority levels and limits, from `build_problem`.
        mode: the priority law. "nsb": the NSB law, equation (16) of the paper, without limits (`relaxed` then lists the
            violated limits). "projected": equation (16) with the projection on the first task restricted to the limits.
            "filter": the velocity that satisfies the limits and is nearest to the result of (16). "lexicographic":
            strict priority within the limits.
        damping: see `Settings`.
        backend: None for the compiled step. Otherwise the reference solver in NumPy (module `reference`) is used, with
            this QP solver: "daqp", "osqp" or another solver of the package qpsolvers. The reference solver with DAQP
            also solves what the compiled step does not take: a set-based level with several rows.

    Raises:
        InputError: the mode or the backend is unknown, or a setting is out of range.

    Example:
        >>> import numpy as np
        >>> from surctl.priority import Level, Row, build_problem, solve
        >>> goal, wall = Level("goal", np.eye(2), np.array([0.3, 0.4]), unit="m/s"), np.array([1.0, 0.0])
        >>> found = solve(build_problem([goal], [Row("wall", "barrier", wall, -np.inf, 0.1)]))
        >>> found.v.round(3).tolist(), found.explain()
        ([0.1, 0.4], 'Task `goal` gave up 0.2 m/s because `wall` binds.')
    """
    try:
        settings = _settings(mode, damping)
    except TypeError:  # not hashable, so not a valid setting either
        settings = Settings(mode, damping)
    shape = tuple([(level.lower.size, level.upper is None or level.is_goal) for level in problem.levels])
    if backend is None and all(is_goal or rows == 1 for rows, is_goal in shape):
        return _by_step(problem, settings, shape)
    return _by_reference(problem, settings, "daqp" if backend is None else backend)


def explained(problem: PriorityProblem, v: Array, stage: Stage, *, mode: Mode) -> PrioritySolution:
    """Return the velocity v (n,) of a step without damping as a solution that explains itself.

    `stage` is that of the step, and `problem` the problem that it solved.
    """
    settings = _settings(mode)
    target = target_of(problem, settings)
    return PrioritySolution(problem, settings, v, target, _OUTCOMES[get_args(Stage).index(stage)], 0)


def _by_step(problem: PriorityProblem, settings: Settings, shape: tuple[tuple[int, bool], ...]) -> PrioritySolution:
    places = max(1, -(-len(problem.rows) // _BUCKET)) * _BUCKET
    key = (problem.width, places, shape, settings.mode, settings.damping)
    known = _steps.get(key)
    if known is None:
        known = _steps.setdefault(key, _Step(problem, settings, places))
    step = known.step
    with known.lock:
        step.write(problem)
        step.solve()
        v, target, count = step.v.copy(), step.target.copy(), int(step.count[0])
        status = _OUTCOMES[int(step.status[0]) - 1]
    return PrioritySolution(problem, settings, v, target, _with_moved(status, problem, settings), count)


def _by_reference(problem: PriorityProblem, settings: Settings, backend: str) -> PrioritySolution:
    result = reference_solution(problem, settings, backend)
    status = cast("Outcome", result.status)
    if result.iterations > 0 and status in ("optimal", "limited", "relaxed"):
        with np.errstate(all="ignore"):
            shown = is_least(result.v, problem, settings=settings, target=result.target, tol=LOSS)
        status = status if shown else "unconfirmed"
    status = _with_moved(status, problem, settings)
    return PrioritySolution(problem, settings, result.v, result.target, status, result.iterations)


def _with_moved(status: Outcome, problem: PriorityProblem, settings: Settings) -> Outcome:
    return "relaxed" if problem.moved and settings.mode != "nsb" and status in ("optimal", "limited") else status
