"""Functions for the range to the nearest point of a wall or disc within a cone, in CasADi symbols."""

from __future__ import annotations

from math import cos

import casadi as ca

__all__ = ["disc_range", "turned", "wall_range"]


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
