"""Whether the speeds of a scenario can be held."""

from __future__ import annotations

import numpy as np

from surctl.guidance.braking import Watch, brakes_of, fastest_obstacle, range_needed, stopping_way
from surctl.simulation.finding import Finding
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["motion_findings"]


def motion_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Obstacles and currents too fast, thrust too small, time too short."""
    return [
        *_obstacle_speeds(scenario),
        *_braking(scenario, vehicle),
        *_current(scenario),
        *_thrust(scenario, vehicle),
        *_time(scenario),
    ]


def _obstacle_speeds(scenario: Scenario) -> list[Finding]:
    return [
        Finding(
            "warning",
            f"obstacles.{o.name}.speed_m_per_s",
            f"obstacle {o.name!r} at {o.speed_m_per_s:g} m/s is faster than the cap of {scenario.cap:g} m/s: "
            "it cannot be outrun, only sidestepped",
        )
        for o in scenario.obstacles
        if o.speed_m_per_s is not None and o.speed_m_per_s > scenario.cap
    ]


def _braking(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Obstacles that are only evaded: braking, at the worst of the vehicle's ranges, does not keep them off."""
    brakes, found = brakes_of(vehicle), []
    most, sight = fastest_obstacle(brakes), scenario.sensors.equipment.array.maximum
    for o in scenario.obstacles:
        speed = o.speed_m_per_s or 0.0
        needed = range_needed(brakes, Watch(), scenario.cap, obstacle=speed, way=stopping_way)
        if speed <= 0 or needed <= sight:
            continue
        why = f"it takes {needed:.2f} m to stop from the cap before it, and the sonars reach {sight:g} m"
        if speed >= most:
            why = f"braking guarantees nothing before obstacles faster than {most:.3f} m/s"
        text = f"obstacle {o.name!r} at {speed:g} m/s is evaded sideways, not braked for: with {vehicle.name} {why}"
        found.append(Finding("info", f"obstacles.{o.name}.speed_m_per_s", text))
    return found


def _current(scenario: Scenario) -> list[Finding]:
    current = float(np.hypot(*scenario.disturbance.current_m_per_s))
    if current < scenario.cap:
        return []
    text = f"the current of {current:g} m/s is not below the speed cap of {scenario.cap:g} m/s"
    return [Finding("error", "disturbance.current_m_per_s", text)]


def _thrust(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Drag of the cruise speed through the water, heading along the leg or into the stream, whichever is easier."""
    d = scenario.disturbance
    current, weak = np.array(d.current_m_per_s), 1 - d.thrust_error - d.thrust_bias
    worst, told = 0.0, (0.0, 0.0, 0.0)
    for leg in np.diff(scenario.path.waypoints, axis=0):
        ahead = leg / np.linalg.norm(leg)
        through = scenario.cruise * ahead - current
        along, across = float(through @ ahead), float(through[1] * ahead[0] - through[0] * ahead[1])
        speed = float(np.linalg.norm(through))
        surge, sway = (
            (_drag(vehicle, "Xu", abs(u)) + d.drift_force_n, vehicle["Fu_max"] * weak) for u in (speed, along)
        )
        side = (_drag(vehicle, "Yv", abs(across)) + d.drift_force_n, vehicle["Fv_max"] * weak)
        needed, limit = min(surge, max(sway, side, key=_share), key=_share)
        if needed / limit > worst:
            worst, told = needed / limit, (speed, needed, limit)
    if worst <= 1:
        return []
    speed, needed, limit = told
    text = (
        f"to hold the cruise speed of {scenario.cruise:g} m/s against the current {vehicle.name} goes {speed:.3g} m/s "
        f"through the water and needs {needed:.2f} N, and its thrusters give {limit:.2f} N"
    )
    return [Finding("error", "cruise_m_per_s", text)]


def _share(force: tuple[float, float]) -> float:
    return force[0] / force[1]


def _drag(vehicle: Vehicle, axis: str, speed: float) -> float:
    quadratic = axis + axis[-1]
    return vehicle[axis] * speed + vehicle[quadratic] * speed**2


def _time(scenario: Scenario) -> list[Finding]:
    length = scenario.path.length
    least = length / scenario.cruise
    if scenario.time_limit >= least:
        return []
    text = (
        f"the path is {length:.2f} m long and takes {least:.1f} s at the cruise speed of {scenario.cruise:g} m/s; "
        f"the run ends at {scenario.time_limit:g} s"
    )
    return [Finding("error", "time_limit_s", text)]
