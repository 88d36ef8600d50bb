"""Rendering of sections as one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from surctl.report.document import Check, Section

__all__ = ["render_sections"]

_TEMPLATES = Path(__file__).parent / "templates"


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
    """Return an HTML page with the given sections, in the layout of all reports.

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
        >>> from surctl.report import Check, render_sections
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
