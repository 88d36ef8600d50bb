"""Reflecting shapes (disc, box, walls) in CasADi symbols: where a ray or cone of the compiled loop meets them.

If a ray or cone does not meet a shape, the range is `nothing`, a value beyond the sensor's maximum. Every branch of an
if_else is finite for finite inputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from math import cos

import casadi as ca


def turned(heading: ca.SX, angle: float | ca.SX) -> ca.SX:
    """Return the unit vector in the direction ψ + angle, where `heading` is (cos ψ, sin ψ)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(c * heading[0] - s * heading[1], s * heading[0] + c * heading[1])


def wall_range(
    axis: ca.SX,
    normal: tuple[float, float],
    *,
    distance: ca.SX,
    half_angle: float | ca.SX,
    nothing: float,
    incidence: float | None = None,
    sides: tuple[ca.SX, ca.SX] | None = None,
) -> ca.SX:
    """Return the range [m] to a wall within a cone; `nothing` if the cone does not meet the wall.

    `distance` [m] is perpendicular to the wall, and `normal` points out of the water. With `incidence` [rad], only the
    directions within this angle of the normal count; `sides` are then the distances [m] from the apex to the end of the
    wall on the left of the normal, and to its end on the right.
    """
    along = axis[0] * normal[0] + axis[1] * normal[1]
    across = ca.fabs(axis[0] * normal[1] - axis[1] * normal[0])
    # cosine of the angle between the wall's perpendicular and the nearer edge ray
    edge = along * ca.cos(half_angle) + across * ca.sin(half_angle)
    slant = distance / ca.fmax(edge, 1e-9)
    if incidence is None or sides is None:
        outside = ca.if_else(edge > 1e-9, slant, nothing)
    else:
        # the wall ends where it meets the next wall
        left = axis[1] * normal[0] - axis[0] * normal[1] > 0
        past = slant * slant - distance * distance > ca.if_else(left, sides[0] * sides[0], sides[1] * sides[1])
        outside = ca.if_else(ca.logic_and(edge >= cos(incidence), ca.logic_not(past)), slant, nothing)
    nearest = ca.if_else(along >= ca.cos(half_angle), distance, outside)
    return ca.fmin(ca.fmax(nearest, 0.0), nothing)


def disc_range(axis: ca.SX, to: ca.SX, *, radius: ca.SX, half_angle: float | ca.SX, nothing: float) -> ca.SX:
    """Return the range [m] to a disc within a cone; `nothing` if the cone does not meet the disc.

    The centre of the disc has the offset `to` (2,) [m] from the apex.
    """
    length = ca.sqrt(ca.dot(to, to))
    inside_cone = ca.dot(to, axis) >= length * ca.cos(half_angle)
    edges: ca.SX = ca.SX(nothing)
    for angle in (half_angle, -half_angle):
        ray = turned(axis, angle)
        along, across = ca.dot(to, ray), to[0] * ray[1] - to[1] * ray[0]
        square = radius * radius - across * across
        hits = ca.logic_and(along > 0, square >= 0)
        edges = ca.fmin(edges, ca.if_else(hits, along - ca.sqrt(ca.fmax(square, 0.0)), nothing))
    nearest = ca.if_else(inside_cone, length - radius, edges)
    return ca.fmax(0.0, ca.if_else(length <= radius, 0.0, nearest))


_IN_CONE = 1e-12  # tolerance of a cosine, so that a corner exactly on the cone's edge counts as inside
_BESIDE = 1e-9  # [rad] angle between a ray and the corner or rim that it passes, so that rounding cannot change the hit
_PARALLEL = 1e-30  # replaces a direction component of 0, so that the ray crosses the slab very far away
_LEAST = 1e-30  # m, lower limit of a length used as divisor


@dataclass(frozen=True, eq=False)
class Cone:
    """A part of a beam: its axis as a unit vector (2, 1) in {E}, and half its opening angle [rad], below π/2."""

    axis: ca.SX
    half_angle: float | ca.SX

    @property
    def edges(self) -> tuple[ca.SX, ca.SX]:
        """Unit vectors along the left and the right edge of the cone."""
        return turned(self.axis, self.half_angle), turned(self.axis, -self.half_angle)

    def holds(self, ray: ca.SX) -> ca.SX:
        """Return whether a unit vector (2, 1) lies in the cone."""
        return ca.dot(ray, self.axis) >= ca.cos(self.half_angle) - _IN_CONE


class Solid(ABC):
    """A reflecting shape: the distances and directions of its surface as seen from an apex."""

    present: ca.SX
    """1 if the shape is present, else 0."""

    @abstractmethod
    def nearest_in_cone(self, apex: ca.SX, cone: Cone, *, nothing: float) -> ca.SX:
        """Return the distance [m] from the apex (2, 1) to the shape's nearest point in the cone; 0 inside the shape."""

    @abstractmethod
    def holds(self, apex: ca.SX) -> ca.SX:
        """Return whether the apex lies inside the shape."""

    @abstractmethod
    def hit(self, apex: ca.SX, ray: ca.SX, *, nothing: float) -> tuple[ca.SX, ca.SX]:
        """Return the distance [m] along the unit vector `ray` (2, 1) to the first hit, and the cosine of incidence."""

    @abstractmethod
    def outlook(self, apex: ca.SX) -> list[ca.SX]:
        """Return unit vectors (2, 1) from the apex: the directions in which the nearest echo of a scene may lie."""


@dataclass(frozen=True, eq=False)
class SolidDisc(Solid):
    """A `Disc` in CasADi symbols: centre (2, 1) and radius [m]."""

    centre: ca.SX
    radius: ca.SX
    present: ca.SX = field(default_factory=lambda: ca.SX(1))

    def nearest_in_cone(self, apex: ca.SX, cone: Cone, *, nothing: float) -> ca.SX:
        """See `Solid.nearest_in_cone`."""
        return disc_range(
            cone.axis, self.centre - apex, radius=self.radius, half_angle=cone.half_angle, nothing=nothing
        )

    def holds(self, apex: ca.SX) -> ca.SX:
        """See `Solid.holds`."""
        return ca.sqrt(ca.sumsqr(self.centre - apex)) <= self.radius

    def hit(self, apex: ca.SX, ray: ca.SX, *, nothing: float) -> tuple[ca.SX, ca.SX]:
        """See `Solid.hit`."""
        to = self.centre - apex
        along, across = ca.dot(to, ray), to[0] * ray[1] - to[1] * ray[0]
        square = self.radius * self.radius - across * across
        root = ca.sqrt(ca.fmax(square, 0.0))
        hits = ca.logic_and(along > 0, square >= 0)
        return ca.if_else(hits, along - root, nothing), root / ca.fmax(self.radius, _LEAST)

    def outlook(self, apex: ca.SX) -> list[ca.SX]:
        """See `Solid.outlook`: directions to the centre, and just past both sides of the disc."""
        to = self.centre - apex
        length = ca.fmax(ca.sqrt(ca.sumsqr(to)), _LEAST)
        ray, s = to / length, ca.fmin(1.0, self.radius / length)
        c = ca.sqrt(1.0 - s * s)
        return [ray, *(_beside(c * ray + side * s * _left(ray), side) for side in (1.0, -1.0))]


@dataclass(frozen=True, eq=False)
class SolidBox(Solid):
    """A `Box` in CasADi symbols: centre (2, 1) [m]; edge lengths `size` (2, 1) [m]; angle of the box in {E} [rad]."""

    centre: ca.SX
    size: ca.SX
    angle: ca.SX | float = 0.0
    present: ca.SX = field(default_factory=lambda: ca.SX(1))

    def nearest_in_cone(self, apex: ca.SX, cone: Cone, *, nothing: float) -> ca.SX:
        """See `Solid.nearest_in_cone`."""
        half, here = 0.5 * self.size, self._local(apex - self.centre)
        offset = ca.fmin(ca.fmax(here, -half), half) - here
        distance = ca.sqrt(ca.sumsqr(offset))
        in_cone = ca.dot(offset, self._local(cone.axis)) >= distance * (ca.cos(cone.half_angle) - _IN_CONE)
        edges = ca.SX(nothing)
        for edge in cone.edges:
            edges = ca.fmin(edges, self._entry(here, self._local(edge), nothing)[0])
        return ca.if_else(distance <= 0, 0.0, ca.if_else(in_cone, distance, edges))

    def holds(self, apex: ca.SX) -> ca.SX:
        """See `Solid.holds`."""
        beyond = ca.fabs(self._local(apex - self.centre)) - 0.5 * self.size
        return ca.fmax(beyond[0], beyond[1]) <= 0

    def hit(self, apex: ca.SX, ray: ca.SX, *, nothing: float) -> tuple[ca.SX, ca.SX]:
        """See `Solid.hit`."""
        return self._entry(self._local(apex - self.centre), self._local(ray), nothing)

    def outlook(self, apex: ca.SX) -> list[ca.SX]:
        """See `Solid.outlook`: directions to the foot point of a face, and just beside the three nearest corners."""
        half, here = 0.5 * self.size, self._local(apex - self.centre)
        corner = ca.if_else(here >= 0, half, -half)
        either = _towards(corner - here)
        rays = [_beside(either, 1.0), _beside(either, -1.0)]
        on_face = ca.logic_or(ca.fabs(here[0]) <= half[0], ca.fabs(here[1]) <= half[1])
        foot = _towards(ca.fmin(ca.fmax(here, -half), half) - here)
        rays.append(ca.if_else(on_face, foot, rays[0]))
        for mirrored in ((1.0, -1.0), (-1.0, 1.0)):
            to = ca.DM(mirrored) * corner - here
            side = ca.if_else(here[0] * to[1] < here[1] * to[0], 1.0, -1.0)
            rays.append(_beside(_towards(to), side))
        return [self._global(ray) for ray in rays]

    def edges(self, apex: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
        """Return the vertical edges (2, 1) [m], each with 1 if the box does not hide it; see `box_edges`."""
        half, here = 0.5 * self.size, self._local(apex - self.centre)
        edges = []
        for along, across in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            shown = ca.logic_or(along * here[0] > half[0], across * here[1] > half[1])
            edges.append((self.centre + self._global(ca.vertcat(along * half[0], across * half[1])), shown))
        return edges

    def _entry(self, here: ca.SX, ray: ca.SX, nothing: float) -> tuple[ca.SX, ca.SX]:
        # slab method in the frame of the box: distance [m] and cosine of the incidence angle
        half = 0.5 * self.size
        ray = ca.if_else(ray == 0, _PARALLEL, ray)
        one, other = (-half - here) / ray, (half - here) / ray
        near, far = ca.fmin(one, other), ca.fmax(one, other)
        first, last = ca.fmax(near[0], near[1]), ca.fmin(far[0], far[1])
        hits = ca.logic_and(first >= 0, first <= last)
        cosine = ca.if_else(near[0] >= near[1], ca.fabs(ray[0]), ca.fabs(ray[1]))
        return ca.if_else(hits, first, nothing), cosine

    def _local(self, vector: ca.SX) -> ca.SX:
        return vector if _is_zero(self.angle) else turned(vector, -self.angle)

    def _global(self, vector: ca.SX) -> ca.SX:
        return vector if _is_zero(self.angle) else turned(vector, self.angle)


@dataclass(frozen=True, eq=False)
class SolidWalls(Solid):
    """The `site_walls` in CasADi symbols: (4,) x_min, x_max, y_min, y_max [m]; behind a wall the range is 0."""

    walls: ca.SX
    present: ca.SX = field(default_factory=lambda: ca.SX(1))

    def nearest_in_cone(self, apex: ca.SX, cone: Cone, *, nothing: float) -> ca.SX:
        """See `Solid.nearest_in_cone`."""
        nearest = ca.SX(nothing)
        for normal, distance in self._faces(apex):
            candidate = wall_range(cone.axis, normal, distance=distance, half_angle=cone.half_angle, nothing=nothing)
            nearest = ca.fmin(nearest, ca.if_else(distance <= 0, 0.0, candidate))
        return nearest

    def holds(self, apex: ca.SX) -> ca.SX:
        """See `Solid.holds`."""
        (_, one), (_, two), (_, three), (_, four) = self._faces(apex)
        return ca.fmin(ca.fmin(one, two), ca.fmin(three, four)) <= 0

    def hit(self, apex: ca.SX, ray: ca.SX, *, nothing: float) -> tuple[ca.SX, ca.SX]:
        """See `Solid.hit`."""
        approach, along_x, along_y = self._along(apex, ray)
        cosine = ca.if_else(along_x <= along_y, approach[0], approach[1])
        return ca.fmin(ca.fmin(along_x, along_y), nothing), cosine

    def picked(self, apex: ca.SX, ray: ca.SX, values: tuple[float, ...]) -> ca.SX:
        """Return the value of the wall that a ray hits, from the values (4,) of x_min, x_max, y_min, y_max."""
        if all(value == values[0] for value in values):
            return ca.SX(values[0])
        _, along_x, along_y = self._along(apex, ray)
        west, east, south, north = values
        return ca.if_else(along_x <= along_y, ca.if_else(ray[0] > 0, east, west), ca.if_else(ray[1] > 0, north, south))

    def _along(self, apex: ca.SX, ray: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        west, east, south, north = (distance for _, distance in self._faces(apex))
        approach = ca.fmax(ca.fabs(ray), _PARALLEL)
        along_x = ca.if_else(ray[0] > 0, east, west) / approach[0]
        along_y = ca.if_else(ray[1] > 0, north, south) / approach[1]
        return approach, along_x, along_y

    def outlook(self, apex: ca.SX) -> list[ca.SX]:
        """See `Solid.outlook`: directions to the foot points on the four walls."""
        return [ca.SX(normal) for normal, _ in self._faces(apex)]

    def _faces(self, apex: ca.SX) -> tuple[tuple[tuple[float, float], ca.SX], ...]:
        # unit vector out of the water, and the distance [m] to the wall along this vector
        return (
            ((-1.0, 0.0), apex[0] - self.walls[0]),
            ((1.0, 0.0), self.walls[1] - apex[0]),
            ((0.0, -1.0), apex[1] - self.walls[2]),
            ((0.0, 1.0), self.walls[3] - apex[1]),
        )


def _is_zero(angle: ca.SX | float) -> bool:
    return isinstance(angle, float) and angle == 0.0


def _left(ray: ca.SX) -> ca.SX:
    return ca.vertcat(-ray[1], ray[0])


def _beside(ray: ca.SX, side: ca.SX | float) -> ca.SX:
    # turned by 1e-9 rad, to the left if `side` is 1 and to the right if `side` is −1
    return ray + side * _BESIDE * _left(ray)


def _towards(to: ca.SX) -> ca.SX:
    return to / ca.fmax(ca.sqrt(ca.sumsqr(to)), _LEAST)
