"""Pictures that are plotted and saved, but not rendered: rendering takes seconds a command.

Tests of the plots render them, and so do the guides; here it is only whether a command saves its pictures.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

BLANK = "SURCTL_TESTS_BLANK_PICTURES"
PNG = b"\x89PNG\r\n\x1a\n"


def save_blank(figure: Figure, file: Any, **options: Any) -> None:
    """Instead of `Figure.savefig`."""
    if hasattr(file, "write"):
        file.write(PNG)
    else:
        Path(file).write_bytes(PNG)


def blank_pictures() -> None:
    """From now on no figure of this process is rendered."""
    Figure.savefig = save_blank  # type: ignore[method-assign, assignment]
