"""The page of a study: its order of sections, its tables of figures and margins, and the sections of a system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surctl.assessment import Assessment
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
from surctl.system import Record, System, entry_labels, entry_units
from surctl.tuning import SweepTable
from surctl.verification import Inapplicable, LoopMargins
from surctl.verification.linear import DiskMargin


def study_page(
    *,
    title: str,
    about: str,
    command: str,
    version: str,
    assessment: Assessment,
    decided: Sequence[str] = (),
    evidence: Sequence[Section],
    sweep: Section | None,
    export: Section | None,
    seconds: Mapping[str, float],
    numbers: Sequence[Section],
) -> str:
    """Return the page of a study, of a system or of a robot, as one HTML text without links to the network.

    Args:
        title: heading of the page.
        about: the sentence below the heading.
        command: the command line of the study.
        version: version of surctl.
        assessment: what is assessed, for the first line and the summary.
        decided: parts of the assessment that must hold, as for `Assessment.accepted`.
        evidence: the sections about runs, margins and claims.
        sweep: the section about the sweep, or None.
        export: the section about the exported controller, or None.
        seconds: computing time [s] of each part of the study.
        numbers: the sections with parameters, gains and their units.
    """
    details = (sweep, export, _time_section(seconds))
    sections = [*evidence, *filter(None, details), *numbers]
    return render_sections(
        title=title,
        subject=about,
        version=version,
        command=command,
        passed=assessment.passed,
        banner=assessment.verdict(*decided),
        lines=assessment.lines,
        sections=[section for section in sections if section.blocks],
    )


def _time_section(seconds: Mapping[str, float]) -> Section:
    rows = [(stage, Cell(number(value, digits=3), number=True)) for stage, value in seconds.items()]
    rows.append(("total", Cell(number(sum(seconds.values()), digits=3), number=True)))
    table = Table("Time by stage", ("stage", "time [s]"), tuple(rows))
    return Section("time", "Computing time", (table,) if seconds else (), folded=True)


def export_section(text: str, files: Sequence[ExportedFile], reports: Sequence[SilReport]) -> Section:
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
    return Section("export", "Exported controller", tuple(blocks), folded=True)


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
            Cell(m.name, code=True), outcome_cell(m.stable, "stable", "not stable"),
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
            outcome_cell(disk.stable, "stable", "not stable"),
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


def run_section(record: Record, command: str) -> Section:
    """Return the section about a run of a system, which the command repeats."""
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
    return Section("run", "Run", (Pictures((figures,)), *([table] if rows else [])))


def margins_section(
    assessment: Assessment, resting: Mapping[str, Sequence[tuple[str, float, str]]], mode: str, command: str
) -> Section:
    """Return the section about the linear loop of a system.

    Args:
        assessment: what is assessed of the system.
        resting: (label, value, unit) of every number at the equilibrium, by kind; empty if there is none.
        mode: what the slowest mode does.
        command: the command that computes the margins.
    """
    loop, title = assessment.sources["loop"], "Equilibrium and margins"
    if isinstance(loop, InputError):
        return Section("margins", title, (Paragraph(f"Not judged: {loop.problem}.", "note"),))
    rest = tuple(
        (kind, Cell(label, code=True), Cell(number(value, digits=6), number=True), unit)
        for kind, rows in resting.items()
        for label, value, unit in rows
    )
    text = "The sampled loop, linear about its equilibrium, is opened at one signal while all others stay closed."
    loops = picture(
        plot_loop(loop.nominal.linear),
        alt="Bode plot, sensitivities, Nyquist curve, step response and poles of the sampled loop",
        caption="The sampled loop: loop gain, sensitivities, Nyquist curve, step response and poles.",
        command=command,
    )
    blocks = (
        figures_table(assessment),
        Paragraph(text),
        Pictures((loops,)),
        margins_table("Margins of each loop alone, nominal", loop.nominal.margins),
        disk_table([("nominal", disk) for disk in loop.nominal.disks]),
        Paragraph(f"Slowest mode: {mode}."),
        Table("Equilibrium", ("kind", "entry", "value", "unit"), rest),
    )
    return Section("margins", title, blocks)


def region_section(assessment: Assessment, command: str) -> Section:
    """Return the section about the region of attraction of a system; it is empty if none is claimed."""
    solution, title = assessment.sources.get("region"), "Region of attraction"
    if solution is None:
        return Section("region", title, ())
    if isinstance(solution, Inapplicable):
        return Section("region", title, (Paragraph(f"Not assessed: {solution.sentence}.", "note"),))
    first, *others = (" ".join(line.split()) for line in solution.lines())
    marks: dict[str, Literal["good", "bad"]] = {"proved": "good", "refuted": "bad"}
    blocks: list[Block] = [Paragraph(first, marks.get(solution.verdict, "")), *map(Paragraph, others)]
    claim = None if solution.decision is None else solution.decision.claim
    if claim is not None and hasattr(claim, "level"):
        figures = plot_motion(solution.dynamics, claim.function, level=claim.level, falsified=solution.falsified)
        text = "Level set of the Lyapunov function, with solutions of the dynamics."
        blocks.append(Pictures((picture(figures, alt=text, caption=text, command=command),)))
    return Section("region", title, (*blocks, Paragraph(f"The claim is about {solution.about}.")))


def costs_section(swept: SweepTable, system: System, best: Sequence[str], command: str) -> Section:
    """Return the section about the costs of a system over its gains, with a line for the best point of each cost."""
    titles = {name: cost.meaning or name for name, cost in system.costs.items()}
    pictures = sweep_pictures(swept, titles, command=command)
    count = math.prod(swept.shape) * swept.each
    return sweep_section([Paragraph(f"{count:,} runs."), *map(Paragraph, best)], pictures)


def sweep_section(blocks: Sequence[Block], pictures: Sequence[Pictures]) -> Section:
    """Return the section about a sweep."""
    return Section("sweep", "Sweep of the gains", (*blocks, *pictures), folded=True)


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


def signals_section(record: Record) -> Section:
    """Return the section with all signals, parameters and gains of a run of a system, and their units."""
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
    table = Table("Signals, parameters and gains of this run", heads, tuple(rows))
    return Section("signals", "Signals, parameters and gains", (table,))
