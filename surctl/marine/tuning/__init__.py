"""Choice of gains by simulated missions: sweeps, sensitivity, goals, automatic tuning."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.tuning.derived import Derivation, default_cruise, derive_gains, derived_gains, gains_for
    from surctl.marine.tuning.evaluation import case_loop, conditions, evaluate, figures
    from surctl.marine.tuning.goals import Goal, load_goals
    from surctl.marine.tuning.request import TUNED, GainRange, Request, gain_ranges, tuned_gains
    from surctl.marine.tuning.sweep import MissionSweep, build_cases, picked_gains


__all__ = [
    "TUNED", "Derivation", "GainRange", "Goal", "MissionSweep", "Request", "build_cases", "case_loop", "conditions",
    "default_cruise", "derive_gains", "derived_gains", "evaluate", "figures", "gain_ranges", "gains_for", "load_goals",
    "picked_gains", "tuned_gains",
]  # fmt: skip

load_at_first_use(__name__)
