"""A figure as a PNG file that says which command and which function drew it."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

from matplotlib.figure import Figure

import surctl
from surctl.files import write_file
from surctl.report.theme import png

__all__ = ["save_figure"]


def _command() -> dict[str, str]:
    # the command that draws the picture, as text in the file; a script by its name, since its folder is this machine's
    program = Path(sys.argv[0])
    if program.stem == "surctl" or program == Path(surctl.__file__).with_name("__main__.py"):
        words = ["surctl", *sys.argv[1:]]
    elif program.suffix == ".py" and program.name != "__main__.py":
        words = ["python", program.name, *sys.argv[1:]]
    else:
        return {}
    return {"Description": shlex.join(words).encode("ascii", "backslashreplace").decode()}  # a name may be any bytes


def save_figure(figure: Figure, folder: Path | str, what: tuple[str, ...]) -> Path:
    """Write a figure as a PNG in the folder, named after its contents; return its path.

    The text `Description` in the file is the command that wrote it, `Software` the function that plotted the figure.
    """
    # names can come from input files: replace characters that could lead out of the folder
    name = "-".join(re.sub(r"[^A-Za-z0-9_.]+", "-", part).strip("-.") or "x" for part in what)
    body = png(figure, **{"Software": getattr(figure, "maker", None), **_command()})
    return write_file(Path(folder) / f"{name}.png", body)
