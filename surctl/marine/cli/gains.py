"""`surctl gains derive`: write a gain file that follows from a vehicle; lines about its margins and no contact."""

from __future__ import annotations

import shlex
from dataclasses import replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

import click

from surctl.cli.new import write_new
from surctl.cli.options import FILE, FiniteRange, changed, options
from surctl.cli.output import as_json, finish
from surctl.errors import InputError
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import RobotOptions, derive_words, margin_short

_SPEED = FiniteRange(min=0, max=100, min_open=True)


@click.group()
def gains() -> None:
    """Write a gain file: surctl gains derive computes gains from a vehicle.

    Example: surctl gains derive rov.toml --cruise 0.3 --out gains.toml
    """


@gains.command()
@click.argument("vehicle")
@click.option(
    "--cruise", type=_SPEED, metavar="V", help="Cruise speed [m/s] (default: 35 % of the surge speed at full thrust)."
)
@click.option(
    "--margin",
    type=FiniteRange(min=0),
    metavar="D",
    help="Gain `margin`, distance to keep [m] (default: 0.2 hull radii, at least 0.05).",
)
@options(only={"robot": ("barrier",)}, robot=RobotOptions)
@click.option("--out", type=FILE, help="Gain file to write (default: none).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@as_json
def derive(
    robot: RobotOptions, cruise: float | None, margin: float | None, out: Path | None, force: bool, as_json: bool
) -> None:
    """Derive gains for a vehicle, and print the stability margins.

    VEHICLE is the name of a built-in vehicle, or a vehicle file; the gains follow from its mass, drag, thrust, lag and
    hull. If the derived gains miss the required margins at the cruise speed, the exit status is 1, and the output gives
    the largest speed for which derived gains reach them.

    Examples: surctl gains derive bluerov2-wu; surctl gains derive rov.toml --cruise 0.3 --out gains.toml
    """
    vehicle = str(robot.vehicle)  # the argument
    craft = lib.load_vehicle(vehicle)
    try:
        derivation = lib.derive_gains(craft, cruise=lib.default_cruise(craft) if cruise is None else cruise)
    except InputError as error:
        raise error.inside(vehicle, "--cruise" if error.key == "cruise" else None) from None
    if margin is not None:
        gains, provenance = derivation.gains, f"{derivation.gains.provenance}; margin {margin:g} m as stated"
        derivation = replace(derivation, gains=gains.with_values({"margin": margin}, provenance=provenance))
    contact = _contact(craft, derivation, robot.barrier)
    short = margin_short(contact)
    lines = derivation.lines()
    if isinstance(contact, lib.SafetyClaim) and not contact.holds:
        at = f"at up to {contact['speed cap']:.3g} m/s in still water (true positions, barrier {contact.barrier})"
        lines.append(f"  the claim of no contact fails {at}: {contact.shortfall}")
    if derivation.reached and (slow := _slow(craft, derivation)) is not None and slow.short:
        lines.append(f"  {slow.sentence}")
    brief = [line.strip() for line in lines if not line.startswith("  ") or "no contact" in line or "below" in line]
    lines += [f"  {name:<10} {value:8.4g} {derivation.gains.specs[name].unit}" for name, value in derivation.shown()]
    then, file = [], str(out or "gains.toml")
    better = partial(derive_words, vehicle, file=file, barrier=robot.barrier, force=out is not None)
    if not derivation.reached and derivation.bearable > 0:
        then.append(better(derivation.bearable))
    elif isfinite(short):
        then.append(better(derivation.cruise, margin=short))
    if out is not None:
        target = write_new(out, lib.write_gains(derivation.gains, warning=derivation.warning), force=force)
        lines.append(f"wrote {target}")
        chosen = [word for option in changed(robot).items() for word in option]
        words = ["surctl", "verify", *chosen, "--gains", str(target), "--cruise", f"{derivation.cruise:g}"]
        then.append(shlex.join(words))
    data = derivation.to_dict() | {"file": None if out is None else str(out)}
    finish(
        data, lines, as_json=as_json, passed=derivation.reached, then=then, brief=brief,
        files=[] if out is None else [f"gains {out}"],
    )  # fmt: skip


def _slow(vehicle: lib.Vehicle, derivation: lib.Derivation) -> lib.OverSpeeds | None:
    """Return the least margins of the gains from rest to the cruise speed; None for a law that steers."""
    law = lib.default_law(vehicle)
    if not lib.has_cruise_loop(law, "los"):
        return None
    return lib.slow_margins(vehicle, derivation.gains.values, cruise=derivation.cruise, dt=derivation.dt, law=law)


def _contact(vehicle: lib.Vehicle, derived: lib.Derivation, barrier: Any) -> lib.SafetyClaim | lib.Inapplicable | None:
    """Return the no-contact claim of the gains on a straight path in still water; None if it is not about the law."""
    if lib.BARRIER not in lib.law_source(lib.default_law(vehicle)).parts:
        return None
    size = lib.mission_size(vehicle, derived.gains, cruise=derived.cruise)
    mission = lib.straight_mission(vehicle, cruise=derived.cruise, size=size)
    return lib.judged_contact(mission, vehicle, derived.gains, sonar=False, barrier=barrier)
