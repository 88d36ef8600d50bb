"""The returns of one firing in CasADi symbols for the compiled loop, equal to `certain_range` and `weak_range`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import tan

import casadi as ca

from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.echo import Beam, looks_of
from surctl.marine.sensing.sonar.reflector import Reflector, Surfaces, detection_odds
from surctl.marine.sensing.sonar.returns import LEVEL, level_range, rim
from surctl.marine.sensing.sonar.solids import Solid, SolidBox, SolidDisc, SolidWalls

__all__ = ["certain_range_symbols", "weak_range_symbols"]

_TOUCHES = 1e-9  # [m] as in `in_view`
_LEAST = 1e-30


def certain_range_symbols(
    array: SonarArray,
    beam: Beam,
    bodies: Sequence[tuple[Solid, Reflector]],
    walls: SolidWalls,
    *,
    z: ca.SX,
    surfaces: Surfaces,
) -> ca.SX:
    """Return the distance [m] to the nearest return that is detected with certainty, at most 2·maximum.

    Args:
        array: the sonar array.
        beam: the beam of the firing sensor.
        bodies: the obstacles of the scene with their reflectors.
        walls: the walls of the site.
        z: z of the robot [m].
        surfaces: reflectors of walls, water surface and floor, and the depth of the water.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.sensing import REFLECTORS, SolidWalls, SonarArray, Surfaces
        >>> from surctl.marine.sensing import beam_of, certain_range_symbols
        >>> array, rough, z = SonarArray(), REFLECTORS["diffuse"], ca.SX.sym("z")
        >>> beam = beam_of(array, [0], 0, position=ca.SX([1.0, 1.0]), heading=ca.SX(0.0))
        >>> around = Surfaces((), (rough,) * 4, surface=rough, floor=rough, depth=5.0)
        >>> walls = SolidWalls(ca.SX([0.0, 10.0, 0.0, 5.0]))
        >>> found = certain_range_symbols(array, beam, [], walls, z=z, surfaces=around)
        >>> distance = ca.Function("distance", [z], [found])
        >>> distance(-0.15), distance(-2.0)
        (DM(0.246402), DM(1.64268))
    """
    nothing = 2.0 * array.maximum
    solids: list[Solid] = [*(solid for solid, _ in bodies), walls]
    faced = [ca.SX(reflector.faced(curved=isinstance(solid, SolidDisc))) for solid, reflector in bodies]
    sides = tuple(reflector.faced(curved=False) for reflector in surfaces.walls)

    def first(ray: ca.SX) -> tuple[ca.SX, ca.SX]:
        # distance, and by how much the cosine exceeds the least one
        distance, margin = ca.SX(nothing), ca.SX(-1)
        for solid, least in zip(solids, [*faced, None], strict=True):
            far, facing = solid.hit(beam.apex, ray, nothing=nothing)
            limit = walls.picked(beam.apex, ray, sides) if least is None else least
            nearer = ca.logic_and(solid.present, far < distance)
            distance = ca.if_else(nearer, far, distance)
            margin = ca.if_else(nearer, ca.if_else(facing >= limit, 1.0, -1.0), margin)
        return distance, margin

    looks, inside = looks_of(beam, solids)
    hits = [(ray, looked, *first(ray)) for ray, looked in looks]
    nearest = ca.SX(nothing)
    for _, looked, distance, margin in hits:
        nearest = ca.fmin(nearest, ca.if_else(ca.logic_and(looked, margin > 0), distance, nothing))
    nearest = ca.if_else(inside, 0.0, nearest)
    levels = [(1, surfaces.surface, -z), (-1, surfaces.floor, surfaces.depth + z)]
    levels = [level for level in levels if level_range(array, level[1], side=level[0], gap=1.0) is not None]
    if not levels:
        return nearest
    rays = [(first(beam.axis)[0], 1.0), *((free, ca.dot(ray, beam.axis)) for ray, _, free, _ in hits)]
    for free, cosine in rays:
        for side, reflector, gap in levels:
            rise, level = rim(array, cosine, side=side)
            least = max(reflector.faced(curved=False), LEVEL)
            shown = ca.logic_and(rise >= least, free * rise > ca.fmax(gap, 0.0) * level)
            nearest = ca.fmin(nearest, ca.if_else(shown, ca.fmax(gap, 0.0) / ca.fmax(rise, LEVEL), nothing))
    return nearest


def weak_range_symbols(
    array: SonarArray,
    beam: Beam,
    bodies: Sequence[tuple[ca.SX, Solid, Reflector]],
    walls: SolidWalls,
    *,
    surfaces: Surfaces,
    uniform: Callable[[ca.SX], ca.SX],
) -> ca.SX:
    """Return the distance [m] to the nearest detected edge, cylinder or corner of the site, at most 2·maximum.

    `bodies` are the obstacles with the numbers of their first echoes; see `weak_range`.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.sensing import (
        ...     REFLECTORS, SolidDisc, SolidWalls, SonarArray, Surfaces, beam_of, weak_range_symbols
        ... )
        >>> array, smooth, u = SonarArray(), REFLECTORS["specular"], ca.SX.sym("u")
        >>> wall = REFLECTORS["webots"]
        >>> beam = beam_of(array, [0], 0, position=ca.SX([1.0, 1.0]), heading=ca.SX(0.0))
        >>> around = Surfaces((smooth,), (wall,) * 4, surface=smooth, floor=smooth, depth=5.0)
        >>> pipe, walls = SolidDisc(ca.SX([3.0, 1.0]), ca.SX(0.05)), SolidWalls(ca.SX([0, 10, 0, 5]))
        >>> drawn = {"surfaces": around, "uniform": lambda echo: u}
        >>> distance = weak_range_symbols(array, beam, [(ca.SX(0), pipe, smooth)], walls, **drawn)
        >>> [round(float(ca.Function("distance", [u], [distance])(chance)), 2) for chance in (0.9, 0.99)]
        [1.68, 9.0]
    """
    nothing, tangent = 2.0 * array.maximum, tan(array.half_angle)
    solids = [solid for _, solid, _ in bodies]
    nearest = ca.SX(nothing)
    for i, j in surfaces.corners:
        distance, ray = _in_view(solids, beam.apex, ca.vertcat(walls.walls[i], walls.walls[j]), nothing)
        nearest = ca.fmin(nearest, ca.if_else(beam.holds(ray), distance, nothing))
    for number, solid, reflector in bodies:
        others = [other for other in solids if other is not solid]
        for k, (point, shown, half_range, radius) in enumerate(_parts(solid, reflector, beam.apex)):
            distance, ray = _in_view(others, beam.apex, point, nothing)
            cosine = ca.fmax(ca.dot(ray, beam.axis), 1e-3)
            odds = detection_odds(distance, cosine, half_range=half_range, tangent=tangent, radius=radius)
            shown = ca.logic_and(ca.logic_and(solid.present, shown), beam.holds(ray))
            detected = ca.logic_and(shown, uniform(number + k) * odds < 1.0)
            nearest = ca.fmin(nearest, ca.if_else(detected, distance, nothing))
    return nearest


_Part = tuple[ca.SX, ca.SX, float, ca.SX | None]


def _parts(solid: Solid, reflector: Reflector, apex: ca.SX) -> list[_Part]:
    # point (2, 1), whether the solid shows it to the apex, range of half the detections, and radius of a cylinder
    if isinstance(solid, SolidBox) and reflector.edge_range > 0:
        return [(point, shown, reflector.edge_range, None) for point, shown in solid.edges(apex)]
    if isinstance(solid, SolidDisc) and reflector.cylinder_range:
        away = apex - solid.centre
        length = ca.fmax(ca.sqrt(ca.sumsqr(away)), _LEAST)
        radius = ca.fmax(solid.radius, _LEAST)
        return [(solid.centre + solid.radius * (away / length), ca.SX(1), reflector.cylinder_range, radius)]
    return []


def _in_view(solids: Sequence[Solid], apex: ca.SX, point: ca.SX, nothing: float) -> tuple[ca.SX, ca.SX]:
    to = point - apex
    distance = ca.sqrt(ca.sumsqr(to))
    ray = to / ca.fmax(distance, _LEAST)
    hidden = ca.SX(0)
    for solid in solids:
        far, _ = solid.hit(apex, ray, nothing=nothing)
        hidden = ca.logic_or(hidden, ca.logic_and(solid.present, far < distance - _TOUCHES))
    return ca.if_else(hidden, nothing, distance), ray
