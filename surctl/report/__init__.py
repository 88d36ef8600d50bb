"""Plots of systems, loops, regions and claims, and the parts of self-contained HTML pages."""

from typing import TYPE_CHECKING

from surctl.lazy import load_at_first_use

if TYPE_CHECKING:
    from surctl.report.evidence import margin_slice, plot_counterexample, plot_slice
    from surctl.report.motion_plots import plot_motion
    from surctl.report.page_parts import plot_locus, plot_loops
    from surctl.report.sweep_plots import plot_heat_map, plot_parallel
    from surctl.report.system_plots import (
        plot_dependence,
        plot_fan,
        plot_phase_plane,
        plot_record,
        plot_runs,
    )

__all__ = [
    "margin_slice", "plot_counterexample", "plot_dependence", "plot_fan", "plot_heat_map",
    "plot_locus", "plot_loops", "plot_motion", "plot_parallel", "plot_phase_plane", "plot_record", "plot_runs",
    "plot_slice",
]  # fmt: skip

load_at_first_use(__name__)
