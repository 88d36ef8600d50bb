"""Plots of missions, and the report of a study as one self-contained HTML file."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.report.animation import check_animation, save_animation
    from surctl.marine.report.calibration_plots import plot_calibration
    from surctl.marine.report.data import ExportSummary, ReportData
    from surctl.marine.report.evidence_sections import runs_section
    from surctl.marine.report.files import (
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
    from surctl.marine.report.film import check_film, film_frames, film_pictures, moment_of, save_film
    from surctl.marine.report.goals import (
        GoalBars,
        GoalView,
        goal_bars,
        goal_view,
        plot_front,
        plot_goal_bars,
        plot_goal_view,
    )
    from surctl.marine.report.heat_map import plot_heat_map
    from surctl.marine.report.locus import plot_locus
    from surctl.marine.report.loops import LoopResponse, loop_responses, plot_bode, plot_nyquist, plot_poles
    from surctl.marine.report.map_view import MapView, map_view, plot_map, plot_maps
    from surctl.marine.report.page import render_page, write_page
    from surctl.marine.report.paper_plots import plot_coordinates, plot_position_errors, plot_series
    from surctl.marine.report.plan_view import plot_run
    from surctl.marine.report.prediction_plots import plot_prediction, save_prediction
    from surctl.marine.report.priority_plot import plot_priority
    from surctl.marine.report.region_plots import plot_region
    from surctl.marine.report.replay_plots import plot_replay_sensor, plot_sonar_replay
    from surctl.marine.report.signals import plot_run_signals
    from surctl.marine.report.sweep_plots import plot_parallel, plot_sensitivity
    from surctl.marine.report.thruster_plot import plot_attainable, save_attainable
    from surctl.marine.report.verify_files import save_margins, save_regions, save_verdicts

__all__ = [
    "ExportSummary",
    "GoalBars",
    "GoalView",
    "LoopResponse",
    "MapView",
    "ReportData",
    "check_animation",
    "check_film",
    "film_frames",
    "film_pictures",
    "goal_bars",
    "goal_view",
    "loop_responses",
    "map_view",
    "moment_of",
    "plot_attainable",
    "plot_bode",
    "plot_calibration",
    "plot_coordinates",
    "plot_front",
    "plot_goal_bars",
    "plot_goal_view",
    "plot_heat_map",
    "plot_locus",
    "plot_map",
    "plot_maps",
    "plot_nyquist",
    "plot_parallel",
    "plot_poles",
    "plot_position_errors",
    "plot_prediction",
    "plot_priority",
    "plot_region",
    "plot_replay_sensor",
    "plot_run",
    "plot_run_signals",
    "plot_sensitivity",
    "plot_series",
    "plot_sonar_replay",
    "render_page",
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
        "data": "ExportSummary ReportData",
        "evidence_sections": "runs_section",
        "files": "save_calibrations save_heat_map save_locus save_parallel "
        "save_priority save_run save_sensitivity save_sonar_replay save_tuning",
        "film": "check_film film_frames film_pictures moment_of save_film",
        "goals": "GoalBars GoalView goal_bars goal_view plot_front plot_goal_bars plot_goal_view",
        "heat_map": "plot_heat_map",
        "locus": "plot_locus",
        "loops": "LoopResponse loop_responses plot_bode plot_nyquist plot_poles",
        "map_view": "MapView map_view plot_map plot_maps",
        "page": "render_page write_page",
        "paper_plots": "plot_coordinates plot_position_errors plot_series",
        "plan_view": "plot_run",
        "prediction_plots": "plot_prediction save_prediction",
        "priority_plot": "plot_priority",
        "region_plots": "plot_region",
        "replay_plots": "plot_replay_sensor plot_sonar_replay",
        "signals": "plot_run_signals",
        "sweep_plots": "plot_parallel plot_sensitivity",
        "thruster_plot": "plot_attainable save_attainable",
        "verify_files": "save_margins save_regions save_verdicts",
    },
)
