"""Lyapunov functions, regions of attraction and barriers of dynamics, proved by certificates that can be checked."""

from surctl.lyapunov.claims import Bound, DynamicClaim, Power, Safety, Stability
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.dynamics import Dynamics, Range, State

__all__ = [
    "Bound",
    "Decision",
    "DynamicClaim",
    "Dynamics",
    "Power",
    "Range",
    "Safety",
    "Stability",
    "State",
    "decide_motion",
]
