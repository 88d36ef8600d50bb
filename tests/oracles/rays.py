"""Rays and cones against planar shapes, in plain Python.

Every cone query uses one property of a convex set K. Let p be the foot point, the point of K nearest to the apex of the
cone. If p lies in the cone, the echo comes from p. Otherwise, the nearest point of K in the cone lies on one of the
cone's two edge rays: from any point of K strictly inside the cone, a small move towards p stays in K and in the cone,
and reduces the distance. So the foot point p and the hits of the two edge rays give the echo in closed form, and no
other part of K hides this echo.
"""

from __future__ import annotations

from functools import singledispatch
from math import cos, hypot, inf, isfinite, pi, sin, sqrt

from surctl.errors import InputError
from surctl.marine.world import Box, Disc, Shape, Vector2, Wall

_IN_CONE = 1e-12  # tolerance of a cosine, so that a corner exactly on the cone's edge counts as inside
_BESIDE = 1e-9  # [rad] angle between a ray and the corner or rim that it passes, so that rounding cannot change the hit


@singledispatch
def hit(shape: Shape, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
    """Return distance [m] from (x, y) along the unit vector (ex, ey) to the first hit, and the cosine of incidence.

    The distance is inf if there is no hit. The incidence angle is the angle between the outward normal at the hit
    and the direction back to (x, y). The point (x, y) must lie outside the shape.
    """
    raise NotImplementedError


@singledispatch
def outlook(shape: Shape, x: float, y: float) -> list[tuple[float, float]]:
    """Return unit vectors from the point (x, y): the directions in which the nearest echo of a scene may lie.

    The point (x, y) must lie outside the shape. The vectors include, for each face, the direction of its nearest
    reflecting point, and directions 1e-9 rad past the rims of the shape, where other shapes behind it become
    visible.
    """
    raise NotImplementedError


def nearest_in_cone(shape: Shape, apex: Vector2, axis: float, *, half_angle: float) -> float:
    """Return the distance [m] from `apex` to the shape's nearest point in the cone |bearing − axis| ≤ half_angle.

    Args:
        apex: (2,) [m] in {E}.
        axis: bearing of the cone's axis [rad], counter-clockwise from x of {E}.
        half_angle: half the opening angle [rad], 0 ≤ half_angle < π/2.

    Returns:
        The distance [m]; inf if no part of the shape lies in the cone, 0 if the apex lies inside the shape.

    Raises:
        InputError: the half angle is out of range, or apex or axis is not finite.
    """
    x, y = float(apex[0]), float(apex[1])
    if not 0.0 <= half_angle < pi / 2:
        raise InputError("must lie in [0, pi/2)", key="half_angle", value=half_angle, remedy="give radians")
    if not isfinite(x + y + axis):
        raise InputError("apex and axis must be finite", key="apex, axis", value=(x, y, axis))
    distance, fx, fy = shape.foot(x, y)
    if distance <= 0.0:
        return 0.0
    c, s, k, h = cos(axis), sin(axis), cos(half_angle), sin(half_angle)
    if (fx - x) * c + (fy - y) * s >= distance * (k - _IN_CONE):
        return distance
    left = hit(shape, x, y, ex=c * k - s * h, ey=s * k + c * h)[0]
    right = hit(shape, x, y, ex=c * k + s * h, ey=s * k - c * h)[0]
    return min(left, right)


@hit.register
def _hit_of_disc(disc: Disc, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
    cx, cy = disc.center
    dx, dy = cx - x, cy - y
    along, across = dx * ex + dy * ey, dx * ey - dy * ex
    square = disc.radius * disc.radius - across * across
    if along <= 0.0 or square < 0.0:
        return inf, 0.0
    root = sqrt(square)
    return along - root, root / disc.radius


@hit.register
def _hit_of_box(box: Box, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
    """Return: the ray enters the box where it has entered both strips between opposite faces."""
    px, py = box.local(x, y)
    c, s = box._axis
    hx, hy = box._half
    lx, ly = c * ex + s * ey, c * ey - s * ex
    near_x, far_x = _slab(px, lx, half=hx)
    near_y, far_y = _slab(py, ly, half=hy)
    near = max(near_x, near_y)
    if not 0.0 <= near <= min(far_x, far_y):
        return inf, 0.0
    return near, abs(lx) if near_x >= near_y else abs(ly)


@hit.register
def _hit_of_wall(wall: Wall, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
    approach = -(ex * wall.normal[0] + ey * wall.normal[1])
    return (wall.foot(x, y)[0] / approach, approach) if approach > 0.0 else (inf, 0.0)


@outlook.register
def _outlook_of_disc(disc: Disc, x: float, y: float) -> list[tuple[float, float]]:
    """Return: directions to the centre, where incidence and range are least, and past both rims."""
    dx, dy = disc.center[0] - x, disc.center[1] - y
    length = hypot(dx, dy)
    ux, uy, s = dx / length, dy / length, min(1.0, disc.radius / length)
    c = sqrt(1.0 - s * s)
    left, right = (c * ux - s * uy, c * uy + s * ux), (c * ux + s * uy, c * uy - s * ux)
    return [(ux, uy), _beside(*left, 1.0), _beside(*right, -1.0)]


@outlook.register
def _outlook_of_box(box: Box, x: float, y: float) -> list[tuple[float, float]]:
    """Return: directions to the foot point, beside the nearest corner, and past both adjacent corners.

    On a face, range and incidence angle increase with the distance from the foot point. So the point of a face that
    reflects first is the foot point or, if the apex is not in front of the face, the end of the face at the nearest
    corner. A corner itself has no normal, so a corner reflects only as the end of a face that faces the apex (an
    edge alone only scatters sound).
    """
    px, py = box.local(x, y)
    hx, hy = box._half
    cx, cy = (hx if px >= 0.0 else -hx), (hy if py >= 0.0 else -hy)
    directions = []
    if abs(px) <= hx or abs(py) <= hy:
        qx, qy = max(-hx, min(hx, px)) - px, max(-hy, min(hy, py)) - py
        length = hypot(qx, qy)
        directions.append((qx / length, qy / length))
    for corner_x, corner_y in ((cx, cy), (cx, -cy), (-cx, cy)):
        dx, dy = corner_x - px, corner_y - py
        length = hypot(dx, dy)
        # "outward" means away from the centre, which lies at (-px, -py) from the apex
        side = 1.0 if px * dy < py * dx else -1.0
        directions.append(_beside(dx / length, dy / length, side))
        if (corner_x, corner_y) == (cx, cy):
            directions.append(_beside(dx / length, dy / length, -side))
    c, s = box._axis
    return [(c * ux - s * uy, s * ux + c * uy) for ux, uy in directions]


@outlook.register
def _outlook_of_wall(wall: Wall, x: float, y: float) -> list[tuple[float, float]]:
    """Return: only towards the foot point, because a half-plane has no rim at a finite distance."""
    return [(-wall.normal[0], -wall.normal[1])]


def _beside(ux: float, uy: float, side: float) -> tuple[float, float]:
    """Return the unit vector (ux, uy) turned by 1e-9 rad, to the left for `side` = 1, to the right for `side` = −1."""
    return ux - side * _BESIDE * uy, uy + side * _BESIDE * ux


def _slab(position: float, direction: float, *, half: float) -> tuple[float, float]:
    """Return the line parameters at entry to and exit from the strip |coordinate| ≤ half; (inf, −inf) if none."""
    if direction == 0.0:
        return (-inf, inf) if abs(position) <= half else (inf, -inf)
    one, other = (-half - position) / direction, (half - position) / direction
    return (one, other) if one <= other else (other, one)
