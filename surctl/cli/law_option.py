"""Options `--law`, the control law of a command, and `--trust`, for files that name a law of the user's own."""

from __future__ import annotations

import click

__all__ = ["law_option", "law_words", "trust_option"]

law_option = click.option(
    "--law",
    default="guarded",
    metavar="NAME",
    help="Law: guarded (default), paper, closed_form, apf, dwa, vo, cbf; or your own, FILE.py:FUNCTION, which is run.",
)


def law_words(reference: str) -> list[str]:
    """Return the command-line options that select this law, for a suggested command."""
    from surctl.own_code import own_file

    return ["--law", own_file(reference)]


trust_option = click.option("--trust", is_flag=True, help="Run the law of your own that FILE names.")
