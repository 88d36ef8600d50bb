"""Check the speeds in a scenario: moving obstacles, current, available thrust, speed cap and time limit."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from surctl.marine.guidance.braking import Watch, brakes_of, fastest_obstacle, range_needed, stopping_distance_with_drag
from surctl.marine.simulation.finding import Finding
from surctl.marine.simulation.mission_fit import leg_speeds
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import WITHIN_LAW, ahead_limit, command_range

__all__ = ["closest", "motion_findings"]

_SAME = 1e-6  # [m] distance of points that are one


def motion_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Return the findings about moving obstacles (collisions, speed), current, thrust, speed cap and time limit."""
    return [
        *_obstacle_speeds(scenario),
        *_meetings(scenario, vehicle),
        *_braking(scenario, vehicle),
        *_current(scenario),
        *_thrust(scenario, vehicle),
        *_cap(scenario, vehicle),
        *_time(scenario),
    ]


def _obstacle_speeds(scenario: Scenario) -> list[Finding]:
    return [
        Finding(
            "warning",
            f"obstacles.{o.name}.speed_m_per_s",
            f"obstacle {o.name!r} at {o.speed_m_per_s:g} m/s is faster than the cap of {scenario.cap:g} m/s: "
            "the robot can evade it only sideways",
        )
        for o in scenario.obstacles
        if o.speed_m_per_s is not None and o.speed_m_per_s > scenario.cap
    ]


def _meetings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    results = []
    for a, b in combinations([o for o in scenario.obstacles if o.shape == "moving"], 2):
        apart = closest(a, b, until=scenario.time_limit) - sum(o.radius_m or vehicle["radius"] for o in (a, b))
        if apart < 0:
            text = f"obstacles {a.name!r} and {b.name!r} collide with each other: they overlap by {-apart:.2f} m"
            results.append(Finding("error", f"obstacles.{b.name}.to_m", text))
    return results


def closest(a: Obstacle, b: Obstacle, *, until: float) -> float:
    """Return the smallest distance [m] between the centres of two moving obstacles up to the given time [s].

    Each of the two obstacles moves along a straight line at its constant speed. At the end of its line, the obstacle
    stays, or it leaves the water if it is `removed`. The distance is inf if the two obstacles are never in the water
    together.
    """
    ends = [_arrival(o) for o in (a, b)]
    last = min([until, *(end for end, o in zip(ends, (a, b), strict=True) if o.removed)])
    times = sorted({0.0, last, *(end for end in ends if end < last)})
    least = inf
    for start, end in pairwise(times):
        first, then = (_at(a, t) - _at(b, t) for t in (start, end))
        step = then - first
        share = float(np.clip(-float(first @ step) / max(float(step @ step), 1e-12), 0, 1))
        least = min(least, float(np.hypot(*(first + share * step))))
    return least


def _arrival(obstacle: Obstacle) -> float:
    # inf if the obstacle does not move
    distance = float(np.hypot(*np.subtract(obstacle.to_m or obstacle.centre_m, obstacle.centre_m)))
    return distance / obstacle.speed_m_per_s if obstacle.speed_m_per_s else inf


def _at(obstacle: Obstacle, time: float) -> NDArray[np.float64]:
    start, end = (np.asarray(place) for place in (obstacle.centre_m, obstacle.to_m or obstacle.centre_m))
    arrival = _arrival(obstacle)
    return np.asarray(start + (end - start) * (min(time / arrival, 1.0) if 0 < arrival < inf else 0.0))


def _braking(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    # by braking alone, at the worst values of the vehicle's ranges
    brakes, results = brakes_of(vehicle), []
    most, sight = fastest_obstacle(brakes), scenario.sensors.equipment.array.maximum
    for o in scenario.obstacles:
        speed = o.speed_m_per_s or 0.0
        needed = range_needed(brakes, Watch(), scenario.cap, obstacle=speed, stopping=stopping_distance_with_drag)
        if speed <= 0 or needed <= sight:
            continue
        why = f"stopping before it from the speed cap takes {needed:.2f} m, but the sonars reach {sight:g} m"
        if speed >= most:
            why = f"braking guarantees nothing against obstacles faster than {most:.3f} m/s"
        text = f"braking cannot avoid obstacle {o.name!r} at {speed:g} m/s: evasion must; with {vehicle.name} {why}"
        results.append(Finding("info", f"obstacles.{o.name}.speed_m_per_s", text))
    return results


def _current(scenario: Scenario) -> list[Finding]:
    current = float(np.hypot(*scenario.disturbance.current_m_per_s))
    if current < scenario.cap:
        return []
    text = f"the current of {current:g} m/s is not below the speed cap of {scenario.cap:g} m/s"
    return [Finding("error", "disturbance.current_m_per_s", text)]


def _thrust(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Report a thrust below the drag at cruise speed.

    The check takes the heading with less drag: along the path segment or into the current.
    """
    d = scenario.disturbance
    current, weak = np.array(d.current_m_per_s), 1 - d.thrust_error - d.thrust_bias
    worst, figures, worst_leg = 0.0, (0.0, 0.0, 0.0, 0.0), 0
    ahead_most, aside_most = weak * ahead_limit(vehicle), weak * float(vehicle.thrust_limit[1])
    legs = np.diff(scenario.path.waypoints, axis=0)
    for k, (leg, cruise) in enumerate(zip(legs, leg_speeds(scenario).tolist(), strict=True)):
        ahead = leg / np.linalg.norm(leg)
        through = cruise * ahead - current
        along, across = float(through @ ahead), float(through[1] * ahead[0] - through[0] * ahead[1])
        speed = float(np.linalg.norm(through))
        surge, sway = ((_drag(vehicle, "Xu", abs(u)) + d.drift_force_n, ahead_most) for u in (speed, along))
        side = (_drag(vehicle, "Yv", abs(across)) + d.drift_force_n, aside_most)
        # a craft without sway force always heads into the water that it moves through
        aside = vehicle["Fv_max"] > 0
        needed, limit = min(surge, max(sway, side, key=_share), key=_share) if aside else surge
        if needed / limit > worst:
            worst, figures, worst_leg = needed / limit, (cruise, speed, needed, limit), k
    if worst <= 1:
        return []
    cruise, speed, needed, limit = figures
    key = _speed_key(scenario, worst_leg)
    of = "the cruise speed" if key == "cruise_m_per_s" else "this leg's speed"
    text = (
        f"at {of} of {cruise:g} m/s {vehicle.name} moves at {speed:.3g} m/s through the water and "
        f"needs {needed:.2f} N, but its thrusters deliver {limit:.2f} N"
    )
    if needed < vehicle["Fu_max"] * weak and limit < vehicle["Fu_max"] * weak:
        text = (
            f"at {of} of {cruise:g} m/s {vehicle.name} needs {needed:.3g} N ahead; the law gives at most "
            f"{limit:.3g} N, the smaller of ahead and astern; {WITHIN_LAW}"
        )
    return [Finding("error", key, text)]


def _speed_key(scenario: Scenario, segment: int) -> str:
    """Return the key of the scenario file that states the speed of a segment of the path."""
    route, points = scenario.route, scenario.path.waypoints
    if route is None or scenario.path.speeds is None or not scenario.path.speeds[segment + 1] > 0:
        return "cruise_m_per_s"
    end = max(len(route.path_m) - 1, 0)
    for k, leg in enumerate(route.leg):
        end += 1 + int(np.argmin(np.hypot(*(points[end + 1 :] - leg.to_m).T) > _SAME))
        if segment < end:
            return f"leg.{k}.speed_m_per_s"
    return "survey.speed_m_per_s"


def _cap(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    ahead, most = vehicle.thrust_range[1], command_range(vehicle)[1]
    axes = {"surge": ("Xu", 0), "sway": ("Yv", 1)}
    held = {axis: _held(vehicle, drag, float(most[k])) for axis, (drag, k) in axes.items() if ahead[k] > 0}
    if scenario.cap <= min(held.values()):
        return []
    speeds = " and ".join(f"{speed:.3g} m/s in {axis}" for axis, speed in held.items())
    text = f"the cap of {scenario.cap:g} m/s is above the speeds that {vehicle.name} can hold by thrust: {speeds}"
    return [Finding("warning", "cap_m_per_s", text)]


def _held(vehicle: Vehicle, axis: str, most: float) -> float:
    # speed [m/s] at which the drag equals the largest thrust
    linear, quadratic = vehicle[axis], vehicle[axis + axis[-1]]
    root = linear + sqrt(linear**2 + 4 * quadratic * most)
    return 2 * most / root if root > 0 else inf


def _share(force: tuple[float, float]) -> float:
    return force[0] / force[1]


def _drag(vehicle: Vehicle, axis: str, speed: float) -> float:
    quadratic = axis + axis[-1]
    return vehicle[axis] * speed + vehicle[quadratic] * speed**2


def _time(scenario: Scenario) -> list[Finding]:
    length, least = scenario.path.length, scenario.duration
    if scenario.time_limit >= least:
        return []
    text = (
        f"the path is {length:.2f} m long and takes {least:.1f} s at the cruise speed of {scenario.cruise:g} m/s"
        f"{' and the speeds of its legs' if scenario.path.speeds is not None else ''}; "
        f"the run ends at {scenario.time_limit:g} s"
    )
    return [Finding("error", "time_limit_s", text)]
