"""Lyapunov functions, regions of attraction and barriers of dynamics, proved by certificates that can be checked."""

from surctl.lyapunov.claims import Bound, DynamicClaim, Power, Safety, Stability
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.lyapunov.problem import Problem, is_problem, load_problem
from surctl.lyapunov.solve import solve

__all__ = [
    "Bound",
    "Decision",
    "DynamicClaim",
    "Dynamics",
    "Power",
    "Problem",
    "Range",
    "Safety",
    "Stability",
    "State",
    "decide_motion",
    "is_problem",
    "load_problem",
    "solve",
]
