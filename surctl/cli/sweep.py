"""`surctl sweep`: closed-loop and linear metrics over gains and other parameters."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import as_json, finish, progress, same_command, saving, stoppable
from surctl.cli.robot_options import SPEEDS, at_hand, choose_law, choose_shared, law_option, law_words
from surctl.cli.subject import OwnSystem, command_line, is_system, load_system, seconds_option
from surctl.errors import InputError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from surctl.marine.control import Gains
    from surctl.marine.simulation import Case
    from surctl.marine.tuning import SweepTable
    from surctl.marine.verification import Locus
    from surctl.tuning import Axis, Design, Executor, SobolIndices, Span, SystemSweep
    from surctl.tuning.system_sweep import Choice

_SHOWN = 40  # largest number of points in the text output; the file holds all points
_MOST_JSON = 100_000  # largest number of points printed as JSON
_LOCUS = 61  # number of parameter values at which poles are computed
_SMOOTH = 0.02  # parameter values are added where a pole moves further than this share of its modulus
_PRINTED = (  # columns of the text output
    "deviation_m", "path_error_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin",
    "disk_margin_at_m_per_s", "reached_worst", "score", "feasible",
)  # fmt: skip
_EXPLAINED = ("deviation_m", "path_error_m")  # columns whose meaning is printed below the points: their names are alike


@click.command
@click.argument(
    "axes", nargs=-1, required=True, metavar="[FILE.py:FUNCTION] PARAMETER=V1,V2,...|LOW..HIGH[:COUNT][:log] ..."
)
@seconds_option
@click.option(
    "--scenario",
    "scenarios",
    multiple=True,
    default=("tank-static", "pool-static"),
    metavar="FILE",
    help="Scenario simulated at each point: name or file; may be repeated (default tank-static and pool-static).",
)
@click.option(
    "--vehicle",
    "vehicles",
    multiple=True,
    metavar="FILE",
    help="Vehicle: name or file; may be repeated (default: each scenario's).",
)
@click.option("--sensing", default="truth", metavar="NAME", help="Obstacle positions from truth (default) or sonar.")
@click.option("--gains", metavar="FILE", help="Gains not swept: name or file (default: the vehicle's).")
@law_option
@click.option(
    "--priority-mode", default="nsb", metavar="NAME", help="Mode: nsb (default), filter, projected, lexicographic."
)
@click.option(
    "--guidance",
    default="los",
    metavar="NAME",
    help="Path guidance: los (default), ilos or alos. Loop margins and --locus always use los.",
)
@click.option(
    "--design",
    default="grid",
    metavar="NAME",
    help="Points: grid (default), or space-filling in the ranges: lhs, sobol.",
)
@click.option("--points", type=click.IntRange(min=1), metavar="N", help="Number of points for lhs and sobol.")
@click.option(
    "--sensitivity",
    metavar="COLUMN",
    help="Sobol' indices of a result column; needs N (number of axes + 2) points, N = --points (default 64).",
)
@click.option("--locus", metavar="PARAMETER", help="Plot the closed-loop poles over this axis, for the selected gains.")
@click.option(
    "--cruise",
    type=SPEEDS,
    metavar="U1,U2,...",
    help="Cruise speeds [m/s] of the loop margins; the worst counts (default: the scenarios' speeds).",
)
@click.option(
    "--seeds",
    type=click.IntRange(1, 1_000_000),
    default=1,
    metavar="N",
    help="Simulate every point with the seeds 0 to N-1 (default 1).",
)
@click.option("--workers", type=click.IntRange(min=1), metavar="N", help="Processes or threads (default 2).")
@click.option("--dask", metavar="ADDRESS", help="Use a Dask scheduler instead of local processes.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out"),
    metavar="DIR",
    help="Folder of sweep.nc (default surctl-out); an interrupted sweep resumes there.",
)
@as_json
def sweep(
    axes: tuple[str, ...],
    seconds: float | None,
    scenarios: tuple[str, ...],
    vehicles: tuple[str, ...],
    sensing: str,
    gains: str | None,
    law: str | None,
    priority_mode: str,
    guidance: str,
    design: str,
    points: int | None,
    sensitivity: str | None,
    locus: str | None,
    cruise: tuple[float, ...] | None,
    seeds: int,
    workers: int | None,
    dask: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Simulate scenarios over values of parameters, compute loop margins, and select the best point.

    A parameter is a gain (k_v), a vehicle parameter (vehicle.m11; plant.m11 changes the plant but not the controller's
    model), a number of the scenario (scenario.cruise) or seed. Exit status: 1 if the best point is not accepted.

    For a system of your own, FILE.py:FUNCTION, the axes are gains (k), plant.NAME, reference.NAME, disturbance.NAME,
    start.NAME. With --seeds N, the worst of N runs with plant.NAME=LOW..HIGH at random counts.

    Examples: surctl sweep --scenario pool-static lookahead=0.6,0.9,1.2 k_v=0.5..3:6:log;
    surctl sweep k_v=1..3 plant.m11=30..60 --sensitivity deviation_m;
    surctl sweep my_system.py:build k=1..8:20:log plant.m=1..2 --seeds 100 --seconds 5
    """
    if is_system(axes, "seconds", "design", "points", "sensitivity", "seeds", "workers", "dask", "out", "as_json"):
        remote = None if dask is None else _executor(workers, dask)
        sweep_own_system(
            axes, seconds=seconds, design=design, points=points, sensitivity=sensitivity, seeds=seeds,
            threads=workers or (2 if dask is None else 1), executor=remote, out=out, as_json=as_json,
        )  # fmt: skip
    from surctl.assessment import assess
    from surctl.files import prepare_folder, write_file
    from surctl.marine.assessment import missions_of
    from surctl.marine.control import law_source, load_gains, write_gains
    from surctl.marine.simulation import load_scenario
    from surctl.marine.tuning import build_cases
    from surctl.marine.tuning import sweep as run_sweep
    from surctl.marine.tuning.measure import check_column
    from surctl.marine.vehicle import load_vehicle
    from surctl.tuning import make_design, parse_axis, saltelli, sobol_indices

    parsed = [parse_axis(text) for text in axes]
    if sensitivity is None:
        chosen = make_design(design, parsed, count=points)
    elif design != "grid":
        raise InputError("chooses its own points", key="--sensitivity", value=sensitivity, remedy="drop --design")
    else:
        check_column(sensitivity)
        chosen = saltelli(parsed, base=64 if points is None else points)
    if locus is not None and locus not in chosen.names:
        raise InputError(
            "is not an axis of this sweep", key="--locus", value=locus, remedy=nearest(locus, chosen.names)
        )
    if as_json and len(chosen.points) > _MOST_JSON:
        raise InputError(
            f"would print {len(chosen.points)} points", key="--json", remedy="drop this option and read sweep.nc"
        )
    missions, robots = [load_scenario(name) for name in scenarios], [load_vehicle(name) for name in vehicles]
    law, why = choose_law(law, robots or [load_vehicle(mission.vehicle) for mission in missions])
    own = law_source(law).gains
    cases = build_cases(
        missions,
        robots,
        gains=load_gains(gains or "default", own=own),
        law=law, mode=priority_mode, sensing=sensing, guidance=guidance,
    )  # fmt: skip
    tuned = choose_shared(gains, [(case.vehicle, case.scenario.cruise) for case in cases], own=own)
    base = tuned.gains
    cases = tuple(replace(case, gains=base) for case in cases)
    executor = _executor(workers, dask)
    if locus is not None:  # report a mistake before the simulations, not after them
        swept = chosen.points[:, chosen.names.index(locus)]
        _locus(cases, base, locus, swept, {})
    prepare_folder(out)
    with stoppable(f"the finished points are in {out}; to continue: {same_command()}"):
        table = run_sweep(
            cases, chosen, seeds=range(seeds), cruise=cruise or (), executor=executor, out=out, progress=progress
        )
    sobol = None if sensitivity is None else sobol_indices(chosen, table.column(sensitivity), sensitivity)
    picked = table.picked
    moved = _set_aside(out / "gains.toml") if picked is None else []
    gains_path = None if picked is None else write_file(out / "gains.toml", write_gains(table.gains))
    pictures = _pictures(table, sobol, out)
    if locus is not None:
        with saving("root locus"):
            from surctl.marine.report import plot_locus
            from surctl.report.theme import save_figure

            at = {} if picked is None else table.at(picked)
            axis = next(axis for axis in table.axes if axis.name == locus)
            poles = _locus(cases, table.gains, locus, axis.values, at)
            figure = plot_locus(poles, unit=axis.unit, picked=at.get(locus))
            pictures.append(save_figure(figure, out, ("locus", locus)))
    judged_missions = () if picked is None else missions_of(cases, table.gains)
    assessments = [assess(one, parts=["loop", "no contact"]) for one in judged_missions]
    verdicts = [f"{one.subject} {one.verdict()}" for one in assessments]
    lines = [*why, *_vehicles(cases, vehicles), *tuned.lines, *_lines(table, sobol)]
    where = "No point is feasible, so no gain file was written." if picked is None else table.gains.provenance
    for one, verdict in zip(assessments, verdicts, strict=True):
        lines += ["", verdict, *one.decisive]
    lines += ["", where, *moved, *([] if gains_path is None else [f"gains {gains_path}"]), f"table {table.path}"]
    lines += [f"plot  {picture}" for picture in pictures]
    about = shlex.join(at_hand(cases[0].scenario, cases[0].vehicle, str(gains_path)))
    named = shlex.join(law_words(law))
    # the claims of `verify` are about parts of the built-in laws
    judged = f"surctl verify {about}" if law_source(law).parts else f"surctl export {about} {named} --sensing {sensing}"
    then = [judged] if picked is not None else []
    data: dict[str, Any] = {
        "axes": {axis.name: axis.values.tolist() for axis in table.axes},
        "units": {axis.name: axis.unit for axis in table.axes} | dict(table.units),
        "cases": list(table.cases),
        "results": table.rows() if as_json else [],
        "picked": None if picked is None else table.row(picked),
        "accepted": bool(assessments) and all(one.accepted() for one in assessments),
        "assessments": [one.to_dict() for one in assessments],
        "gains": None if gains_path is None else str(gains_path),
        "sensitivity": None if sobol is None else sobol.to_dict(),
        "table": str(table.path),
    }
    files = [*([] if gains_path is None else [f"gains {gains_path}"]), f"table {table.path}"]
    feasible = table.column("feasible") > 0.5
    best = {} if picked is None else table.at(picked)
    values = "; the best has " * bool(best) + ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
    brief = [f"{feasible.sum()} of {feasible.size} points are feasible{values}"]
    brief = [*(sobol.lines() if sobol is not None else ()), *brief, *([where] if picked is None else ()), *moved]
    brief += [verdict for one, verdict in zip(assessments, verdicts, strict=True) if not one.accepted()]
    finish(data, lines, as_json=as_json, passed=data["accepted"], then=then, brief=brief, files=files)


def _vehicles(cases: Sequence[Case], typed: Sequence[str]) -> list[str]:
    """Return a line for each vehicle of a scenario, with the origin of the choice."""
    from surctl.cli.robot_options import choose_vehicle

    option = next(iter(typed), None)
    choices = [(choose_vehicle(option, (c.scenario.name, c.scenario.vehicle)), c.vehicle.name) for c in cases]
    return list(dict.fromkeys(choice.line(name) for choice, name in choices))


def _set_aside(gains: Path) -> list[str]:
    """Rename the gain file of an earlier sweep, which the present results do not confirm; return the line about it."""
    if not gains.exists():
        return []
    return [f"the gain file of an earlier sweep is now {gains.replace(gains.with_stem('gains-before'))}"]


def _executor(workers: int | None, dask: str | None) -> Executor:
    from surctl.tuning import DaskExecutor, LocalExecutor

    if workers is not None and dask is not None:
        raise click.UsageError("--workers and --dask exclude each other")
    return LocalExecutor(workers or 2) if dask is None else DaskExecutor(dask)


def _pictures(table: SweepTable, sobol: SobolIndices | None, out: Path) -> list[Path]:
    pictures = list[Path]()
    with saving("plots"):
        from surctl.marine.report import plot_heat_map, plot_parallel
        from surctl.report.theme import save_figure

        if sobol is not None:
            pictures.append(save_figure(sobol.plot(), out, ("sensitivity", sobol.column)))
            return pictures
        pictures.append(save_figure(plot_parallel(table), out, ("sweep", "parallel")))
        if table.is_grid and len(table.axes) > 1:
            named = ("sweep", *(axis.name for axis in table.axes[:2]), "score")
            pictures.append(save_figure(plot_heat_map(table, "score"), out, named))
    return pictures


def _locus(
    cases: Sequence[Case], gains: Gains, parameter: str, swept: NDArray[np.float64], at: Mapping[str, float]
) -> Locus:
    # poles of the first vehicle at its largest cruise speed, about the point `at`
    import numpy as np

    from surctl.marine.verification import sweep_locus
    from surctl.marine.verification.cruise_loop import TRACKING_LAW, has_cruise_loop

    first = cases[0]
    values = np.union1d(np.linspace(swept.min(), swept.max(), _LOCUS), [at[parameter]] if parameter in at else [])
    return sweep_locus(
        first.vehicle,
        gains.values,
        parameter,
        values,
        cruise=max(c.scenario.cruise for c in cases if c.vehicle == first.vehicle),
        dt=first.build().dt,
        model=first.model,
        smooth=_SMOOTH,
        about=at,
        law=first.law if has_cruise_loop(first.law, "los") else TRACKING_LAW,
    )


def _lines(table: SweepTable, sobol: SobolIndices | None) -> list[str]:
    if sobol is not None:
        return sobol.lines()
    import numpy as np

    from surctl.marine.simulation import METRICS

    indices = list(np.ndindex(table.shape))
    columns = {name: table.column(name) for name in _PRINTED if name in table.columns}
    rows = [table.at(index) | {name: float(v[index]) for name, v in columns.items()} for index in indices[:_SHOWN]]
    lines = ["  ".join(f"{name}={value:.4g}" for name, value in row.items()) for row in rows]
    lines += [f"  {name}: {METRICS[name].meaning}" for name in _EXPLAINED if name in columns]
    if len(indices) > _SHOWN:
        lines.append(f"... and {len(indices) - _SHOWN} more points in the table")
    return lines


_MOST_REPEATED = 20_000  # largest number of control periods of a run that is repeated in Python
_NAMED = 5  # largest number of points that a line names


def sweep_own_system(
    words: Sequence[str],
    *,
    seconds: float | None,
    design: str,
    points: int | None,
    sensitivity: str | None,
    seeds: int,
    threads: int,
    executor: Executor | None,
    out: Path,
    as_json: bool,
) -> None:
    """Simulate the runs of all points in compiled code; print each cost's range and best point."""
    from surctl.files import prepare_folder
    from surctl.ir.cache import find_compiler
    from surctl.recorded_write import write_csv
    from surctl.system import LOST
    from surctl.system.values import unit_of
    from surctl.tuning import parse_axis, sobol_indices, sweep_system
    from surctl.tuning.system_sweep import chosen_points

    own = load_system(words)
    duration = own.seconds(seconds)
    if sensitivity is not None and sensitivity not in own.system.costs:
        remedy = nearest(sensitivity, own.system.costs)
        raise InputError("is not a cost of the system", key="--sensitivity", value=sensitivity, remedy=remedy)
    axes = [parse_axis(text) for text in own.settings]
    chosen, draws = choices_and_draws(
        own, axes, design=design if sensitivity is None else "saltelli", points=points, seeds=seeds
    )
    count = len(chosen.points) * max(map(len, draws.values()), default=1)
    if as_json and count > _MOST_JSON:
        problem = f"would print {count} runs"
        raise InputError(problem, key="--json", remedy="drop this option and read sweep.csv")
    if executor is None:
        find_compiler()
    prepare_folder(out)
    with stoppable(f"the finished runs are in {out}; to continue: {same_command()}"):
        swept = sweep_system(
            own.system, chosen, duration,
            draws=draws, threads=threads, out=out, about=own.origin, source=own.word, executor=executor,
            progress=progress,
        )  # fmt: skip
    runs = swept.runs
    table = None
    with saving("table"):
        table = write_csv(out / "sweep.csv", swept.table())
    choices = chosen_points(swept)
    best = best_points(swept, choices)
    indices = None if sensitivity is None else sobol_indices(chosen, swept.mean(sensitivity), sensitivity)
    lost = [k for k, stopped in enumerate(runs.stopped) if stopped == LOST]
    lines = [f"{own.system.title}: {len(runs.time)} runs of {duration:g} s, control period {own.system.dt:g} s"]
    lines += _rows(swept) if indices is None else indices.lines()
    for name, row in best.items():
        marked = [line for line in choices[name].assessment.lines if line.about]
        lines += [best_line(swept, name, row, choices[name]), *(f"  {line.mark} {line.text}" for line in marked)]
    if lost:
        named = "; ".join(_numbers(_at(swept, k)) for k in lost[:_NAMED])
        lines.append(f"{len(lost)} of {len(runs.time)} runs are not finite: {named}{'; …' * (len(lost) > _NAMED)}")
        lines += [f"  in the first of them: {name}" for name in [_lost_number(swept, lost[0])] if name]
    lines.append(", ".join([*([f"table {table}"] if table else []), f"netCDF {swept.path}"]))
    pictures = _system_pictures(swept, out)
    lines += [f"plot  {picture}" for picture in pictures]
    data = {
        **own.names,
        "seconds": duration,
        "axes": {name: sorted(set(chosen.points[:, k].tolist())) for k, name in enumerate(chosen.names)},
        "random": list(draws),
        "units": {name: unit_of(own.system, name) for name in swept.swept}
        | {name: cost.unit for name, cost in own.system.costs.items()},
        "runs_per_point": swept.each,
        "results": [_result(swept, k) for k in range(len(runs.time))] if as_json else [],
        "best": best,
        "sensitivity": None if indices is None else indices.to_dict(),
        "not_finite": [_at(swept, k) for k in lost],
        "table": table and str(table),
        "netcdf": str(swept.path),
        "pictures": [str(picture) for picture in pictures],
    }
    then = []
    if best:
        row = next(iter(best.values()))
        numbers = [f"{n}={v!r}" for n, v in (row["at"] | row["random"]).items()]
        then = [command_line("simulate", own, *numbers, "--seconds", f"{duration:g}")]
    brief = [lines[0], *(best_line(swept, name, row, choices[name]) for name, row in best.items())]
    brief += [f"FAIL {text}" for one in choices.values() for text in one.assessment.failures]
    brief += [line for line in lines if " are not finite: " in line] if lost else []
    brief += [] if indices is None else indices.lines()
    where = [f"table {table or swept.path}"]
    passed = bool(best) and all(choice.assessment.accepted() for choice in choices.values())
    finish(data, lines, as_json=as_json, passed=passed, then=then, brief=brief, files=where)


def choices_and_draws(
    own: OwnSystem, axes: Sequence[Axis | Span], *, design: str = "grid", points: int | None = None, seeds: int = 1
) -> tuple[Design, dict[str, NDArray[np.float64]]]:
    """Return the points of a sweep, and the numbers of the runs at each point.

    Seeds are numbers of runs. If a grid has several runs at each point, a range without a count is random as well,
    unless it is that of a gain.

    Raises:
        InputError: the system has no costs or nothing random, an axis is not valid, or its name is not that of one
            number.
    """
    import numpy as np

    from surctl.system.values import check_scalar
    from surctl.tuning.design import ONE_POINT, SEED, Axis, Span, make_design, random_draws, saltelli

    if not own.system.costs:
        raise InputError("has no costs", key="system", value=own.label, remedy="give System(..., costs={...})")
    for axis in axes:
        check_scalar(own.system, axis.name)
    listed = [axis for axis in axes if axis.name == SEED]
    if listed and (seeds > 1 or not isinstance(listed[0], Axis)):
        problem = "is given twice" if seeds > 1 else "is a range without a count"
        raise InputError(problem, key="axis seed", remedy="write --seeds N for the seeds 0 to N-1")
    numbers = np.array(listed[0].values if listed and isinstance(listed[0], Axis) else range(seeds), dtype=float)
    random = [a for a in axes if isinstance(a, Span) and design == "grid" and len(numbers) > 1 and "." in a.name]
    others = [axis for axis in axes if axis not in random and axis not in listed]
    draws = {SEED: numbers} if own.system.blocks.noise and (listed or seeds > 1) else {}
    draws |= random_draws(random, count=len(numbers)) if random else {}
    if seeds > 1 and not draws:
        problem, remedy = "has no noise", "draw a number as well: plant.NAME=LOW..HIGH or start.NAME=LOW..HIGH"
        raise InputError(problem, key="--seeds", value=seeds, remedy=remedy)
    if design == "saltelli":
        return saltelli(others, base=64 if points is None else points), draws
    if draws and not others and points is None:
        return ONE_POINT, draws
    return make_design(design, others, count=points), draws


def _system_pictures(swept: SystemSweep, out: Path) -> list[Path]:
    """Write how costs are distributed at a single point, or a heat map of each if two axes have several values."""
    import numpy as np

    design, system = swept.design, swept.system
    if not design.names:
        with saving("plot"):
            from surctl.report.theme import save_figure

            return [save_figure(swept.runs.plot(), out, ("sweep", "runs"))]
    axes = [(name, np.unique(design.points[:, k])) for k, name in enumerate(design.names)]
    axes = [(name, values) for name, values in axes if len(values) > 1]
    if len(axes) != 2 or design.kind != "grid":
        return []
    from surctl.system.values import unit_of

    labels = {f"{name} [{unit_of(system, name)}]": values for name, values in axes}
    files = list[Path]()
    with saving("heat maps"):
        from surctl.report.cost_map import plot_cost_map
        from surctl.report.theme import save_figure

        for name, cost in system.costs.items():
            table = swept.worst(name).reshape([len(values) for _, values in axes])
            title = f"{name} [{cost.unit}]" + (f", worst of {swept.each} runs" if swept.each > 1 else "")
            figure = plot_cost_map(labels, table, title)
            files.append(save_figure(figure, out, ("sweep", *(axis for axis, _ in axes), name)))
    return files


def _lost_number(swept: SystemSweep, k: int) -> str:
    """Return the number of run k that is not finite, from a run in Python; "" if that run would take too long."""
    from surctl.system import run_system

    system = swept.system
    periods = round(float(swept.runs.time[k]) / system.dt) + 2
    return run_system(system, periods * system.dt, _at(swept, k)).lost if periods < _MOST_REPEATED else ""


def _at(swept: SystemSweep, k: int) -> dict[str, float]:
    return {name: float(values[k]) for name, values in swept.swept.items()}


def _numbers(at: dict[str, float]) -> str:
    return ", ".join(f"{name}={value:.6g}" for name, value in at.items())


def _result(swept: SystemSweep, k: int) -> dict[str, Any]:
    runs = swept.runs
    costs = {name: float(values[k]) for name, values in runs.figures.items()}
    return {"at": _at(swept, k), "costs": costs, "stopped": str(runs.stopped[k]), "duration_s": float(runs.time[k])}


def _rows(swept: SystemSweep) -> list[str]:
    costs, runs, rows = swept.system.costs, swept.runs, list[str]()
    count = len(swept.design.points)
    for point in range(min(count, _SHOWN)):
        texts = []
        for name, cost in costs.items():
            worst = swept.worst(name)[point]
            mean = f" (mean {swept.mean(name)[point]:.6g})" if swept.each > 1 else ""
            texts.append(f"{name}={worst:.6g}{mean} {cost.unit}")
        known = any(math.isfinite(swept.worst(name)[point]) for name in costs)
        k = point * swept.each
        end = _ended(str(runs.stopped[k]), float(runs.time[k])) if swept.each == 1 else _ends(swept, point)
        at = _numbers(swept.at(point)) or "all runs"
        rows.append(f"  {at}: {'  '.join(texts) if known else 'no costs'}{end}")
    if swept.each > 1:
        rows.insert(0, f"the worst of {swept.each} runs at each point, which differ in {', '.join(swept.draws)}:")
    return [*rows, f"  ... and {count - _SHOWN} more points in the table"] if count > _SHOWN else rows


def _ended(stopped: str, time: float) -> str:
    from surctl.system import ENDED

    return "" if stopped == ENDED else f"  ({stopped} at {time:.6g} s)"


def _ends(swept: SystemSweep, point: int) -> str:
    """Return how many runs of a point ended early, with an upper bound of the probability."""
    from surctl.system import ENDED
    from surctl.tuning.statistics import Share

    ends = Counter(swept.runs.stopped[point * swept.each : (point + 1) * swept.each].tolist())
    early = swept.each - ends.pop(ENDED, 0)
    reasons = ", ".join(f"{count} {reason}" for reason, count in sorted(ends.items())) or "0 ended early"
    return f"  ({reasons}; at most {100 * Share(early, swept.each).at_most():.3g} % at 95 % confidence)"


def best_points(swept: SystemSweep, choices: Mapping[str, Choice]) -> dict[str, Any]:
    """Return, for each cost, the chosen point, its assessment, and the range of finite values.

    `costs`, `stopped` and `duration_s` are of the worst run, whose random numbers are `random`.
    """
    import numpy as np

    best: dict[str, Any] = {}
    for name, choice in choices.items():
        worst = swept.worst(name)
        finite = worst[np.isfinite(worst)]
        means = {other: float(swept.mean(other)[choice.point]) for other in swept.system.costs}
        best[name] = _result(swept, choice.run) | {
            "at": swept.at(choice.point), "random": swept.random_of(choice.run), "mean": means,
            "least": float(finite.min()), "largest": float(finite.max()), "passed_over": choice.passed_over,
            "accepted": choice.assessment.accepted(), "assessment": choice.assessment.to_dict(),
        }  # fmt: skip
    return best


def best_line(swept: SystemSweep, name: str, row: dict[str, Any], choice: Choice) -> str:
    """Return one line with the chosen point of a cost, its value, the range of the cost, and what fails."""
    unit, end = swept.system.costs[name].unit, _ended(row["stopped"], row["duration_s"])
    at = f" at {_numbers(row['at'])}" if row["at"] else ""
    spread = f"{row['least']:.6g} … {row['largest']:.6g} {unit}"
    value, random = f"{row['costs'][name]:.6g} {unit}", f" ({_numbers(row['random'])}{end})"
    mean = f", mean {row['mean'][name]:.6g} {unit}"
    if swept.each == 1:
        text = f"least {name}: {value}{at}{end}, range {spread}"
    elif len(swept.design.points) == 1:
        text = f"worst {name} of {swept.each} runs: {value}{random}{mean}"
    else:
        text = f"least {name} in the worst of {swept.each} runs: {value}{at}{random}{mean}; "
        text += f"range of the worst over the points {spread}"
    if choice.passed_over:
        count = f"{choice.passed_over} of {len(swept.design.points)} points"
        text += f"; lower, but not with the margins and the bounds of the costs: {count}"
    if failures := choice.assessment.failures:
        text += f"; no point meets the margins and the bounds of the costs: here, {'; '.join(failures)}"
    return text
