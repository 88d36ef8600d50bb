"""The library behind the commands: what a command uses is loaded when it is first needed, so commands start fast."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.assessment import STEP, Assessment, ClosedLoop, Part, assess, cost_verdicts
    from surctl.certcheck import PATIENCE, check_file
    from surctl.certcheck.belonging import compare
    from surctl.certcheck.bundle import read_bundle
    from surctl.export import CheckReport, ProofReport, Records, SilReport
    from surctl.export.bundle import Bundle, build_bundle, check_folder
    from surctl.export.check import STEPS, check_builds
    from surctl.export.contract import Exportable, checked_name
    from surctl.export.emulated import TARGETS as PROCESSORS, Target, chosen_targets
    from surctl.export.envelope import as_records
    from surctl.export.evidence import ReplayedRun, write_evidence
    from surctl.export.fmu import write_fmu
    from surctl.export.precision import REALS
    from surctl.export.process import build_controller
    from surctl.export.prove import prove_bundle, with_proof
    from surctl.export.sil import compare_runs
    from surctl.export.supplement import PlantLists
    from surctl.files import changes, file_name, prepare_folder, quoted, write_file
    from surctl.ir import Layout, Real
    from surctl.ir.c99 import identifier
    from surctl.ir.cache import find_compiler
    from surctl.lyapunov import Problem, Safety, Solution, is_problem, load_problem, sampled_dynamics, solve
    from surctl.lyapunov.equilibrium import require_common
    from surctl.recorded import read_recorded
    from surctl.recorded_write import RECORD_FORMATS, write_csv
    from surctl.report import plot_heat_map, plot_parallel
    from surctl.report.design_bench import DesignBench, SystemBench
    from surctl.report.motion_plots import plot_motion
    from surctl.report.serve import serve
    from surctl.report.theme import save_figure
    from surctl.study import StudyParts, conduct_parts
    from surctl.system import (
        Cost, LOST, Linearisation, Record, Runs, System, entry_labels, entry_units, periods, run_system, save_record,
    )  # fmt: skip
    from surctl.system.linear_loop import EDGE
    from surctl.system.loop import ENDED
    from surctl.system.subjects import is_subject, load_subject, registered_subjects
    from surctl.system.values import check_scalar, checked_ranges, run_numbers
    from surctl.tuning import (
        DaskExecutor, Design, Executor, LocalExecutor, RunGoal, SobolIndices, SweepSubject, SweepTable, SystemRequest,
        SystemSweep, Tuning, judge_loops, load_loop_goals, parse_axis, sobol_indices, summary, sweep, tune,
    )  # fmt: skip
    from surctl.tuning.design import default_range
    from surctl.tuning.goals import load_system_goals, not_representative
    from surctl.tuning.outcome import Finals, Miss, advice, check_finals, misses, tuning_dict
    from surctl.tuning.pool import SearchRequest
    from surctl.tuning.statistics import Share
    from surctl.tuning.system_sweep import Choice, choices_and_draws, chosen_points, run_at, runs_of
    from surctl.tuning.systems import margin_goals, system_request
    from surctl.verification import Inapplicable
    from surctl.verification.formula import parse, variable
    from surctl.verification.sampled_margins import LoopCorners, SampledLoop

load_at_first_use(__name__, cache=False)
