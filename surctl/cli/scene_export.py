"""`surctl export --target mjcf`: write a vehicle in a scenario as a model for MuJoCo."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import click
from click.core import ParameterSource

from surctl.cli.output import finish

__all__ = ["export_scene"]

_APPLY = ("scenario", "vehicle", "target", "out", "as_json")


def export_scene(scenario: str, vehicle: str | None, *, out: Path, as_json: bool) -> None:
    """Write the model and the force of the water to a folder, and end the command.

    Raises:
        InputError: an option concerns the controller, which is not part of the model, or the hull starts inside an
            obstacle.
    """
    from surctl.cli.vehicle_choice import choose_vehicle
    from surctl.errors import InputError
    from surctl.marine.engine import EngineOptions, write_mjcf
    from surctl.marine.simulation import load_scenario
    from surctl.marine.vehicle import load_vehicle

    context = click.get_current_context()
    for parameter in context.command.params:
        typed = context.get_parameter_source(str(parameter.name)) != ParameterSource.DEFAULT
        if typed and parameter.name not in _APPLY:
            remedy = "drop it: the model holds the scenario and the vehicle, without a controller"
            raise InputError("does not apply to --target mjcf", key=parameter.opts[0], remedy=remedy)
    mission = load_scenario(scenario)
    choice = choose_vehicle(vehicle, (mission.name, mission.vehicle))
    robot = load_vehicle(choice.word)
    files = write_mjcf(mission, robot, out)
    hashes = {file.name: sha256(file.read_bytes()).hexdigest() for file in files}
    dof = EngineOptions().of(robot).dof
    lines = [choice.line(robot.name), f"{mission.name}, {dof} degrees of freedom"]
    lines += [f"{hashes[file.name][:12]}  {file}" for file in files]
    result = {"files": [str(file) for file in files], "sha256": hashes, "dof": dof, "vehicle_from": choice.origin}
    finish(result, lines, as_json=as_json, passed=True)
