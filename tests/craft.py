"""Four craft without sway force, with numbers from the literature, and missions scaled to them.

The numbers fit the diagonal model of this toolkit: terms of the published models that depend on the forward speed are
taken at the cruise speed, and coupled terms are left out.
"""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np

from surctl.marine.simulation import Scenario
from surctl.marine.simulation.scenario import LIBRARY, scenario_from_table
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.parameters import PARAMETERS, vehicle_from_table

CRUISE = {"otter": 0.77, "remus": 0.87, "lauv": 0.64, "a9": 0.79}
"""Cruise speed [m/s] of each craft."""

_NUMBERS: dict[str, dict[str, float]] = {
    # Fossen, MSS and PythonVehicleSimulator: 24.4 kgf ahead at 6 kn, 13.6 kgf astern, T_yaw = 1 s; lag chosen
    "otter": {
        "radius": 1.1,
        "mass": (60.5, 137.5, 110.0, 41.4),
        "linear": (77.6, 137.5, 100.0, 41.4),
        "quadratic": (0.0, 240.0, 0.0, 414.0),
        "thrust": (133.0, 0.0, 0.0, 50.0),
        "lag": 0.3,
    },
    # Prestero 2001: Xuu, Yvv, Nrr, Yuv, Nur; rudder at 30 degrees; propeller at 1525 rpm after Allen et al. 2000
    "remus": {
        "radius": 0.8,
        "mass": (31.4, 66.0, 66.0, 8.3),
        "linear": (0.0, 24.9, 24.9, 1.7),
        "quadratic": (3.9, 1310.0, 131.0, 94.0),
        "thrust": (40.0, 0.0, 0.0, 2.4),
        "lag": 0.3,
    },
    # da Silva et al. 2007
    "lauv": {
        "radius": 0.6,
        "mass": (19.0, 34.0, 34.0, 3.5),
        "linear": (2.4, 23.0, 23.0, 9.7),
        "quadratic": (2.4, 80.0, 80.0, 9.1),
        "thrust": (14.0, 0.0, 0.0, 2.0),
        "lag": 0.3,
    },
    # uuvsimulator/eca_a9: damping per forward speed 8, 162, 108, 32; thruster and fins chosen
    "a9": {
        "radius": 1.0,
        "mass": (74.0, 165.0, 145.0, 67.0),
        "linear": (6.3, 128.0, 85.0, 25.0),
        "quadratic": (0.0, 0.0, 0.0, 0.0),
        "thrust": (40.0, 0.0, 0.0, 15.0),
        "lag": 0.3,
    },
}
_TABLES = {
    "mass": ("m11", "m22", "m33", "m44"),
    "linear": ("Xu", "Yv", "Zw", "Nr"),
    "quadratic": ("Xuu", "Yvv", "Zww", "Nrr"),
    "thrust": ("Fu_max", "Fv_max", "Fw_max", "Fr_max"),
}


def craft(name: str, **changed: float) -> Vehicle:
    """Return a craft by name; `changed` replaces parameters by name."""
    numbers = _NUMBERS[name]
    values = {"radius": numbers["radius"], "thrust_lag": numbers["lag"]}
    for table, names in _TABLES.items():
        values |= dict(zip(names, numbers[table], strict=True))
    table: dict[str, Any] = {"kind": "vehicle", "name": name}
    for key, value in (values | changed).items():
        spec = PARAMETERS[key]
        section = table.setdefault(spec.table, {"provenance": "literature, see tests/craft.py"})
        section[key] = {"value": value, "unit": spec.unit}
    return vehicle_from_table(table, source=f"{name}.toml")


def table(path: list[list[float]], name: str, *, size: tuple[float, float], time: float, **more: Any) -> dict[str, Any]:
    """Return the table of a mission without obstacles, at the cruise speed of a craft."""
    return {
        "kind": "scenario",
        "name": "test",
        "title": "test",
        "provenance": "test",
        "vehicle": "sur400",
        "path_m": path,
        "depth_m": -2.0,
        "cruise_m_per_s": CRUISE[name],
        "cap_m_per_s": 1.1 * CRUISE[name],
        "arrival_m": 1.0,
        "time_limit_s": time,
        "site": {"length_m": size[0], "width_m": size[1], "depth_m": 5.0},
    } | more


def mission(path: list[list[float]], name: str, *, size: tuple[float, float], time: float, **more: Any) -> Scenario:
    """Return the mission of `table`."""
    return scenario_from_table(table(path, name, size=size, time=time, **more), source="test.toml")


def factor(vehicle: Vehicle, radius: float) -> float:
    """Return the factor between lengths of the library's missions and lengths for a craft.

    It is the larger of two ratios: hull radius over the 0.27 m of the vehicle of `tank-static`, and turning radius
    `radius` [m] over the 0.44 m on which that vehicle turns at its cruise speed of 0.2 m/s and spin rate of 0.45 rad/s.
    """
    return max(vehicle["radius"] / 0.27, radius / 0.44)


def scaled(library: str, factor: float, name: str) -> Scenario:
    """Return a mission of the library with all lengths times `factor`, at the cruise speed of a craft."""
    table = tomllib.loads((LIBRARY / f"{library}.toml").read_text())
    ratio = CRUISE[name] / table["cruise_m_per_s"]
    table["path_m"] = (factor * np.array(table["path_m"])).tolist()
    table["site"] = {key: factor * value for key, value in table["site"].items()}
    table["depth_m"] *= factor
    table["launch_m"] *= factor
    table["arrival_m"] = 0.1 * factor
    table["cruise_m_per_s"] = CRUISE[name]
    table["cap_m_per_s"] *= ratio
    table["time_limit_s"] *= 2 * factor / ratio
    for obstacle in table["obstacles"]:
        for key in ("centre_m", "size_m", "to_m"):
            if key in obstacle:
                obstacle[key] = [factor * value for value in obstacle[key]]
        for key in ("radius_m",):
            if key in obstacle:
                obstacle[key] *= factor
        if "speed_m_per_s" in obstacle:
            obstacle["speed_m_per_s"] *= ratio
    table.pop("paper", None)
    return scenario_from_table(table, source=f"{library}.toml")
