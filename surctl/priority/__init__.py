"""Who wins: the paper's null-space-based law (16), and the same law kept inside limits by a QP."""

from __future__ import annotations

from surctl.priority.backends import BACKENDS, Backend, LeastDistance, solve_least_distance
from surctl.priority.compiled.assemble import AssembledTick, Assembly, assemble
from surctl.priority.compiled.level_shape import LevelShape
from surctl.priority.compiled.runner import PriorityTick
from surctl.priority.compiled.tick import priority_tick
from surctl.priority.kept import KeptDaqp, KeptOsqp
from surctl.priority.nsb import nsb
from surctl.priority.problem import Level, PriorityProblem, Row, build_problem
from surctl.priority.settings import Ladder, Mode, Settings, check_ladder
from surctl.priority.solution import PrioritySolution
from surctl.priority.solver.ladder import safe_tick
from surctl.priority.solver.safe_point import SafePoint, least_distance
from surctl.priority.solving import solve
from surctl.priority.sweep import nsb_sweep
from surctl.priority.symbolic import nsb_symbolic

__all__ = [
    "BACKENDS",
    "AssembledTick",
    "Assembly",
    "Backend",
    "KeptDaqp",
    "KeptOsqp",
    "Ladder",
    "LeastDistance",
    "Level",
    "LevelShape",
    "Mode",
    "PriorityProblem",
    "PrioritySolution",
    "PriorityTick",
    "Row",
    "SafePoint",
    "Settings",
    "assemble",
    "build_problem",
    "check_ladder",
    "least_distance",
    "nsb",
    "nsb_sweep",
    "nsb_symbolic",
    "priority_tick",
    "safe_tick",
    "solve",
    "solve_least_distance",
]
