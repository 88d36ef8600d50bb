"""Write a vehicle file."""

from __future__ import annotations

from surctl.files import quoted
from surctl.marine.vehicle.parameters import Vehicle
from surctl.marine.vehicle.specs import PARAMETERS, TERMS
from surctl.marine.vehicle.thruster_file import thruster_text

__all__ = ["write_vehicle"]


def write_vehicle(vehicle: Vehicle) -> str:
    """Return the text of a vehicle file from which the vehicle's numbers, ranges and provenances can be read again.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle import load_vehicle, write_vehicle
        >>> heavier = load_vehicle("sur400").with_values({"m11": 60.0})
        >>> _ = Path("heavier.toml").write_text(write_vehicle(heavier))
        >>> load_vehicle("heavier.toml")["m11"]
        60.0
    """
    lines = ['kind = "vehicle"', f"name = {quoted(vehicle.name)}", f"note = {quoted(vehicle.note)}"]
    specs = {name: spec for name, spec in (*PARAMETERS.items(), *TERMS.items()) if name in vehicle.parameters}
    for table in dict.fromkeys(spec.table for spec in specs.values()):
        lines += ["", f"[{table}]"]
        for name, spec in specs.items():
            if spec.table != table:
                continue
            known = vehicle.parameters[name]
            bounds = f", range = [{known.range[0]!r}, {known.range[1]!r}]" if known.range is not None else ""
            lines += [
                f"# {spec.meaning}",
                f'{name} = {{ value = {known.value!r}, unit = "{known.unit}"{bounds}, '
                f"provenance = {quoted(known.provenance)} }}",
            ]
    return "\n".join([*lines, *thruster_text(vehicle.actuators)]) + "\n"
