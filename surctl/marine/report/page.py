"""Rendering of the report of a study as one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from surctl.files import write_file
from surctl.marine.report.data import ReportData
from surctl.marine.report.evidence_sections import claims_section, decisive_section, runs_section
from surctl.marine.report.findings import findings_section
from surctl.marine.report.sections import (
    export_section,
    gains_section,
    loops_section,
    sweep_section,
    time_section,
    vehicle_section,
)
from surctl.marine.report.words import number
from surctl.report.document import Check, Section, marked

__all__ = ["render_page", "render_sections", "write_page"]

_TEMPLATES = Path(__file__).parent / "templates"


def render_page(data: ReportData, *, runs: Section | None = None) -> str:
    """Return the report as one HTML text without links to the network; all text is escaped.

    Args:
        data: the contents of the report.
        runs: result of `runs_section` for `data`, if it was rendered before.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import ReportData, render_page
        >>> from surctl.marine.vehicle import load_vehicle
        >>> data = ReportData(
        ...     title="Pool",
        ...     command="",
        ...     version="1.0",
        ...     vehicle=load_vehicle("sur400"),
        ...     gains=load_gains("default"),
        ...     summary=((True, "margins suffice"),),
        ... )
        >>> page = render_page(data)
        >>> "margins suffice" in page, "https://" in page
        (True, False)
    """
    return render_sections(
        title=data.title,
        subject=_subject(data),
        version=data.version,
        command=data.command,
        outcome=_outcome(data),
        summary=data.summary,
        sections=_sections(data, runs),
    )


def render_sections(
    *,
    title: str,
    subject: str,
    version: str,
    command: str,
    outcome: tuple[str, str],
    summary: Sequence[Check | tuple[bool | None, str]],
    sections: Sequence[Section],
) -> str:
    """Return an HTML page with the given sections, in the layout of `render_page`.

    Args:
        title: heading of the page.
        subject: sentence below the heading with the subject of the page.
        version: version of this package.
        command: the command line that produced the page; may be empty.
        outcome: class (`good`, `bad` or `note`) and text of the first line.
        summary: lines of the summary, see `Check`. Lines that fail come first, then those that are open; lines
            that do not count towards the result come last. If a section is folded, the other lines are folded too.
        sections: the sections in reading order.

    Example:
        >>> from surctl.report import Check
        >>> from surctl.marine.report import render_sections
        >>> page = render_sections(
        ...     title="Pool",
        ...     subject="One hull, one pool.",
        ...     version="1.0",
        ...     command="",
        ...     outcome=("good", "All holds."),
        ...     summary=[Check(True, "margins suffice")],
        ...     sections=[],
        ... )
        >>> page[:15], [words in page for words in ("One hull, one pool.", "margins suffice")]
        ('<!DOCTYPE html>', [True, True])
    """
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    style = (_TEMPLATES / "page.css").read_text(encoding="utf-8")
    plays = any(block.kind == "player" for section in sections for block in section.blocks)
    folds = any(section.folded for section in sections)
    scripts = [name for name, needed in (("fold.js", folds), ("player.js", plays)) if needed]
    script = "".join((_TEMPLATES / name).read_text(encoding="utf-8") for name in scripts)
    lines = _linked(summary, sections)
    hidden = [line for line in lines if folds and line.good is not False and not line.open]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    page = environment.get_template("page.html")
    return page.render(
        title=title,
        subject=subject,
        version=version,
        command=command,
        checks=[line for line in lines if line not in hidden],
        folded=hidden,
        folded_title=_counted(hidden),
        first_below=next((section for section in sections if section.folded), next(iter(sections), None)),
        style=style,
        script=script,
        digest=digest,
        sections=sections,
        outcome=outcome,
    )


def _linked(summary: Sequence[Check | tuple[bool | None, str]], sections: Sequence[Section]) -> list[Check]:
    # failed checks first, each with the nearest anchor that the page has
    there = {section.anchor for section in sections} | {h.anchor for section in sections for h in section.headings}
    linked = []
    for line in summary:
        good, text, anchor, undecided = Check(*line)
        whole = anchor.partition("-")[0]  # the section, if the page does not show this part of it
        linked.append(Check(good, text, anchor if anchor in there else whole if whole in there else "", undecided))
    order = {False: 0, None: 1, True: 2}
    return sorted(linked, key=lambda check: 3 if check.good is None and not check.open else order[check.good])


def _counted(lines: Sequence[Check]) -> str:
    hold = sum(line.good is True for line in lines)
    notes = len(lines) - hold
    parts = [f"{hold} {'check holds' if hold == 1 else 'checks hold'}"] if hold else []
    parts += [f"{notes} {'note does' if notes == 1 else 'notes do'} not count towards the result"] if notes else []
    return "; ".join(parts)


def _sections(data: ReportData, runs: Section | None) -> tuple[Section, ...]:
    # decisive run, margins and claims, folded details, parameters
    decisive = decisive_section(data)
    sections = [] if decisive is None else [decisive]
    if data.margins or data.linear or data.verdicts or data.inapplicable:
        sections.append(findings_section(data))
    if data.margins or data.loops or data.poles is not None:
        sections.append(loops_section(data))
    if data.verdicts:
        sections.append(claims_section(data))
    if data.runs:
        sections.append(runs or runs_section(data))
    if data.sweep is not None:
        sections.append(sweep_section(data, data.sweep))
    if data.export is not None:
        sections.append(export_section(data.export))
    if data.seconds:
        sections.append(time_section(data))
    return (*sections, vehicle_section(data), gains_section(data))


def _subject(data: ReportData) -> str:
    speeds = ""
    if data.speeds is not None:
        cruise, cap = data.speeds
        speeds = f", cruise speed {number(cruise)} m/s, speed limit {number(cap)} m/s"
    return f"Vehicle {data.vehicle.name}, gains {data.gains.name}{speeds}."


def _outcome(data: ReportData) -> tuple[str, str]:
    failed = sum(line[0] is False for line in data.summary)
    words = {
        False: f"{failed} {'check fails' if failed == 1 else 'checks fail'}.",
        None: "No check counts towards the result.",
        True: "All checks hold.",
    }
    return marked(data.passed, data.banner or words[data.passed])


def write_page(data: ReportData, path: Path | str, *, runs: Section | None = None) -> Path:
    """Render the report with `render_page` and write it; the file is replaced in one step or stays unchanged.

    Returns:
        The path of the written file.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import ReportData, write_page
        >>> from surctl.marine.vehicle import load_vehicle
        >>> data = ReportData(
        ...     title="Pool",
        ...     command="",
        ...     version="1.0",
        ...     vehicle=load_vehicle("sur400"),
        ...     gains=load_gains("default"),
        ...     summary=((True, "margins suffice"),),
        ... )
        >>> _ = write_page(data, "report.html")
        >>> "margins suffice" in Path("report.html").read_text(encoding="utf-8")
        True
    """
    return write_file(Path(path), render_page(data, runs=runs))
