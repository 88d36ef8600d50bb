"""Lyapunov functions, regions of attraction and barriers of dynamics, proved by certificates that can be checked."""

from surctl.lyapunov.barrier_search import BarrierResult, find_barrier
from surctl.lyapunov.claims import Bound, DynamicClaim, Power, Safety, Stability
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.lyapunov.falsified import Falsified, least_level
from surctl.lyapunov.from_system import continuous_dynamics, sampled_dynamics
from surctl.lyapunov.problem import Problem, is_problem, load_problem
from surctl.lyapunov.search import StabilityResult, find_stability
from surctl.lyapunov.solve import Solution, solve

__all__ = [
    "BarrierResult",
    "Bound",
    "Decision",
    "DynamicClaim",
    "Dynamics",
    "Falsified",
    "Power",
    "Problem",
    "Range",
    "Safety",
    "Solution",
    "Stability",
    "StabilityResult",
    "State",
    "continuous_dynamics",
    "decide_motion",
    "find_barrier",
    "find_stability",
    "is_problem",
    "least_level",
    "load_problem",
    "sampled_dynamics",
    "solve",
]
