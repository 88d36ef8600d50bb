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

from collections.abc import Iterable
from math import cos, inf, isfinite, pi, sin

from surctl.errors import InputError
from surctl.world.shapes import Shape, Vector2

__all__ = ["nearest_echo"]

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
        >>> from surctl.world import Disc, nearest_echo
        >>> pillar = Disc((3.0, 0.0), 0.5)
        >>> nearest_echo([pillar], (0.0, 0.0), 0.0, half_angle=math.radians(10))
        2.5
        >>> nearest_echo([pillar], (0.0, 0.0), math.pi / 2, half_angle=math.radians(10))
        inf
    """
    if incidence_limit is None:
        return min((shape.nearest_in_cone(apex, axis, half_angle=half_angle) for shape in shapes), default=inf)
    _check(half_angle, incidence_limit)
    x, y = float(apex[0]), float(apex[1])
    if not isfinite(x + y + axis):
        raise InputError("apex and axis must be finite", key="apex, axis", value=(x, y, axis))
    scene = list(shapes)
    if any(shape.foot(x, y)[0] <= 0.0 for shape in scene):
        return 0.0
    c, s, least = cos(axis), sin(axis), cos(half_angle) - _IN_CONE
    looks = [(cos(axis + turn), sin(axis + turn)) for turn in (half_angle, -half_angle)]
    looks += [e for shape in scene for e in shape.outlook(x, y) if e[0] * c + e[1] * s >= least]
    faced = cos(incidence_limit)
    nearest = inf
    for ex, ey in looks:
        distance, cosine = min((shape.hit(x, y, ex=ex, ey=ey) for shape in scene), default=(inf, 0.0))
        if cosine >= faced:
            nearest = min(nearest, distance)
    return nearest


def _check(half_angle: float, incidence_limit: float) -> None:
    if not 0.0 <= half_angle < pi / 2:
        raise InputError("must lie in [0, pi/2)", key="half_angle", value=half_angle, remedy="give radians")
    if not 0.0 < incidence_limit < pi / 2:
        raise InputError(
            "must lie between 0 and pi/2", key="incidence_limit", value=incidence_limit, remedy="give radians, or None"
        )
