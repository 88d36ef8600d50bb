"""`surctl gains`: write a gain file that follows from a vehicle."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from surctl.cli.gains_choice import derive_words
from surctl.cli.new import write_new
from surctl.cli.output import FiniteRange, as_json, finish

if TYPE_CHECKING:
    from surctl.marine.tuning import Derivation
    from surctl.marine.vehicle import Vehicle

__all__ = ["gains"]

_SPEED = FiniteRange(min=0, max=100, min_open=True)


@click.group()
def gains() -> None:
    """Write a gain file: derive, gains that follow from a vehicle.

    Example: surctl gains derive rov.toml --cruise 0.3 --out gains.toml
    """


@gains.command()
@click.argument("vehicle")
@click.option(
    "--cruise", type=_SPEED, metavar="V", help="Cruise speed [m/s] (default: 35 % of the speed at full thrust)."
)
@click.option("--out", type=click.Path(path_type=Path), metavar="FILE", help="Gain file to write (default: none).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@as_json
def derive(vehicle: str, cruise: float | None, out: Path | None, force: bool, as_json: bool) -> None:
    """Derive gains from the mass, drag, thrust, lag and hull of a vehicle, and state the margin that they reach.

    VEHICLE is a name or a file. If no gains reach the disk margin at the cruise speed, the largest speed at which
    derived gains reach it is printed. Exit status: 1 if the margin is not reached.

    Examples: surctl gains derive bluerov2-wu; surctl gains derive rov.toml --cruise 0.3 --out gains.toml
    """
    from surctl.errors import InputError
    from surctl.marine.control import write_gains
    from surctl.marine.tuning import default_cruise, derive_gains
    from surctl.marine.vehicle import load_vehicle

    robot = load_vehicle(vehicle)
    try:
        derivation = derive_gains(robot, cruise=default_cruise(robot) if cruise is None else cruise)
    except InputError as error:
        raise error.inside(vehicle, "--cruise" if error.key == "cruise" else None) from None
    lines = [*derivation.lines(), *_contact_line(robot, derivation)]
    lines += [f"  {name:<10} {value:8.4g} {derivation.gains.specs[name].unit}" for name, value in derivation.shown()]
    then = []
    if not derivation.reached and derivation.bearable > 0:
        then.append(derive_words(vehicle, derivation.bearable, "gains.toml"))
    if out is not None:
        target = write_new(out, write_gains(derivation.gains, warning=derivation.warning), force=force)
        lines.append(f"wrote {target}")
        words = ["surctl", "verify", "--vehicle", vehicle, "--gains", str(target)]
        then.append(shlex.join([*words, "--cruise", f"{derivation.cruise:g}"]))
    data = derivation.to_dict() | {"file": None if out is None else str(out)}
    finish(data, lines, as_json=as_json, passed=derivation.reached, then=then)


def _contact_line(vehicle: Vehicle, derivation: Derivation) -> list[str]:
    """Return a line if the no-contact claim needs a larger gain `margin` than the derived one, even in still water."""
    from surctl.marine.assessment.motion import judged_contact
    from surctl.marine.control import CASCADE, default_law, law_source
    from surctl.marine.simulation import mission_size, straight_mission
    from surctl.verification import Inapplicable

    if CASCADE not in law_source(default_law(vehicle)).parts:
        return []
    speeds = {"cruise": derivation.cruise, "size": mission_size(vehicle, derivation.gains, cruise=derivation.cruise)}
    claim = judged_contact(straight_mission(vehicle, **speeds), vehicle, derivation.gains, sonar=False)
    if isinstance(claim, Inapplicable) or claim.holds:
        return []
    return [f"  no contact with obstacles at up to {claim['speed cap']:.3g} m/s in still water: {claim.shortfall}"]
