"""Check before the simulation whether a vehicle can carry out a scenario."""

from __future__ import annotations

from math import atan, degrees, inf, pi, tan

import numpy as np

from surctl.errors import InputError
from surctl.marine.control import Gains, load_gains
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.mapping.local_map import MIDDLE, LocalMap
from surctl.marine.simulation.clearance import clearance_findings
from surctl.marine.simulation.detection import detection_range
from surctl.marine.simulation.echo_fit import echo_findings
from surctl.marine.simulation.finding import Finding
from surctl.marine.simulation.mission_fit import mission_findings
from surctl.marine.simulation.motion import motion_findings
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.steering_fit import steering_findings
from surctl.marine.simulation.thruster_fit import thruster_findings
from surctl.marine.simulation.tilting import tilt_findings
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle

__all__ = ["Finding", "findings"]

_SAME_FLOOR = 0.1  # [m] difference between the floor that the law assumes and the site's depth


def findings(scenario: Scenario, vehicle: Vehicle, *, gains: Gains | None = None) -> list[Finding]:
    """Return all findings about a scenario and a vehicle: errors first, then warnings, then notes.

    Args:
        scenario: the mission.
        vehicle: the vehicle of the mission.
        gains: gains of the law, which determine how the vehicle turns and brakes; default: the built-in gains.

    Raises:
        InputError: the hull starts inside a still or moving obstacle.

    Example:
        >>> from surctl.marine.simulation import findings, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> first, *_ = findings(load_scenario("pool-behind"), load_vehicle("sur540-flooded"))
        >>> print(f"{first.level}, {first.key}: {first.text}")
        error, path_m: the 0.27 m hull of sur540-flooded is 0.020 m inside a wall at the target (E15)
    """
    build_world(scenario, vehicle, seed=0)
    gains = gains or load_gains("default")
    results = [*clearance_findings(scenario, vehicle, gains), *motion_findings(scenario, vehicle)]
    results += [*steering_findings(scenario, vehicle, gains), *tilt_findings(scenario, vehicle)]
    results += _sonars(scenario, vehicle, gains) if vehicle["Fv_max"] > 0 else []
    results += [*mission_findings(scenario, vehicle, gains), *thruster_findings(vehicle)]
    return sorted(results, key=lambda f: ("error", "warning", "info").index(f.level))


def _sonars(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    # the law enters only water that its sonars have observed
    try:
        array = scenario.sensors.on(vehicle["radius"]).array
    except InputError as error:
        return [Finding("error", error.key or "sonar", f"on {vehicle.name}: {error.problem}")]
    split = [i for i, cones in enumerate(array.cones) if len(cones) > 1]
    if split:
        text = f"the hull of {vehicle.name} splits the beam of sensor {split[0]}; the map supports one cone per sensor"
        return [Finding("error", "sonar.mounts_m", text)]
    turning = min(gains["spin"], vehicle.steady_yaw(YAW_SHARE, scenario.cruise))
    listed = [*_unseen(array, turning), *_short(scenario, vehicle, gains), *_floor(scenario)]
    return [*listed, *echo_findings(scenario, vehicle, array)]


def _unseen(array: SonarArray, turning: float) -> list[Finding]:
    """Report directions that no sonar beam observes again before the obstacle map forgets them.

    The hull turns at the yaw rate `turning` [rad/s].

    A sonar beam marks grid cells of the map as free only in the middle part of its width (the share `MIDDLE`). After
    the time `LocalMap.memory`, the map forgets that a grid cell is free.
    """
    memory, between = LocalMap(dt=0.05).memory, turning * array.cycle
    least = min(2 * atan(MIDDLE * tan(half)) for cones in array.cones for _, half in cones)
    if between > least:
        text = (
            f"between two firings of a sensor the robot turns {degrees(between):.2g}°, but the middle of its beam, "
            f"which clears the map, is only {degrees(least):.2g}° wide: a turn leaves places ahead unobserved"
        )
        return [Finding("error", "sonar.beam_deg", text)]
    gap = _widest_gap(array)
    wait = gap / turning if turning > 0 else (inf if gap > 0 else 0.0)
    if wait <= memory:
        return []
    text = (
        f"the widest gap between two beams is {degrees(gap):.0f}°; turning at {turning:.2g} rad/s, the robot needs "
        f"{wait:.1f} s to observe it, but the map forgets after {memory:.1f} s, so places ahead stay unknown"
    )
    return [Finding("error", "sonar.azimuths_deg", text)]


def _widest_gap(array: SonarArray) -> float:
    """Return the largest angle [rad] between neighbouring sonar beams far from the hull; 0 without gaps."""
    cones = sorted(
        ((azimuth + offset) % (2 * pi), half)
        for azimuth, parts in zip(array.azimuths, array.cones, strict=True)
        for offset, half in parts
    )
    end, widest = cones[0][0] + cones[0][1], 0.0
    for middle, half in [*cones[1:], (cones[0][0] + 2 * pi, cones[0][1])]:
        widest, end = max(widest, middle - half - end), max(end, middle + half)
    return widest


def _floor(scenario: Scenario) -> list[Finding]:
    floor, depth = scenario.sensors.equipment.floor, scenario.site[2]
    if floor is None or abs(floor - depth) <= _SAME_FLOOR:
        return []
    how = (
        "echoes of the floor mark obstacles"
        if floor > depth
        else "echoes from the range of that floor, or from beyond, mark no obstacle"
    )
    text = f"the law assumes a floor {floor:g} m deep, but the site is {depth:g} m deep: {how}"
    return [Finding("warning", "sonar.floor_m", text)]


def _short(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    # stopping distance v²/(2a) + v t from the largest speed v along the path
    deceleration = gains["brake"] * float(np.min(vehicle.thrust_limit[:2]) / np.max(vehicle.mass[:2]))
    speed = scenario.fastest
    braking = speed**2 / (2 * deceleration) + speed * gains["reaction"]
    detected = detection_range(scenario)
    if detected >= braking:
        return []
    if detected < scenario.sensors.equipment.array.maximum:
        text = (
            f"from {detected:.2g} m the law takes every echo for that of the floor, but from the cruise speed of "
            f"{speed:g} m/s {vehicle.name} needs {braking:.2f} m to stop: it may collide with what it does not mark; "
            "stay higher above the floor, or point the beams less downwards"
        )
        return [Finding("error", "sonar.floor_m", text)]
    ahead = gains["brake"] * vehicle["Fu_max"] / vehicle["m11"]
    stop = speed**2 / (2 * ahead) + speed * gains["reaction"]
    text = (
        f"the sonars reach {detected:g} m; from the cruise speed of {speed:g} m/s {vehicle.name} stops "
        f"within {stop:.2f} m by surge thrust, "
    )
    if stop <= detected:
        text += (
            f"but the law plans with the weaker of surge and sway, {min(vehicle.thrust_limit[:2]):g} N, and needs "
            f"{braking:.2f} m: with sonars the law stays below the cruise speed"
        )
    else:
        text += "which exceeds this range: with sonars the law stays below the cruise speed"
    return [Finding("error", "sonar.maximum_m", text)]
