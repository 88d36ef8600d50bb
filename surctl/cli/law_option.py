"""Options `--law`, the control law of a command, and `--trust`, for files that name a law of the user's own."""

from __future__ import annotations

import click

__all__ = ["law_option", "trust_option"]

law_option = click.option(
    "--law",
    default="guarded",
    metavar="NAME",
    help="Law: guarded (default), paper, closed_form, apf, dwa, vo, cbf; or your own, FILE.py:FUNCTION, which is run.",
)

trust_option = click.option("--trust", is_flag=True, help="Run the law of your own that FILE names.")
