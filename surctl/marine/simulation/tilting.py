"""Check whether a vehicle holds its depth against its net buoyancy, and how far its thrust tilts the hull."""

from __future__ import annotations

from math import atan2, degrees, hypot

import numpy as np

from surctl.marine.simulation.finding import Finding
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_tilt

__all__ = ["tilt_findings"]

_WIDE = 15.0  # [deg] tilt above which the sonars' beams leave the depth of the path, and sin² of it costs thrust


def tilt_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings about net buoyancy, stability of roll and pitch, and tilt at cruise and at full thrust."""
    return [*_buoyancy(vehicle), *(_tilt(scenario, vehicle) if vehicle.form.tilts else [])]


def _number(vehicle: Vehicle, name: str) -> float:
    return vehicle[name] if name in vehicle.parameters else 0.0


def _buoyancy(vehicle: Vehicle) -> list[Finding]:
    least, most = vehicle.thrust_range[:, 2]
    up = _number(vehicle, "Z0") + _number(vehicle, "buoyancy") - _number(vehicle, "weight")
    if up == 0 or -most < up < -least:
        return []
    limit = f"the heave thrust reaches {-least if up > 0 else most:g} N"
    text = f"{vehicle.name} {'rises' if up > 0 else 'sinks'}: {abs(up):.3g} N act on it vertically, and {limit}"
    return [Finding("error", "vehicle", f"{text}; ballast it")]


def _tilt(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    # [N m/rad] about the axes of roll and pitch
    righting = vehicle["buoyancy"] * _number(vehicle, "zb") - vehicle["weight"] * _number(vehicle, "zg")
    if righting <= 0:
        text = f"{vehicle.name} capsizes: its centre of gravity is not below its centre of buoyancy"
        return [Finding("error", "vehicle", f"{text} (zg, zb)")]
    height = abs(_number(vehicle, "zt"))
    pull = {"pitch": max(abs(vehicle.thrust_range[:, 0])), "roll": max(abs(vehicle.thrust_range[:, 1]))}
    tilts = {axis: degrees(atan2(force * height, righting)) for axis, force in pull.items()}
    axis = max(tilts, key=lambda name: tilts[name])
    results = []
    if tilts[axis] > _WIDE:
        text = f"full thrust tilts {vehicle.name} by {tilts[axis]:.0f} deg in {axis}, because it acts {height:g} m from"
        remedy = "move the thrusters to the height of the centre, lower the centre of gravity, or limit the thrust"
        results.append(Finding("warning", "vehicle", f"{text} the centre of the hull; {remedy}"))
    tilt = np.asarray(trim_tilt(vehicle.form)(np.array([scenario.cruise, 0, 0, 0]), plant_parameters(vehicle))).ravel()
    steady = degrees(hypot(*tilt[:2]))
    if not steady <= _WIDE:  # also where the vehicle has no trim
        text = f"at the cruise speed of {scenario.cruise:g} m/s {vehicle.name} is tilted by {steady:.0f} deg"
        results.append(Finding("warning", "cruise_m_per_s", text))
    return results
