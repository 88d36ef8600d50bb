"""The nearest echo of a scene in which every surface reflects, or in which only surfaces that face the sonar reflect.

If the incidence angle at a surface exceeds a limit, the surface reflects the sound away from the sonar, but still hides
the shapes behind it. So `nearest_echo` cannot treat the shapes one by one. Instead, the function examines a few
directions, one of which contains the nearest echo. On each face, range and incidence both increase with the distance
from the foot point, the point of the face nearest to the apex. So the nearest reflecting point of a face is its foot
point if the foot point is visible; otherwise it lies where the visible part of the face ends: at a corner of the face,
on an edge ray of the cone, or at the shadow of another shape's rim. `Shape.outlook` lists the directions to these
points, and `nearest_echo` evaluates the first hit in each direction.

The directions to corners and rims are turned by 1e-9 rad past the corner or rim, which changes a range r by less than
1e-9·r·tan(limit). Shapes may touch each other. If two shapes overlap, the directions do not include the intersection of
their surfaces; if the smallest range is exactly at this intersection, the result is the next larger range.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import cos, hypot, inf, isfinite, pi, sin

from surctl.errors import InputError
from surctl.marine.world.shapes import Box, Shape, Vector2

__all__ = ["box_edges", "in_view", "nearest_echo", "nearest_facing"]

_TOUCHES = 1e-9  # [m] a shape that is nearer than a point by less than this does not hide it
_IN_CONE = 1e-12  # tolerance of `Shape.nearest_in_cone`


def nearest_echo(
    shapes: Iterable[Shape], apex: Vector2, axis: float, *, half_angle: float, incidence_limit: float | None = None
) -> float:
    """Return the distance [m] from `apex` to the nearest reflecting point in the cone |bearing − axis| ≤ half_angle.

    Args:
        shapes: all shapes of the scene.
        apex: (2,) [m] in {E}, position of the sonar.
        axis: bearing of the cone's axis [rad], counter-clockwise from x of {E}.
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.
        incidence_limit: largest angle [rad], in (0, π/2), between a surface's outward normal and the direction to the
            apex at which the surface reflects; None: every surface reflects.

    Returns:
        The distance [m]; inf if there is no echo, 0 if the apex lies inside a shape.

    Raises:
        InputError: an angle is out of range, or apex or axis is not finite.

    Example:
        >>> import math
        >>> from surctl.marine.world import Disc, nearest_echo
        >>> pillar = Disc((3.0, 0.0), 0.5)
        >>> nearest_echo([pillar], (0.0, 0.0), 0.0, half_angle=math.radians(10))
        2.5
        >>> nearest_echo([pillar], (0.0, 0.0), math.pi / 2, half_angle=math.radians(10))
        inf
    """
    if incidence_limit is None:
        return min((shape.nearest_in_cone(apex, axis, half_angle=half_angle) for shape in shapes), default=inf)
    _check(half_angle, incidence_limit)
    scene = list(shapes)
    return nearest_facing(scene, [cos(incidence_limit)] * len(scene), apex, axis, half_angle=half_angle)


def nearest_facing(
    shapes: Sequence[Shape], faced: Sequence[float], apex: Vector2, axis: float, *, half_angle: float
) -> float:
    """Return the distance [m] as `nearest_echo` does, for shapes that answer up to different angles of incidence.

    Args:
        shapes: all shapes of the scene.
        faced: for each shape, the least cosine of incidence at which it reflects; above 1: it only hides other shapes.
        apex: (2,) [m] in {E}, position of the sonar.
        axis: bearing of the cone's axis [rad].
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.

    Example:
        >>> from surctl.marine.world import Box, Disc, nearest_facing
        >>> scene = [Box((3.0, 0.0), (1.0, 1.0)), Disc((2.0, 0.5), 0.1)]
        >>> nearest_facing(scene, [0.9, 2.0], (0.0, 0.0), 0.0, half_angle=0.5)
        2.5
    """
    x, y = float(apex[0]), float(apex[1])
    if not isfinite(x + y + axis):
        raise InputError("apex and axis must be finite", key="apex, axis", value=(x, y, axis))
    if any(shape.foot(x, y)[0] <= 0.0 for shape in shapes):
        return 0.0
    c, s, least = cos(axis), sin(axis), cos(half_angle) - _IN_CONE
    looks = [(cos(axis + turn), sin(axis + turn)) for turn in (half_angle, -half_angle)]
    looks += [e for shape in shapes for e in shape.outlook(x, y) if e[0] * c + e[1] * s >= least]
    nearest = inf
    for ex, ey in looks:
        hits = ((*shape.hit(x, y, ex=ex, ey=ey), limit) for shape, limit in zip(shapes, faced, strict=True))
        distance, cosine, limit = min(hits, key=lambda hit: hit[:2], default=(inf, 0.0, 0.0))
        if cosine >= limit:
            nearest = min(nearest, distance)
    return nearest


def in_view(shapes: Iterable[Shape], apex: Vector2, point: Vector2) -> tuple[float, float, float]:
    """Return the distance [m] from `apex` to `point`, inf if one of the shapes hides it, and the unit vector to it.

    Example:
        >>> from surctl.marine.world import Disc, in_view
        >>> in_view([Disc((3.0, 0.0), 0.5)], (0.0, 0.0), (0.0, 2.0)), in_view([Disc((3.0, 0.0), 0.5)], (0, 0), (4, 0))
        ((2.0, 0.0, 1.0), (inf, 1.0, 0.0))
    """
    x, y = float(apex[0]), float(apex[1])
    dx, dy = point[0] - x, point[1] - y
    distance = hypot(dx, dy)
    ex, ey = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
    hidden = any(shape.hit(x, y, ex=ex, ey=ey)[0] < distance - _TOUCHES for shape in shapes)
    return inf if hidden else distance, ex, ey


def box_edges(box: Box, apex: Vector2) -> list[tuple[float, float] | None]:
    """Return the four vertical edges (x, y) [m] of a box, with None for an edge that the box hides from the apex.

    Example:
        >>> from surctl.marine.world import Box, box_edges
        >>> box_edges(Box((2.0, 0.0), (1.0, 1.0)), (0.0, 0.0))
        [None, None, (1.5, 0.5), (1.5, -0.5)]
    """
    px, py = box.local(float(apex[0]), float(apex[1]))
    (hx, hy), (c, s), (cx, cy) = (0.5 * box.size[0], 0.5 * box.size[1]), (cos(box.angle), sin(box.angle)), box.center
    edges: list[tuple[float, float] | None] = []
    for along, across in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        shown = along * px > hx or across * py > hy
        qx, qy = along * hx, across * hy
        edges.append((cx + c * qx - s * qy, cy + s * qx + c * qy) if shown else None)
    return edges


def _check(half_angle: float, incidence_limit: float) -> None:
    if not 0.0 <= half_angle < pi / 2:
        raise InputError("must lie in [0, pi/2)", key="half_angle", value=half_angle, remedy="give radians")
    if not 0.0 < incidence_limit < pi / 2:
        raise InputError(
            "must lie between 0 and pi/2", key="incidence_limit", value=incidence_limit, remedy="give radians, or None"
        )
