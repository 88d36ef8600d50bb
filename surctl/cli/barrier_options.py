"""The options that choose the barrier of the guarded law."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["barrier_options"]

barrier_options = together(
    click.option(
        "--barrier",
        default="simple",
        help="How law guarded bounds its approach: simple, s^2/(2a) + s t, or inertia, for the worst of the ranges.",
    ),
    click.option("--movers", default="predict", help="What moves is evaded (predict), or braked for (barrier)."),
)
"""Give a command the options; it takes them as `barrier` and `movers`."""
