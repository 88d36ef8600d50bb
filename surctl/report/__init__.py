"""Plots of results, and the report of a study as one self-contained HTML file."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.report.animation import check_animation, save_animation
    from surctl.report.calibration_plots import plot_calibration
    from surctl.report.cost_map import plot_cost_map
    from surctl.report.data import ExportSummary, ReportData
    from surctl.report.document import Check
    from surctl.report.evidence import MarginSlice, margin_slice, plot_counterexample, plot_replay, plot_slice
    from surctl.report.evidence_sections import runs_section
    from surctl.report.files import (
        save_calibrations,
        save_heat_map,
        save_locus,
        save_parallel,
        save_priority,
        save_run,
        save_sensitivity,
        save_sonar_replay,
        save_tuning,
    )
    from surctl.report.film import check_film, film_frames, film_pictures, moment_of, save_film
    from surctl.report.goals import GoalBars, GoalView, goal_bars, goal_view, plot_front, plot_goal_bars, plot_goal_view
    from surctl.report.heat_map import plot_heat_map
    from surctl.report.locus import plot_locus
    from surctl.report.loop_views import plot_loop, plot_loop_goals, plot_loops
    from surctl.report.loops import LoopResponse, loop_responses, plot_bode, plot_nyquist, plot_poles
    from surctl.report.map_view import MapView, map_view, plot_map, plot_maps
    from surctl.report.motion_plots import plot_motion
    from surctl.report.page import render_page, render_sections, write_page
    from surctl.report.paper_plots import plot_coordinates, plot_position_errors, plot_series
    from surctl.report.plan_view import plot_run
    from surctl.report.prediction_plots import plot_prediction, save_prediction
    from surctl.report.priority_plot import plot_priority
    from surctl.report.region_plots import plot_region
    from surctl.report.replay_plots import plot_replay_sensor, plot_sonar_replay
    from surctl.report.signals import plot_run_signals
    from surctl.report.sweep_plots import plot_parallel, plot_sensitivity
    from surctl.report.system_plot import plot_record, save_record_plot
    from surctl.report.system_plots import (
        plot_attainable_rates,
        plot_dependence,
        plot_fan,
        plot_phase_plane,
        plot_runs,
    )
    from surctl.report.theme import darkened
    from surctl.report.thruster_plot import plot_attainable, save_attainable
    from surctl.report.verify_files import save_margins, save_regions, save_verdicts

__all__ = [
    "Check",
    "ExportSummary",
    "GoalBars",
    "GoalView",
    "LoopResponse",
    "MapView",
    "MarginSlice",
    "ReportData",
    "check_animation",
    "check_film",
    "darkened",
    "film_frames",
    "film_pictures",
    "goal_bars",
    "goal_view",
    "loop_responses",
    "map_view",
    "margin_slice",
    "moment_of",
    "plot_attainable",
    "plot_attainable_rates",
    "plot_bode",
    "plot_calibration",
    "plot_coordinates",
    "plot_cost_map",
    "plot_counterexample",
    "plot_dependence",
    "plot_fan",
    "plot_front",
    "plot_goal_bars",
    "plot_goal_view",
    "plot_heat_map",
    "plot_locus",
    "plot_loop",
    "plot_loop_goals",
    "plot_loops",
    "plot_map",
    "plot_maps",
    "plot_motion",
    "plot_nyquist",
    "plot_parallel",
    "plot_phase_plane",
    "plot_poles",
    "plot_position_errors",
    "plot_prediction",
    "plot_priority",
    "plot_record",
    "plot_region",
    "plot_replay",
    "plot_replay_sensor",
    "plot_run",
    "plot_run_signals",
    "plot_runs",
    "plot_sensitivity",
    "plot_series",
    "plot_slice",
    "plot_sonar_replay",
    "render_page",
    "render_sections",
    "runs_section",
    "save_animation",
    "save_attainable",
    "save_calibrations",
    "save_film",
    "save_heat_map",
    "save_locus",
    "save_margins",
    "save_parallel",
    "save_prediction",
    "save_priority",
    "save_record_plot",
    "save_regions",
    "save_run",
    "save_sensitivity",
    "save_sonar_replay",
    "save_tuning",
    "save_verdicts",
    "write_page",
]

load_at_first_use(
    __name__,
    {
        "animation": "check_animation save_animation",
        "calibration_plots": "plot_calibration",
        "cost_map": "plot_cost_map",
        "data": "ExportSummary ReportData",
        "document": "Check",
        "evidence": "MarginSlice margin_slice plot_counterexample plot_replay plot_slice",
        "evidence_sections": "runs_section",
        "files": "save_calibrations save_heat_map save_locus save_parallel"
        " save_priority save_run save_sensitivity save_sonar_replay save_tuning",
        "film": "check_film film_frames film_pictures moment_of save_film",
        "goals": "GoalBars GoalView goal_bars goal_view plot_front plot_goal_bars plot_goal_view",
        "heat_map": "plot_heat_map",
        "locus": "plot_locus",
        "loop_views": "plot_loop plot_loop_goals plot_loops",
        "loops": "LoopResponse loop_responses plot_bode plot_nyquist plot_poles",
        "map_view": "MapView map_view plot_map plot_maps",
        "motion_plots": "plot_motion",
        "page": "render_page render_sections write_page",
        "paper_plots": "plot_coordinates plot_position_errors plot_series",
        "plan_view": "plot_run",
        "prediction_plots": "plot_prediction save_prediction",
        "priority_plot": "plot_priority",
        "region_plots": "plot_region",
        "replay_plots": "plot_replay_sensor plot_sonar_replay",
        "signals": "plot_run_signals",
        "sweep_plots": "plot_parallel plot_sensitivity",
        "system_plot": "plot_record save_record_plot",
        "system_plots": "plot_attainable_rates plot_dependence plot_fan plot_phase_plane plot_runs",
        "theme": "darkened",
        "thruster_plot": "plot_attainable save_attainable",
        "verify_files": "save_margins save_regions save_verdicts",
    },
)
