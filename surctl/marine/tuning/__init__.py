"""Choice of gains by simulated missions: sweeps, sensitivity, goals, automatic tuning."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.tuning.cegis import Round, Tuning, tune
    from surctl.marine.tuning.derived import Derivation, default_cruise, derive_gains, derived_gains, gains_for
    from surctl.marine.tuning.evaluation import Condition, Evaluation, case_loop, conditions, evaluate, figures
    from surctl.marine.tuning.goals import ASSESSED, Goal, load_goals
    from surctl.marine.tuning.measure import build_cases
    from surctl.marine.tuning.montecarlo import Counterexample, MonteCarlo
    from surctl.marine.tuning.outcome import CHECKED, Finals, Miss, summary, tuned_gains
    from surctl.marine.tuning.pool import TUNED, GainRange, Pool, Request, gain_ranges
    from surctl.marine.tuning.search import search
    from surctl.marine.tuning.sweep import SweepTable, SweptAxis, load_sweep, sweep


__all__ = [
    "ASSESSED",
    "CHECKED",
    "TUNED",
    "Condition",
    "Counterexample",
    "Derivation",
    "Evaluation",
    "Finals",
    "GainRange",
    "Goal",
    "Miss",
    "MonteCarlo",
    "Pool",
    "Request",
    "Round",
    "SweepTable",
    "SweptAxis",
    "Tuning",
    "build_cases",
    "case_loop",
    "conditions",
    "default_cruise",
    "derive_gains",
    "derived_gains",
    "evaluate",
    "figures",
    "gain_ranges",
    "gains_for",
    "load_goals",
    "load_sweep",
    "search",
    "summary",
    "sweep",
    "tune",
    "tuned_gains",
]

load_at_first_use(__name__)
