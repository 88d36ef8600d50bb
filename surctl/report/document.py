"""What a page consists of: sections of paragraphs, tables and pictures, as data. The template only lays it out."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from io import BytesIO
from typing import ClassVar, Literal, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = [
    "Block",
    "Cell",
    "Check",
    "Heading",
    "Paragraph",
    "Picture",
    "Pictures",
    "Player",
    "Section",
    "Table",
    "outcome_cell",
    "picture",
]

Mark = Literal["", "good", "bad", "note"]


class Check(NamedTuple):
    """A line of the summary.

    Attributes:
        good: it holds, fails, or, with None, decides nothing.
        text: what it says.
        anchor: of the section or heading that tells more; empty for none.
    """

    good: bool | None
    text: str
    anchor: str = ""


@dataclass(frozen=True)
class Cell:
    """One entry of a table: its text, what it says of the outcome, whether it is set as code or as a number.

    `anchor` is that of the section or heading that tells more; empty for none.
    """

    text: str
    mark: Mark = ""
    code: bool = False
    number: bool = False
    anchor: str = ""

    @property
    def style(self) -> str:
        """Classes of the cell: its mark, and how it may be broken into lines."""
        length = len(self.text)
        fit = "number" if self.number else "short" if length <= 16 else "long" if length > 40 else "text"
        return f"{self.mark} {fit}".strip()


@dataclass(frozen=True)
class Table:
    """A table: caption, column heads with units, rows of cells. Plain text stands for an unmarked cell.

    `widths` are the columns' shares of the page's width [%]; without them each column is as wide as its text.
    """

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Cell | str, ...], ...]
    widths: tuple[int, ...] = ()
    kind: ClassVar[str] = "table"

    @property
    def cells(self) -> tuple[tuple[Cell, ...], ...]:
        """The rows with plain text as cells."""
        return tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in self.rows)

    @property
    def columns(self) -> tuple[tuple[str, str], ...]:
        """Head and class of each column: that of numbers where the first row has one."""
        first = self.cells[0] if self.rows else tuple(Cell("") for _ in self.heads)
        return tuple((head, "number" if cell.number else "") for head, cell in zip(self.heads, first, strict=True))


@dataclass(frozen=True)
class Paragraph:
    """A paragraph; a marked one tells an outcome."""

    text: str
    mark: Mark = ""
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Heading:
    """A heading inside a section; one with an anchor (an HTML id) can be linked to."""

    text: str
    anchor: str = ""
    kind: ClassVar[str] = "heading"


@dataclass(frozen=True)
class Picture:
    """An embedded picture.

    Attributes:
        uri: `data:image/png;base64,...`.
        width, height: [px].
        alt: what it shows, for those who do not see it.
        caption: what to read from it.
        command: the command that makes it.
    """

    uri: str
    width: int
    height: int
    alt: str
    caption: str
    command: str


@dataclass(frozen=True)
class Pictures:
    """Pictures side by side where there is room."""

    pictures: tuple[Picture, ...]
    kind: ClassVar[str] = "pictures"


@dataclass(frozen=True)
class Player:
    """A run to be played and scrubbed; without a script, and on paper, its still picture.

    Attributes:
        frames: what `player.js` plays, as JSON without any `<`.
        still: the whole run in one picture.
        label: what is played, for those who do not see it.
    """

    frames: str
    still: Picture
    label: str
    kind: ClassVar[str] = "player"

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """The still picture."""
        return (self.still,)


Block = Table | Paragraph | Heading | Pictures | Player


@dataclass(frozen=True)
class Section:
    """A section: its anchor (an HTML id), title and blocks; a folded one is closed until the reader opens it."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    folded: bool = False

    @property
    def headings(self) -> tuple[Heading, ...]:
        """Those with an anchor."""
        return tuple(block for block in self.blocks if isinstance(block, Heading) and block.anchor)


def picture(plot: Axes | Figure, *, alt: str, caption: str, command: str) -> Picture:
    """Render a plot into a `Picture`; the same plot gives the same bytes."""
    figure = plot if isinstance(plot, Figure) else plot.figure.figure
    buffer = BytesIO()
    # a library's version in the file would make the bytes depend on it
    figure.savefig(buffer, format="png", metadata={"Software": None})
    width, height = (round(side) for side in figure.get_size_inches() * figure.dpi)
    uri = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    return Picture(uri, width, height, alt, caption, command)


def outcome_cell(good: bool, yes: str, no: str) -> Cell:
    """`yes` marked good, or `no` marked bad."""
    return Cell(yes, "good") if good else Cell(no, "bad")
