"""Options `--law`, which selects the control law, and `--trust`, which permits a file to load a law of the user."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from surctl.marine.vehicle import Vehicle

__all__ = ["choose_law", "law_option", "law_words", "trust_option"]

law_option = click.option(
    "--law",
    metavar="NAME",
    help="guarded, calm, steered, paper, closed_form, apf, dwa, vo, cbf, FILE.py:FUNCTION (default: the vehicle's).",
)


def choose_law(law: str | None, vehicles: Sequence[Vehicle]) -> tuple[str, list[str]]:
    """Return the reference of the law for the vehicles, and a line that says why, unless it is the usual default.

    Args:
        law: value of the option `--law`; None: the law that the forces of the vehicles allow.
        vehicles: all vehicles of the command.

    Raises:
        InputError: the law is unknown, a vehicle lacks a force that it needs, or the vehicles need different laws.
    """
    from surctl.errors import InputError
    from surctl.marine.control import LAW_NAMES, check_forces, default_law, law_ref

    if law is not None:
        reference = law_ref(law, key="--law")
        for vehicle in vehicles:
            check_forces(reference, vehicle, key="--law")
        return reference, []
    chosen = {default_law(vehicle): vehicle.name for vehicle in vehicles}
    if len(chosen) > 1:
        names = " and ".join(f"{name} for {vehicle}" for name, vehicle in chosen.items())
        raise InputError(f"the vehicles need different laws, {names}", key="--law", remedy="run them one by one")
    reference, name = next(iter(chosen.items()), (LAW_NAMES[0], ""))
    if reference == LAW_NAMES[0]:
        return reference, []
    return reference, [f"law {reference}, because {name} has no sway force (Fv_max = 0)"]


def law_words(reference: str) -> list[str]:
    """Return the command-line options that select this law, for a suggested command."""
    from surctl.own_code import own_file

    return ["--law", own_file(reference)]


trust_option = click.option("--trust", is_flag=True, help="Run the law of your own that FILE names.")
