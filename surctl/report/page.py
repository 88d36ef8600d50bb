"""The page: one HTML file with everything in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from surctl.files import write_file
from surctl.report.data import ReportData
from surctl.report.document import Section
from surctl.report.evidence_sections import claims_section, runs_section
from surctl.report.sections import (
    export_section,
    gains_section,
    margins_section,
    sweep_section,
    time_section,
    vehicle_section,
)

__all__ = ["render_page", "render_sections", "write_page"]

_TEMPLATES = Path(__file__).parent / "templates"


def render_page(data: ReportData, *, runs: Section | None = None) -> str:
    """The page as one HTML text: no network, no script, pictures and style inside, every text escaped.

    Args:
        data: what it tells.
        runs: `runs_section` of the same runs, where it was drawn before.
    """
    return render_sections(
        title=data.title,
        subject=f"Vehicle {data.vehicle.name}, gains {data.gains.name}.",
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
    summary: Sequence[tuple[bool | None, str]],
    sections: Sequence[Section],
) -> str:
    """A page of any sections, as `render_page` makes it.

    Args:
        title: heading.
        subject: sentence under it: what the page is about.
        version: of this package.
        command: the command line that made it; may be empty.
        outcome: class (`good`, `bad` or `note`) and words of the first line.
        summary: lines of the outcome: holds, fails, or None for a note that decides nothing.
        sections: in reading order.
    """
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    style = (_TEMPLATES / "page.css").read_text(encoding="utf-8")
    page = environment.get_template("page.html")
    return page.render(
        title=title,
        subject=subject,
        version=version,
        command=command,
        summary=summary,
        style=style,
        sections=sections,
        outcome=outcome,
    )


def _sections(data: ReportData, runs: Section | None) -> tuple[Section, ...]:
    """The sections in reading order; one that has nothing to tell is left out."""
    found = [vehicle_section(data), gains_section(data)]
    if data.margins or data.loops or data.poles is not None:
        found.append(margins_section(data))
    if data.sweep is not None:
        found.append(sweep_section(data, data.sweep))
    if data.verdicts:
        found.append(claims_section(data))
    if data.runs:
        found.append(runs or runs_section(data))
    if data.export is not None:
        found.append(export_section(data.export))
    if data.seconds:
        found.append(time_section(data))
    return tuple(found)


def _outcome(data: ReportData) -> tuple[str, str]:
    """Class and words of the first line."""
    failed = sum(good is False for good, _ in data.summary)
    if failed:
        return "bad", f"✗ {failed} of the checks that decide {'fails' if failed == 1 else 'fail'}."
    if data.passed is None:
        return "note", "• Nothing was decided."
    return "good", "✓ All checks that decide hold."


def write_page(data: ReportData, path: Path | str, *, runs: Section | None = None) -> Path:
    """Render (see `render_page`) and write the page; the file is replaced in one step or left as it was.

    Returns:
        The path written.

    Raises:
        InputError: the folder cannot be written.
    """
    return write_file(Path(path), render_page(data, runs=runs))
