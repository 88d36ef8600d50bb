"""Whether a hull has room: at the start, at the target, and on the way between."""

from __future__ import annotations

from math import floor

import numpy as np
from numpy.typing import NDArray

from surctl.control import Gains
from surctl.control.layers import SLACK
from surctl.simulation.column import BAND
from surctl.simulation.finding import Finding
from surctl.simulation.obstacle import Obstacle
from surctl.simulation.passage import tightest_gap
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["clearance_findings", "end_findings", "layers"]

_CLEARANCE = 0.02  # [m] two standard deviations of the base station's position: less room than that cannot be kept


def clearance_findings(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """Walls, still obstacles with their drift, and moving ones at both ends; gaps; the surface."""
    return [
        *end_findings(scenario, vehicle),
        *_drifting_together(scenario),
        *_gap(scenario, vehicle, gains),
        *_launch(scenario, vehicle),
        *_surface(scenario, vehicle),
    ]


def _met(scenario: Scenario, vehicle: Vehicle) -> list[Obstacle]:
    """The obstacles that a hull at the path's depth meets, or whose ends it passes within `_ROOM`."""
    extent = vehicle["radius"] + _CLEARANCE
    return [o for o in scenario.obstacles if o.heights.crosses(scenario.depth, extent)]


def end_findings(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """Those at start and target alone, without what takes time to find: the gaps between."""
    results = _at_walls(scenario, vehicle)
    for obstacle in _met(scenario, vehicle):
        results += _at_still(obstacle, scenario, vehicle) if obstacle.still else _at_moving(obstacle, scenario, vehicle)
    return results


def _ends(scenario: Scenario) -> list[tuple[str, NDArray[np.float64], float]]:
    """Where the hull has to come: name, place, and how near [m] is enough."""
    corners = scenario.path.waypoints[1:-1] if scenario.visit else ()
    visited = [(f"corner ({c[0]:g}, {c[1]:g})", c, scenario.arrival_radius) for c in corners]
    return [("start", scenario.start, 0.0), *visited, ("target", scenario.target, 0.0)]


def _launch(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    """What stands in the water that the mission says is free at the start: the law would not look before it moves."""
    results = []
    start = (float(scenario.start[0]), float(scenario.start[1]))
    for obstacle in _met(scenario, vehicle):
        own = vehicle["radius"] if not obstacle.still and obstacle.radius_m is None else 0.0
        clearance = obstacle.distance(start) - own - vehicle["radius"] - obstacle.drift_m
        if clearance <= 0 and obstacle.still:
            continue  # told by `_at_still`
        if scenario.launch > 0 and clearance < scenario.launch:
            hull = f"the hull of {vehicle.name} at the start"
            text = f"obstacle {obstacle.name!r} may come within {clearance:.3f} m of {hull}"
            results.append(Finding("error", "launch_m", f"{text}, where {scenario.launch:g} m are said to be free"))
    return results


def _at_walls(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    results = []
    for name, point, near in _ends(scenario):
        clearance = min(wall.nearest(point)[0] for wall in scenario.walls) - vehicle["radius"] + near
        if clearance < _CLEARANCE:
            where = f"{-clearance:.3f} m inside a wall" if clearance < 0 else f"only {clearance:.3f} m off a wall"
            text = f"the {vehicle['radius']:g} m hull of {vehicle.name} is {where} at the {name} (E15)"
            results.append(Finding("error", "path_m", text))
    return results


def _at_still(obstacle: Obstacle, scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    results = []
    for name, point, near in _ends(scenario):
        clearance = obstacle.distance((float(point[0]), float(point[1]))) - vehicle["radius"] + near
        if clearance - obstacle.drift_m > 0:
            continue
        if clearance <= 0:
            what = f"obstacle {obstacle.name!r} for the hull of {vehicle.name}"
            text = f"the {name} lies {-clearance:.3f} m too close to {what}"
        else:
            text = (
                f"at the {name} the hull of {vehicle.name} is {clearance:.3f} m off obstacle {obstacle.name!r}, which "
                f"drifts by {obstacle.drift_m:g} m: it may touch (E15)"
            )
        results.append(Finding("error", f"obstacles.{obstacle.name}", text))
    return results


def _at_moving(obstacle: Obstacle, scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    key = f"obstacles.{obstacle.name}"
    contact_distance = vehicle["radius"] + (obstacle.radius_m or vehicle["radius"])
    centre, end = np.array(obstacle.centre_m), np.array(obstacle.to_m)
    clearance = float(np.linalg.norm(scenario.target - end)) - contact_distance
    if clearance > 0:
        return []
    speed = float(obstacle.speed_m_per_s or 0.0)
    when = float(np.linalg.norm(end - centre)) / speed
    if obstacle.removed:
        text = (
            f"it ends on the target and is taken out at {when:.1f} s; the robot at cruise speed is there at "
            f"{scenario.path.length / scenario.cruise:.1f} s, and cannot arrive while the obstacle is near"
        )
        return [Finding("warning", f"{key}.to_m", text)]
    text = f"it stays {-clearance:.3f} m too close to the target for the hull of {vehicle.name} from {when:.1f} s on"
    return [Finding("error", f"{key}.to_m", text)]


def _drifting_together(scenario: Scenario) -> list[Finding]:
    still = [o for o in scenario.obstacles if o.still]
    results = []
    for k, one in enumerate(still):
        for other in still[k + 1 :]:
            clearance, drift = one.apart(other), one.drift_m + other.drift_m
            if drift > 0 and clearance < drift and one.heights.shares(other.heights):
                pair = f"obstacles {one.name!r} and {other.name!r}"
                text = f"{pair} are {clearance:.3f} m apart and may drift into each other"
                results.append(Finding("warning", f"obstacles.{other.name}.drift_m", text))
    return results


def _gap(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[Finding]:
    """A gap that the way must pass and the hull, with the error that is stated for its path, may not.

    Where another depth has a way on, that is told instead of an error.
    """
    error = scenario.paper.position_error_m or _CLEARANCE
    hull = 2 * vehicle["radius"]
    gap = tightest_gap(scenario, hull / 2 + error)
    if gap is None or gap.always >= hull + 2 * error:
        return []
    drifts = f", of which their drift leaves {max(gap.always, 0.0):.3f} m" if gap.drift else ""
    text = (
        f"the widest way to the target passes between {gap.between[0]} and {gap.between[1]} near "
        f"({gap.place[0]:.2f}, {gap.place[1]:.2f}): {max(gap.width, 0.0):.3f} m wide{drifts}; the hull of "
        f"{vehicle.name} takes {hull:.3f} m, {hull + 2 * error:.3f} m with an error of {error:g} m to either side"
    )
    if gap.always >= hull:
        return [Finding("warning", "obstacles" if scenario.obstacles else "site", text)]
    lost = "no way through is guaranteed (E15)" if gap.width >= hull else "there is no way through"
    if scenario.depths is None:
        return [Finding("error", "obstacles" if scenario.obstacles else "site", f"{lost}: {text}")]
    tried = layers(scenario, vehicle, gains)
    open_depths = [z for z in tried if _passes(scenario, hull / 2 + max(error, BAND), z, hull=hull)]
    if open_depths:
        summary = f"only another depth leads on, z = {open_depths[0]:.2f} m is the first that is tried and free"
        return [Finding("warning", "depths_m", f"{summary}; at the path's depth {lost}: {text}")]
    listed = ", ".join(f"{z:.2f}" for z in tried) or "none has room"
    summary = f"neither at the path's depth nor at another (z in m: {listed}) is there a way through"
    return [Finding("error", "depths_m", f"{summary}: {text}")]


def _passes(scenario: Scenario, clearance: float, z: float, *, hull: float) -> bool:
    gap = tightest_gap(scenario, clearance, depth=z)
    return gap is None or gap.always >= hull


def layers(scenario: Scenario, vehicle: Vehicle, gains: Gains) -> list[float]:
    """z of the depths [m] that the law tries in turn besides the path's, see `control.layers`; none without `depths`.

    Those above come first, nearest first; what its echo sounders find in the way there is not known here.
    """
    if scenario.depths is None:
        return []
    lowest, highest = scenario.depths
    keep, pitch = vehicle["radius"] + gains["margin"], 2 * vehicle["radius"] + gains["margin"]
    above, below = (
        max(0, floor((height + SLACK) / pitch))
        for height in (highest - keep - scenario.depth, scenario.depth - keep - lowest)
    )
    return [scenario.depth + k * pitch for k in (*range(1, above + 1), *range(-1, -below - 1, -1))]


def _surface(scenario: Scenario, vehicle: Vehicle) -> list[Finding]:
    out = vehicle["radius"] + scenario.depth
    if out <= 0:
        return []
    text = f"the hull stands {out:.2f} m out of the water at this depth; the model has no buoyancy (E16)"
    return [Finding("warning", "depth_m", text)]
