"""Check whether a vehicle can follow the arcs, the changes of depth and the short segments of a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.control import Gains
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.guidance import BEND
from surctl.marine.simulation.finding import Finding
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.steering_fit import planned_radius
from surctl.marine.vehicle import Vehicle

__all__ = ["leg_speeds", "mission_findings"]

Array = NDArray[np.float64]


def leg_speeds(scenario: Scenario) -> Array:
    """Return the speed of the target point on each path segment (n - 1,) [m/s]."""
    speeds = scenario.path.speeds
    if speeds is None:
        return np.full(len(scenario.path.waypoints) - 1, scenario.cruise)
    return np.where(speeds[1:] > 0, speeds[1:], scenario.cruise)


def mission_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Return the findings about arcs, changes of depth and segments shorter than the look-ahead distance."""
    return [*_arcs(scenario, vehicle, gains), *_climb(scenario, vehicle), *_short(scenario, gains)]


def _arcs(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Report the arc that needs most of the yaw rate or of the sway force, if it needs more than there is."""
    kinds, speeds, lengths = scenario.path.kinds, leg_speeds(scenario), scenario.path.lengths
    if kinds is None or not np.any(kinds[1:-1] == BEND):
        return []
    ahead = np.diff(scenario.path.waypoints, axis=0)
    turns = np.diff(np.arctan2(ahead[:, 1], ahead[:, 0]))
    turns = np.abs((turns + np.pi) % (2 * np.pi) - np.pi)
    curvature = np.where(kinds[1:-1] == BEND, turns / ((lengths[1:] + lengths[:-1]) / 2), 0.0)
    speed = np.maximum(speeds[1:], speeds[:-1])
    if vehicle["Fv_max"] > 0:
        return _forced_arcs(scenario, vehicle, curvature, speed)
    # the drift of the hull carries the force towards the centre: the radius of a planned turn counts, as at corners
    tightest = [(v, float(np.max(curvature[speed == v]))) for v in np.unique(speed)]
    results = []
    for v, most in tightest:
        radius, about = planned_radius(vehicle, gains, float(v))
        if most * radius > 1:
            text = (
                f"an arc of radius {1 / most:.2g} m is tighter than {vehicle.name} turns: its {about}, so it "
                "leaves the path; lower the speed or enlarge the radius"
            )
            results.append((most * radius, Finding("warning", "leg.radius_m", text)))
    return [max(results, key=lambda one: one[0])[1]] if results else []


def _forced_arcs(scenario: Scenario, vehicle: Vehicle, curvature: Array, speed: Array) -> list[Finding]:
    results = []
    most = vehicle.at_speed(scenario.cruise).steady_yaw(YAW_SHARE, scenario.cruise)
    k = int(np.argmax(curvature * speed))
    if curvature[k] * speed[k] > most:
        text = (
            f"an arc of radius {1 / curvature[k]:.2g} m at {speed[k]:g} m/s turns at {curvature[k] * speed[k]:.2g} "
            f"rad/s, but {vehicle.name} sustains {most:.2g} rad/s: its hull will lag behind the path"
        )
        results.append(Finding("warning", "leg.radius_m", text))
    # the force towards the centre turns with the hull, which heads along the path: sway thrust
    force = vehicle["m11"] * speed**2 * curvature
    k = int(np.argmax(force))
    if force[k] > vehicle["Fv_max"]:
        text = (
            f"an arc of radius {1 / curvature[k]:.2g} m at {speed[k]:g} m/s needs {force[k]:.2f} N towards its centre, "
            f"but the sway thrust of {vehicle.name} is {vehicle['Fv_max']:g} N"
        )
        results.append(Finding("error", "leg.radius_m", text))
    return results


def _climb(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    rises = scenario.path.rises
    if rises is None or not rises.any():
        return []
    climb = float(np.max(np.abs(np.diff(rises)) / scenario.path.lengths * leg_speeds(scenario)))
    needed = vehicle["Zw"] * climb + vehicle["Zww"] * climb**2
    if needed <= vehicle["Fw_max"]:
        return []
    text = (
        f"a change of depth at {climb:.2g} m/s needs {needed:.2f} N, but the heave thrust of {vehicle.name} is "
        f"{vehicle['Fw_max']:g} N"
    )
    return [Finding("error", "climb_m_per_s", text)]


def _short(scenario: Scenario, gains: Gains) -> list[Finding]:
    """Report corners that are closer together than the look-ahead distance: the law smooths such a path."""
    path = scenario.path
    kinds = path.table(visits=scenario.corners == "visit")[1:-1, 4]
    ahead = np.diff(path.waypoints, axis=0)
    turns = np.diff(np.arctan2(ahead[:, 1], ahead[:, 0]))
    turns = np.abs((turns + np.pi) % (2 * np.pi) - np.pi)
    corner = np.concatenate([[True], (kinds != BEND) & (turns > np.deg2rad(30)), [True]])
    at = np.concatenate([[0.0], np.cumsum(path.lengths)])[corner]
    near = int(np.sum(np.diff(at) < gains["lookahead"]))
    if len(path.waypoints) <= 2 or not near:
        return []
    text = (
        f"{near} of {len(at) - 1} stretches between corners are shorter than the look-ahead distance of "
        f"{gains['lookahead']:g} m: the robot cuts these corners"
    )
    return [Finding("info", "path_m", text)]
