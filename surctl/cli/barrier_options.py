"""The options that select the barrier of the guarded law."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["barrier_options"]

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
