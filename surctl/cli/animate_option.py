"""The option `--animate` of `surctl simulate`, which writes an animation of a run."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["animate_option", "check_animate"]

animate_option = click.option(
    "--animate", type=click.Path(path_type=Path), metavar="FILE", help="Animation to write: FILE.gif or FILE.mp4."
)


def check_animate(path: Path | None, *, runs: int, campaign: bool) -> None:
    """Create the folder of the animation; raise InputError before any simulation if the runs cannot be animated."""
    if path is None:
        return
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.report import check_animation

    if campaign:
        remedy = "simulate one run of DIR/worst: --from FILE --animate"
        raise InputError("shows one run, not a campaign", key="--animate", value=str(path), remedy=remedy)
    if runs != 1:
        raise InputError(
            f"shows one run, not {runs}", key="--animate", value=str(path), remedy="name one scenario, drop --runs"
        )
    prepare_folder(check_animation(path).parent, key="--animate")
