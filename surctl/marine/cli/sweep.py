"""`surctl sweep` of missions: results over gains, vehicles and scenarios; the picked gains, root locus."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.options import collected, only, option, options
from surctl.cli.sweep import SweepJob, SweepOptions, SweepSummary, point_rows
from surctl.errors import InputError, check_known
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

    from surctl.marine.control import Gains
    from surctl.marine.simulation import Case
    from surctl.system import LinearLoop
    from surctl.tuning import SobolIndices, SweepTable

_LOCUS = 401  # number of parameter values at which poles are computed
_PRINTED = (  # columns of the text output
    "deviation_m", "path_error_m", "time_s", "min_clearance_m_worst", "effort_n", "delay_margin_s", "disk_margin",
    "disk_margin_at_m_per_s", "reached_worst", "score", "feasible",
)  # fmt: skip
_EXPLAINED = ("deviation_m", "path_error_m")  # columns whose meaning is printed below the points: their names are alike


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


@click.command
@click.argument("words", nargs=-1, metavar="")
@options(missions=SweptMissions, robot=only(_Robot, "gains", "law", "guidance", "priority_mode", "sensing"))
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
    from surctl.marine.control import law_source, load_gains
    from surctl.marine.report.goals import COLUMN_TITLES, SHOWN
    from surctl.marine.simulation import load_scenario
    from surctl.marine.tuning import MissionSweep, build_cases
    from surctl.marine.tuning.sweep import check_column
    from surctl.marine.vehicle import load_vehicle
    from surctl.tuning import make_design, parse_axis, saltelli

    parsed = [parse_axis(text) for text in words]
    locus, vehicles = missions.locus, missions.vehicles
    if options.sensitivity is None:
        chosen = make_design(options.design, parsed, count=options.points)
    else:
        check_column(options.sensitivity)
        chosen = saltelli(parsed, base=64 if options.points is None else options.points)
    if locus is not None:
        check_known(locus, chosen.names, "is not an axis of this sweep", key="--locus")
        if len(set(chosen.points[:, chosen.names.index(locus)])) < 2:
            raise InputError("has one value", key=locus, remedy="give a range")
    scenarios, robots = [load_scenario(name) for name in missions.scenarios], [load_vehicle(name) for name in vehicles]
    law, why = choose_law(robot.law, robots or [load_vehicle(scenario.vehicle) for scenario in scenarios])
    own = law_source(law).gains
    base, sensing = load_gains(robot.gains or "default", own=own), str(robot.sensing)
    kind = {"law": law, "mode": robot.priority_mode, "sensing": sensing, "guidance": robot.guidance}
    cases = build_cases(scenarios, robots, gains=base, **kind)
    tuned = choose_shared(robot.gains, [(case.vehicle, case.scenario.cruise) for case in cases], own=own)
    cases = tuple(replace(case, gains=tuned.gains) for case in cases)
    if locus is not None:  # report a mistake before the simulations, not after them
        _locus(cases, tuned.gains, locus, chosen.points[:, chosen.names.index(locus)], {})
    subject = MissionSweep(cases, tuple(range(options.seeds)), cruise=tuple(missions.cruise or ()))
    option = next(iter(vehicles), None)
    choices = [(choose_vehicle(option, (c.scenario.name, c.scenario.vehicle)), c.vehicle.name) for c in cases]
    head = [*why, *dict.fromkeys(choice.line(name) for choice, name in choices), *tuned.lines]
    summary = partial(_mission_summary, cases, law, sensing, locus, head)
    return SweepJob(subject, chosen, len(chosen.points), "points", "sweep.nc", SHOWN, ["score"], COLUMN_TITLES, summary)


def _set_aside(gains: Path) -> list[str]:
    """Rename the gain file of an earlier sweep, which the present results do not confirm; return the line about it."""
    if not gains.exists():
        return []
    return [f"the gain file of an earlier sweep is now {gains.replace(gains.with_stem('gains-before'))}"]


def _mission_summary(
    cases: Sequence[Case],
    law: str,
    sensing: str,
    locus: str | None,
    head: Sequence[str],
    table: SweepTable,
    sobol: SobolIndices | None,
    out: Path,
    as_json: bool,
) -> SweepSummary:
    from surctl.assessment import assess
    from surctl.files import write_file
    from surctl.marine.assessment import missions_of
    from surctl.marine.control import law_source, write_gains
    from surctl.marine.simulation import METRICS
    from surctl.marine.tuning import picked_gains
    from surctl.report import plot_locus

    picked, gains, file = table.picked, picked_gains(table), out / "gains.toml"
    moved = _set_aside(file) if picked is None else []
    files = {} if picked is None else {"gains": write_file(file, write_gains(gains))}
    assessments = [] if picked is None else [assess(m, parts=["loop", "no contact"]) for m in missions_of(cases, gains)]
    verdicts = [f"{one.subject} {one.verdict()}" for one in assessments]
    where = "No point is feasible, so no gain file was written." if picked is None else gains.provenance
    lines = [*head, *(point_rows(table, _PRINTED) if sobol is None else sobol.lines())]
    lines += [f"  {name}: {METRICS[name].meaning}" for name in _EXPLAINED if sobol is None and name in table.columns]
    for one, verdict in zip(assessments, verdicts, strict=True):
        lines += ["", verdict, *one.decisive]
    about = shlex.join(at_hand(cases[0].scenario, cases[0].vehicle, str(files.get("gains"))))
    # the claims of `verify` are about parts of the built-in laws
    exported = f"surctl export {about} {shlex.join(law_words(law))} --sensing {sensing}"
    then = [f"surctl verify {about}" if law_source(law).parts else exported] if picked is not None else []
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
        return plot_locus(loops, values, axis.name, unit=axis.unit, picked=best.get(axis.name))

    return SweepSummary(
        [*lines, "", where, *moved], brief, data,
        passed=bool(assessments) and all(one.accepted() for one in assessments), then=then,
        files=files | {"table": Path(str(table.path))},
        pictures={} if locus is None else {("locus", locus): locus_plot},
    )  # fmt: skip


def _locus(
    cases: Sequence[Case], gains: Gains, parameter: str, swept: NDArray[np.float64], at: Mapping[str, float]
) -> tuple[NDArray[np.float64], list[LinearLoop]]:
    # values, and loops of the first vehicle at its largest cruise speed, about the point `at`
    import numpy as np

    from surctl.marine.verification import sweep_locus
    from surctl.marine.verification.cruise_loop import TRACKING_LAW, has_cruise_loop

    first = cases[0]
    values = np.union1d(np.linspace(swept.min(), swept.max(), _LOCUS), [at[parameter]] if parameter in at else [])
    return values, sweep_locus(
        first.vehicle,
        gains.values,
        parameter,
        values,
        cruise=max(c.scenario.cruise for c in cases if c.vehicle == first.vehicle),
        dt=first.build().dt,
        model=first.model,
        about=at,
        law=first.law if has_cruise_loop(first.law, "los") else TRACKING_LAW,
    )
