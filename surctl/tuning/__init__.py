"""Choice of gains by simulation: parameter sweeps, sensitivity indices, goals, exact gradients, automatic tuning."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.tuning.assessed import ASSESSED
    from surctl.tuning.axes import SEED, Axis, Span, parse_axis
    from surctl.tuning.cegis import Tuning, tune
    from surctl.tuning.derived import (
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
    from surctl.tuning.finals import CHECKED, Finals, check_finals
    from surctl.tuning.goal_file import LIBRARY, GoalTable
    from surctl.tuning.goal_search import RunGoal
    from surctl.tuning.goals import Goal, goals_at, goals_from_tables, load_goals, with_floor
    from surctl.tuning.gradient import SURROGATES, DifferentiableRun, prepare
    from surctl.tuning.law_goals import case_loop
    from surctl.tuning.loop_frequency_goals import Effort, LoopShape, MaxGain, Rejection, SensitivityBound, Tracking
    from surctl.tuning.loop_goal_file import LOOP_GOAL_KEYS, LoopGoalTable, PointTable, loop_goal
    from surctl.tuning.loop_goals import Judgement, LoopGoal, LoopView, Profile
    from surctl.tuning.loop_scores import LoopScores, Score, judge_loops, operating_loops
    from surctl.tuning.loop_time_goals import Margins, Overshoot, Poles, Settling, StepRejection, StepTracking
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
    from surctl.tuning.system_goals import load_loop_goals, load_system_goals
    from surctl.tuning.systems import SystemTuning, tune_system
    from surctl.tuning.table import SweepTable, SweptAxis, load_sweep

__all__ = [
    "ASSESSED",
    "CHECKED",
    "DESIGNS",
    "LIBRARY",
    "LOOP_GOAL_KEYS",
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
    "Effort",
    "Evaluation",
    "Executor",
    "Finals",
    "GainRange",
    "Goal",
    "GoalTable",
    "Judgement",
    "LocalExecutor",
    "LoopGoal",
    "LoopGoalTable",
    "LoopScores",
    "LoopShape",
    "LoopView",
    "Margins",
    "MaxGain",
    "Miss",
    "MonteCarlo",
    "Overshoot",
    "PointTable",
    "Poles",
    "Pool",
    "Profile",
    "Refinement",
    "Rejection",
    "Request",
    "Round",
    "RunGoal",
    "Score",
    "Sensitivity",
    "SensitivityBound",
    "Settling",
    "Span",
    "StepRejection",
    "StepTracking",
    "SweepTable",
    "SweptAxis",
    "SystemTuning",
    "Tracking",
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
    "grid",
    "has_tuned",
    "judge_loops",
    "judged_goals",
    "load_goals",
    "load_loop_goals",
    "load_sweep",
    "load_system_goals",
    "loop_goal",
    "lqr_start",
    "make_design",
    "misses",
    "operating_loops",
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
    "with_floor",
]

load_at_first_use(
    __name__,
    {
        "assessed": "ASSESSED",
        "axes": "SEED Axis Span parse_axis",
        "cegis": "Tuning tune",
        "derived": "Derivation default_cruise derive_gains derived_gains gains_for has_tuned shared_gains",
        "design": "DESIGNS Design grid make_design saltelli spread",
        "evaluation": "Condition Evaluation check_goals conditions corners evaluate figures judged_goals scope",
        "executors": "DaskExecutor Executor LocalExecutor",
        "finals": "CHECKED Finals check_finals",
        "goal_file": "LIBRARY GoalTable",
        "goal_search": "RunGoal",
        "goals": "Goal goals_at goals_from_tables load_goals with_floor",
        "gradient": "SURROGATES DifferentiableRun prepare",
        "law_goals": "case_loop",
        "loop_frequency_goals": "Effort LoopShape MaxGain Rejection SensitivityBound Tracking",
        "loop_goal_file": "LOOP_GOAL_KEYS LoopGoalTable PointTable loop_goal",
        "loop_goals": "Judgement LoopGoal LoopView Profile",
        "loop_scores": "LoopScores Score judge_loops operating_loops",
        "loop_time_goals": "Margins Overshoot Poles Settling StepRejection StepTracking",
        "measure": "build_cases check_column",
        "misses": "Miss advice misses value_text",
        "montecarlo": "Counterexample MonteCarlo",
        "pool": "Pool Request",
        "provenance": "goal_rows summary tuned_gains tuning_dict",
        "refine": "Refinement refine",
        "rounds": "Round",
        "search": "search",
        "sensitivity": "Sensitivity sensitivity",
        "space": "TUNED GainRange default_tuned gain_ranges",
        "start": "lqr_start",
        "sweep": "TABLE sweep",
        "system_goals": "load_loop_goals load_system_goals",
        "systems": "SystemTuning tune_system",
        "table": "SweepTable SweptAxis load_sweep",
    },
)
