"""`surctl scenario from-plan`: write a scenario file from a QGroundControl plan or a GPX file."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from surctl.cli.new import path_of, write_new
from surctl.cli.options import FILE, FiniteRange
from surctl.cli.output import as_json, finish
from surctl.marine.cli import lib

_SPEED = 0.15  # m/s, if neither the command nor the file gives a speed


@click.group()
def scenario() -> None:
    """Write a scenario file from a mission of another program.

    Example: surctl scenario from-plan survey.plan --vehicle my-robot.toml --cruise 0.3
    """


@scenario.command("from-plan")
@click.argument("plan", type=click.Path(path_type=Path))
@click.option("--name", metavar="TEXT", help="Name of the scenario (default: name of the plan file).")
@click.option(
    "--vehicle", default="sur540-flooded", metavar="FILE", help="Vehicle: name or file (default sur540-flooded)."
)
@click.option(
    "--cruise",
    type=FiniteRange(min=0, min_open=True),
    metavar="X",
    help="Speed along the path [m/s] (default: from the plan).",
)
@click.option(
    "--depth",
    type=FiniteRange(max=0, max_open=True),
    metavar="Z",
    help="Height of the path [m], below the water surface at 0: -0.1 for a boat (default: lowest height in the plan).",
)
@click.option(
    "--margin",
    type=FiniteRange(min=0, min_open=True),
    default=5.0,
    help="Free water on every side of the path [m] (default 5).",
)
@click.option("--out", type=FILE, help="File to write (default NAME.toml).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@as_json
def from_plan(
    plan: Path, name: str | None, cruise: float | None, out: Path | None, force: bool, as_json: bool, **kind: Any
) -> None:
    """Write a scenario file with the path of a QGroundControl plan (.plan) or of a GPX file.

    Latitude and longitude become x east and y north in metres. The site of the scenario is a rectangle around the path.
    The home position of a plan counts as the water surface, height 0. Circles that the geofence of the plan excludes
    become cylinders. The output lists entries of the plan that surctl does not use although these entries change the
    motion, such as hold times. If neither --cruise nor the plan gives a cruise speed, the cruise speed is 0.15 m/s.

    Example: surctl scenario from-plan survey.plan --depth -2 --out survey.toml
    """
    mission = lib.read_mission(plan)
    speed = cruise or mission.speed or _SPEED
    title = name or plan.stem
    if not (cruise or mission.speed):
        mission = replace(mission, notes=(*mission.notes, f"no speed: {_SPEED:g} m/s is assumed (--cruise)"))
    text, notes = lib.mission_scenario(mission, title, cruise=speed, **kind)
    target = write_new(out or path_of(title, ".toml"), text, force=force)
    shown = shlex.quote(str(target))
    lines = [f"{title}: {len(mission.points)} waypoints at {speed:g} m/s", *(f"  note: {note}" for note in notes)]
    result = {"scenario": title, "waypoints": len(mission.points), "notes": list(notes), "file": str(target)}
    finish(
        result,
        [*lines, f"wrote {target}"],
        as_json=as_json,
        passed=True,
        then=[f"surctl lint {shown}", f"surctl simulate {shown}"],
        brief=[lines[0], *(f"note: {note}" for note in notes)],
        files=[f"wrote {target}"],
    )
