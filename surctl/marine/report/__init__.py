"""Plots of missions, and the report of a study as one self-contained HTML file."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.marine.report.animation import moment_of, save_animation, save_film
    from surctl.marine.report.files import plot_region, save_run
    from surctl.marine.report.goals import GoalBars, plot_goal_bars
    from surctl.marine.report.mission_plot import plot_mission
    from surctl.marine.report.page import render_page
    from surctl.marine.report.plan_view import plot_run
    from surctl.marine.report.sections import ReportData
    from surctl.marine.report.signals import plot_priority
    from surctl.marine.report.vehicle_plots import plot_attainable, plot_prediction

__all__ = [
    "GoalBars", "ReportData", "moment_of", "plot_attainable", "plot_goal_bars",
    "plot_mission", "plot_prediction", "plot_priority", "plot_region", "plot_run", "render_page",
    "save_animation", "save_film", "save_run",
]  # fmt: skip

load_at_first_use(__name__)
