"""Waypoints and geofence of a QGroundControl plan: frames, heights, and what of them a path does not have."""

from __future__ import annotations

from math import cos, isfinite, radians, sin, sqrt
from pathlib import Path
from typing import Any

from surctl.errors import InputError
from surctl.recorded import shown

__all__ = ["Place", "Places", "geofence", "home_position", "metres_per_degree", "unused", "waypoint"]

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

Place = tuple[float, float, float]
"""Latitude and longitude [°], and a height or radius [m]."""
Places = list[Place]


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return metres per degree to the east and to the north, with the radii of curvature of the ellipsoid."""
    eccentricity = _FLATTENING * (2 - _FLATTENING)
    root = sqrt(1 - eccentricity * sin(radians(latitude)) ** 2)
    return radians(_AXIS / root * cos(radians(latitude))), radians(_AXIS * (1 - eccentricity) / root**3)


def home_position(value: object) -> Place | None:
    """Return latitude, longitude [°] and height above the sea [m] of a plan's home; None if it gives none."""
    try:
        latitude, longitude, height = (float(v) for v in value)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        return None
    return latitude, longitude, height


def waypoint(frame: int, numbers: list[float], home: Place | None) -> tuple[Place, list[str]]:
    """Return latitude, longitude and height above the surface of a waypoint, and what of it is not known.

    Args:
        frame: frame of MAVLink.
        numbers: latitude, longitude and height, or three coordinates in metres.
        home: the home position, at the surface.

    Raises:
        InputError: the frame is none of a waypoint, or metres from a home position that does not exist.
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
    east, north = metres_per_degree(home[0])
    return (home[0] + y / north, home[1] + x / east, z), []


def unused(command: int, params: list[Any], item: dict[str, Any]) -> list[str]:
    """Return what of a waypoint changes the motion, and a path does not have."""
    said = {k: float(params[k]) for k in _NOT_USED[command] if k < len(params) and params[k] is not None}
    texts = [_NOT_USED[command][k].format(value) for k, value in said.items() if isfinite(value) and value != 0]
    if command == 17:
        texts.append("loiter without end")
    return texts + (["waits for the operator"] if item.get("autoContinue") is False else [])


def geofence(fence: Any, path: Path) -> tuple[Places, list[str]]:
    """Return the circles of a geofence that exclude, with centre [°] and radius [m], and notes about the rest.

    Raises:
        InputError: the geofence cannot be read.
    """
    zones: Places = []
    notes: list[str] = []
    try:
        circles, polygons = (list((fence or {}).get(key) or []) for key in ("circles", "polygons"))
        for number, part in enumerate(circles, start=1):
            (latitude, longitude), radius = (
                (float(v) for v in part["circle"]["center"]),
                float(part["circle"]["radius"]),
            )
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
