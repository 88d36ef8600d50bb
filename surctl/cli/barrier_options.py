"""The options that choose the barrier of the guarded law."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["barrier_options"]

barrier_options = together(
    click.option(
        "--barrier",
        default="simple",
        help="Approach bound: simple or inertia.",
    ),
    click.option("--movers", default="predict", help="Moving obstacles: predict or barrier."),
)
"""Give a command the options; it takes them as `barrier` and `movers`."""
