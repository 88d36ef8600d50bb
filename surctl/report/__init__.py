"""Pictures, and the self-contained HTML page."""

from surctl.report.data import ExportSummary, ReportData
from surctl.report.evidence import MarginSlice, margin_slice, plot_counterexample, plot_replay, plot_slice
from surctl.report.files import save_heat_map, save_run
from surctl.report.heat_map import plot_heat_map
from surctl.report.loops import LoopResponse, loop_responses, plot_bode, plot_nyquist, plot_poles
from surctl.report.page import render_page, write_page
from surctl.report.plan_view import plot_run
from surctl.report.signals import plot_run_signals

__all__ = [
    "ExportSummary",
    "LoopResponse",
    "MarginSlice",
    "ReportData",
    "loop_responses",
    "margin_slice",
    "plot_bode",
    "plot_counterexample",
    "plot_heat_map",
    "plot_nyquist",
    "plot_poles",
    "plot_replay",
    "plot_run",
    "plot_run_signals",
    "plot_slice",
    "render_page",
    "save_heat_map",
    "save_run",
    "write_page",
]
