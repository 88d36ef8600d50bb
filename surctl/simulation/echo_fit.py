"""Findings about reflectors: faces of obstacles that no sonar can hear, weak echoes, and echoes of surface and floor.

A smooth face reflects sound like a mirror. It returns an echo only to a sonar that looks at it within a limited angle
of its normal (`incidence_limit` of the sonar array, or of the reflector that the face has). A face is unheard if the
hull fits in no place to which the face returns an echo.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import cos, degrees, pi, sin

from surctl.sensing import Reflector, SonarArray, Surfaces, level_range
from surctl.simulation.finding import Finding
from surctl.simulation.obstacle import Obstacle
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["echo_findings", "silent_faces"]

Point = tuple[float, float]

_SIDES: dict[str, Point] = {"+x": (1.0, 0.0), "-x": (-1.0, 0.0), "+y": (0.0, 1.0), "-y": (0.0, -1.0)}
_POINTS = 9  # places on a face
_AHEAD = 24  # places along a direction from the face
_NAMED = 4  # faces that a finding names
_CLEARED = {
    "diffuse": "silence is free water: a smooth face that a beam meets obliquely is cleared from the map",
    "smooth-walls": "only walls may be silent: a smooth obstacle that a beam meets obliquely is cleared from the map",
    "smooth": "a mark of a smooth obstacle lasts 9 s, and a face that never answered is not in the map",
    "specular": "a face that never answered is not in the map",
}
_OBLIQUE = pi / 3  # [rad] with a larger limit, the missions arrive as if all surfaces answered (chosen)


def echo_findings(scenario: Scenario, vehicle: Vehicle, array: SonarArray) -> list[Finding]:
    """Return the findings about surfaces that do not answer every firing, and about echoes of surface and floor."""
    surfaces = scenario.surfaces
    limits = {array.incidence_limit} if surfaces is None else {r.incidence_limit for r in _upright(surfaces)}
    oblique = [limit for limit in limits if limit is not None and limit < _OBLIQUE]
    key = "sonar.echoes" if scenario.sensors.echoes else "reflector"
    key = "sonar.incidence_limit_deg" if surfaces is None else key
    listed = []
    angle = " or ".join(f"{degrees(limit):.3g}°" for limit in sorted(limit for limit in limits if limit is not None))
    if oblique:
        assumed = scenario.sensors.equipment.surface_model
        text = (
            f"surfaces answer only within {angle} of their normal; with surface_model = {assumed!r}, "
            f"{_CLEARED[assumed]}; simulate many seeds before a launch"
        )
        listed.append(Finding("warning", key, text))
    faces = silent_faces(scenario, vehicle["radius"], array)
    if faces:
        more = f" and {len(faces) - _NAMED} more" if len(faces) > _NAMED else ""
        text = (
            f"no place where the hull of {vehicle.name} fits hears {', '.join(faces[:_NAMED])}{more}: these faces "
            f"answer only within {angle} of their normal"
        )
        listed.append(Finding("warning", key, text))
    listed += _corners(scenario, vehicle, array, key)
    if surfaces is None:
        return listed
    return [*listed, *_level(scenario, array, surfaces), *_weak(scenario, vehicle, surfaces, key)]


def silent_faces(scenario: Scenario, hull: float, array: SonarArray) -> list[str]:
    """Return the faces of still boxes, as NAME with the side (`OS1 -y`), that answer at no place where the hull fits.

    Args:
        scenario: the mission; obstacles are taken at their places at the start, without drift.
        hull: hull radius [m].
        array: the sonars; their `incidence_limit` is the largest angle [rad] from a face's normal at which it answers,
            unless the scenario gives its surfaces reflectors.
    """
    limits = [reflector.incidence_limit for reflector in _reflectors(scenario, array)]
    still = [obstacle for obstacle in scenario.obstacles if obstacle.shape != "moving"]

    def audible(box: Obstacle, normal: Point, limit: float) -> bool:
        points = _on_face(box, normal)
        return limit > 0 and any(_audible(p, normal, scenario, still, hull, array.maximum, limit) for p in points)

    return [
        f"{box.name} {side}"
        for box, limit in zip(scenario.obstacles, limits, strict=True)
        if box.size_m is not None and limit is not None
        for side, normal in _SIDES.items()
        if not audible(box, normal, limit)
    ]


def _reflectors(scenario: Scenario, array: SonarArray) -> Sequence[Reflector]:
    # of each obstacle
    surfaces = scenario.surfaces
    return [Reflector(array.incidence_limit)] * len(scenario.obstacles) if surfaces is None else surfaces.obstacles


def _corners(scenario: Scenario, vehicle: Vehicle, array: SonarArray, key: str) -> Iterator[Finding]:
    # corners of boxes that are heard nearer than the distance in which the hull stops at full thrust
    slowing = min(vehicle["Fu_max"], vehicle["Fv_max"]) / max(vehicle["m11"], vehicle["m22"])
    stopping, on_hull = scenario.cap**2 / (2 * slowing), replace(array, hull_radius=vehicle["radius"])
    late: dict[float, list[str]] = {}
    for box, reflector in zip(scenario.obstacles, _reflectors(scenario, array), strict=True):
        if box.size_m is not None and reflector.edge_range == 0 and reflector.incidence_limit != 0:
            at = on_hull.corner_range(reflector.incidence_limit)
            late.setdefault(at, []).extend([box.name] if at < stopping else [])
    for at, boxes in late.items():
        if boxes:
            when = f"hears it {at:.2f} m away at best" if at > 0 else "touches it before any sonar can hear it"
            text = (
                f"a hull that comes to a corner of {', '.join(boxes)} along its bisector {when}, and needs "
                f"{stopping:.2f} m to stop from {scenario.cap:g} m/s; only paths along the normals of the faces, "
                "slower motion or wider beams help"
            )
            yield Finding("warning", key, text)


def _upright(surfaces: Surfaces) -> set[Reflector]:
    return {*surfaces.obstacles, *surfaces.walls}


def _level(scenario: Scenario, array: SonarArray, surfaces: Surfaces) -> Iterator[Finding]:
    # echoes of water surface and floor, which the law takes for obstacles
    depth = scenario.depth
    for name, side, gap in (("surface", 1, -depth), ("floor", -1, surfaces.depth + depth)):
        reflector: Reflector = getattr(surfaces, name)
        distance = level_range(array, reflector, side=side, gap=gap)
        if distance is None or distance > array.maximum:
            continue
        what = "water surface" if side == 1 else "floor"
        limit = reflector.incidence_limit
        pitch = None if limit is None else 90 - degrees(limit + 0.5 * array.beam_angle)
        remedy = "a narrower beam makes it silent"
        if pitch is not None and pitch > -0.5 * degrees(array.beam_angle):
            remedy = f"sonar.pitch_deg {'below' if side == 1 else 'above'} {side * pitch:.3g} makes it silent"
        text = (
            f"every sonar hears the {what} at {distance:.2f} m at the depth of {depth:g} m and takes it for an "
            f"obstacle: what is farther away is not heard; {remedy}"
        )
        yield Finding("warning", f"site.{name}", text)


def _weak(scenario: Scenario, vehicle: Vehicle, surfaces: Surfaces, key: str) -> Iterator[Finding]:
    # cylinders that answer weakly, and faces whose edges do
    ranges = []
    for obstacle, reflector in zip(scenario.obstacles, surfaces.obstacles, strict=True):
        if obstacle.size_m is None and reflector.cylinder_range is not None:
            radius = obstacle.radius_m or vehicle["radius"]
            ranges.append(f"{obstacle.name} {reflector.cylinder_range * (radius / 0.1) ** (1 / 3):.2g} m")
        elif obstacle.size_m is not None and reflector.edge_range > 0:
            ranges.append(f"edges of {obstacle.name} {reflector.edge_range:.2g} m")
    if ranges:
        more = f" and {len(ranges) - _NAMED} more" if len(ranges) > _NAMED else ""
        text = "ahead of a sonar, half of the firings detect at these ranges: " + ", ".join(ranges[:_NAMED]) + more
        yield Finding("info", key, text)


def _on_face(box: Obstacle, normal: Point) -> Iterator[Point]:
    # places on the face, a little outside of it
    assert box.size_m is not None
    (x, y), (length, width) = box.centre_m, box.size_m
    for k in range(_POINTS):
        along = (k + 0.5) / _POINTS - 0.5
        yield (
            x + normal[0] * (0.5 * length + 1e-6) + abs(normal[1]) * along * length,
            y + normal[1] * (0.5 * width + 1e-6) + abs(normal[0]) * along * width,
        )


def _audible(
    point: Point,
    normal: Point,
    scenario: Scenario,
    still: Sequence[Obstacle],
    hull: float,
    maximum: float,
    limit: float,
) -> bool:
    # whether the hull fits at a place from which a sonar on the hull hears this point of a face
    for turn in (0.0, limit, -limit):
        c, s = cos(turn), sin(turn)
        ray = (c * normal[0] - s * normal[1], s * normal[0] + c * normal[1])
        for k in range(_AHEAD + 1):
            distance = hull + maximum * k / _AHEAD
            place = (point[0] + distance * ray[0], point[1] + distance * ray[1])
            nearest = min(obstacle.distance(place) for obstacle in still)
            if nearest <= 0 or not _inside(place, scenario, 0.0):
                break  # another obstacle or a wall hides the rest of the direction
            if nearest >= hull - 1e-5 and _inside(place, scenario, hull):
                return True
    return False


def _inside(place: Point, scenario: Scenario, hull: float) -> bool:
    length, width = scenario.site[0], scenario.site[1]
    return hull <= place[0] <= length - hull and hull <= place[1] <= width - hull
