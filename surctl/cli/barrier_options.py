"""The options that select the barrier of the guarded law."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["barrier_options", "check_barrier"]

barrier_options = together(
    click.option(
        "--barrier",
        default="simple",
        metavar="NAME",
        help="Bound on approach speed: simple (default) or inertia.",
    ),
    click.option("--movers", default="predict", metavar="NAME", help="Moving obstacles: predict (default) or barrier."),
)
"""A decorator that adds these options to a command; the command receives them as `barrier` and `movers`."""


def check_barrier(barrier: str, movers: str) -> None:
    """Raise InputError if one of the options has an unknown value."""
    from surctl.errors import InputError, nearest
    from surctl.marine.control import BARRIER_NAMES, MOVERS

    for key, value, known in (("barrier", barrier, BARRIER_NAMES), ("movers", movers, MOVERS)):
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(value, known))
