"""The report of a study of a system of the user's own, on one page; tables of figures and margins of any report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surctl.assessment import Assessment, Line
from surctl.errors import InputError
from surctl.export import ExportedFile, SilReport
from surctl.ir import Layout
from surctl.report.document import (
    Block,
    Cell,
    Paragraph,
    Pictures,
    Section,
    Table,
    outcome_cell,
    picture,
    render_sections,
)
from surctl.report.motion_plots import plot_motion
from surctl.report.page_parts import plot_loop
from surctl.report.sweep_plots import plot_heat_map
from surctl.report.system_plots import plot_dependence, plot_record
from surctl.report.theme import file_size, number
from surctl.system import Record, entry_labels, entry_units
from surctl.tuning import SweepTable
from surctl.verification import Inapplicable, LoopMargins
from surctl.verification.linear import DiskMargin


@dataclass(frozen=True)
class SystemStudy:
    """The results of a study of a system.

    Attributes:
        title: names of plant and controller.
        record: the run.
        assessment: what is assessed of the system, with the comparison of C and Python.
        resting: (label, value, unit) of every number at the equilibrium, by kind; empty if there is none.
        mode: what the slowest mode does.
        swept: the sweep; None if nothing was swept.
        best: lines with the best point of each cost.
        files: the exported files.
        sil: comparison of C and Python.
        commands: the command lines of the study, of the run, of the margins and claim, and of the sweep.
        version: version of surctl.
    """

    title: str
    record: Record
    assessment: Assessment
    resting: Mapping[str, Sequence[tuple[str, float, str]]]
    mode: str
    swept: SweepTable | None
    best: Sequence[str]
    files: Sequence[ExportedFile]
    sil: SilReport
    commands: Mapping[str, str]
    version: str


def export_line(sil: SilReport) -> Line:
    """Return the verdict on the exported C."""
    most = max(sil.tau.mixed, sil.state.mixed, sil.telemetry.mixed)
    text = f"C and Python differ by at most {most:.1e} over {sil.steps} steps, {sil.fault_cases} invalid inputs tried"
    return Line(sil.passed, text, "export")


def export_section(
    text: str, files: Sequence[ExportedFile], reports: Sequence[SilReport], *, folded: bool = False
) -> Section:
    """Return a section with the exported files (size, SHA-256), and the comparison of C and Python in each run."""
    rows = tuple(
        (Cell(f.path.name, code=True), Cell(file_size(f.path), number=True), Cell(f.sha256, code=True)) for f in files
    )
    blocks: list[Block] = [Paragraph(text), Table("Exported files", ("file", "size [byte]", "SHA-256"), rows)]
    for report in reports:
        head, *others = (line.strip() for line in report.summary().splitlines())
        blocks += [Paragraph(head, "good" if report.conclusive else "bad"), *map(Paragraph, others)]
    if not reports:
        blocks.append(Paragraph("The C was not compiled and not compared with Python.", "note"))
    return Section("export", "Exported controller", tuple(blocks), folded)


def figures_table(assessment: Assessment) -> Table:
    """Return the table of the figures of an assessment."""
    rows = tuple(
        (
            Cell(f.name, code=True),
            Cell(number(f.value), number=True),
            Cell(f.required, number=True),
            f.unit,
            f.meaning,
            f.where,
        )
        for f in assessment.figures.values()
    )
    return Table("Figures of the assessment", ("figure", "value", "required", "unit", "meaning", "worst at"), rows)


def margins_table(caption: str, margins: Sequence[LoopMargins]) -> Table:
    """Return the table of the margins of each loop alone."""
    rows = tuple(
        (
            Cell(m.name, code=True), outcome_cell(m.stable, "stable", "UNSTABLE"),
            *(Cell(number(v), number=True) for v in (
                m.gain_margin, m.least_gain, m.phase_margin_deg, m.delay_margin_s, m.disk_margin, m.crossover_rad_s)),
        )
        for m in margins
    )  # fmt: skip
    heads = (
        "loop", "closed loop", "gain margin [1]", "least gain [1]", "phase margin [deg]", "delay margin [s]",
        "disk margin of this loop alone [1]", "crossover [rad/s]",
    )  # fmt: skip
    return Table(caption, heads, rows)


def disk_table(disks: Sequence[tuple[str, DiskMargin]]) -> Table:
    """Return the table of disk margins of all loops at once, each with what it is of."""
    rows: tuple[tuple[Cell | str, ...], ...] = tuple(
        (
            of,
            Cell(disk.place, code=True),
            outcome_cell(disk.stable, "stable", "UNSTABLE"),
            *(Cell(number(v, digits=3), number=True) for v in (disk.guaranteed, disk.reached, disk.frequency_rad_s)),
            Cell(f"{number(disk.gain[0], digits=3)} to {number(disk.gain[1], digits=3)}", number=True),
            Cell(number(disk.phase_deg, digits=3), number=True),
        )
        for of, disk in disks
    )
    heads = (
        "of", "opened at", "closed loop", "guaranteed [1]", "upper bound [1]", "at [rad/s]",
        "tolerated gain factors [1]", "tolerated phase errors [deg]",
    )  # fmt: skip
    return Table("Disk margins of all loops at once", heads, rows)


def render_system_page(study: SystemStudy) -> str:
    """Return the report as one HTML text without links to the network; all text is escaped.

    `surctl study FILE.py:FUNCTION --seconds S` writes it.
    """
    assessment = study.assessment
    system = study.record.system
    return render_sections(
        title=study.title,
        subject=f"Plant {system.plant.name}, controller {system.controller.name}, control period {system.dt:g} s.",
        version=study.version,
        command=study.commands["study"],
        passed=assessment.passed,
        banner=assessment.verdict("region"),
        lines=assessment.lines,
        sections=[section for section in _sections(study) if section.blocks],
    )


def _sections(study: SystemStudy) -> list[Section]:
    return [
        Section("run", "Run", _run(study)),
        Section("margins", "Equilibrium and margins", _margins(study)),
        Section("region", "Region of attraction", _region(study)),
        Section("sweep", "Sweep", _sweep(study)),
        export_section("The step of the controller as C99.", study.files, [study.sil]),
        Section("signals", "Signals, parameters and gains", _ports(study.record)),
    ]


def _run(study: SystemStudy) -> tuple[Block, ...]:
    record, command = study.record, study.commands["run"]
    figures = picture(
        plot_record(record),
        alt=f"States, commands and references over {record.duration:.6g} s",
        caption="States, commands and references over time; commands are constant between control instants.",
        command=command,
    )
    rows = tuple(
        (Cell(name, code=True), Cell(number(record.figures[name]), number=True), cost.unit, cost.how, cost.meaning)
        for name, cost in record.system.costs.items()
    )
    table = Table("Costs of the run", ("cost", "value", "unit", "over the run", "meaning"), rows)
    return (Pictures((figures,)), *([table] if rows else []))


def _margins(study: SystemStudy) -> tuple[Block, ...]:
    loop = study.assessment.sources["loop"]
    if isinstance(loop, InputError):
        return (Paragraph(f"Not judged: {loop.problem}.", "note"),)
    rest = tuple(
        (kind, Cell(label, code=True), Cell(number(value, digits=6), number=True), unit)
        for kind, rows in study.resting.items()
        for label, value, unit in rows
    )
    text = "The sampled loop, linear about its equilibrium, is opened at one signal while all others stay closed."
    loops = picture(
        plot_loop(loop.nominal.linear),
        alt="Bode plot, sensitivities, Nyquist curve, step response and poles of the sampled loop",
        caption="The sampled loop: loop gain, sensitivities, Nyquist curve, step response and poles.",
        command=study.commands["verify"],
    )
    return (
        figures_table(study.assessment),
        Paragraph(text),
        Pictures((loops,)),
        margins_table("Margins of each loop alone, nominal", loop.nominal.margins),
        disk_table([("nominal", disk) for disk in loop.nominal.disks]),
        Paragraph(f"Slowest mode: {study.mode}."),
        Table("Equilibrium", ("kind", "entry", "value", "unit"), rest),
    )


def _region(study: SystemStudy) -> tuple[Block, ...]:
    solution = study.assessment.sources.get("region")
    if solution is None:
        return ()
    if isinstance(solution, Inapplicable):
        return (Paragraph(f"Not assessed: {solution.sentence}.", "note"),)
    first, *others = (" ".join(line.split()) for line in solution.lines())
    marks: dict[str, Literal["good", "bad"]] = {"proved": "good", "refuted": "bad"}
    blocks: list[Block] = [Paragraph(first, marks.get(solution.verdict, "")), *map(Paragraph, others)]
    claim = None if solution.decision is None else solution.decision.claim
    if claim is not None and hasattr(claim, "level"):
        figures = plot_motion(solution.dynamics, claim.function, level=claim.level, falsified=solution.falsified)
        text = "Level set of the Lyapunov function, with solutions of the dynamics."
        blocks.append(Pictures((picture(figures, alt=text, caption=text, command=study.commands["verify"]),)))
    return (*blocks, Paragraph(f"The claim is about {solution.about}."))


def _sweep(study: SystemStudy) -> tuple[Block, ...]:
    swept = study.swept
    if swept is None:
        return ()
    titles = {name: cost.meaning or name for name, cost in study.record.system.costs.items()}
    pictures = sweep_pictures(swept, titles, command=study.commands["sweep"])
    count = math.prod(swept.shape) * swept.each
    return (Paragraph(f"{count:,} runs."), *map(Paragraph, study.best), *pictures)


def sweep_pictures(table: SweepTable, titles: Mapping[str, str], *, command: str) -> tuple[Pictures, ...]:
    """Return a map over a grid of each titled column, else the column over each number; none for one run."""
    shown = []
    for name, title in titles.items() if math.prod(table.shape) * table.each > 1 else ():
        if table.is_grid and len(table.axes) > 1:
            figure: Axes | Figure = plot_heat_map(table, name, titles=titles)
            note = "A frame marks the chosen point or the least value; hatched cells are infeasible."
        else:
            figure = plot_dependence(table.numbers(), {name: table.column(name).reshape(-1)}, name)
            note = "Each number alone, ordered by its rank correlation."
        alt = f"{title} over {', '.join(table.numbers())}"
        shown.append(picture(figure, alt=alt, caption=f"{title[0].upper()}{title[1:]}. {note}", command=command))
    return (Pictures(tuple(shown)),) if shown else ()


def _ports(record: Record) -> tuple[Block, ...]:
    system = record.system
    layouts: dict[str, Layout] = {
        "state": system.plant.state, "command": system.commands, "reference": system.references,
        "measured output": system.plant.outputs, "disturbance": system.plant.disturbances,
        "controller state": system.controller.state, "telemetry": system.telemetry,
        "plant parameter": system.plant.parameters, "gain": system.controller.gains,
    }  # fmt: skip
    rows = []
    for kind, layout in layouts.items():
        meanings = [port.meaning for port in layout for _ in range(port.size)]
        nominal = layout.pack()
        if kind == "gain":
            nominal = record.controller[2]
        for label, unit, value, meaning in zip(
            entry_labels(layout), entry_units(layout), nominal, meanings, strict=True
        ):
            rows.append((kind, Cell(label, code=True), Cell(number(float(value)), number=True), unit, meaning))
    heads = ("kind", "entry", "value by default", "unit", "meaning")
    return (Table("Signals, parameters and gains of this run", heads, tuple(rows)),)
