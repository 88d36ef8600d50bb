"""`surctl sweep` of missions: results over gains, vehicles and scenarios; the picked gains, root locus."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.options import collected, option, options
from surctl.cli.sweep import SweepJob, SweepOptions, SweepSummary, point_rows
from surctl.errors import InputError, check_known
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import (
    SPEEDS,
    RobotOptions,
    at_hand,
    choose_law,
    choose_shared,
    choose_vehicle,
    law_words,
)

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


_LOCUS = 401  # number of parameter values at which poles are computed
_PRINTED = (  # columns of the text output
    "deviation_m", "path_error_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin",
    "disk_margin_at_m_per_s", "reached_worst", "score", "feasible",
)  # fmt: skip
_EXPLAINED = ("deviation_m", "path_error_m")  # columns whose meaning is printed below the points: their names are alike


@dataclass(frozen=True, eq=False, repr=False)
class SweptMissions:
    """The options about the missions of a sweep, besides those of `RobotOptions`."""

    scenarios: Sequence[str] = option(
        "--scenario",
        "Scenario to simulate at each point: name or file; repeatable (default tank-static and pool-static).",
        ("tank-static", "pool-static"),
        metavar="FILE",
    )
    vehicles: Sequence[str] = option(
        "--vehicle", "Vehicle: name or file; repeatable (default: scenario's).", (), metavar="FILE"
    )
    locus: str | None = option("--locus", "Plot poles over a swept PARAMETER, at the best gains.", metavar="PARAMETER")
    cruise: Sequence[float] | None = option(
        "--cruise",
        "Cruise speeds [m/s] of the loop margins; the worst margin counts (default: speeds of the scenarios).",
        type=SPEEDS,
        metavar="U1,U2,...",
    )


@dataclass(frozen=True, eq=False, repr=False)
class _Robot(RobotOptions):
    gains: str | None = option(
        "--gains", "Gain set for the gains not swept (default: built-in for the vehicle, else derived).", metavar="FILE"
    )
    guidance: str = option(
        "--guidance",
        "Path guidance of simulated runs: los (default), ilos or alos. Loop margins and --locus always use los.",
        "los",
        metavar="NAME",
    )


_OF_ROBOT = ("gains", "law", "guidance", "priority_mode", "sensing")


@click.command
@click.argument("words", nargs=-1, metavar="")
@options(missions=SweptMissions, robot=_Robot, only={"robot": _OF_ROBOT})
@collected(options=SweepOptions)
def sweep(
    words: Sequence[str], options: SweepOptions, missions: SweptMissions, robot: RobotOptions, **_: Any
) -> SweepJob:
    """Simulate scenarios at each combination of parameter values, compute loop margins, and select the best point.

    A parameter is a gain (k_v), a number of the vehicle (vehicle.m11; plant.m11 changes the plant, but not the
    controller's model), a number of the scenario (scenario.cruise) or seed. Exit status: 1 if no point is feasible, or
    if margins, runs or claims fail at the best point.

    The parameters of your own system, FILE.py:FUNCTION, are its gains (by name), plant.NAME, reference.NAME,
    disturbance.NAME and start.NAME. With --seeds N, plant.NAME=LOW..HIGH is random in N runs per point; the worst
    run counts.

    Examples: surctl sweep --scenario pool-static lookahead=0.6,0.9,1.2 k_v=0.5..3:6:log;
    surctl sweep k_v=1..3 plant.m11=30..60 --sensitivity deviation_m;
    surctl sweep my_system.py:build k=1..8:20:log plant.m=1..2 --seeds 100 --seconds 5
    """
    parsed = [lib.parse_axis(text) for text in words]
    locus, vehicles = missions.locus, missions.vehicles
    if options.sensitivity is None:
        chosen = lib.make_design(options.design, parsed, count=options.points)
    else:
        lib.check_column(options.sensitivity)
        chosen = lib.saltelli(parsed, base=64 if options.points is None else options.points)
    if locus is not None:
        check_known(locus, chosen.names, "is not an axis of this sweep", key="--locus")
        if len(set(chosen.points[:, chosen.names.index(locus)])) < 2:
            raise InputError("has one value", key=locus, remedy="give a range")
    scenarios = [lib.load_scenario(name) for name in missions.scenarios]
    robots = [lib.load_vehicle(name) for name in vehicles]
    law, why = choose_law(robot.law, robots or [lib.load_vehicle(scenario.vehicle) for scenario in scenarios])
    own = lib.law_source(law).gains
    base, sensing = lib.load_gains(robot.gains or "default", own=own), str(robot.sensing)
    kind = {"law": law, "mode": robot.priority_mode, "sensing": sensing, "guidance": robot.guidance}
    cases = lib.build_cases(scenarios, robots, gains=base, **kind)
    tuned = choose_shared(robot.gains, [(case.vehicle, case.scenario.cruise) for case in cases], own=own)
    cases = tuple(replace(case, gains=tuned.gains) for case in cases)
    if locus is not None:  # report a mistake before the simulations, not after them
        _locus(cases, tuned.gains, locus, chosen.points[:, chosen.names.index(locus)], {})
    subject = lib.MissionSweep(cases, tuple(range(options.seeds)), cruise=tuple(missions.cruise or ()))
    option = next(iter(vehicles), None)
    choices = [(choose_vehicle(option, (c.scenario.name, c.scenario.vehicle)), c.vehicle.name) for c in cases]
    head = [*why, *dict.fromkeys(choice.line(name) for choice, name in choices), *tuned.lines]
    summary = partial(_mission_summary, cases, law, sensing, locus, head)
    return SweepJob(
        subject, chosen, len(chosen.points), "points", "sweep.nc", lib.SHOWN, ["score"], lib.COLUMN_TITLES, summary
    )


def _set_aside(gains: Path) -> list[str]:
    """Rename the gain file of an earlier sweep, which the present results do not confirm; return the line about it."""
    if not gains.exists():
        return []
    return [f"the gain file of an earlier sweep is now {gains.replace(gains.with_stem('gains-before'))}"]


def _mission_summary(
    cases: Sequence[lib.Case],
    law: str,
    sensing: str,
    locus: str | None,
    head: Sequence[str],
    table: lib.SweepTable,
    sobol: lib.SobolIndices | None,
    out: Path,
    as_json: bool,
) -> SweepSummary:
    picked, gains, file = table.picked, lib.picked_gains(table), out / "gains.toml"
    moved = _set_aside(file) if picked is None else []
    files = {} if picked is None else {"gains": lib.write_file(file, lib.write_gains(gains))}
    judged = () if picked is None else lib.missions_of(cases, gains)
    assessments = [lib.assess(mission, parts=["loop", "no contact"]) for mission in judged]
    verdicts = [f"{one.subject} {one.verdict()}" for one in assessments]
    where = "No point is feasible, so no gain file was written." if picked is None else gains.provenance
    lines = [*head, *(point_rows(table, _PRINTED) if sobol is None else sobol.lines())]
    lines += [
        f"  {name}: {lib.METRICS[name].meaning}" for name in _EXPLAINED if sobol is None and name in table.columns
    ]
    for one, verdict in zip(assessments, verdicts, strict=True):
        lines += ["", verdict, *one.decisive()]
    about = shlex.join(at_hand(cases[0].scenario, cases[0].vehicle, str(files.get("gains"))))
    # the claims of `verify` are about parts of the built-in laws
    exported = f"surctl export {about} {shlex.join(law_words(law, cases[0]))} --sensing {sensing}"
    chosen = [*law_words(law, vehicle=cases[0].vehicle), "--sensing", sensing]
    verified = f"surctl verify {about} {shlex.join(chosen)}"
    then = [verified if lib.law_source(law).parts else exported] if picked is not None else []
    feasible, best = table.column("feasible") > 0.5, {} if picked is None else table.at(picked)
    values = "; the best has " * bool(best) + ", ".join(f"{name} = {value:.4g}" for name, value in best.items())
    brief = [f"{feasible.sum()} of {feasible.size} points are feasible{values}"]
    brief += [*([where] if picked is None else ()), *moved]
    brief += [verdict for one, verdict in zip(assessments, verdicts, strict=True) if not one.accepted()]
    data = {
        "axes": {axis.name: axis.values.tolist() for axis in table.axes},
        "units": dict(table.units),
        "cases": list(table.cases),
        "results": table.rows() if as_json else [],
        "picked": None if picked is None else table.row(picked),
        "assessments": [one.to_dict() for one in assessments],
        "gains": None if picked is None else str(files["gains"]),
        "table": str(table.path),
    }

    def locus_plot() -> Axes:
        [axis] = (axis for axis in table.axes if axis.name == locus)
        values, loops = _locus(cases, gains, axis.name, axis.values, best)
        return lib.plot_locus(loops, values, axis.name, unit=axis.unit, picked=best.get(axis.name))

    return SweepSummary(
        [*lines, "", where, *moved], brief, data,
        passed=bool(assessments) and all(one.accepted() for one in assessments), then=then,
        files=files | {"table": Path(str(table.path))},
        pictures={} if locus is None else {("locus", locus): locus_plot},
    )  # fmt: skip


def _locus(
    cases: Sequence[lib.Case], gains: lib.Gains, parameter: str, swept: NDArray[np.float64], at: Mapping[str, float]
) -> tuple[NDArray[np.float64], list[lib.LinearLoop]]:
    # values, and loops of the first vehicle at its largest cruise speed, about the point `at`
    import numpy as np

    first = cases[0]
    values = np.union1d(np.linspace(swept.min(), swept.max(), _LOCUS), [at[parameter]] if parameter in at else [])
    return values, lib.sweep_locus(
        first.vehicle,
        gains.values,
        parameter,
        values,
        cruise=max(c.scenario.cruise for c in cases if c.vehicle == first.vehicle),
        dt=first.build().dt,
        model=first.model,
        about=at,
        law=first.law if lib.has_cruise_loop(first.law, "los") else lib.TRACKING_LAW,
    )
