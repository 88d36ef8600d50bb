"""Lyapunov functions, regions of attraction and barriers of dynamics, proved by certificates that can be checked."""

from surctl.lyapunov.barrier_search import find_barrier
from surctl.lyapunov.claims import Bound, DynamicClaim, Safety, Stability
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.lyapunov.from_system import continuous_dynamics, sampled_dynamics
from surctl.lyapunov.problem import Problem, is_problem, load_problem
from surctl.lyapunov.search import find_stability
from surctl.lyapunov.solve import Solution, solve

__all__ = [
    "Bound", "Decision", "DynamicClaim", "Dynamics", "Problem", "Range", "Safety", "Solution", "Stability", "State",
    "continuous_dynamics", "decide_motion", "find_barrier", "find_stability", "is_problem", "load_problem",
    "sampled_dynamics", "solve",
]  # fmt: skip
