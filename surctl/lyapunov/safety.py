"""Decide a barrier claim, and whether its solutions stay in the box."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from surctl.lyapunov.claims import Safety
from surctl.lyapunov.decide import Decision, decide_motion, prove_motion
from surctl.lyapunov.inward import inward_speeds

__all__ = ["decide_safety"]

_SHARE = 0.6  # of the remaining time for the stronger claim


def decide_safety(
    claim: Safety, *, time_limit: float = 60.0, seed: int = 0, progress: Callable[[str], None] | None = None
) -> Decision:
    """Decide a barrier claim, and try to prove also that the solutions stay in the box.

    The verdict is that of the claim as it stands. If the stronger claim is proved too, the decision is about it: its
    claim has `stays`. The arguments are those of `decide_motion`.
    """
    began, worked = time.perf_counter(), time.process_time()
    decision = decide_motion(claim, time_limit=time_limit, seed=seed, progress=progress)
    if decision.verdict != "proved" or claim.stays or inward_speeds(claim) is None:
        return decision
    left = max(_SHARE * (time_limit - (time.process_time() - worked)), 1.0)
    stronger = prove_motion(replace(claim, stays=True), time_limit=left, seed=seed, progress=progress)
    return replace(stronger if stronger.verdict == "proved" else decision, seconds=time.perf_counter() - began)
