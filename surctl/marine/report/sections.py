"""Sections of the HTML report on the design: loops, sweep, export, computing time, and tables of parameters.

The disk margins hold for simultaneous perturbations of all loops.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from surctl.assessment import Assessment
from surctl.errors import InputError
from surctl.marine.control import Gains
from surctl.marine.report.goals import COLUMN_TITLES
from surctl.marine.simulation import Run
from surctl.marine.vehicle import SPECS, Vehicle
from surctl.report.document import (
    Block,
    Cell,
    Heading,
    Paragraph,
    Pictures,
    Section,
    Table,
    outcome_cell,
    picture,
)
from surctl.report.page_parts import plot_tightest
from surctl.report.study_page import disk_table, margins_table, sweep_pictures, sweep_section
from surctl.report.sweep_plots import axis_title
from surctl.report.theme import number
from surctl.system import LinearLoop
from surctl.tuning import SweepTable
from surctl.verification import Inapplicable, LoopCorners, Verdict

_NOTHING = Assessment("", {}, (), {})


@dataclass(kw_only=True, eq=False)
class ReportData:
    """The contents of one HTML report, which a study fills.

    Attributes:
        title: heading of the report.
        command: the command line that produced the report.
        version: version of this package.
        vehicle: the vehicle that the gains and margins are for.
        gains: the gains of the runs.
        speeds: (cruise speed, speed limit) [m/s] of the margins and claims; None if these speeds are not known.
        margins: margins of the eight loops.
        linear: linear analysis (all loops together, poles, sampling), for the nominal vehicle and for the worst corner
            of its ranges.
        loops: the sampled loop at each speed, by name of the speed; if empty, the report has no Bode plot.
        verdicts: verdicts on the claims.
        inapplicable: claims that do not apply to this vehicle, each with the reason.
        regions: region claims that cannot be proved for this vehicle, grouped by reason.
        runs: closed-loop runs.
        deciding: for each run, whether the run counts towards the result; if None, only runs with true positions count.
        sweep: the parameter sweep that selected the gains, or None.
        export: the section about the exported controller, or None.
        seconds: computing time [s] of each part of the study.
        assessment: what is assessed, for the first line and the summary.
        gains_file: name of the gain file with these gains, for the option `--gains`; empty if there is none.
        film: whether MuJoCo's pictures of the scene are shown beside the plan view of the decisive run.

    Raises:
        InputError: `deciding` and `runs` differ in length.
    """

    title: str
    command: str
    version: str
    vehicle: Vehicle
    gains: Gains
    speeds: tuple[float, float] | None = None
    linear: LoopCorners | None = None
    loops: Mapping[str, LinearLoop] = field(default_factory=dict)
    verdicts: tuple[Verdict, ...] = ()
    inapplicable: tuple[Inapplicable, ...] = ()
    regions: tuple[Inapplicable, ...] = ()
    runs: tuple[Run, ...] = ()
    deciding: tuple[bool, ...] | None = None
    sweep: SweepTable | None = None
    export: Section | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    assessment: Assessment = _NOTHING
    gains_file: str = ""
    film: bool = False

    def __post_init__(self) -> None:
        if self.deciding is not None and len(self.deciding) != len(self.runs):
            problem = f"has {len(self.deciding)} entries for {len(self.runs)} runs"
            raise InputError(problem, key="deciding", remedy="give one entry per run")

    @property
    def decides(self) -> tuple[bool, ...]:
        """Return, for each run, whether the run counts towards the result."""
        if self.deciding is None:
            return tuple(run.sensing == "truth" for run in self.runs)
        return self.deciding


def _linear_blocks(loops: LoopCorners | None) -> list[Block]:
    """Return a table of disk margins and a table of poles; empty if there is no analysis."""
    if loops is None:
        return []
    text = (
        "All loops at once: the gains and phases of all loops may vary together, in any combination, within the disk "
        "margin. The guaranteed margin holds at every frequency. The upper bound is the size of a perturbation that "
        "destabilises the loop. The sampled loop is computed without approximation: thrust is constant over each "
        "control period, and delays are whole periods."
    )
    worst = f"worst of {loops.of}"
    named = [("nominal", disk) for disk in loops.nominal.disks] + [(worst, disk) for disk in loops.disks]
    poles = (("nominal", loops.nominal.slowest_per_s, loops.nominal), (worst, loops.slowest_per_s, loops.worst))
    rows: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            of,
            outcome_cell(loop.stable, "stable", "UNSTABLE"),
            *(Cell(number(v, digits=3), number=True) for v in (slowest, loop.least_damping)),
        )
        for of, slowest, loop in poles
    )
    heads = ("vehicle", "closed loop", "slowest pole [1/s]", "least damping [1]")
    each = margins_table("Margins of each loop alone about cruise, nominal vehicle", loops.nominal.margins)
    return [each, Paragraph(text), disk_table(named), Table("Poles", heads, rows)]


_SWEPT = (
    "score",
    "deviation_m",
    "path_error_m",
    "time_s",
    "min_clearance_m_worst",
    "effort_n",
    "delay_margin_s",
    "disk_margin",
)


def vehicle_section(data: ReportData) -> Section:
    """Return a section with all vehicle parameters (unit, range, provenance); other simulated vehicles come last."""
    others = {run.vehicle.name: run.vehicle for run in data.runs if run.vehicle.name != data.vehicle.name}
    blocks: list[Block] = [*_note(data.vehicle), _parameters(data.vehicle)]
    for vehicle in others.values():
        blocks += [Heading(f"Also simulated: {vehicle.name}"), *_note(vehicle), _parameters(vehicle)]
    return Section("vehicle", f"Parameters of vehicle {data.vehicle.name}", tuple(blocks))


def _note(vehicle: Vehicle) -> list[Block]:
    return [Paragraph(vehicle.note)] if vehicle.note else []


def _parameters(vehicle: Vehicle) -> Table:
    rows = []
    for name, p in vehicle.parameters.items():
        span = "–" if p.range is None else f"{number(p.range[0])} to {number(p.range[1])}"
        value = Cell(number(p.value, digits=6), number=True)
        rows.append((Cell(name, code=True), SPECS[name].meaning, value, p.unit, span, p.provenance))
    heads = ("parameter", "meaning", "value", "unit", "range (same unit)", "provenance")
    return Table(f"Parameters of {vehicle.name}", heads, tuple(rows))


def gains_section(data: ReportData) -> Section:
    """Return a section with the gains, their units and meanings, and their provenance."""
    specs = data.gains.specs
    rows = tuple(
        (Cell(name, code=True), Cell(number(value, digits=6), number=True), specs[name].unit, specs[name].meaning)
        for name, value in data.gains.values.items()
    )
    table = Table(f"Gains {data.gains.name}", ("gain", "value", "unit", "meaning"), rows)
    provenance = Paragraph(f"Provenance: {data.gains.provenance.rstrip('.')}.")
    return Section("gains", f"Gains {data.gains.name}", (provenance, table))


def loops_section(data: ReportData) -> Section:
    """Return a section with the margins of each loop, and plots of the loops that tolerate the least delay."""
    text = (
        "Each loop of the sampled law is opened at one place while all others stay closed, about straight cruise: "
        "surge, yaw and the like at the thrust command, x, y, psi, u, v and r at the measurement."
    )
    blocks: list[Block] = [
        Paragraph(text),
        *_linear_blocks(data.linear),
    ]
    pictures = tuple(
        picture(
            figure,
            alt=f"Bode plot, sensitivities, Nyquist curve, step response and poles of the loop opened at {opening}",
            caption=f"The sampled loop, opened at {opening}, where it tolerates the least delay.",
            command=data.command,
        )
        for opening, figure in (plot_tightest(data.loops) if data.loops else {}).items()
    )
    if pictures:
        blocks.append(Pictures(pictures))
    return Section("loops", "Margins of each loop", tuple(blocks), folded=True)


def picked_section(data: ReportData, sweep: SweepTable) -> Section:
    """Return a section with plots of the columns of the sweep, and a table of the picked point."""
    feasible = sweep.column("feasible") > 0.5
    over = " and ".join(axis_title(axis) for axis in sweep.axes)
    text = (
        f"The sweep has {feasible.size} points over {over}; each is simulated in {', '.join(sweep.cases)}. "
        f"{int(feasible.sum())} points are feasible: every run arrives without contact and the margins suffice. The "
        "feasible point with the lowest score is picked."
    )
    blocks: list[Block] = [Paragraph(text)]
    if sweep.picked is None:
        blocks.append(Paragraph("No point is feasible, so the gains of the file stay in use.", "bad"))
    else:
        blocks.append(_picked(sweep, sweep.picked))
    titles = {name: COLUMN_TITLES.get(name, name) for name in _SWEPT if name in sweep.columns}
    return sweep_section(blocks, sweep_pictures(sweep, titles, command=data.command))


def _picked(sweep: SweepTable, at: tuple[int, ...]) -> Table:
    here = sweep.row(at)
    rows = [(axis.name, Cell(number(here[axis.name]), number=True), axis.unit) for axis in sweep.axes]
    rows += [
        (COLUMN_TITLES.get(name, name), Cell(number(here[name]), number=True), sweep.units[name])
        for name in _SWEPT
        if name in sweep.columns
    ]
    return Table("The picked point", ("quantity", "value", "unit"), tuple(rows))
