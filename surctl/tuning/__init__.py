"""Choice of gains of any system: sweep axes and designs, loop goals, and automatic tuning."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.tuning.chunked import DaskExecutor, Executor, LocalExecutor
    from surctl.tuning.design import (
        DESIGNS,
        ONE_POINT,
        SEED,
        Axis,
        Design,
        Span,
        grid,
        make_design,
        parse_axis,
        random_draws,
        saltelli,
        spread,
    )
    from surctl.tuning.goals import LIBRARY, GoalTable, RunGoal, load_loop_goals
    from surctl.tuning.loop_frequency_goals import Effort, LoopShape, MaxGain, Rejection, SensitivityBound, Tracking
    from surctl.tuning.loop_goal_file import LOOP_GOAL_KEYS, LoopGoalTable, PointTable
    from surctl.tuning.loop_goals import Judgement, LoopGoal, LoopView, Profile
    from surctl.tuning.loop_scores import LoopScores, Score, judge_loops, operating_loops
    from surctl.tuning.loop_time_goals import Margins, Overshoot, Poles, Settling, StepRejection, StepTracking
    from surctl.tuning.statistics import Share, SobolIndices, sobol_indices
    from surctl.tuning.system_sweep import SystemSweep, sweep_system
    from surctl.tuning.systems import SystemTuning, tune_system


__all__ = [
    "DESIGNS",
    "LIBRARY",
    "LOOP_GOAL_KEYS",
    "ONE_POINT",
    "SEED",
    "Axis",
    "DaskExecutor",
    "Design",
    "Effort",
    "Executor",
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
    "Overshoot",
    "PointTable",
    "Poles",
    "Profile",
    "Rejection",
    "RunGoal",
    "Score",
    "SensitivityBound",
    "Settling",
    "Share",
    "SobolIndices",
    "Span",
    "StepRejection",
    "StepTracking",
    "SystemSweep",
    "SystemTuning",
    "Tracking",
    "grid",
    "judge_loops",
    "load_loop_goals",
    "make_design",
    "operating_loops",
    "parse_axis",
    "random_draws",
    "saltelli",
    "sobol_indices",
    "spread",
    "sweep_system",
    "tune_system",
]

load_at_first_use(__name__)
