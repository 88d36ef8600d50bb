"""Single pictures on disk, for the commands that make no page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure

from surctl.files import write_file
from surctl.report.calibration_plots import plot_calibration
from surctl.report.goals import goal_bars, goal_view, plot_front, plot_goal_bars, plot_goal_view
from surctl.report.heat_map import plot_heat_map
from surctl.report.locus import plot_locus
from surctl.report.plan_view import plot_run
from surctl.report.replay_plots import plot_sonar_replay
from surctl.report.signals import plot_run_signals
from surctl.report.sweep_plots import plot_parallel, plot_sensitivity
from surctl.report.theme import new_figure
from surctl.sensing import Replay, SensorCalibration, file_stems
from surctl.simulation import Run
from surctl.tuning import Sensitivity, SweepTable, Tuning
from surctl.verification import Locus

__all__ = [
    "save_calibrations",
    "save_heat_map",
    "save_locus",
    "save_parallel",
    "save_run",
    "save_sensitivity",
    "save_sonar_replay",
    "save_tuning",
]


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
    how = (law, run.law.avoidance, *(() if run.law.guidance == "los" else (run.law.guidance,)), run.law.mode)
    what = (run.scenario.name, run.vehicle.name, *how, run.sensing, f"seed{run.seed}")
    return _save(figure, Path(folder), what)


def save_heat_map(table: SweepTable, column: str, folder: Path | str, *, over: tuple[str, str] | None = None) -> Path:
    """One column of a sweep over two axes as a PNG, named after it; the path written.

    Raises:
        InputError: as `plot_heat_map`, or the folder cannot be written.
    """
    across, up = over or (table.axes[0].name, table.axes[1].name if len(table.axes) > 1 else "")
    figure = plot_heat_map(table, column, over=over).figure.figure
    return _save(figure, Path(folder), ("sweep", across, up, column))


def save_parallel(table: SweepTable, folder: Path | str) -> Path:
    """Parallel coordinates of a sweep as a PNG; the path written. InputError if the folder cannot be written."""
    return _save(plot_parallel(table).figure.figure, Path(folder), ("sweep", "parallel"))


def save_sensitivity(found: Sensitivity, folder: Path | str) -> Path:
    """Sobol' indices as a PNG; the path written. InputError if the folder cannot be written."""
    return _save(plot_sensitivity(found).figure.figure, Path(folder), ("sensitivity", found.column))


def save_locus(data: Locus, folder: Path | str, *, unit: str = "", picked: float | None = None) -> Path:
    """A sweep locus as a PNG, named after its knob; the path written.

    Raises:
        InputError: the folder cannot be written.
    """
    return _save(plot_locus(data, unit=unit, picked=picked).figure.figure, Path(folder), ("locus", data.knob))


def save_tuning(tuning: Tuning, folder: Path | str) -> list[Path]:
    """Overview, front and a view of each goal that has a course over time, as PNGs; the paths written.

    Raises:
        InputError: the folder cannot be written.
    """
    drawn = {"goals": plot_goal_bars(goal_bars(tuning)), "front": plot_front(tuning)}
    for goal in tuning.request.goals:
        view = goal_view(tuning, goal)
        if view is not None:
            drawn[goal.name] = plot_goal_view(view)
    return [_save(ax.figure.figure, Path(folder), ("tuning", name)) for name, ax in drawn.items()]


def save_calibrations(results: Sequence[SensorCalibration], folder: Path | str) -> list[Path]:
    """Residual plots of calibrations as PNGs, named after sensor and medium; the paths written.

    Raises:
        InputError: the folder cannot be written.
    """
    stems = file_stems(results)
    return [
        _save(plot_calibration(one), Path(folder), (f"calibration{stem}",))
        for one, stem in zip(results, stems, strict=True)
    ]


def save_sonar_replay(replayed: Replay, folder: Path | str, *, title: str = "") -> Path:
    """Raw and filtered ranges of a recording as a PNG; the path written. InputError if the folder cannot be written."""
    return _save(plot_sonar_replay(replayed, title=title), Path(folder), ("sonar-replay",))


def _save(figure: Figure, folder: Path, what: tuple[str, ...]) -> Path:
    # names come from files: whatever could leave the folder is replaced
    name = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "-", part).strip("-.") or "x" for part in what)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return write_file(folder / f"{name}.png", buffer.getvalue())
