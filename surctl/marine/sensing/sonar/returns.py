"""The returns of one firing in a scene of different reflectors: faces, surface and floor, edges, cylinders, corners.

Several surfaces in a beam answer the same ping, and the module measures the first echo that it detects. So the measured
range is the minimum over the returns that are detected. `certain_range` gives the nearest return that is always
detected. `weak_range` gives the nearest of the other returns, if detected in this firing: edges and cylinders, which
are detected with a probability, and corners of the site.

Upright surfaces are met in the horizontal plane of the sensor: for a beam with pitch 0 this is exact, because the
nearest point of an upright surface in a circular cone about a horizontal axis lies in that plane. The water surface and
the floor answer where the beam is steepest, if no upright surface stands before this point. If one does, the echo is
sought past the rims of the upright surfaces; a beam that meets the level surface above a silent oblique face, between
two rims, can answer a little earlier than the model says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, inf, sin, sqrt, tan
from typing import Any
from zlib import crc32

import casadi as ca

from surctl.errors import InputError
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.reflector import Reflector, Surfaces, detection_odds
from surctl.marine.world import Box, Disc, Shape, Vector2, Wall, box_edges, in_view, nearest_facing

__all__ = ["LEVEL", "certain_range", "corner_points", "echo_number", "level_range", "rim", "weak_range"]

_NAMES = 1 << 20

_IN_CONE = 1e-12
_BESIDE = 1e-3  # least cosine of a bearing from the axis
LEVEL = 1e-6
"""Least sine of the elevation of a ray that meets water surface or floor."""


def certain_range(
    array: SonarArray,
    sensor: int,
    *,
    place: Sequence[float],
    heading: float,
    shapes: Sequence[tuple[Shape, Reflector]],
    surfaces: Surfaces,
) -> float:
    """Return the distance [m] to the nearest return that is detected with certainty; inf if there is none.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        place: (3,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: upright shapes of the scene, walls included, with their reflectors.
        surfaces: reflectors of water surface and floor, and the depth of the water.

    Raises:
        InputError: if the sensor does not exist, or the place or heading is not finite.

    Example:
        >>> from surctl.marine.sensing import REFLECTORS, SonarArray, Surfaces, certain_range
        >>> rough, smooth = REFLECTORS["diffuse"], REFLECTORS["specular"]
        >>> beam = {"place": (1.0, 1.0, -0.15), "heading": 0.0, "shapes": []}
        >>> for surface in (rough, smooth):
        ...     around = Surfaces((), (rough,) * 4, surface=surface, floor=smooth, depth=5.0)
        ...     print(round(certain_range(SonarArray(), 0, surfaces=around, **beam), 3))
        0.246
        inf
    """
    x, y, axis = array.apex(sensor, position=place, heading=heading)
    if not abs(x + y + axis) < inf:
        raise InputError("position and heading must be finite", key="place", value=(*place, heading))
    scene = [shape for shape, _ in shapes]
    faced = [reflector.faced(curved=isinstance(shape, Disc)) for shape, reflector in shapes]
    nearest = min(
        nearest_facing(scene, faced, (x, y), axis + offset, half_angle=half) for offset, half in array.cones[sensor]
    )
    levels = [(1, surfaces.surface, -place[2]), (-1, surfaces.floor, surfaces.depth + place[2])]
    levels = [level for level in levels if level_range(array, level[1], side=level[0], gap=1.0) is not None]
    if not levels:
        return nearest
    ahead = (cos(axis), sin(axis))
    for ex, ey in [ahead, *(ray for shape in scene for ray in shape.outlook(x, y))]:
        cosine = ex * ahead[0] + ey * ahead[1]
        free = min((shape.hit(x, y, ex=ex, ey=ey)[0] for shape in scene), default=inf)
        for side, reflector, gap in levels:
            rise, level = rim(array, cosine, side=side)
            if rise >= max(reflector.faced(curved=False), LEVEL) and free * rise > max(gap, 0.0) * level:
                nearest = min(nearest, max(gap, 0.0) / rise)
    return nearest


def level_range(array: SonarArray, reflector: Reflector, *, side: int, gap: float) -> float | None:
    """Return the range [m] of the return of the water surface (`side` 1) or floor (−1) that is `gap` [m] away.

    The result is None if it does not answer in the beam.

    Example:
        >>> from surctl.marine.sensing import REFLECTORS, SonarArray, level_range
        >>> rough = {"reflector": REFLECTORS["diffuse"], "side": 1, "gap": 0.15}
        >>> level_range(SonarArray(pitch=-0.32), **rough)  # 20° and steeper answers
        >>> round(level_range(SonarArray(), **rough), 3)
        0.246
    """
    rise, _ = rim(array, 1.0, side=side)
    return gap / rise if rise >= max(reflector.faced(curved=False), LEVEL) else None


def rim(array: SonarArray, cosine: Any, *, side: int) -> tuple[Any, Any]:
    """Return sine and cosine of the elevation at which the beam is steepest, upwards (`side` 1) or downwards (−1).

    Args:
        array: the sonar array.
        cosine: cosine of the bearing from the beam's axis, a number or a CasADi symbol.
        side: 1 for upwards, −1 for downwards; elevations count in this direction.

    Example:
        >>> from math import asin, cos, degrees, radians
        >>> from surctl.marine.sensing import SonarArray, rim
        >>> [round(degrees(asin(rim(SonarArray(), cos(radians(aside)), side=1)[0])), 1) for aside in (0, 30, 37.5)]
        [37.5, 23.6, 0.0]
    """
    pitch = side * array.pitch
    up, half = sin(pitch), cos(0.5 * array.beam_angle)
    symbolic = isinstance(cosine, ca.SX)
    larger, either = (ca.fmax, ca.if_else) if symbolic else (max, lambda holds, yes, no: yes if holds else no)
    along = larger(cosine, _BESIDE) * cos(pitch)
    size = along * along + up * up
    inside = size - half * half  # below 0 beside the beam
    root = (ca.sqrt if symbolic else sqrt)(larger(inside, 0.0))
    level = (along * half - up * root) / size
    rise = either(level < 0, 1.0, (up * half + along * root) / size)  # the beam contains the vertical
    return either(inside < 0, 0.0, rise), larger(level, 0.0)


def weak_range(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    bodies: Sequence[tuple[int, Shape, Reflector]],
    corners: Sequence[Vector2],
    uniform: Callable[[int], float],
) -> float:
    """Return the distance [m] to the nearest detected edge, cylinder or corner of the site; inf if there is none.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        bodies: the obstacles of the scene: number of their first echo (`echo_number`), shape, and reflector.
        corners: corners of the site that answer (with certainty), from `corner_points`.
        uniform: function that returns the random number in (0, 1) of an echo, by its number: that of the obstacle's
            first echo, plus the number of the edge.

    Example:
        >>> from surctl.marine.sensing import REFLECTORS, SonarArray, weak_range
        >>> from surctl.marine.world import Disc
        >>> pipe = (0, Disc((3.0, 1.0), 0.05), REFLECTORS["specular"])
        >>> beam = {"position": (1.0, 1.0), "heading": 0.0, "bodies": [pipe], "corners": []}
        >>> [round(weak_range(SonarArray(), 0, uniform=lambda echo: u, **beam), 2) for u in (0.9, 0.99)]  # P is 0.92
        [1.68, inf]
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    ahead, tangent, nearest = (cos(axis), sin(axis)), tan(array.half_angle), inf
    cones = [(cos(axis + o), sin(axis + o), cos(half) - _IN_CONE) for o, half in array.cones[sensor]]
    shapes = [shape for _, shape, _ in bodies]

    def holds(ex: float, ey: float) -> bool:
        return any(ex * c + ey * s >= least for c, s, least in cones)

    for point in corners:
        distance, ex, ey = in_view(shapes, (x, y), point)
        if holds(ex, ey):
            nearest = min(nearest, distance)
    for number, shape, reflector in bodies:
        others = [other for other in shapes if other is not shape]
        if isinstance(shape, Box) and reflector.edge_range > 0:
            points, half_range, radius = box_edges(shape, (x, y)), reflector.edge_range, None
        elif isinstance(shape, Disc) and reflector.cylinder_range:
            _, px, py = shape.foot(x, y)
            points, half_range, radius = [(px, py)], reflector.cylinder_range, shape.radius
        else:
            continue
        for k, place in enumerate(points):
            if place is None:
                continue
            distance, ex, ey = in_view(others, (x, y), place)
            if not holds(ex, ey) or distance >= nearest:
                continue
            cosine = ex * ahead[0] + ey * ahead[1]
            odds = detection_odds(distance, cosine, half_range=half_range, tangent=tangent, radius=radius)
            if uniform(number + k) * odds < 1.0:
                nearest = distance
    return nearest


def echo_number(name: str) -> int:
    """Return the number of the first weak echo of an obstacle, from its name.

    So an obstacle has the same random numbers whatever other obstacles the scenario has.

    Example:
        >>> from surctl.marine.sensing import echo_number
        >>> echo_number("OS1"), echo_number("OS2")
        (3962120, 1651680)
    """
    return 4 * (crc32(name.encode()) % _NAMES)  # a box has four edges


def corner_points(walls: Sequence[Wall], surfaces: Surfaces) -> list[tuple[float, float]]:
    """Return the corners (x, y) [m] of the site that answer from any direction; see `Surfaces.corners`.

    Example:
        >>> from surctl.marine.sensing import REFLECTORS, Surfaces, corner_points
        >>> from surctl.marine.world import site_walls
        >>> smooth = REFLECTORS["specular"]
        >>> corner_points(site_walls(2.0, 3.0), Surfaces((), (smooth,) * 4, smooth, smooth, depth=1.0))
        [(0.0, 0.0), (0.0, 2.0), (3.0, 0.0), (3.0, 2.0)]
    """
    return [(walls[i].point[0], walls[j].point[1]) for i, j in surfaces.corners]
