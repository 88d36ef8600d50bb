"""Contents of an HTML report as data: paragraphs, tables, pictures; its page with banner and lines below it."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from pathlib import Path
from typing import ClassVar, Literal

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from surctl.assessment import Line
from surctl.report.theme import png

Mark = Literal["", "good", "bad", "note"]


@dataclass(frozen=True)
class Cell:
    """One entry of a table, with its text, its mark (good, bad or note), and its format as code, number or text.

    `anchor` is the anchor of the section or heading with the details; empty for none.
    """

    text: str
    mark: Mark = ""
    code: bool = False
    number: bool = False
    anchor: str = ""

    @property
    def style(self) -> str:
        """Return the CSS classes of the cell for its mark, and for the way its text may be broken into lines."""
        length = len(self.text)
        fit = "number" if self.number else "short" if length <= 16 else "long" if length > 40 else "text"
        return f"{self.mark} {fit}".strip()


@dataclass(frozen=True)
class Table:
    """A table with a caption, column heads with units, and rows of cells; plain text stands for an unmarked cell.

    `widths` are the columns' shares of the page width [%]; without `widths`, each column is as wide as its text.
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell | str, ...], ...]
    widths: tuple[int, ...] = ()
    kind: ClassVar[str] = "table"

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """Return the rows of the table, with plain text converted to cells."""
        return tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in self.rows)

    @property
    def columns(self) -> tuple[tuple[str, str], ...]:
        """Return (head, CSS class) of each column; the class is `number` if the column's first cell is a number."""
        first = self.cells[0] if self.rows else tuple(Cell("") for _ in self.heads)
        return tuple((head, "number" if cell.number else "") for head, cell in zip(self.heads, first, strict=True))


@dataclass(frozen=True)
class Paragraph:
    """A paragraph; a paragraph with a mark states a result."""

    text: str
    mark: Mark = ""
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Heading:
    """A heading inside a section; links can point to a heading with an anchor (an HTML id)."""

    text: str
    anchor: str = ""
    kind: ClassVar[str] = "heading"


@dataclass(frozen=True)
class Picture:
    """An embedded picture.

    Attributes:
        uri: `data:image/png;base64,...`.
        width, height: size [px].
        alt: description of the picture for screen readers.
        caption: sentences below the picture.
        command: the command that draws the picture.
    """

    uri: str
    width: int
    height: int
    alt: str
    caption: str
    command: str


@dataclass(frozen=True)
class Pictures:
    """Pictures that are shown side by side if the page is wide enough."""

    pictures: tuple[Picture, ...]
    kind: ClassVar[str] = "pictures"


@dataclass(frozen=True)
class Player:
    """A run that the report can play; without scripts, and on paper, the report shows a still picture instead.

    Attributes:
        frames: input of `player.js`, as JSON without any `<`.
        still: the whole run in one picture.
        label: description of the animation for screen readers.
        film: pictures of the scene as data URIs, which the frames date; may be empty.
    """

    frames: str
    still: Picture
    label: str
    film: tuple[str, ...] = ()
    kind: ClassVar[str] = "player"

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """Return the still picture of the run, as a tuple with one element."""
        return (self.still,)


Block = Table | Paragraph | Heading | Pictures | Player


@dataclass(frozen=True)
class Section:
    """A section of a report with anchor (an HTML id), title and contents; a reader must open a folded section."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    folded: bool = False

    @property
    def headings(self) -> tuple[Heading, ...]:
        """Return the headings of the section that have an anchor."""
        return tuple(block for block in self.blocks if isinstance(block, Heading) and block.anchor)


def picture(plot: Axes | Figure, *, alt: str, caption: str, command: str) -> Picture:
    """Render a plot as a `Picture`; equal plots give equal bytes."""
    figure = plot if isinstance(plot, Figure) else plot.figure.figure
    # leave out the library's version, so that the bytes do not depend on it
    body = png(figure, Software=None)
    width, height = (round(side) for side in figure.get_size_inches() * figure.dpi)
    uri = "data:image/png;base64," + base64.b64encode(body).decode("ascii")
    return Picture(uri, width, height, alt, caption, command)


def outcome_cell(good: bool, yes: str, no: str) -> Cell:
    """Return a cell with the text `yes` marked good, or with the text `no` marked bad."""
    return Cell(yes, "good") if good else Cell(no, "bad")


_TEMPLATES = Path(__file__).parent / "templates"


@cache
def template(name: str) -> Template:
    """Return the template of a page, which escapes all text."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["whole"] = _whole
    return environment.get_template(name)


def _whole(text: str) -> str:
    # as HTML; browsers break a line after a hyphen, also inside --option
    return re.sub(r"(?<!\S)--?\w[\w-]*", r'<span class="whole">\g<0></span>', escape(text))


def render_sections(
    *,
    title: str,
    subject: str,
    version: str,
    command: str,
    passed: bool | None,
    banner: str,
    lines: Sequence[Line],
    sections: Sequence[Section],
) -> str:
    """Return an HTML page with the given sections, in the layout of all reports.

    Args:
        title: heading of the page.
        subject: sentence below the heading with the subject of the page.
        version: version of this package.
        command: the command line that produced the page; may be empty.
        passed: outcome of the first line.
        banner: text of the first line.
        lines: the verdicts, shown worst first; `about` is the anchor of the section or heading with the details. If a
            section is folded, only lines that fail or are not decided are open.
        sections: the sections in reading order.
    """
    style = (_TEMPLATES / "page.css").read_text(encoding="utf-8")
    plays = any(block.kind == "player" for section in sections for block in section.blocks)
    folds = any(section.folded for section in sections)
    scripts = [name for name, needed in (("fold.js", folds), ("player.js", plays)) if needed]
    script = "".join((_TEMPLATES / name).read_text(encoding="utf-8") for name in scripts)
    # a line that the first line quotes whole, and that leads nowhere, is not said twice
    shown = [line for line in _linked(lines, sections) if line.about or not banner.endswith(f": {line.text}")]
    hidden = [line for at, line in enumerate(shown) if folds and (line.rank > 2 or (line.rank == 2 and at >= _FACTS))]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return template("page.html").render(
        title=title,
        subject=subject,
        version=version,
        command=command,
        checks=[line for line in shown if line not in hidden],
        folded=hidden,
        folded_title=_counted(hidden),
        first_below=next((section for section in sections if section.folded), next(iter(sections), None)),
        style=style,
        script=script,
        digest=digest,
        sections=sections,
        rank=Line(passed, banner).rank,
        banner=banner,
    )


_FACTS = 3  # lines under the banner, also where all of them hold
_MAIN = "region"  # what is about it precedes the other lines of its rank


def _linked(lines: Sequence[Line], sections: Sequence[Section]) -> list[Line]:
    # worst first, then the region, each with the nearest anchor that the page has
    there = {section.anchor for section in sections} | {h.anchor for section in sections for h in section.headings}
    linked = []
    for line in lines:
        whole = line.about.partition("-")[0]  # the section, if the page does not show this part of it
        linked.append(replace(line, about=next((name for name in (line.about, whole) if name in there), "")))
    return sorted(linked, key=lambda line: (line.rank, line.about != _MAIN))


def _counted(lines: Sequence[Line]) -> str:
    hold = sum(line.rank == 2 for line in lines)
    notes = len(lines) - hold
    parts = [f"{hold} {'check holds' if hold == 1 else 'checks hold'}"] if hold else []
    parts += [f"{notes} {'note does' if notes == 1 else 'notes do'} not count towards the result"] if notes else []
    return "; ".join(parts)
