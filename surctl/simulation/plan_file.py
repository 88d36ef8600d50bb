"""A scenario from a mission of another program: a QGroundControl plan (.plan) or a GPX file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, isfinite, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.files import quoted
from surctl.recorded import shown, xml_root
from surctl.simulation.route import MAX_POINTS
from surctl.simulation.scenario import scenario_from_table

__all__ = ["Mission", "mission_scenario", "read_mission"]

_AXIS, _FLATTENING = 6378137.0, 1 / 298.257223563  # WGS 84
_WAYPOINTS = frozenset({16, 17, 18, 19, 82})  # commands of MAVLink that go to a position
_SPEED = 178
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
    """

    points: NDArray[np.float64]
    heights: NDArray[np.float64]
    speed: float | None
    origin: tuple[float, float]
    notes: tuple[str, ...]


def read_mission(path: Path) -> Mission:
    """Read the waypoints of a QGroundControl plan or a GPX file; the first waypoint is the origin.

    Of a plan, the function takes the waypoints, those of surveys included, and the first change of speed; of a GPX file
    the first route, else the first track, else the waypoints.

    Raises:
        InputError: the file cannot be read, or has fewer than two waypoints.

    Example:
        >>> from pathlib import Path
        >>> from surctl.simulation import read_mission
        >>> points = "".join(f'<rtept lat="{lat}" lon="10.0"><ele>-2</ele></rtept>' for lat in (63.0, 63.001))
        >>> _ = Path("bay.gpx").write_text(f"<gpx><rte>{points}</rte></gpx>")
        >>> mission = read_mission(Path("bay.gpx"))
        >>> mission.points.round(1).tolist(), mission.heights.tolist()
        ([[0.0, 0.0], [0.0, 111.5]], [-2.0, -2.0])
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file", file=shown(path), remedy="check the path") from None
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", file=shown(path), remedy="give a .plan or .gpx file") from None
    places, speed, notes = _gpx(text, path) if path.suffix.lower() == ".gpx" else _plan(text, path)
    if len(places) > MAX_POINTS:
        remedy = f"give at most {MAX_POINTS:,} waypoints"
        raise InputError(f"has {len(places):,} waypoints", file=shown(path), remedy=remedy)
    for k, (latitude, longitude, _) in enumerate(places):
        if not (-90 < latitude < 90 and -180 <= longitude <= 180):
            raise InputError(
                "is not a position",
                file=shown(path),
                key=f"waypoint {k + 1}",
                value=(latitude, longitude),
                remedy="correct it",
            )
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
    return Mission(np.array(points), np.array(heights), speed, (places[0][0], places[0][1]), notes)


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

    Raises:
        InputError: the mission has no height below the surface, and `depth` is not given; or the scenario would be
            refused, for example because of a depth above the surface.

    Example:
        >>> import numpy as np
        >>> from surctl.simulation import Mission, mission_scenario
        >>> mission = Mission(np.array([[0.0, 0.0], [20.0, 0.0]]), np.array([-2.0, -2.0]), None, (63.0, 10.0), ())
        >>> text, _ = mission_scenario(mission, "bay", vehicle="sur400", cruise=0.15)
        >>> [line for line in text.splitlines() if line.startswith("path_m")]
        ['path_m = [[5.0, 5.0], [25.0, 5.0]]']
    """
    notes = list(mission.notes)
    heights = mission.heights[np.isfinite(mission.heights)]
    if depth is None:
        if not len(heights) or float(heights.min()) >= 0:
            raise InputError(
                "is not below the surface", key="--depth", remedy="give the depth of the path: -0.1 for a boat"
            )
        depth = float(heights.min())
        if float(np.ptp(heights)) > _LEAST:
            notes.append(
                f"heights from {heights.min():g} to {heights.max():g} m: the path keeps the lowest, {depth:g} m"
            )
    shifted = mission.points - mission.points.min(axis=0) + margin
    length, width = shifted.max(axis=0) + margin
    duration = float(np.sum(np.hypot(*np.diff(shifted, axis=0).T))) / cruise
    points = ", ".join(f"[{x!r}, {y!r}]" for x, y in np.round(shifted, 3).tolist())
    about = (
        f"{len(shifted)} waypoints; x east, y north; the first at {mission.origin[0]:.7f}°, {mission.origin[1]:.7f}°"
    )
    lines = [
        'kind = "scenario"',
        f"name = {quoted(name)}",
        f"title = {quoted(name)}",
        f"provenance = {quoted(about)}",
        f"vehicle = {quoted(vehicle)}",
        f"path_m = [{points}]",
        f"depth_m = {depth!r}",
        f"cruise_m_per_s = {cruise!r}",
        f"cap_m_per_s = {1.25 * cruise!r}",
        f"time_limit_s = {float(np.ceil(2 * duration + 60))!r}",
        "",
        "[site]",
        f"length_m = {float(np.ceil(length))!r}",
        f"width_m = {float(np.ceil(width))!r}",
        f"depth_m = {float(np.ceil(-2 * depth + 1))!r}",
    ]
    text = "\n".join(lines) + "\n"
    scenario_from_table(tomllib.loads(text), source=name)  # a file that `lint` refuses is not written
    return text, tuple(notes)


Places = list[tuple[float, float, float]]


def _plane(latitude: float, longitude: float, origin: tuple[float, float, float]) -> NDArray[np.float64]:
    # x east and y north, with the radii of curvature of the ellipsoid at the origin
    eccentricity = _FLATTENING * (2 - _FLATTENING)
    root = sqrt(1 - eccentricity * sin(radians(origin[0])) ** 2)
    north = _AXIS * (1 - eccentricity) / root**3
    east = _AXIS / root * cos(radians(origin[0]))
    turn = (longitude - origin[1] + 180) % 360 - 180
    return np.array([east * radians(turn), north * radians(latitude - origin[0])])


def _plan(text: str, path: Path) -> tuple[Places, float | None, tuple[str, ...]]:
    try:
        table = json.loads(text)
        items = table["mission"]["items"]
        assert isinstance(items, list)
    except (json.JSONDecodeError, KeyError, TypeError, AssertionError, RecursionError):
        raise InputError("is not a QGroundControl plan", file=shown(path), remedy="give a .plan or .gpx file") from None
    places: Places = []
    speeds: list[tuple[str, float]] = []
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
                latitude, longitude, height = (float(v) for v in params[4:7])
                places.append((latitude, longitude, height))
            elif command == _SPEED:
                speeds.append((number, float(params[1])))
            else:
                skipped.setdefault(f"command {command}", []).append(number)
        except (KeyError, TypeError, ValueError, IndexError):
            remedy = "correct this item in QGroundControl and save the plan again"
            raise InputError(
                "cannot be read", file=shown(path), key=f"item {number}", value=shown(item), remedy=remedy
            ) from None
    notes = [f"not used: item {', '.join(numbers)} ({what})" for what, numbers in skipped.items()]
    speed, of_speeds = _speed(speeds, table["mission"].get("cruiseSpeed"))
    return places, speed, (*notes, *of_speeds)


def _speed(changes: list[tuple[str, float]], cruise: object) -> tuple[float | None, list[str]]:
    """Return the first change of speed of a plan, else its cruise speed [m/s], and notes of what is not used."""
    notes: list[str] = []
    speed: float | None = None
    for number, value in changes:
        if not (isfinite(value) and value > 0):
            notes.append(f"not used: item {number} (speed {value:g} m/s)")
        elif speed is None:
            speed = value
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


def _gpx(text: str, path: Path) -> tuple[Places, float | None, tuple[str, ...]]:
    root = xml_root(text, file=path, remedy="give a .plan or .gpx file")
    groups = [list(rte.iter("rtept")) for rte in root.iter("rte")] + [
        list(trk.iter("trkpt")) for trk in root.iter("trk")
    ]
    groups = [group for group in groups if group] or [list(root.iter("wpt"))]
    notes = (f"{len(groups) - 1} more routes or tracks are not used",) if len(groups) > 1 else ()
    places: Places = []
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
    return places, None, notes
