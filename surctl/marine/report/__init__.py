"""Plots of missions, and the report of a study as one self-contained HTML file."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.report.animation import (
        check_animation,
        check_film,
        film_frames,
        film_pictures,
        moment_of,
        save_animation,
        save_film,
    )
    from surctl.marine.report.evidence_sections import runs_section
    from surctl.marine.report.files import (
        plot_region,
        save_margins,
        save_run,
        save_tuning,
        save_verdicts,
    )
    from surctl.marine.report.goals import (
        GoalBars,
        GoalView,
        goal_bars,
        goal_view,
        plot_front,
        plot_goal_bars,
        plot_goal_view,
        plot_heat_map,
        plot_parallel,
    )
    from surctl.marine.report.margin_plots import plot_locus
    from surctl.marine.report.page import render_page, write_page
    from surctl.marine.report.paper_plots import plot_coordinates, plot_position_errors, plot_series
    from surctl.marine.report.plan_view import plot_run
    from surctl.marine.report.sections import ExportSummary, ReportData
    from surctl.marine.report.signals import plot_priority, plot_run_signals
    from surctl.marine.report.sonar_plots import plot_calibration, plot_replay_sensor, plot_sonar_replay
    from surctl.marine.report.vehicle_plots import plot_attainable, plot_prediction

__all__ = [
    "ExportSummary",
    "GoalBars",
    "GoalView",
    "ReportData",
    "check_animation",
    "check_film",
    "film_frames",
    "film_pictures",
    "goal_bars",
    "goal_view",
    "moment_of",
    "plot_attainable",
    "plot_calibration",
    "plot_coordinates",
    "plot_front",
    "plot_goal_bars",
    "plot_goal_view",
    "plot_heat_map",
    "plot_locus",
    "plot_parallel",
    "plot_position_errors",
    "plot_prediction",
    "plot_priority",
    "plot_region",
    "plot_replay_sensor",
    "plot_run",
    "plot_run_signals",
    "plot_series",
    "plot_sonar_replay",
    "render_page",
    "runs_section",
    "save_animation",
    "save_film",
    "save_margins",
    "save_run",
    "save_tuning",
    "save_verdicts",
    "write_page",
]

load_at_first_use(__name__)
