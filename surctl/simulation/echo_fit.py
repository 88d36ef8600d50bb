"""Findings about smooth surfaces: faces of obstacles that no sonar can hear, because they answer near their normal.

A smooth face reflects sound like a mirror. It answers a sonar only if the sonar looks at it within a limited angle of
its normal (`incidence_limit` of the array). A face is unheard if the hull fits nowhere from where it answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import cos, degrees, sin

from surctl.sensing import SonarArray
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


def echo_findings(scenario: Scenario, vehicle: Vehicle, array: SonarArray) -> list[Finding]:
    """Return the findings about surfaces that answer only near their normal; none if every surface answers."""
    limit = array.incidence_limit
    if limit is None:
        return []
    angle = f"{degrees(limit):.3g}°"
    listed = [
        Finding(
            "warning",
            "sonar.incidence_limit_deg",
            f"surfaces answer only within {angle} of their normal, but the law takes silence for free water: a smooth "
            "face that a beam meets obliquely is cleared from the map; simulate many seeds before a launch",
        )
    ]
    faces = silent_faces(scenario, vehicle["radius"], array)
    if faces:
        more = f" and {len(faces) - _NAMED} more" if len(faces) > _NAMED else ""
        text = (
            f"no place where the hull of {vehicle.name} fits hears {', '.join(faces[:_NAMED])}{more}: these faces "
            f"answer only within {angle} of their normal"
        )
        listed.append(Finding("warning", "sonar.incidence_limit_deg", text))
    return listed


def silent_faces(scenario: Scenario, hull: float, array: SonarArray) -> list[str]:
    """Return the faces of still boxes, as NAME with the side (`OS1 -y`), that answer at no place where the hull fits.

    Args:
        scenario: the mission; obstacles are taken at their places at the start, without drift.
        hull: hull radius [m].
        array: the sonars; their `incidence_limit` is the largest angle [rad] from a face's normal at which it answers.
    """
    still = [obstacle for obstacle in scenario.obstacles if obstacle.shape != "moving"]
    return [
        f"{box.name} {side}"
        for box in still
        if box.size_m is not None
        for side, normal in _SIDES.items()
        if not any(_audible(point, normal, scenario, still, hull, array) for point in _on_face(box, normal))
    ]


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
    point: Point, normal: Point, scenario: Scenario, still: Sequence[Obstacle], hull: float, array: SonarArray
) -> bool:
    # whether the hull fits at a place from which a sonar on the hull hears this point of a face
    limit = array.incidence_limit or 0.0
    for turn in (0.0, limit, -limit):
        c, s = cos(turn), sin(turn)
        ray = (c * normal[0] - s * normal[1], s * normal[0] + c * normal[1])
        for k in range(_AHEAD + 1):
            distance = hull + array.maximum * k / _AHEAD
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
