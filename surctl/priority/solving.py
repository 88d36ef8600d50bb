"""The function `solve`: solve a priority problem in the mode nsb, filter, projected or lexicographic."""

from __future__ import annotations

from functools import lru_cache
from threading import Lock
from typing import cast

import numpy as np

from surctl.priority.backends import Backend
from surctl.priority.compiled.runner import PriorityStep, level_shapes
from surctl.priority.compiled.step import LEAST_DAMPING
from surctl.priority.optimality import LOSS, is_least
from surctl.priority.problem import PriorityProblem
from surctl.priority.reference import reference_solution
from surctl.priority.settings import Mode, Settings
from surctl.priority.solution import Outcome, PrioritySolution

__all__ = ["solve"]

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
            sweeps=settings.sweeps,
            damping=settings.damping,
        )


_steps: dict[tuple[object, ...], _Step] = {}


def solve(
    problem: PriorityProblem,
    *,
    mode: Mode = "projected",
    sweeps: int = 1,
    damping: float = 0.0,
    backend: Backend | None = None,
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
        sweeps, damping: see `Settings`.
        backend: None for the compiled step. Otherwise the reference solver in NumPy (module `reference`) is used, with
            this QP solver: "daqp", "osqp", another name in `BACKENDS`, or a `Kernel`. It also solves, with DAQP, what
            the step does not take: a set-based level with several rows, and mode projected with damping below 1e-3.

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
        settings = _settings(mode, sweeps, damping)
    except TypeError:  # not hashable, so not a valid setting either
        settings = Settings(mode, sweeps, damping)
    shape = tuple([(level.lower.size, level.upper is None or level.is_goal) for level in problem.levels])
    if backend is None and _takes(shape, settings):
        return _by_step(problem, settings, shape)
    return _by_reference(problem, settings, "daqp" if backend is None else backend)


def _takes(shape: tuple[tuple[int, bool], ...], settings: Settings) -> bool:
    small = settings.mode == "projected" and 0.0 < settings.damping < LEAST_DAMPING
    return not small and all(is_goal or rows == 1 for rows, is_goal in shape)


def _by_step(problem: PriorityProblem, settings: Settings, shape: tuple[tuple[int, bool], ...]) -> PrioritySolution:
    places = max(1, -(-len(problem.rows) // _BUCKET)) * _BUCKET
    key = (problem.width, places, shape, settings.mode, settings.sweeps, settings.damping)
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


def _by_reference(problem: PriorityProblem, settings: Settings, backend: Backend) -> PrioritySolution:
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
