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

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from math import cos, hypot, inf, isfinite, isinf, isnan, pi, sin, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = [
    "WHOLE",
    "Box",
    "Disc",
    "Heights",
    "Prism",
    "Shape",
    "Vector2",
    "Wall",
    "box_edges",
    "in_view",
    "nearest_echo",
    "nearest_facing",
    "site_walls",
]

# Convex shapes and their exact distances, in the horizontal plane at the robot's depth.
#
# All geometry here is planar: a shape is the section of a body at the robot's depth, and `prism.Heights` defines the
# depths that the body occupies. Coordinates are in {E}, with x along the tank and y to the left, in metres and radians.
#
# Every cone query uses one property of a convex set K. Let p be the foot point, the point of K nearest to the apex of
# the cone. If p lies in the cone, the echo comes from p. Otherwise, the nearest point of K in the cone lies on one of
# the cone's two edge rays: from any point of K strictly inside the cone, a small move towards p stays in K and in the
# cone, and reduces the distance. So the foot point p and the hits of the two edge rays give the echo in closed form,
# and no other part of K hides this echo.
#
# If only surfaces that face the apex reflect, `echoes.nearest_echo` casts rays along the `outlook` of every shape.
#
# The z axis points up, so z is negative below the water surface. A prism is the product of a planar set and an interval
# of z. So the squared distance of a point to a prism is the sum of the squared distances to the planar set and to the
# interval. The clearance of a sphere is the distance of its centre minus its radius.


Vector2: TypeAlias = Sequence[float] | NDArray[np.float64]
"""Two numbers, (x, y) in {E}; shapes store them as a tuple of floats."""

_IN_CONE = 1e-12  # tolerance of a cosine, so that a corner exactly on the cone's edge counts as inside
_BESIDE = 1e-9  # [rad] angle between a ray and the corner or rim that it passes, so that rounding cannot change the hit


class Shape(ABC):
    """A solid convex set in the plane; subclasses define `foot`, `hit`, `outlook` and `moved`."""

    @abstractmethod
    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """Return the signed distance [m] of (x, y), negative inside, and the nearest surface point (x, y) [m]."""

    @abstractmethod
    def hit(self, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
        """Return distance [m] from (x, y) along the unit vector (ex, ey) to the first hit, and the cosine of incidence.

        The distance is inf if there is no hit. The incidence angle is the angle between the outward normal at the hit
        and the direction back to (x, y). The point (x, y) must lie outside the shape.
        """

    @abstractmethod
    def outlook(self, x: float, y: float) -> list[tuple[float, float]]:
        """Return unit vectors from the point (x, y): the directions in which the nearest echo of a scene may lie.

        The point (x, y) must lie outside the shape. The vectors include, for each face, the direction of its nearest
        reflecting point, and directions 1e-9 rad past the rims of the shape, where other shapes behind it become
        visible.
        """

    @abstractmethod
    def moved(self, offset: Vector2) -> Shape:
        """Return a copy of the shape, displaced by `offset` (2,) [m] in {E}."""

    def ray(self, x: float, y: float, *, ex: float, ey: float) -> float:
        """Return the distance [m] that `hit` returns, without the cosine of incidence."""
        return self.hit(x, y, ex=ex, ey=ey)[0]

    def nearest(self, point: Vector2) -> tuple[float, NDArray[np.float64]]:
        """Return the signed distance [m] of `point` (2,), negative inside, and the nearest surface point (2,) [m]."""
        distance, x, y = self.foot(float(point[0]), float(point[1]))
        return distance, np.array((x, y))

    def nearest_in_cone(self, apex: Vector2, axis: float, *, half_angle: float) -> float:
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
        distance, fx, fy = self.foot(x, y)
        if distance <= 0.0:
            return 0.0
        c, s, k, h = cos(axis), sin(axis), cos(half_angle), sin(half_angle)
        if (fx - x) * c + (fy - y) * s >= distance * (k - _IN_CONE):
            return distance
        left = self.ray(x, y, ex=c * k - s * h, ey=s * k + c * h)
        right = self.ray(x, y, ex=c * k + s * h, ey=s * k - c * h)
        return min(left, right)


@dataclass(frozen=True)
class Disc(Shape):
    """The section of an upright cylinder, or of a sphere, at the robot's depth.

    Attributes:
        center: centre (2,) [m] in {E}.
        radius: radius of the section [m], greater than 0.
    """

    center: Vector2
    radius: float

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        object.__setattr__(self, "center", _pair("disc.center", self.center))
        object.__setattr__(self, "radius", _positive("disc.radius", self.radius))

    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """See `Shape.foot`; for a point at the exact centre, the result is the surface point in direction +x."""
        cx, cy = self.center
        dx, dy = x - cx, y - cy
        length = hypot(dx, dy)
        ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
        return length - self.radius, cx + self.radius * ux, cy + self.radius * uy

    def hit(self, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
        """See `Shape.hit`."""
        cx, cy = self.center
        dx, dy = cx - x, cy - y
        along, across = dx * ex + dy * ey, dx * ey - dy * ex
        square = self.radius * self.radius - across * across
        if along <= 0.0 or square < 0.0:
            return inf, 0.0
        root = sqrt(square)
        return along - root, root / self.radius

    def outlook(self, x: float, y: float) -> list[tuple[float, float]]:
        """See `Shape.outlook`: directions to the centre, where incidence and range are least, and past both rims."""
        dx, dy = self.center[0] - x, self.center[1] - y
        length = hypot(dx, dy)
        ux, uy, s = dx / length, dy / length, min(1.0, self.radius / length)
        c = sqrt(1.0 - s * s)
        left, right = (c * ux - s * uy, c * uy + s * ux), (c * ux + s * uy, c * uy - s * ux)
        return [(ux, uy), _beside(*left, 1.0), _beside(*right, -1.0)]

    def moved(self, offset: Vector2) -> Disc:
        """See `Shape.moved`."""
        return replace(self, center=_shifted(self.center, offset))


@dataclass(frozen=True)
class Box(Shape):
    """The section of an upright box at the robot's depth.

    Attributes:
        center: centre (2,) [m] in {E}.
        size: full lengths (2,) [m] along the box's own x and y axes, each greater than 0.
        angle: angle from x of {E} to the box's x axis [rad], counter-clockwise.
    """

    center: Vector2
    size: Vector2
    angle: float = 0.0
    _axis: tuple[float, float] = field(init=False, repr=False, compare=False)
    _half: tuple[float, float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        object.__setattr__(self, "center", _pair("box.center", self.center))
        size = _pair("box.size", self.size)
        angle = float(self.angle)
        if not isfinite(angle):
            raise InputError("must be finite", key="box.angle", value=angle, remedy="give radians")
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "angle", angle)
        object.__setattr__(self, "_axis", (cos(angle), sin(angle)))
        object.__setattr__(self, "_half", tuple(0.5 * _positive("box.size", edge) for edge in size))

    def local(self, x: float, y: float) -> tuple[float, float]:
        """Return the coordinates (x, y) [m] of a point of {E} along the box's own axes, from its centre."""
        (c, s), (cx, cy) = self._axis, self.center
        dx, dy = x - cx, y - cy
        return c * dx + s * dy, c * dy - s * dx

    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """See `Shape.foot`; for a point inside, the result is on the nearest face (an x face if equally near)."""
        px, py = self.local(x, y)
        hx, hy = self._half
        qx, qy = max(-hx, min(hx, px)), max(-hy, min(hy, py))
        distance = hypot(px - qx, py - qy)
        if distance == 0.0:
            outside_x, outside_y = abs(px) - hx, abs(py) - hy
            distance = max(outside_x, outside_y)
            if outside_x >= outside_y:
                qx = hx if px >= 0.0 else -hx
            else:
                qy = hy if py >= 0.0 else -hy
        (c, s), (cx, cy) = self._axis, self.center
        return distance, cx + c * qx - s * qy, cy + s * qx + c * qy

    def hit(self, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
        """See `Shape.hit`; the ray enters the box where it has entered both strips between opposite faces."""
        px, py = self.local(x, y)
        c, s = self._axis
        hx, hy = self._half
        lx, ly = c * ex + s * ey, c * ey - s * ex
        near_x, far_x = _slab(px, lx, half=hx)
        near_y, far_y = _slab(py, ly, half=hy)
        near = max(near_x, near_y)
        if not 0.0 <= near <= min(far_x, far_y):
            return inf, 0.0
        return near, abs(lx) if near_x >= near_y else abs(ly)

    def outlook(self, x: float, y: float) -> list[tuple[float, float]]:
        """See `Shape.outlook`: directions to the foot point, beside the nearest corner, and past both adjacent corners.

        On a face, range and incidence angle increase with the distance from the foot point. So the point of a face that
        reflects first is the foot point or, if the apex is not in front of the face, the end of the face at the nearest
        corner. A corner itself has no normal, so a corner reflects only as the end of a face that faces the apex (an
        edge alone only scatters sound).
        """
        px, py = self.local(x, y)
        hx, hy = self._half
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
        c, s = self._axis
        return [(c * ux - s * uy, s * ux + c * uy) for ux, uy in directions]

    def moved(self, offset: Vector2) -> Box:
        """See `Shape.moved`."""
        return replace(self, center=_shifted(self.center, offset))


@dataclass(frozen=True)
class Wall(Shape):
    """A half-plane: all points behind the line through `point`.

    Attributes:
        point: (2,) any point of the surface [m] in {E}.
        normal: (2,) vector into the water, of any length greater than 0; the shape stores the unit vector.
    """

    point: Vector2
    normal: Vector2

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        nx, ny = _pair("wall.normal", self.normal)
        length = hypot(nx, ny)
        if length == 0.0:
            raise InputError("has no direction", key="wall.normal", value=(nx, ny), remedy="point it into the water")
        object.__setattr__(self, "point", _pair("wall.point", self.point))
        object.__setattr__(self, "normal", (nx / length, ny / length))

    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """See `Shape.foot`."""
        (px, py), (nx, ny) = self.point, self.normal
        distance = (x - px) * nx + (y - py) * ny
        return distance, x - distance * nx, y - distance * ny

    def hit(self, x: float, y: float, *, ex: float, ey: float) -> tuple[float, float]:
        """See `Shape.hit`."""
        approach = -(ex * self.normal[0] + ey * self.normal[1])
        return (self.foot(x, y)[0] / approach, approach) if approach > 0.0 else (inf, 0.0)

    def outlook(self, x: float, y: float) -> list[tuple[float, float]]:
        """See `Shape.outlook`: only towards the foot point, because a half-plane has no rim at a finite distance."""
        return [(-self.normal[0], -self.normal[1])]

    def moved(self, offset: Vector2) -> Wall:
        """See `Shape.moved`."""
        return replace(self, point=_shifted(self.point, offset))


def site_walls(width: float, length: float) -> tuple[Wall, Wall, Wall, Wall]:
    """Return the walls x = 0, x = length, y = 0, y = width of the rectangular tank [0, length] × [0, width] [m].

    Raises:
        InputError: a side is not finite or not greater than 0.

    Example:
        >>> from surctl.marine.world import nearest_echo, site_walls
        >>> walls = site_walls(3.0, 8.0)
        >>> nearest_echo(walls, (1.0, 1.0), 0.0, half_angle=0.1)
        7.0
    """
    across, along = _positive("site.width", width), _positive("site.length", length)
    return (
        Wall((0.0, 0.0), (1.0, 0.0)),
        Wall((along, 0.0), (-1.0, 0.0)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        Wall((0.0, across), (0.0, -1.0)),
    )


def _beside(ux: float, uy: float, side: float) -> tuple[float, float]:
    """Return the unit vector (ux, uy) turned by 1e-9 rad, to the left for `side` = 1, to the right for `side` = −1."""
    return ux - side * _BESIDE * uy, uy + side * _BESIDE * ux


def _slab(position: float, direction: float, *, half: float) -> tuple[float, float]:
    """Return the line parameters at entry to and exit from the strip |coordinate| ≤ half; (inf, −inf) if none."""
    if direction == 0.0:
        return (-inf, inf) if abs(position) <= half else (inf, -inf)
    one, other = (-half - position) / direction, (half - position) / direction
    return (one, other) if one <= other else (other, one)


def _shifted(point: Vector2, offset: Vector2) -> tuple[float, float]:
    dx, dy = _pair("offset", offset)
    return point[0] + dx, point[1] + dy


def _pair(key: str, value: Vector2) -> tuple[float, float]:
    if len(value) != 2:
        raise InputError(f"has {len(value)} numbers", key=key, value=value, remedy="give two: x, y in m")
    x, y = float(value[0]), float(value[1])
    if not isfinite(x + y):
        raise InputError("must be finite", key=key, value=(x, y), remedy="give x, y in m")
    return x, y


def _positive(key: str, value: float) -> float:
    if not (isfinite(value) and value > 0):
        raise InputError("must be greater than 0", key=key, value=value, remedy="give m")
    return float(value)


@dataclass(frozen=True)
class Heights:
    """The interval of z [m] that a body occupies; an infinite end lies beyond the floor or the water surface.

    Attributes:
        bottom, top: z of the lower and the upper end [m], bottom < top.
    """

    bottom: float = -inf
    top: float = inf

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if isnan(self.bottom) or isnan(self.top) or self.bottom >= self.top:
            raise InputError(
                f"is not below the top, {self.top:g}",
                key="bottom",
                value=self.bottom,
                remedy="z is up: write z of both ends (negative below the surface), with the lower one as bottom",
            )

    @property
    def whole(self) -> bool:
        """Whether the body occupies the whole water column."""
        return isinf(self.bottom) and isinf(self.top)

    def gap(self, z: float) -> float:
        """Return the signed vertical distance [m] from z to the interval, negative if z lies inside the interval."""
        return max(self.bottom - z, z - self.top)

    def crosses(self, z: float, distance: float) -> bool:
        """Return whether any part of the interval lies less than `distance` [m] above or below z."""
        return self.gap(z) < distance

    def shares(self, other: Heights) -> bool:
        """Return whether the intervals of two bodies have a depth in common."""
        return self.bottom < other.top and other.bottom < self.top


WHOLE = Heights()
"""The whole water column."""


@dataclass(frozen=True)
class Prism:
    """An upright solid with the horizontal section `base` at every depth of `heights`."""

    base: Shape
    heights: Heights = WHOLE

    def distance(self, x: float, y: float, z: float) -> float:
        """Return the signed distance [m] of a point in {E} to the prism; negative if the point lies inside."""
        across = self.base.foot(x, y)[0]
        if self.heights.whole:
            return across
        along = self.heights.gap(z)
        if across <= 0.0 or along <= 0.0:
            return max(across, along)
        return hypot(across, along)


_TOUCHES = 1e-9  # [m] a shape that is nearer than a point by less than this does not hide it


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
