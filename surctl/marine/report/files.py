"""Functions that write single pictures to disk, for commands that write no HTML report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from surctl.marine.report.goals import goal_bars, goal_views, plot_front, plot_goal_bars, plot_goal_view
from surctl.marine.report.margin_plots import plot_locus
from surctl.marine.report.plan_view import describe, plot_run
from surctl.marine.report.signals import plot_priority, plot_run_signals
from surctl.marine.report.sonar_plots import plot_calibration, plot_sonar_replay
from surctl.marine.report.sweep_plots import plot_heat_map, plot_parallel
from surctl.marine.sensing import Replay, SensorCalibration, file_stems
from surctl.marine.simulation import Run, priority_timeline
from surctl.marine.tuning import SweepTable, Tuning
from surctl.marine.verification import Locus
from surctl.report.theme import new_figure, save_figure

__all__ = [
    "save_calibrations",
    "save_heat_map",
    "save_locus",
    "save_parallel",
    "save_priority",
    "save_run",
    "save_sonar_replay",
    "save_tuning",
]


def save_run(run: Run, folder: Path | str) -> Path:
    """Write plan view and signals of a run as one PNG, named after the run; return the path of the PNG.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import save_run
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> print(save_run(run, "pictures").name)
        pool-behind-sur400-closed_form-corrected-nsb-truth-seed0.png
    """
    length, width, _ = run.scenario.site
    plan_height = min(max(8.2 * width / length + 1.5, 3.6), 7.6)
    figure = new_figure(9.8, plan_height + 7.0)
    halves = figure.add_gridspec(2, 1, height_ratios=[plan_height, 7.0])
    plot_run(run, figure.add_subfigure(halves[0]).add_subplot())
    plot_run_signals(run, figure.add_subfigure(halves[1]).subplots(3, 2, sharex=True).ravel().tolist())
    return save_figure(figure, Path(folder), _run_labels(run))


def save_priority(run: Run, folder: Path | str) -> Path:
    """Write a plot of the relaxation of each priority level over a run as a PNG; return the path of the PNG.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import save_priority
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law(mode="filter", contacts=1), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> print(save_priority(run, "pictures").name)
        pool-behind-sur400-guarded-corrected-filter-truth-seed0-priority.png
    """
    return save_figure(
        plot_priority(priority_timeline(run), title=describe(run)), Path(folder), (*_run_labels(run), "priority")
    )


def _run_labels(run: Run) -> tuple[str, ...]:
    law = run.law.name.removeprefix("surctl_")  # an identifier, also if the law is of the user's own
    how = (law, run.law.avoidance, *(() if run.law.guidance == "los" else (run.law.guidance,)), run.law.mode)
    how += () if run.law.fallback == "exact" else (run.law.fallback,)
    return (run.scenario.name, run.vehicle.name, *how, run.sensing, f"seed{run.seed}")


def save_heat_map(table: SweepTable, column: str, folder: Path | str, *, over: tuple[str, str] | None = None) -> Path:
    """Write a heat map of one column of a sweep as a PNG, named after column and axes; return the path of the PNG.

    Raises:
        InputError: see `plot_heat_map`; or the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_heat_map
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> save_heat_map(table, "disk_margin", "pictures").name
        'sweep-k_v-lookahead-disk_margin.png'
    """
    across, up = over or (table.axes[0].name, table.axes[1].name if len(table.axes) > 1 else "")
    figure = plot_heat_map(table, column, over=over).figure.figure
    return save_figure(figure, Path(folder), ("sweep", across, up, column))


def save_parallel(table: SweepTable, folder: Path | str) -> Path:
    """Write a sweep in parallel coordinates as a PNG; return its path. InputError if the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_parallel
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, sweep
        >>> from surctl.tuning import grid, parse_axis
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> table = sweep(cases, grid([parse_axis("k_v=1,2"), parse_axis("lookahead=0.4,0.8,1.2")]))
        >>> save_parallel(table, "pictures").name
        'sweep-parallel.png'
    """
    return save_figure(plot_parallel(table).figure.figure, Path(folder), ("sweep", "parallel"))


def save_locus(data: Locus, folder: Path | str, *, unit: str = "", picked: float | None = None) -> Path:
    """Write a plot of a sweep locus as a PNG, named after the swept parameter; return the path of the PNG.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_locus
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> locus = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> save_locus(locus, "pictures", unit="1/s").name
        'locus-k_psi.png'
    """
    return save_figure(
        plot_locus(data, unit=unit, picked=picked).figure.figure, Path(folder), ("locus", data.parameter)
    )


def save_tuning(tuning: Tuning, folder: Path | str) -> list[Path]:
    """Write PNGs of the overview, of the Pareto front, and of each goal with a metric over time; return their paths.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_tuning
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> goals = (Goal("soon", "time_s", "s", 20.0), Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard"))
        >>> tuning = tune(Request(goals, runs, gains, gain_ranges(gains, ["k_v"])), trials=8, rounds=1, runs=0)
        >>> [path.name for path in save_tuning(tuning, "pictures")]
        ['tuning-goals.png', 'tuning-front.png', 'tuning-soon.png', 'tuning-clear.png']
    """
    axes = {"goals": plot_goal_bars(goal_bars(tuning)), "front": plot_front(tuning)}
    for view in goal_views(tuning, tuning.request.goals):
        axes[view.goal.name] = plot_goal_view(view)
    return [save_figure(ax.figure.figure, Path(folder), ("tuning", name)) for name, ax in axes.items()]


def save_calibrations(results: Sequence[SensorCalibration], folder: Path | str) -> list[Path]:
    """Write residual plots of calibrations as PNGs, named after sensor and medium; return their paths.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.report import save_calibrations
        >>> from surctl.marine.sensing import calibrate_table_ii
        >>> [path.name for path in save_calibrations(calibrate_table_ii(), "pictures")]
        ['calibration-U1-air.png', 'calibration-U1-water.png']
    """
    stems = file_stems(results)
    return [
        save_figure(plot_calibration(one), Path(folder), (f"calibration{stem}",))
        for one, stem in zip(results, stems, strict=True)
    ]


def save_sonar_replay(replayed: Replay, folder: Path | str, *, title: str = "") -> Path:
    r"""Write a plot of raw and filtered ranges of a sonar recording as a PNG; return the path of the PNG.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.report import save_sonar_replay
        >>> from surctl.marine.sensing import read_readings, replay_readings, sonar_array
        >>> rows = ["time_s,sensor,range_m", *(f"{0.1 * k:.1f},0,{2.0 - 0.01 * k:.2f}" for k in range(60))]
        >>> _ = Path("readings.csv").write_text("\n".join(rows))
        >>> replayed = replay_readings(read_readings(Path("readings.csv"), sonar_array(1)).readings)
        >>> save_sonar_replay(replayed, "pictures", title="in the tank").name
        'sonar-replay.png'
    """
    return save_figure(plot_sonar_replay(replayed, title=title), Path(folder), ("sonar-replay",))
