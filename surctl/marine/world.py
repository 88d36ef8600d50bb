"""Convex shapes (disc, box, wall) in the plane, upright prisms, and their exact distances from a point.

All geometry here is planar: a shape is the section of a body at the robot's depth, and `Heights` defines the
depths that the body occupies. Coordinates are in {E}, with x along the tank and y to the left, in metres and radians.

The z axis points up, so z is negative below the water surface. A prism is the product of a planar set and an interval
of z. So the squared distance of a point to a prism is the sum of the squared distances to the planar set and to the
interval. The clearance of a sphere is the distance of its centre minus its radius.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, hypot, inf, isfinite, isinf, isnan, sin
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_number

__all__ = ["WHOLE", "Box", "Disc", "Heights", "Prism", "Shape", "Vector2", "Wall", "site_walls"]

Vector2: TypeAlias = Sequence[float] | NDArray[np.float64]
"""Two numbers, (x, y) in {E}; shapes store them as a tuple of floats."""


class Shape(ABC):
    """A solid convex set in the plane; subclasses define `foot`."""

    @abstractmethod
    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """Return the signed distance [m] of (x, y), negative inside, and the nearest surface point (x, y) [m]."""

    def nearest(self, point: Vector2) -> tuple[float, NDArray[np.float64]]:
        """Return the signed distance [m] of `point` (2,), negative inside, and the nearest surface point (2,) [m]."""
        distance, x, y = self.foot(float(point[0]), float(point[1]))
        return distance, np.array((x, y))


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
        object.__setattr__(self, "center", _pair("disc.center", self.center))
        object.__setattr__(self, "radius", _positive("disc.radius", self.radius))

    def foot(self, x: float, y: float) -> tuple[float, float, float]:
        """See `Shape.foot`; for a point at the exact centre, the result is the surface point in direction +x."""
        cx, cy = self.center
        dx, dy = x - cx, y - cy
        length = hypot(dx, dy)
        ux, uy = (dx / length, dy / length) if length > 0.0 else (1.0, 0.0)
        return length - self.radius, cx + self.radius * ux, cy + self.radius * uy


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


def site_walls(width: float, length: float) -> tuple[Wall, Wall, Wall, Wall]:
    """Return the walls x = 0, x = length, y = 0, y = width of a rectangular tank whose sides are given in m.

    Raises:
        InputError: a side is not finite or not greater than 0.

    Example:
        >>> from surctl.marine.world import site_walls
        >>> [wall.nearest((1.0, 1.0))[0] for wall in site_walls(3.0, 8.0)]
        [1.0, 7.0, 1.0, 2.0]
    """
    across, along = _positive("site.width", width), _positive("site.length", length)
    return (
        Wall((0.0, 0.0), (1.0, 0.0)),
        Wall((along, 0.0), (-1.0, 0.0)),
        Wall((0.0, 0.0), (0.0, 1.0)),
        Wall((0.0, across), (0.0, -1.0)),
    )


def _pair(key: str, value: Vector2) -> tuple[float, float]:
    if len(value) != 2:
        raise InputError(f"has {len(value)} numbers", key=key, value=value, remedy="give two: x, y in m")
    x, y = float(value[0]), float(value[1])
    if not isfinite(x + y):
        raise InputError("must be finite", key=key, value=(x, y), remedy="give x, y in m")
    return x, y


def _positive(key: str, value: float) -> float:
    check_number(key, value, unit="m")
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
