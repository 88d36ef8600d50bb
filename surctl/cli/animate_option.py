"""The option `--animate` of `surctl simulate`, which writes an animation of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

__all__ = ["NamedFile", "animate_option", "check_animate"]


class NamedFile(click.Path):
    """The name of a file to write, which is not empty (an empty name would be the present folder)."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; raise InputError if the name is empty."""
        if value == "":
            from surctl.errors import InputError

            raise InputError("is empty", key=param.opts[0] if param else None, value=value, remedy="name a file")
        return super().convert(value, param, ctx)


animate_option = click.option(
    "--animate", type=NamedFile(path_type=Path), metavar="FILE", help="Animation to write: FILE.gif or FILE.mp4."
)


def check_animate(path: Path | None, *, runs: int, campaign: bool, film: Path | None = None) -> None:
    """Create the folder of the animation; raise InputError before any simulation if the runs cannot be animated.

    `film` is the file of `--film`, which must be another one.
    """
    if path is None:
        return
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.marine.report import check_animation

    if campaign:
        remedy = "simulate one run of DIR/worst: --from FILE --animate"
        raise InputError("shows one run, not a campaign", key="--animate", value=str(path), remedy=remedy)
    if runs != 1:
        raise InputError(
            f"shows one run, not {runs}", key="--animate", value=str(path), remedy="name one scenario, drop --runs"
        )
    if film is not None and film.resolve() == path.resolve():
        raise InputError("is also the file of --film", key="--animate", value=str(path), remedy="name two files")
    prepare_folder(check_animation(path).parent, key="--animate")
