"""The nearest echo of a whole scene, where every surface answers or only one that faces the listener.

With an incidence limit a surface that is met too obliquely sends its echo elsewhere, and still hides what stands
behind it: an oblique box is silent, it is not transparent. So the shapes cannot be asked one by one. What is
nearest then lies in one of few directions: on each face, range and incidence both grow away from its foot point, so
that its best visible point is that foot point, or where the face, the cone, or another shape's shadow ends: at a
corner, on an edge ray, beside a rim. `Shape.outlook` lists them; each is looked along, the first hit counts.

Corners and rims are looked past at 1e-9 rad, which moves a range r by less than 1e-9·r·tan(limit). Shapes may touch.
Where two overlap, the seam between them is not among the directions: a range that is least exactly there comes out as
the next best one.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import cos, inf, isfinite, pi, sin

from surctl.errors import InputError
from surctl.world.shapes import Shape, Vector2

__all__ = ["nearest_echo"]

_IN_CONE = 1e-12  # as `Shape.nearest_in_cone`


def nearest_echo(
    shapes: Iterable[Shape], apex: Vector2, axis: float, *, half_angle: float, incidence_limit: float | None = None
) -> float:
    """Distance from `apex` to the nearest reflecting point with |bearing − axis| ≤ half_angle [m].

    Args:
        shapes: all that is there.
        apex: (2,) [m] in {E}.
        axis: bearing of the cone's axis [rad], counter-clockwise from x of {E}.
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.
        incidence_limit: largest angle [rad], in (0, π/2), between a surface's outward normal and the way back to
            the apex at which it reflects; None: every surface reflects.

    Returns:
        Distance [m]; inf when there is none, 0 when the apex lies inside a shape.

    Raises:
        InputError: an angle out of range, or apex or axis not finite.

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
