"""Rendering of the report of a study as one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path

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
from surctl.report.document import Section, marked
from surctl.report.numbers import number
from surctl.report.page import render_sections

__all__ = ["render_page", "write_page"]


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
