"""The options that choose how the law keeps limits."""

from __future__ import annotations

import click

from surctl.cli.output import together

__all__ = ["priority_options"]

priority_options = together(
    click.option(
        "--priority-mode", default="nsb", help="nsb, or one that keeps limits: filter, projected, lexicographic."
    ),
    click.option(
        "--ladder",
        default="exact",
        help="Where limits and task 1 cannot all be kept, in modes filter and projected: the best answer (exact), or a "
        "safe one within a bounded number of instructions (bounded).",
    ),
)
"""Give a command the options; it takes them as `priority_mode` and `ladder`."""
