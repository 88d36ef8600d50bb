"""A scenario from a QGroundControl plan or a GPX file: frames, heights, geofence, and items that are not used."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from math import cos, isfinite, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.simulation.route import MAX_POINTS
from surctl.marine.simulation.scenario import scenario_from_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.recorded import LARGEST_XML, file_bytes, shown, xml_root

_AXIS, _FLATTENING = 6378137.0, 1 / 298.257223563  # WGS 84
_ABOVE_SEA, _ABOVE_HOME, _ABOVE_TERRAIN = (0, 5), (3, 6), (10, 11)  # frames of MAVLink
_NED, _ENU = 1, 4  # local frames, in metres from the home position
_NOT_USED: dict[int, dict[int, str]] = {  # parameters of the commands that change the motion, by their index
    16: {0: "hold {:g} s", 2: "pass at {:g} m", 3: "yaw {:g}°"},
    17: {2: "radius {:g} m"},
    18: {0: "{:g} turns", 2: "radius {:g} m"},
    19: {0: "hold {:g} s", 2: "radius {:g} m"},
    82: {0: "hold {:g} s"},
}

_Place = tuple[float, float, float]
"""Latitude and longitude [°], and a height or radius [m]."""
_Places = list[_Place]


def _metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return metres per degree to the east and to the north, with the radii of curvature of the ellipsoid."""
    eccentricity = _FLATTENING * (2 - _FLATTENING)
    root = sqrt(1 - eccentricity * sin(radians(latitude)) ** 2)
    return radians(_AXIS / root * cos(radians(latitude))), radians(_AXIS * (1 - eccentricity) / root**3)


def _home_position(value: object) -> _Place | None:
    """Return latitude, longitude [°] and height above the sea [m] of a plan's home; None if it gives none."""
    try:
        latitude, longitude, height = (float(v) for v in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        return None
    return latitude, longitude, height


def _waypoint(frame: int, numbers: list[float], home: _Place | None) -> tuple[_Place, list[str]]:
    """Return latitude, longitude and height above the surface of a waypoint, and what of it is not known.

    `numbers` are these three or, by the `frame` of MAVLink, coordinates in metres from `home`, which is at the surface.
    """
    one, other, height = numbers
    if frame in _ABOVE_HOME:
        return (one, other, height), []
    if frame in _ABOVE_TERRAIN:
        return (one, other, float("nan")), [f"height {height:g} m above the terrain"]
    if frame in _ABOVE_SEA:
        if home is None:
            return (one, other, float("nan")), [f"height {height:g} m above the sea, without a home position"]
        return (one, other, height - home[2]), []
    if frame not in (_NED, _ENU):
        remedy = "give latitude, longitude and height above home"
        raise InputError("is no frame of a waypoint", value=f"frame {frame}", remedy=remedy)
    if home is None:
        problem = "is in metres from a home position, and the plan has no plannedHomePosition"
        raise InputError(problem, value=f"frame {frame}", remedy="save the plan with a home position")
    x, y, z = (other, one, -height) if frame == _NED else (one, other, height)
    east, north = _metres_per_degree(home[0])
    return (home[0] + y / north, home[1] + x / east, z), []


def _unused(command: int, params: list[Any], item: dict[str, Any]) -> list[str]:
    """Return what of a waypoint changes the motion, and a path does not have."""
    said = {k: float(params[k]) for k in _NOT_USED[command] if k < len(params) and params[k] is not None}
    texts = [_NOT_USED[command][k].format(value) for k, value in said.items() if isfinite(value) and value != 0]
    if command == 17:
        texts.append("loiter without end")
    return texts + (["waits for the operator"] if item.get("autoContinue") is False else [])


def _geofence(fence: Any, path: Path) -> tuple[_Places, list[str]]:
    """Return the circles of a geofence that exclude, with centre [°] and radius [m], and notes about the rest."""
    zones: _Places = []
    notes: list[str] = []
    try:
        circles, polygons = (list((fence or {}).get(key) or []) for key in ("circles", "polygons"))
        for number, part in enumerate(circles, start=1):
            latitude, longitude = (float(v) for v in part["circle"]["center"])
            radius = float(part["circle"]["radius"])
            if part.get("inclusion", True):
                notes.append(f"not used: inclusion circle {number}, of radius {radius:g} m")
            else:
                zones.append((latitude, longitude, radius))
        for number, part in enumerate(polygons, start=1):
            kind = "inclusion" if part.get("inclusion", True) else "exclusion"
            notes.append(f"not used: {kind} polygon {number}, with {len(part['polygon'])} corners")
    except (KeyError, TypeError, ValueError, AttributeError):
        remedy = "correct it in QGroundControl and save the plan again"
        raise InputError("cannot be read", file=shown(path), key="geoFence", remedy=remedy) from None
    return zones, notes


_WAYPOINTS = frozenset({16, 17, 18, 19, 82})  # commands of MAVLink that go to a position
_SPEED = 178
_FORWARD = (0, 1)  # types of a change of speed: through the air (or water), over ground
_FARTHEST = 100_000.0  # m, beyond which the plane of the scenario no longer fits
_LEAST = 0.05  # m, shorter legs are one point


@dataclass(frozen=True, eq=False)
class Mission:
    """The waypoints of a mission in a plane.

    Attributes:
        points: (n, 2) x east and y north [m] from the origin.
        heights: (n,) height above the surface [m], negative below it; NaN if the file gives none.
        speed: speed through the mission [m/s]; None if the file gives none.
        origin: latitude and longitude of the origin [°].
        notes: what of the file was not used.
        zones: (k, 3) centre x, y and radius [m] of circles that the path must not enter.
    """

    points: NDArray[np.float64]
    heights: NDArray[np.float64]
    speed: float | None
    origin: tuple[float, float]
    notes: tuple[str, ...]
    zones: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))


def read_mission(path: Path) -> Mission:
    """Read the waypoints of a QGroundControl plan or a GPX file; the first waypoint is the origin.

    Of a plan, the function takes the waypoints, those of surveys included, the first change of speed, and the circles
    of the geofence that exclude; the home position is at the surface. Of a GPX file it takes the first route, else the
    first track, else the waypoints. Everything else that changes the motion, such as hold times, is in the notes.
    """
    raw = file_bytes(path, remedy="give a .plan or .gpx file", most=LARGEST_XML)
    content = _gpx(raw, path) if path.suffix.lower() == ".gpx" else _plan(raw, path)
    places, notes = content.places, tuple(content.notes)
    if len(places) > MAX_POINTS:
        remedy = f"give at most {MAX_POINTS:,} waypoints"
        raise InputError(f"has {len(places):,} waypoints", file=shown(path), remedy=remedy)
    for k, (latitude, longitude, _) in enumerate(places):
        if not (-90 < latitude < 90 and -180 <= longitude <= 180):
            key, value = f"waypoint {k + 1}", (latitude, longitude)
            raise InputError("is not a position", file=shown(path), key=key, value=value, remedy="correct it")
    points: list[NDArray[np.float64]] = []
    heights: list[float] = []
    for latitude, longitude, height in places:
        point = _plane(latitude, longitude, places[0])
        if points and float(np.hypot(*(point - points[-1]))) < _LEAST:
            continue
        points.append(point)
        heights.append(height)
    if len(points) < 2:
        left_out = f" ({'; '.join(notes)})" if notes else ""
        raise InputError(f"has fewer than two waypoints{left_out}", file=shown(path), remedy="add waypoints")
    distances = np.hypot(*np.array(points).T)
    if np.max(distances) > _FARTHEST:
        at = f"one is {np.max(distances) / 1000:.0f} km from the first"
        remedy = "check the waypoints; a plane fits up to 100 km"
        raise InputError(f"has waypoints too far apart: {at}", file=shown(path), remedy=remedy)
    zones = [[*_plane(latitude, longitude, places[0]), radius] for latitude, longitude, radius in content.zones]
    origin = (places[0][0], places[0][1])
    return Mission(np.array(points), np.array(heights), content.speed, origin, notes, np.reshape(zones, (-1, 3)))


def mission_scenario(
    mission: Mission, name: str, *, vehicle: str, cruise: float, margin: float = 5.0, depth: float | None = None
) -> tuple[str, tuple[str, ...]]:
    """Return the text of a scenario file with the path of a mission in a site around it, and notes for the user.

    Args:
        mission: the mission.
        name: name of the scenario.
        vehicle: name or file of the vehicle.
        cruise: desired speed along the path [m/s].
        margin: free water around the path [m].
        depth: z of the path [m], below 0; default: the lowest height of the mission.
    """
    notes = list(mission.notes)
    heights = mission.heights[np.isfinite(mission.heights)]
    if depth is None:
        if not len(heights) or float(heights.min()) >= 0:
            problem = "; ".join(["is not below the surface", *(() if len(heights) else notes)])
            raise InputError(problem, key="--depth", remedy="give the depth of the path: -0.1 for a boat")
        depth = float(heights.min())
        if float(np.ptp(heights)) > _LEAST:
            notes.append(
                f"heights from {heights.min():g} to {heights.max():g} m: the path keeps the lowest, {depth:g} m"
            )
    corner = mission.points.min(axis=0) - margin
    shifted = mission.points - corner
    length, width = shifted.max(axis=0) + margin
    duration = float(np.sum(np.hypot(*np.diff(shifted, axis=0).T))) / cruise
    about = (
        f"{len(shifted)} waypoints; x east, y north; the first at {mission.origin[0]:.7f}°, {mission.origin[1]:.7f}°"
    )
    obstacles, of_zones = _obstacles(mission.zones - np.array([*corner, 0.0]), shifted, (length, width))
    table = {
        "kind": "scenario",
        "name": name,
        "title": name,
        "provenance": about,
        "vehicle": vehicle,
        "path_m": np.round(shifted, 3).tolist(),
        "depth_m": depth,
        "cruise_m_per_s": cruise,
        "cap_m_per_s": 1.25 * cruise,
        "time_limit_s": float(np.ceil(2 * duration + 60)),
        "site": {
            "length_m": float(np.ceil(length)),
            "width_m": float(np.ceil(width)),
            "depth_m": float(np.ceil(-2 * depth + 1)),
        },
        **({"obstacles": obstacles} if obstacles else {}),
    }
    scenario_from_table(table, source=name)  # a file that `lint` refuses is not written
    return toml_text(table), (*notes, *of_zones)


def _obstacles(
    zones: NDArray[np.float64], points: NDArray[np.float64], site: tuple[float, float]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the circles (k, 3) as cylinders of a scenario file, and notes about those that cannot be ones."""
    cylinders: list[dict[str, Any]] = []
    notes: list[str] = []
    used: list[NDArray[np.float64]] = []
    for number, (x, y, radius) in enumerate(zones.tolist(), start=1):
        where = f"exclusion circle {number}, of radius {radius:g} m"
        if min(np.hypot(*(points[k] - (x, y))) for k in (0, -1)) <= radius:
            problem = "the path begins or ends inside it"
            raise InputError(problem, key=where, remedy="move the waypoint or the circle, and save the plan again")
        if not (0 <= x <= site[0] and 0 <= y <= site[1]):
            notes.append(f"not used: {where} (its centre lies outside the site; a larger --margin includes it)")
        elif any(np.hypot(x - other[0], y - other[1]) < radius + other[2] for other in used):
            notes.append(f"not used: {where} (it overlaps an earlier one)")
        else:
            used.append(np.array([x, y, radius]))
            body = {"name": f"exclusion-{number}", "shape": "cylinder", "centre_m": [round(x, 3), round(y, 3)]}
            cylinders.append({**body, "radius_m": radius})
    if cylinders:
        notes.append(f"{len(used)} exclusion circles are cylinders in the water, so sonars see them too")
    return cylinders, notes


@dataclass
class _Content:
    # of a file, in degrees and metres; the zones are circles
    places: _Places
    speed: float | None
    notes: list[str]
    zones: _Places = field(default_factory=list)


def _plane(latitude: float, longitude: float, origin: tuple[float, float, float]) -> NDArray[np.float64]:
    # x east and y north
    east, north = _metres_per_degree(origin[0])
    turn = (longitude - origin[1] + 180) % 360 - 180
    return np.array([east * turn, north * (latitude - origin[0])])


def _plan(raw: bytes, path: Path) -> _Content:
    try:
        table = json.loads(raw)
        items = table["mission"]["items"]
        assert isinstance(items, list)
    except (ValueError, KeyError, TypeError, AssertionError, RecursionError):
        raise InputError("is not a QGroundControl plan", file=shown(path), remedy="give a .plan or .gpx file") from None
    home = _home_position(table["mission"].get("plannedHomePosition"))
    places: _Places = []
    speeds: list[tuple[str, float, bool]] = []
    skipped: dict[str, list[str]] = {}
    for number, item in _items(items):
        try:
            if not isinstance(item, dict):
                raise TypeError
            if item.get("type") == "ComplexItem":
                skipped.setdefault(f"{item.get('complexItemType')} without waypoints", []).append(number)
                continue
            command, params = int(item["command"]), list(item.get("params", ()))
            if command in _WAYPOINTS:
                place, unknown = _waypoint(int(item["frame"]), [float(v) for v in params[4:7]], home)
                places.append(place)
                for text in (*unknown, *_unused(command, params, item)):
                    skipped.setdefault(text, []).append(number)
            elif command == _SPEED and params[0] in _FORWARD:
                speeds.append((number, float(params[1]), bool(places)))
            else:
                skipped.setdefault(f"command {command}", []).append(number)
        except InputError as error:
            raise error.inside(shown(path), f"item {number}") from None
        except (KeyError, TypeError, ValueError, IndexError):
            remedy = "correct this item in QGroundControl and save the plan again"
            raise InputError(
                "cannot be read", file=shown(path), key=f"item {number}", value=shown(item), remedy=remedy
            ) from None
    notes = [f"not used: item {', '.join(numbers)} ({what})" for what, numbers in skipped.items()]
    speed, of_speeds = _speed(speeds, table["mission"].get("cruiseSpeed"))
    zones, of_fence = _geofence(table.get("geoFence"), path)
    return _Content(places, speed, [*notes, *of_speeds, *of_fence], zones)


def _speed(changes: list[tuple[str, float, bool]], cruise: object) -> tuple[float | None, list[str]]:
    """Return the first change of speed of a plan, else its cruise speed [m/s], and notes of what is not used."""
    notes: list[str] = []
    speed: float | None = None
    for number, value, moving in changes:
        if not (isfinite(value) and value > 0):
            notes.append(f"not used: item {number} (speed {value:g} m/s)")
        elif speed is None:
            speed = value
            if moving:
                notes.append(f"item {number} (speed {value:g} m/s, on the way) holds from the first waypoint")
        elif value != speed:
            notes.append(f"not used: item {number} (speed {value:g} m/s; the first one, {speed:g} m/s, holds)")
    if speed is None and cruise is not None:
        if isinstance(cruise, int | float) and not isinstance(cruise, bool) and isfinite(cruise) and cruise > 0:
            return float(cruise), notes
        notes.append(f"not used: cruiseSpeed = {shown(repr(cruise)[:40])} (not a speed above 0 m/s)")
    return speed, notes


def _items(items: list[Any]) -> Iterator[tuple[str, Any]]:
    # items with their numbers; in place of a survey its items, as 3.1, 3.2, ...
    for k, item in enumerate(items, start=1):
        inner = None
        if isinstance(item, dict) and item.get("type") == "ComplexItem":
            transects = item.get("TransectStyleComplexItem")
            inner = (transects.get("Items") if isinstance(transects, dict) else None) or item.get("Items")
        if inner and isinstance(inner, list):
            yield from ((f"{k}.{j}", part) for j, part in enumerate(inner, start=1))
        else:
            yield str(k), item


def _gpx(raw: bytes, path: Path) -> _Content:
    root = xml_root(raw, file=path, remedy="give a .plan or .gpx file")
    groups = [list(rte.iter("rtept")) for rte in root.iter("rte")] + [
        list(trk.iter("trkpt")) for trk in root.iter("trk")
    ]
    groups = [group for group in groups if group] or [list(root.iter("wpt"))]
    notes = [f"{len(groups) - 1} more routes or tracks are not used"] if len(groups) > 1 else []
    places: _Places = []
    for k, point in enumerate(groups[0], start=1):
        latitude, longitude, height = point.get("lat"), point.get("lon"), point.findtext("ele")
        try:
            places.append((float(latitude or ""), float(longitude or ""), float(height or "nan")))
        except ValueError:
            raise InputError(
                "is not a position in numbers",
                file=shown(path),
                key=f"point {k}",
                value=(latitude, longitude, height),
                remedy="give lat and lon in degrees; ele in metres or none",
            ) from None
    return _Content(places, None, notes)
