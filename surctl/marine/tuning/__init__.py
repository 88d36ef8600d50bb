"""Choice of gains by simulated missions: sweeps, sensitivity, goals, automatic tuning."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.tuning.cegis import Round, Tuning, tune
    from surctl.marine.tuning.derived import (
        Derivation,
        default_cruise,
        derive_gains,
        derived_gains,
        gains_for,
        has_tuned,
        shared_gains,
    )
    from surctl.marine.tuning.evaluation import (
        Condition,
        Evaluation,
        case_loop,
        check_goals,
        conditions,
        corners,
        evaluate,
        figures,
        judged_goals,
        scope,
    )
    from surctl.marine.tuning.goals import ASSESSED, Goal, goals_at, goals_from_tables, load_goals, with_floor
    from surctl.marine.tuning.measure import build_cases, check_column
    from surctl.marine.tuning.montecarlo import Counterexample, MonteCarlo
    from surctl.marine.tuning.outcome import (
        CHECKED,
        Finals,
        Miss,
        advice,
        check_finals,
        goal_rows,
        misses,
        summary,
        tuned_gains,
        tuning_dict,
        value_text,
    )
    from surctl.marine.tuning.pool import TUNED, GainRange, Pool, Request, default_tuned, gain_ranges
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
    "advice",
    "build_cases",
    "case_loop",
    "check_column",
    "check_finals",
    "check_goals",
    "conditions",
    "corners",
    "default_cruise",
    "default_tuned",
    "derive_gains",
    "derived_gains",
    "evaluate",
    "figures",
    "gain_ranges",
    "gains_for",
    "goal_rows",
    "goals_at",
    "goals_from_tables",
    "has_tuned",
    "judged_goals",
    "load_goals",
    "load_sweep",
    "misses",
    "scope",
    "search",
    "shared_gains",
    "summary",
    "sweep",
    "tune",
    "tuned_gains",
    "tuning_dict",
    "value_text",
    "with_floor",
]

load_at_first_use(__name__)
