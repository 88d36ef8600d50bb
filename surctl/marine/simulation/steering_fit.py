"""Check what a scenario asks of a craft without sway force, or without heave force."""

from __future__ import annotations

from itertools import pairwise
from math import acos, degrees, tan

import numpy as np

from surctl.marine.control import Gains, default_law, law_source, turning_radius
from surctl.marine.guidance import BEND
from surctl.marine.simulation.finding import Finding
from surctl.marine.simulation.passage import tightest_gap
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle

__all__ = ["planned_radius", "steering_findings"]

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


def steering_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Return the findings about turning, holding a place and depth; empty for a vehicle that has all four forces."""
    results = _depths(scenario, vehicle)
    if vehicle["Fv_max"] > 0:
        return results
    radius, about = planned_radius(vehicle, gains, scenario.cruise)
    at_rest = vehicle.fin_share(scenario.cruise) * 100
    text = (
        f"{vehicle.name} has no sway force (Fv_max = 0): law {default_law(vehicle)} steers it by heading and speed, "
        f"from obstacle positions, without sonars; its {about}"
    )
    if at_rest > 0:
        text += f"; rudders or fins give {at_rest:.0f} % of its yaw moment, and nothing at rest"
    return [
        *results,
        Finding("info", "vehicle", text),
        *_corners(scenario, radius),
        *_turning_circle(scenario, vehicle, radius),
        *_arrival(scenario, vehicle, radius),
        *_station(scenario, vehicle),
    ]


def _depths(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    if vehicle["Fw_max"] > 0 or scenario.depths is None:
        return []
    text = f"{vehicle.name} has no heave force (Fw_max = 0), so it cannot leave the path's depth; remove depths_m"
    return [Finding("error", "depths_m", text)]


def _corners(scenario: Scenario, radius: float) -> list[Finding]:
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
    results = []
    for listed, others in ((reversals, "also turn back"), (sharp, "are also too sharp")):
        if listed:
            more = f" (the worst; {len(listed) - 1} other corners {others})" if len(listed) > 1 else ""
            results.append(Finding("warning", "path_m", max(listed)[1] + more))
    return results


def _turning_circle(scenario: Scenario, vehicle: Vehicle, radius: float) -> list[Finding]:
    needed, hull = 2 * radius, vehicle["radius"]
    results = []
    width = min(scenario.site[:2]) - 2 * hull
    if width < needed:
        text = (
            f"the site leaves {width:.2g} m for the centre of {vehicle.name}, less than its planned turning circle of "
            f"{needed:.2g} m at the cruise speed: it must slow down to turn round; lower cruise_m_per_s"
        )
        results.append(Finding("warning", "site", text))
    gap = tightest_gap(scenario, hull + radius)
    if gap is not None and 0 < gap.always - 2 * hull < needed:
        text = (
            f"the passage between {gap.between[0]} and {gap.between[1]} leaves {gap.always - 2 * hull:.2g} m for the "
            f"centre of {vehicle.name}, less than its planned turning circle of {needed:.2g} m at the cruise speed: "
            "it cannot turn back there without slowing down"
        )
        results.append(Finding("info", "obstacles", text))
    return results


def _arrival(scenario: Scenario, vehicle: Vehicle, radius: float) -> list[Finding]:
    needed = _PASSES * radius
    if vehicle.fin_share(scenario.cruise) < 0.5 or scenario.arrival_radius >= needed:
        return []
    text = (
        f"{vehicle.name} steers by rudders or fins and passes its target at speed, to within about {needed:.1g} m, "
        f"{100 * _PASSES:g} % of its planned turning radius: in {scenario.arrival_radius:g} m it may turn round "
        f"several times; set arrival_m = {needed:.1g}"
    )
    return [Finding("warning", "arrival_m", text)]


def _station(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    d = scenario.disturbance
    if not scenario.visit or not (np.hypot(*d.current_m_per_s) > 0 or d.drift_force_n > 0):
        return []
    text = f"{vehicle.name} has no sway force, so a current or a drift force moves it away from a corner to visit"
    return [Finding("warning", "corners", text)]
