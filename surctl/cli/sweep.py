"""`surctl sweep`: closed-loop and linear metrics over gains and other parameters."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.activity import progress
from surctl.cli.gains_choice import choose_shared
from surctl.cli.law_option import choose_law, law_option, law_words
from surctl.cli.output import as_json, finish, same_command, saving, stoppable
from surctl.cli.speeds import SPEEDS
from surctl.cli.system_option import is_system, seconds_option
from surctl.cli.system_sweep import sweep_own_system
from surctl.cli.vehicle_choice import at_hand

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from surctl.marine.control import Gains
    from surctl.marine.simulation import Case
    from surctl.marine.tuning import SweepTable
    from surctl.marine.verification import Locus
    from surctl.tuning import Executor, SobolIndices

__all__ = ["sweep"]

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
    "axes",
    nargs=-1,
    required=True,
    metavar="[FILE.py:FUNCTION] PARAMETER=V1,V2,...|LOW..HIGH[:COUNT][:log] ...",
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
@click.option("--gains", metavar="FILE", help="All other gains: name or file (default: the vehicle's).")
@law_option
@click.option(
    "--priority-mode",
    default="nsb",
    metavar="NAME",
    help="Priorities: nsb (default), filter, projected or lexicographic.",
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
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Processes or threads (default 2).",
)
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
    model), a number of the scenario (scenario.cruise) or seed. Exit status: 1 if no point is feasible.

    FILE.py:FUNCTION names a system of your own: its costs over gains (k), plant.NAME, reference.NAME, disturbance.NAME,
    start.NAME. With --seeds N, the worst of N runs counts, and plant.NAME=LOW..HIGH is random.

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
    from surctl.errors import InputError, nearest
    from surctl.files import prepare_folder, write_file
    from surctl.marine.control import law_source, load_gains, write_gains
    from surctl.marine.simulation import load_scenario
    from surctl.marine.tuning import build_cases, check_column
    from surctl.marine.tuning import sweep as run_sweep
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
            from surctl.marine.report import save_locus

            at = {} if picked is None else table.at(picked)
            axis = next(axis for axis in table.axes if axis.name == locus)
            poles = _locus(cases, table.gains, locus, axis.values, at)
            pictures.append(save_locus(poles, out, unit=axis.unit, picked=at.get(locus)))
    lines = [*why, *_vehicles(cases, vehicles), *tuned.lines, *_lines(table, sobol)]
    where = "No point is feasible, so no gain file was written." if picked is None else table.gains.provenance
    lines += ["", where, *moved, *([] if gains_path is None else [f"gains {gains_path}"]), f"table {table.path}"]
    lines += [f"plot  {picture}" for picture in pictures]
    about = shlex.join(at_hand(cases[0].scenario, cases[0].vehicle, str(gains_path)))
    named = shlex.join(law_words(law))
    # the claims of `verify` are about parts of the built-in laws
    judged = f"surctl verify {about}" if law_source(law).parts else f"surctl export {about} {named} --sensing {sensing}"
    then = [judged] if picked is not None else []
    data = {
        "axes": {axis.name: axis.values.tolist() for axis in table.axes},
        "units": {axis.name: axis.unit for axis in table.axes} | dict(table.units),
        "cases": list(table.cases),
        "results": table.rows() if as_json else [],
        "picked": None if picked is None else table.row(picked),
        "gains": None if gains_path is None else str(gains_path),
        "sensitivity": None if sobol is None else sobol.to_dict(),
        "table": str(table.path),
    }
    finish(data, lines, as_json=as_json, passed=picked is not None, then=then)


def _vehicles(cases: Sequence[Case], typed: Sequence[str]) -> list[str]:
    """Return a line for each vehicle of a scenario, with the origin of the choice."""
    from surctl.cli.vehicle_choice import choose_vehicle

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
        from surctl.marine.report import save_heat_map, save_parallel
        from surctl.report import save_sobol_plot

        pictures.append(save_parallel(table, out) if sobol is None else save_sobol_plot(sobol, out))
        if sobol is None and table.is_grid and len(table.axes) > 1:
            pictures.append(save_heat_map(table, "score", out))
    return pictures


def _locus(
    cases: Sequence[Case], gains: Gains, parameter: str, swept: NDArray[np.float64], at: Mapping[str, float]
) -> Locus:
    # poles of the first vehicle at its largest cruise speed, about the point `at`
    import numpy as np

    from surctl.marine.verification import sweep_locus

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
