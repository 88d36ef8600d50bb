"""`surctl lint`: what in a file cannot work."""

from __future__ import annotations

import click

from surctl.cli.output import as_json, finish

__all__ = ["lint"]


@click.command
@click.argument("file")
@click.option("--vehicle", help="Vehicle of a scenario; default: its own.")
@as_json
def lint(file: str, vehicle: str | None, as_json: bool) -> None:
    """Check a file and say what in it cannot work, and why. Exit status 1 when something cannot.

    Examples: surctl lint my-vehicle.toml; surctl lint pool-static --vehicle sur540-flooded
    """
    from surctl.control import load_gains
    from surctl.errors import InputError
    from surctl.files import pick, read_toml
    from surctl.simulation import LIBRARY, findings, load_scenario
    from surctl.study import load_plan
    from surctl.tuning import load_goals
    from surctl.vehicle import load_vehicle

    path = str(pick(file, LIBRARY, what="scenario"))
    kind = read_toml(pick(file, LIBRARY, what="scenario")).get("kind")
    found = []
    if kind == "vehicle":
        load_vehicle(path)
    elif kind == "gains":
        load_gains(path)
    elif kind == "goals":
        load_goals(path)
    elif kind == "scenario":
        scenario = load_scenario(path)
        found = findings(scenario, load_vehicle(vehicle or scenario.vehicle))
    elif kind == "study":
        for leg in load_plan(path).legs:
            found += findings(leg.scenario, leg.vehicle)
    else:
        raise InputError(
            "is not a kind of file",
            file=path,
            key="kind",
            value=kind,
            remedy='write kind = "vehicle", "gains", "goals", "scenario" or "study"',
        )
    lines = [f"{f.level}: {f.key}: {f.text}" for f in found] or [f"{path}: nothing found"]
    result = {"file": path, "kind": kind, "findings": [f.to_dict() for f in found]}
    finish(result, lines, as_json=as_json, passed=all(f.level != "error" for f in found))
