"""Single pictures on disk, for the commands that make no page."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from surctl.report.heat_map import plot_heat_map
from surctl.report.page import write_bytes
from surctl.report.plan_view import plot_run
from surctl.report.signals import plot_run_signals
from surctl.report.theme import new_figure
from surctl.simulation import Run
from surctl.tuning import Sweep

__all__ = ["save_heat_map", "save_run"]


def save_run(run: Run, folder: Path | str) -> Path:
    """Plan view and signals of a run as one PNG, named after what was flown; the path written.

    Raises:
        InputError: the folder cannot be written.
    """
    length, width, _ = run.scenario.site
    plan_height = min(max(8.2 * width / length + 1.5, 3.6), 7.6)
    figure = new_figure(9.8, plan_height + 7.0)
    halves = figure.add_gridspec(2, 1, height_ratios=[plan_height, 7.0])
    plot_run(run, figure.add_subfigure(halves[0]).add_subplot())
    plot_run_signals(run, figure.add_subfigure(halves[1]).subplots(3, 2, sharex=True).ravel().tolist())
    law = run.law.name.removeprefix("surctl_")
    what = (run.scenario.name, run.vehicle.name, law, run.law.avoidance, run.law.mode, run.sensing, f"seed{run.seed}")
    return _save(figure, Path(folder), what)


def save_heat_map(sweep: Sweep, column: str, folder: Path | str) -> Path:
    """One column of a sweep as a PNG, named after it; the path written.

    Raises:
        InputError: the sweep has no such column, or the folder cannot be written.
    """
    figure = plot_heat_map(sweep, column).figure.figure
    return _save(figure, Path(folder), ("sweep", *(axis.name for axis in sweep.axes), column))


def _save(figure: Figure, folder: Path, what: tuple[str, ...]) -> Path:
    # names come from files: whatever could leave the folder is replaced
    name = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "-", part).strip("-.") or "x" for part in what)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return write_bytes(folder / f"{name}.png", buffer.getvalue())
