"""The options that select how the law treats task priorities and infeasible limits."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["priority_options"]

priority_options = together(
    click.option(
        "--priority-mode",
        default="nsb",
        metavar="NAME",
        help="Mode: nsb (default), filter, projected, lexicographic.",
    ),
    click.option(
        "--fallback",
        default="exact",
        metavar="NAME",
        help="If limits conflict: exact (default), or bounded cost.",
    ),
)
"""A decorator that adds these options to a command; the command receives them as `priority_mode` and `fallback`."""
