"""Priority laws: the null-space-based behavioural (NSB) law of the paper, and quadratic programmes with limits."""

from __future__ import annotations

from surctl.priority.backends import BACKENDS, Backend, LeastDistance, solve_least_distance
from surctl.priority.compiled.assemble import AssembledStep, Assembly, assemble
from surctl.priority.compiled.level_shape import LevelShape
from surctl.priority.compiled.runner import PriorityStep
from surctl.priority.compiled.step import priority_step
from surctl.priority.nsb import nsb
from surctl.priority.persistent import PersistentDaqp, PersistentOsqp
from surctl.priority.problem import Level, PriorityProblem, Row, build_problem
from surctl.priority.settings import Fallback, Mode, Settings, check_fallback
from surctl.priority.solution import PrioritySolution
from surctl.priority.solver.fallback import safe_step
from surctl.priority.solver.safe_point import SafePoint, least_distance
from surctl.priority.solving import solve
from surctl.priority.sweep import nsb_sweep
from surctl.priority.symbolic import nsb_symbolic
from surctl.priority.timeline import PriorityTimeline

__all__ = [
    "BACKENDS",
    "AssembledStep",
    "Assembly",
    "Backend",
    "Fallback",
    "LeastDistance",
    "Level",
    "LevelShape",
    "Mode",
    "PersistentDaqp",
    "PersistentOsqp",
    "PriorityProblem",
    "PrioritySolution",
    "PriorityStep",
    "PriorityTimeline",
    "Row",
    "SafePoint",
    "Settings",
    "assemble",
    "build_problem",
    "check_fallback",
    "least_distance",
    "nsb",
    "nsb_sweep",
    "nsb_symbolic",
    "priority_step",
    "safe_step",
    "solve",
    "solve_least_distance",
]
