"""Decide a problem file: prove or refute its claim, and find what the file leaves open."""

from __future__ import annotations

from collections.abc import Callable

from surctl.errors import InputError
from surctl.lyapunov.decide import Decision, decide_motion
from surctl.lyapunov.problem import Problem

__all__ = ["solve"]


def solve(
    problem: Problem, *, time_limit: float = 60.0, seed: int = 0, progress: Callable[[str], None] | None = None
) -> Decision:
    """Prove or refute the claim of a problem.

    Args:
        problem: the problem.
        time_limit: limit of the time [s].
        seed: seed of the falsifier.
        progress: function that receives a line of progress from time to time.

    Raises:
        InputError: the problem is not a claim, or its claim cannot be checked; see `decide_motion`.

    Example:
        >>> from pathlib import Path
        >>> from surctl.lyapunov import load_problem, solve
        >>> _ = Path("jump.toml").write_text('''
        ... kind = "barrier"
        ... name = "decay"
        ... barrier = "x - 1.5"
        ... multiplier = "-1"
        ... initial = ["x^2 <= 1"]
        ... unsafe = ["x >= 2"]
        ... [states]
        ... x = { rate = "-x", lower = -3, upper = 3 }
        ... ''')
        >>> solve(load_problem(Path("jump.toml"))).verdict
        'proved'
    """
    claim = problem.claim
    if claim is None:
        raise InputError("is missing", key=f"{problem.dynamics.name}.function", remedy="give function and level")
    return decide_motion(claim, time_limit=time_limit, seed=seed, progress=progress)
