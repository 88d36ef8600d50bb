"""The echo model in symbols: what `fire` gives, for the closed loop that is compiled."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos

import casadi as ca

from surctl.sensing.array import SonarArray
from surctl.sensing.estimate import disc_range, turned, wall_range

__all__ = ["heard_samples", "range_to_box", "range_to_disc", "range_to_walls"]

_IN_CONE = 1e-12  # as `Shape.nearest_in_cone`
_PARALLEL = 1e-30  # stands for a direction of 0, so that a slab is crossed very far away


def range_to_disc(array: SonarArray, apex: ca.SX, axis: ca.SX, *, centre: ca.SX, radius: ca.SX) -> ca.SX:
    """Distance [m] from the apex (2, 1) to the nearest point of a disc in the cone about `axis` (2, 1); 2·maximum
    when none."""
    return disc_range(axis, centre - apex, radius=radius, half_angle=array.half_angle, nothing=2.0 * array.maximum)


def range_to_walls(array: SonarArray, apex: ca.SX, axis: ca.SX, *, walls: ca.SX) -> ca.SX:
    """As `range_to_disc`, for the walls (4,): x_min, x_max, y_min, y_max [m]; 0 from behind one."""
    nothing = 2.0 * array.maximum
    found = ca.SX(nothing)
    for normal, distance in (
        ((-1.0, 0.0), apex[0] - walls[0]),
        ((1.0, 0.0), walls[1] - apex[0]),
        ((0.0, -1.0), apex[1] - walls[2]),
        ((0.0, 1.0), walls[3] - apex[1]),
    ):
        seen = wall_range(axis, normal, distance=distance, half_angle=array.half_angle, nothing=nothing)
        found = ca.fmin(found, ca.if_else(distance <= 0, 0.0, seen))
    return found


def range_to_box(array: SonarArray, apex: ca.SX, axis: ca.SX, *, centre: ca.SX, size: ca.SX) -> ca.SX:
    """As `range_to_disc`, for a box with edges `size` (2, 1) [m] along x and y of {E}."""
    nothing, half = 2.0 * array.maximum, 0.5 * size
    here = apex - centre
    offset = ca.fmin(ca.fmax(here, -half), half) - here
    distance = ca.sqrt(ca.sumsqr(offset))
    in_cone = ca.dot(offset, axis) >= distance * (cos(array.half_angle) - _IN_CONE)
    edges = ca.SX(nothing)
    for angle in (array.half_angle, -array.half_angle):
        ray = turned(axis, angle)
        ray = ca.if_else(ray == 0, _PARALLEL, ray)
        one, other = (-half - here) / ray, (half - here) / ray
        near, far = ca.fmin(one, other), ca.fmax(one, other)
        first, last = ca.fmax(near[0], near[1]), ca.fmin(far[0], far[1])
        hits = ca.logic_and(first >= 0, first <= last)
        edges = ca.fmin(edges, ca.if_else(hits, first, nothing))
    return ca.if_else(distance <= 0, 0.0, ca.if_else(in_cone, distance, edges))


def heard_samples(array: SonarArray, ranges: Sequence[ca.SX], *, noise: ca.SX) -> ca.SX:
    """The samples (samples, 1) [m] of one firing, from the ranges to all that reflects, as `fire` gives them.

    Args:
        array: the array.
        ranges: distances in the cone [m], beyond the maximum when there is nothing.
        noise: (samples, 1) standard normal numbers.
    """
    distance = ca.SX(2.0 * array.maximum)
    for one in ranges:
        distance = ca.fmin(distance, one)
    heard = ca.fmin(ca.fmax(distance + array.bias + array.noise_sd * noise, array.minimum), array.maximum)
    top = float(array.top_code)
    codes = ca.floor(heard * top / array.maximum + 0.5)
    return ca.if_else(distance > array.maximum, array.maximum, codes * array.maximum / top)
