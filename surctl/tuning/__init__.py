"""Choice of gains by simulation: parameter sweeps, sensitivity indices, goals, exact gradients, automatic tuning."""

from surctl.tuning.axes import SEED, Axis, Span, parse_axis
from surctl.tuning.cegis import Tuning, tune
from surctl.tuning.derived import (
    DERIVED_MARGIN,
    Derivation,
    default_cruise,
    derive_gains,
    derived_gains,
    gains_for,
    has_tuned,
    shared_gains,
)
from surctl.tuning.design import DESIGNS, Design, grid, make_design, saltelli, spread
from surctl.tuning.evaluation import (
    Condition,
    Evaluation,
    check_goals,
    conditions,
    corners,
    evaluate,
    figures,
    judged_goals,
    scope,
)
from surctl.tuning.executors import DaskExecutor, Executor, LocalExecutor
from surctl.tuning.goals import LIBRARY, Goal, GoalTable, goals_at, goals_from_tables, load_goals
from surctl.tuning.gradient import SURROGATES, DifferentiableRun, prepare
from surctl.tuning.measure import build_cases, check_column
from surctl.tuning.misses import Miss, advice, misses, value_text
from surctl.tuning.montecarlo import Counterexample, MonteCarlo
from surctl.tuning.pool import Pool, Request
from surctl.tuning.provenance import goal_rows, summary, tuned_gains, tuning_dict
from surctl.tuning.refine import Refinement, refine
from surctl.tuning.rounds import Round
from surctl.tuning.search import search
from surctl.tuning.sensitivity import Sensitivity, sensitivity
from surctl.tuning.space import TUNED, GainRange, default_tuned, gain_ranges
from surctl.tuning.start import lqr_start
from surctl.tuning.sweep import TABLE, sweep
from surctl.tuning.systems import SystemTuning, tune_system
from surctl.tuning.table import DELAY_FLOOR, DISK_FLOOR, SweepTable, SweptAxis, load_sweep

__all__ = [
    "DELAY_FLOOR",
    "DERIVED_MARGIN",
    "DESIGNS",
    "DISK_FLOOR",
    "LIBRARY",
    "SEED",
    "SURROGATES",
    "TABLE",
    "TUNED",
    "Axis",
    "Condition",
    "Counterexample",
    "DaskExecutor",
    "Derivation",
    "Design",
    "DifferentiableRun",
    "Evaluation",
    "Executor",
    "GainRange",
    "Goal",
    "GoalTable",
    "LocalExecutor",
    "Miss",
    "MonteCarlo",
    "Pool",
    "Refinement",
    "Request",
    "Round",
    "Sensitivity",
    "Span",
    "SweepTable",
    "SweptAxis",
    "SystemTuning",
    "Tuning",
    "advice",
    "build_cases",
    "check_column",
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
    "grid",
    "has_tuned",
    "judged_goals",
    "load_goals",
    "load_sweep",
    "lqr_start",
    "make_design",
    "misses",
    "parse_axis",
    "prepare",
    "refine",
    "saltelli",
    "scope",
    "search",
    "sensitivity",
    "shared_gains",
    "spread",
    "summary",
    "sweep",
    "tune",
    "tune_system",
    "tuned_gains",
    "tuning_dict",
    "value_text",
]
