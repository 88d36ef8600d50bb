"""Findings of `lint` on motion: speeds, cap, current, thrust, arcs, corners, turning circle, depths, time limit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, pairwise
from math import acos, ceil, degrees, floor, inf, log10, tan

import numpy as np
from numpy.typing import NDArray

from surctl.errors import Finding
from surctl.marine.control import Gains, default_law, law_source
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.control.steering import turning_radius
from surctl.marine.guidance import BEND
from surctl.marine.guidance.braking import Watch, brakes_of, fastest_obstacle, range_needed, stopping_distance_with_drag
from surctl.marine.simulation.clearance import tightest_gap
from surctl.marine.simulation.obstacle import Obstacle
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle, steady_speed
from surctl.marine.vehicle.linearise import WITHIN_LAW, ahead_limit, command_range

_REVERSAL = 2.4  # [rad] largest change of direction (137°) that counts as a corner; beyond it the path turns back
_PASSES = 0.03  # of the turning radius: how near a craft with fins passes its target (study 31)


def planned_radius(vehicle: Vehicle, gains: Gains, speed: float) -> tuple[float, str]:
    """Return the radius [m] of the tightest turn that the law plans at a speed [m/s], and a text of what it is.

    The hull can turn more tightly: the gain `sideslip` limits the drift angle of a planned turn.
    """
    values = gains.with_own(law_source(default_law(vehicle)).gains).values
    radius = turning_radius(vehicle, values, speed)
    with_gain = f"(gain sideslip = {values['sideslip']:g} rad)"
    return radius, f"planned turning radius at {speed:g} m/s is {radius:.2g} m {with_gain}"


def steering_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> Iterator[Finding]:
    """Yield the findings about turning, holding a place and depth; none for a vehicle that has all four forces."""
    if vehicle["Fw_max"] <= 0 and scenario.depths is not None:
        text = f"{vehicle.name} has no heave force (Fw_max = 0), so it cannot leave the path's depth; remove depths_m"
        yield Finding("error", "depths_m", text)
    if vehicle["Fv_max"] > 0:
        return
    radius, about = planned_radius(vehicle, gains, scenario.cruise)
    at_rest = vehicle.fin_share(scenario.cruise) * 100
    text = (
        f"{vehicle.name} has no sway force (Fv_max = 0): law {default_law(vehicle)} steers it by heading and speed, "
        f"from obstacle positions, without sonars; its {about}"
    )
    if at_rest > 0:
        text += f"; rudders or fins give {at_rest:.0f} % of its yaw moment, and nothing at rest"
    yield Finding("info", "vehicle", text)
    yield from _corners(scenario, radius)
    yield from _turning_circle(scenario, vehicle, radius)
    yield from _arrival_findings(scenario, vehicle, radius)
    d = scenario.disturbance
    if scenario.visit and (np.hypot(*d.current_m_per_s) > 0 or d.drift_force_n > 0):
        text = f"{vehicle.name} has no sway force, so a current or a drift force moves it away from a corner to visit"
        yield Finding("warning", "corners", text)


def _corners(scenario: Scenario, radius: float) -> Iterator[Finding]:
    """Report the worst reversal, and the worst corner whose wheel-over distance R tan(α/2) exceeds half a leg."""
    reversals, sharp = [], []
    points, legs = scenario.path.waypoints[1:-1], np.diff(scenario.path.waypoints, axis=0)
    bends = np.zeros(len(points)) if scenario.path.kinds is None else scenario.path.kinds[1:-1]
    for (before, after), corner, bend in zip(pairwise(legs), points, bends, strict=True):
        if bend == BEND:  # of an arc, which `mission_findings` judges
            continue
        lengths = float(np.linalg.norm(before)), float(np.linalg.norm(after))
        turn = acos(float(np.clip(before @ after / (lengths[0] * lengths[1]), -1, 1)))
        where = f"corner ({corner[0]:g}, {corner[1]:g})"
        if turn > _REVERSAL:
            text = f"at {where} the path turns by {degrees(turn):.0f}°: the craft leaves it by up to {2 * radius:.2g} m"
            reversals.append((turn, text))
            continue
        wheel_over, half = radius * tan(turn / 2), min(lengths) / 2
        if wheel_over > half and not scenario.visit:
            text = (
                f"{where} turns by {degrees(turn):.0f}°, so the turn must begin {wheel_over:.2g} m before it, but half "
                f"of the shorter leg is {half:.2g} m: it leaves the path; lower cruise_m_per_s or lengthen the leg"
            )
            sharp.append((wheel_over - half, text))
    for listed, others in ((reversals, "also turn back"), (sharp, "are also too sharp")):
        if listed:
            more = f" (the worst; {len(listed) - 1} other corners {others})" if len(listed) > 1 else ""
            yield Finding("warning", "path_m", max(listed)[1] + more)


def _turning_circle(scenario: Scenario, vehicle: Vehicle, radius: float) -> Iterator[Finding]:
    needed, hull = 2 * radius, vehicle["radius"]
    width = min(scenario.site[:2]) - 2 * hull
    if width < needed:
        text = (
            f"the site leaves {width:.2g} m for the centre of {vehicle.name}, less than its planned turning circle of "
            f"{needed:.2g} m at the cruise speed: it must slow down to turn round; lower cruise_m_per_s"
        )
        yield Finding("warning", "site", text)
    gap = tightest_gap(scenario, hull + radius)
    if gap is not None and 0 < gap.always - 2 * hull < needed:
        text = (
            f"the passage between {gap.between[0]} and {gap.between[1]} leaves {gap.always - 2 * hull:.2g} m for the "
            f"centre of {vehicle.name}, less than its planned turning circle of {needed:.2g} m at the cruise speed: "
            "it cannot turn back there without slowing down"
        )
        yield Finding("info", "obstacles", text)


def _arrival_findings(scenario: Scenario, vehicle: Vehicle, radius: float) -> Iterator[Finding]:
    if vehicle.fin_share(scenario.cruise) < 0.5 or not scenario.arrival_radius < _PASSES * radius < inf:
        return
    needed = _rounded_up(_PASSES * radius)
    text = (
        f"{vehicle.name} steers by rudders or fins and passes its target at speed, to within about {needed:g} m, "
        f"{100 * _PASSES:g} % of its planned turning radius: in {scenario.arrival_radius:g} m it may turn round "
        f"several times; set arrival_m = {needed:g}"
    )
    yield Finding("warning", "arrival_m", text)


def _rounded_up(value: float) -> float:
    # to two digits
    step = 10.0 ** (floor(log10(value)) - 1)
    return float(f"{ceil(value / step) * step:.2g}")


Array = NDArray[np.float64]


def _leg_speeds(scenario: Scenario) -> Array:
    """Return the speed of the target point on each path segment (n - 1,) [m/s]."""
    speeds = scenario.path.speeds
    if speeds is None:
        return np.full(len(scenario.path.waypoints) - 1, scenario.cruise)
    return np.where(speeds[1:] > 0, speeds[1:], scenario.cruise)


def mission_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Return the findings about arcs, changes of depth and segments shorter than the look-ahead distance."""
    return [*_arcs(scenario, vehicle, gains), *_climb(scenario, vehicle), *_short(scenario, gains)]


def _arcs(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> Iterator[Finding]:
    """Report the arc that needs most of the yaw rate or of the sway force, if it needs more than there is."""
    kinds, speeds, lengths = scenario.path.kinds, _leg_speeds(scenario), scenario.path.lengths
    if kinds is None or not np.any(kinds[1:-1] == BEND):
        return
    curvature = np.where(kinds[1:-1] == BEND, scenario.turns / ((lengths[1:] + lengths[:-1]) / 2), 0.0)
    speed = np.maximum(speeds[1:], speeds[:-1])
    if vehicle["Fv_max"] > 0:
        yield from _forced_arcs(scenario, vehicle, curvature, speed)
        return
    # the drift of the hull carries the force towards the centre: the radius of a planned turn counts, as at corners
    tightest = [(v, float(np.max(curvature[speed == v]))) for v in np.unique(speed)]
    tight = []
    for v, most in tightest:
        radius, about = planned_radius(vehicle, gains, float(v))
        if most * radius > 1:
            text = (
                f"an arc of radius {1 / most:.2g} m is tighter than {vehicle.name} turns: its {about}, so it "
                "leaves the path; lower the speed or enlarge the radius"
            )
            tight.append((most * radius, text))
    if tight:
        yield Finding("warning", "leg.radius_m", max(tight, key=lambda one: one[0])[1])


def _forced_arcs(scenario: Scenario, vehicle: Vehicle, curvature: Array, speed: Array) -> Iterator[Finding]:
    most = vehicle.at_speed(scenario.cruise).steady_yaw(YAW_SHARE, scenario.cruise)
    k = int(np.argmax(curvature * speed))
    if curvature[k] * speed[k] > most:
        text = (
            f"an arc of radius {1 / curvature[k]:.2g} m at {speed[k]:g} m/s turns at {curvature[k] * speed[k]:.2g} "
            f"rad/s, but {vehicle.name} sustains {most:.2g} rad/s: its hull will lag behind the path"
        )
        yield Finding("warning", "leg.radius_m", text)
    # the force towards the centre turns with the hull, which heads along the path: sway thrust
    force = vehicle["m11"] * speed**2 * curvature
    k = int(np.argmax(force))
    if force[k] > vehicle["Fv_max"]:
        text = (
            f"an arc of radius {1 / curvature[k]:.2g} m at {speed[k]:g} m/s needs {force[k]:.2f} N towards its centre, "
            f"but the sway thrust of {vehicle.name} is {vehicle['Fv_max']:g} N"
        )
        yield Finding("error", "leg.radius_m", text)


def _climb(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    rises = scenario.path.rises
    if rises is None or not rises.any():
        return
    climb = float(np.max(np.abs(np.diff(rises)) / scenario.path.lengths * _leg_speeds(scenario)))
    needed = vehicle["Zw"] * climb + vehicle["Zww"] * climb**2
    if needed <= vehicle["Fw_max"]:
        return
    text = (
        f"a change of depth at {climb:.2g} m/s needs {needed:.2f} N, but the heave thrust of {vehicle.name} is "
        f"{vehicle['Fw_max']:g} N"
    )
    yield Finding("error", "climb_m_per_s", text)


def _short(scenario: Scenario, gains: Gains) -> Iterator[Finding]:
    """Report corners that are closer together than the look-ahead distance: the law smooths such a path."""
    path = scenario.path
    kinds = path.table(visits=scenario.corners == "visit")[1:-1, 4]
    corner = np.concatenate([[True], (kinds != BEND) & (scenario.turns > np.deg2rad(30)), [True]])
    at = np.concatenate([[0.0], np.cumsum(path.lengths)])[corner]
    near = int(np.sum(np.diff(at) < gains["lookahead"]))
    if len(path.waypoints) <= 2 or not near:
        return
    text = (
        f"{near} of {len(at) - 1} stretches between corners are shorter than the look-ahead distance of "
        f"{gains['lookahead']:g} m: the robot cuts these corners"
    )
    yield Finding("info", "path_m", text)


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


def _obstacle_speeds(scenario: Scenario) -> Iterator[Finding]:
    for o in scenario.obstacles:
        if o.speed_m_per_s is not None and o.speed_m_per_s > scenario.cap:
            text = f"obstacle {o.name!r} at {o.speed_m_per_s:g} m/s is faster than the cap of {scenario.cap:g} m/s"
            text += ": the robot can evade it only sideways"
            yield Finding("warning", f"obstacles.{o.name}.speed_m_per_s", text)


def _meetings(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    for a, b in combinations([o for o in scenario.obstacles if o.shape == "moving"], 2):
        apart = closest(a, b, until=scenario.time_limit) - sum(o.radius_m or vehicle["radius"] for o in (a, b))
        if apart < 0:
            text = f"obstacles {a.name!r} and {b.name!r} collide with each other: they overlap by {-apart:.2f} m"
            yield Finding("error", f"obstacles.{b.name}.to_m", text)


def closest(a: Obstacle, b: Obstacle, *, until: float) -> float:
    """Return the smallest distance [m] between the centres of two moving obstacles up to the given time [s].

    Each moves along a straight line at constant speed; at its end it stays, or leaves the water if it is `removed`. The
    distance is inf if the two are never in the water together.
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


def _braking(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    # by braking alone, at the worst values of the vehicle's ranges
    brakes = brakes_of(vehicle)
    most, sight = fastest_obstacle(brakes), scenario.sensors.equipment.array.maximum
    for o in scenario.obstacles:
        speed = o.speed_m_per_s or 0.0
        needed = range_needed(brakes, Watch(), scenario.cap, obstacle=speed, stopping=stopping_distance_with_drag)
        if speed <= 0 or needed <= sight:
            continue
        why = f"stopping before it from the speed cap takes {needed:.2f} m, but the sonars reach {sight:g} m"
        if speed >= most:
            why = f"drag equals the least thrust at {most:.3f} m/s"
        text = f"braking cannot avoid obstacle {o.name!r} at {speed:g} m/s: evasion must; with {vehicle.name} {why}"
        yield Finding("info", f"obstacles.{o.name}.speed_m_per_s", text)


def _current(scenario: Scenario) -> Iterator[Finding]:
    current = float(np.hypot(*scenario.disturbance.current_m_per_s))
    if current < scenario.cap:
        return
    text = f"the current of {current:g} m/s is not below the speed cap of {scenario.cap:g} m/s"
    yield Finding("error", "disturbance.current_m_per_s", text)


def _thrust(scenario: Scenario, vehicle: Vehicle) -> Iterator[Finding]:
    """Report a thrust below the drag at cruise speed.

    The check takes the heading with less drag: along the path segment or into the current.
    """
    d = scenario.disturbance
    current, weak = np.array(d.current_m_per_s), 1 - d.thrust_error - d.thrust_bias
    worst, figures, worst_leg = 0.0, (0.0, 0.0, 0.0, 0.0), 0
    ahead_most, aside_most = weak * ahead_limit(vehicle), weak * float(vehicle.thrust_limit[1])
    legs = np.diff(scenario.path.waypoints, axis=0)
    for k, (leg, cruise) in enumerate(zip(legs, _leg_speeds(scenario).tolist(), strict=True)):
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
        return
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
    yield Finding("error", key, text)


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
    held = {
        axis: steady_speed(float(most[k]), vehicle[drag], vehicle[drag + drag[-1]])
        for axis, (drag, k) in axes.items()
        if ahead[k] > 0
    }
    least = min(held.values())
    if scenario.cap <= least:
        return []
    speeds = " and ".join(f"{speed:.3g} m/s in {axis}" for axis, speed in held.items())
    text = f"the cap of {scenario.cap:g} m/s is above the speeds that {vehicle.name} can hold by thrust: {speeds}"
    if scenario.cruise > least:  # no cap from the cruise speed on is held by every axis
        return [Finding("info", "cap_m_per_s", f"{text}; so is the cruise speed: motion there is slower")]
    return [Finding("warning", "cap_m_per_s", f"{text}; write at most {np.floor(least * 1e3) / 1e3:g}")]


def _share(force: tuple[float, float]) -> float:
    return force[0] / force[1]


def _drag(vehicle: Vehicle, axis: str, speed: float) -> float:
    quadratic = axis + axis[-1]
    return vehicle[axis] * speed + vehicle[quadratic] * speed**2


def _time(scenario: Scenario) -> Iterator[Finding]:
    length, least = scenario.path.length, scenario.duration
    if scenario.time_limit >= least:
        return
    text = (
        f"the path is {length:.2f} m long and takes {least:.1f} s at the cruise speed of {scenario.cruise:g} m/s"
        f"{' and the speeds of its legs' if scenario.path.speeds is not None else ''}; "
        f"the run ends at {scenario.time_limit:g} s"
    )
    yield Finding("error", "time_limit_s", text)
