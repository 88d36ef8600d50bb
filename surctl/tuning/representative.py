"""Whether a goal about a response of the linear loop describes a run: it does not where a limit is active."""

from __future__ import annotations

from collections.abc import Sequence

from surctl.tuning.loop_goals import LoopGoal
from surctl.tuning.loop_time_goals import Overshoot, Settling, StepRejection, StepTracking

__all__ = ["not_representative", "step_goals"]

_ACTIVE = 0.01
"""Share of time at a limit above which a step response of the linear loop does not describe a run."""

_STEPS = (Overshoot, Settling, StepRejection, StepTracking)


def step_goals(goals: Sequence[LoopGoal]) -> tuple[LoopGoal, ...]:
    """Return the goals about a step response of the linear loop."""
    return tuple(goal for goal in goals if isinstance(goal, _STEPS))


def not_representative(names: Sequence[str], share: float, *, limit: str, run: str, remedy: str) -> list[str]:
    """Return a line that says that linear goals do not describe a run; nothing if the limit is hardly active.

    Args:
        names: names of goals about a step response of the linear loop.
        share: share of time at the limit.
        limit: what is at its limit.
        run: the run.
        remedy: how the goal is asked of the run.

    Example:
        >>> from surctl.tuning.representative import not_representative
        >>> options = {"limit": "command force", "run": "the run", "remedy": 'write metric = "settling"'}
        >>> not_representative(["quick"], 0.0, **options)
        []
        >>> print(*not_representative(["quick"], 0.25, **options))
        not representative: quick (linear): command force is at its limit 25% of the run; write metric = "settling"
    """
    if not names or not share > _ACTIVE:
        return []
    return [f"not representative: {', '.join(names)} (linear): {limit} is at its limit {share:.0%} of {run}; {remedy}"]
