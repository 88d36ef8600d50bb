"""Convert a scenario to the content of a scenario file."""

from __future__ import annotations

from math import degrees, inf, nextafter, pi
from typing import Any

import numpy as np

from surctl.errors import InputError
from surctl.marine.guidance import Path
from surctl.marine.sensing import BaseStation, Delivery, OwnState, SonarArray
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.sensors import ANGLES, NAMES, Sensors

_BESIDE = 4  # floating-point neighbours on each side that may convert to the same angle


def scenario_table(scenario: Scenario) -> dict[str, Any]:
    """Return the content of a TOML file that describes the scenario, as nested mappings.

    `scenario_from_table` restores the scenario from these mappings, except for the name of its source.
    """
    tables = scenario.reflectors.tables()
    table: dict[str, Any] = {
        "kind": "scenario",
        "name": scenario.name,
        "title": scenario.title,
        "provenance": scenario.provenance,
        "vehicle": scenario.vehicle,
        **_route(scenario),
        "depth_m": scenario.depth,
        "cruise_m_per_s": scenario.cruise,
        "cap_m_per_s": scenario.cap,
        "arrival_m": scenario.arrival_radius,
        "time_limit_s": scenario.time_limit,
        "launch_m": scenario.launch,
        **({} if scenario.depths is None else {"depths_m": list(scenario.depths)}),
        "corners": scenario.corners,
        "site": dict(zip(("length_m", "width_m", "depth_m"), scenario.site, strict=True)) | tables.pop("site"),
        **tables,
        "obstacles": [o.model_dump(exclude_none=True) for o in scenario.obstacles],
        "disturbance": scenario.disturbance.model_dump(),
        **_sensors(scenario.sensors),
        "uncertainty": scenario.uncertainty.model_dump(),
        "paper": scenario.paper.model_dump(exclude_unset=True),
    }
    return table


def _route(scenario: Scenario) -> dict[str, Any]:
    """Return the entries that describe the path: those of the scenario's file if they give this path, or all points."""
    path, route = scenario.path, scenario.route
    if route is not None:
        try:
            same = route.path(depth=scenario.depth, cruise=scenario.cruise, cap=scenario.cap, corners=scenario.corners)
        except InputError:
            same = None
        if same is not None and _equal(same, path):
            return route.model_dump(exclude_none=True, exclude_defaults=True, mode="json")
    if any(column is not None for column in (path.rises, path.speeds, path.kinds)):
        problem = "has speeds, depths or kinds of corners that the scenario's route does not give"
        raise InputError(problem, key="path_m", remedy="describe them by legs in a scenario file")
    return {"path_m": path.waypoints.tolist()}


def _equal(one: Path, other: Path) -> bool:
    for name in ("waypoints", "rises", "speeds", "kinds"):
        a, b = getattr(one, name), getattr(other, name)
        if (a is None) != (b is None) or (a is not None and not np.array_equal(a, b)):
            return False
    return True


def _sensors(sensors: Sensors) -> dict[str, Any]:
    equipment = sensors.equipment
    sonar = _array(equipment.array) | ({"echoes": sensors.echoes} if sensors.echoes else {})
    sonar["floor_m"] = 0.0 if equipment.floor is None else equipment.floor
    if equipment.search_limit is not None:
        sonar["search_limit_s"] = equipment.search_limit
    sonar |= {
        "faults": [fault.model_dump(exclude_none=True) for fault in sensors.faults],
        "chances": sensors.chances.model_dump(),
    }
    return {"sonar": sonar, "base_station": _station(equipment.station), "own_state": _own(equipment.own)}


def _array(array: SonarArray) -> dict[str, Any]:
    angles = {key: getattr(array, name) for key, name in ANGLES.items()}
    table = {key: getattr(array, name) for key, name in NAMES.items()}
    table |= {
        key: [_degrees(one) for one in angle] if isinstance(angle, tuple) else _degrees(angle)
        for key, angle in angles.items()
        if angle is not None
    }
    return {key: value for key, value in table.items() if value is not None}


def _station(station: BaseStation) -> dict[str, Any]:
    table = {"position_sd_m": station.position_sd, "velocity_sd_m_per_s": station.velocity_sd}
    return table | _delivery(station.messages)


def _own(own: OwnState | None) -> dict[str, Any]:
    if own is None:
        return {"truth": True}
    table = {"position_sd_m": own.position_sd, "yaw_sd_rad": own.yaw_sd, "rate_sd_rad_per_s": own.rate_sd}
    return table | _delivery(own.fixes)


def _delivery(delivery: Delivery) -> dict[str, Any]:
    table = {"period_s": delivery.period, "latency_s": delivery.latency, "loss": delivery.loss}
    return table | {"gaps_s": [list(gap) for gap in delivery.gaps]}


def _degrees(angle: float) -> float:
    """Return the angle [rad] in degrees.

    Whoever reads the file and converts the degrees to radians gets exactly this angle, or the nearest possible angle.
    """
    exact = degrees(angle)
    near, low, high = [round(exact, 9), exact], exact, exact
    for _ in range(_BESIDE):
        low, high = nextafter(low, -inf), nextafter(high, inf)
        near += [low, high]
    return min(near, key=lambda candidate: abs(candidate * pi / 180.0 - angle))
