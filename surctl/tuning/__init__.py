"""Choice of gains of any system: sweeps, goals, and automatic tuning that counterexamples refine."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.tuning.cegis import Round, Tuning, tune
    from surctl.tuning.chunked import DaskExecutor, Executor, LocalExecutor
    from surctl.tuning.design import (
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
    from surctl.tuning.gain_search import search
    from surctl.tuning.goals import LIBRARY, LOOP_GOAL_KEYS, GoalTable, PointTable, RunGoal, load_loop_goals
    from surctl.tuning.loop_goal_types import (
        Effort,
        LoopShape,
        Margins,
        MaxGain,
        Overshoot,
        Poles,
        Rejection,
        SensitivityBound,
        Settling,
        StepRejection,
        StepTracking,
        Tracking,
    )
    from surctl.tuning.loop_goals import LoopGoal, judge_loops, operating_loops
    from surctl.tuning.montecarlo import Counterexample, MonteCarlo
    from surctl.tuning.outcome import Tuned, summary
    from surctl.tuning.pool import Condition, Evaluation, Pool, SearchRequest
    from surctl.tuning.statistics import Share, SobolIndices, sobol_indices
    from surctl.tuning.sweep import SweepSubject, SweepTable, load_sweep, sweep
    from surctl.tuning.system_sweep import SystemSweep
    from surctl.tuning.systems import SystemRequest, tune_system


__all__ = [
    "LIBRARY", "LOOP_GOAL_KEYS", "ONE_POINT", "SEED", "Axis", "Condition", "Counterexample", "DaskExecutor", "Design",
    "Effort", "Evaluation", "Executor", "GoalTable", "LocalExecutor", "LoopGoal", "LoopShape",
    "Margins", "MaxGain", "MonteCarlo", "Overshoot", "PointTable", "Poles", "Pool", "Rejection", "Round", "RunGoal",
    "SearchRequest", "SensitivityBound", "Settling", "Share", "SobolIndices", "Span", "StepRejection", "StepTracking",
    "SweepSubject", "SweepTable", "SystemRequest", "SystemSweep", "Tracking", "Tuned", "Tuning", "grid", "judge_loops",
    "load_loop_goals", "load_sweep", "make_design", "operating_loops", "parse_axis", "random_draws", "saltelli",
    "search", "sobol_indices", "spread", "summary", "sweep", "tune", "tune_system",
]  # fmt: skip

load_at_first_use(__name__)
