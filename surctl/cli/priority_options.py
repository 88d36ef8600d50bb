"""The options that choose how the law keeps limits."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["priority_options"]

priority_options = together(
    click.option("--priority-mode", default="nsb", help="nsb, filter, projected or lexicographic."),
    click.option(
        "--fallback",
        default="exact",
        help="Infeasible limits: exact or bounded solution.",
    ),
)
"""Give a command the options; it takes them as `priority_mode` and `fallback`."""
