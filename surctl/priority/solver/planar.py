"""The step of `dual_step` in two unknowns, by Cramer's rule: half as long a chain of operations as with factors."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

__all__ = ["Planar", "planar"]


class Planar(NamedTuple):
    """Where the entering normal stands to the active ones.

    Attributes:
        apart: the part of it that stands outside their span, times the length of the first active one.
        first: squared length of the first active normal.
        r: coordinates in the active normals, 0 in empty slots. ratios: multipliers divided by those.
        full: (2,), the way to meet the entering row, for a miss of 1. rate: (2,), what stands outside.
        whole: length of the full step in the multiplier, for a miss of 1.
    """

    apart: ca.SX
    first: ca.SX
    r: list[ca.SX]
    ratios: list[ca.SX]
    full: ca.SX
    rate: ca.SX
    whole: ca.SX


def planar(normals: list[ca.SX], numbers: list[ca.SX], multipliers: list[ca.SX], entering: ca.SX) -> Planar:
    """Two slots, the empty ones last. For an empty slot a vector across the other stands in.

    What depends on the entering row is divided by at once, in parallel: the longest chain holds one division.
    """
    one, two = numbers[0] != 0, numbers[1] != 0
    first = ca.if_else(one, normals[0], _across(-entering))
    second = ca.if_else(two, normals[1], _across(first))
    area, apart, along = _cross(first, second), _cross(first, entering), _cross(entering, second)
    inverse, per_miss, per_rate = _inverse(area), _inverse(apart), _inverse(along)
    squared = first[0] * first[0] + first[1] * first[1]
    beside = apart * inverse
    return Planar(
        apart=apart,
        first=squared,
        r=[ca.if_else(one, along * inverse, 0), ca.if_else(two, beside, 0)],
        ratios=[multipliers[0] * area * per_rate, multipliers[1] * area * per_miss],
        full=per_miss * second,
        rate=beside * second,
        whole=per_miss * (per_miss * squared),
    )


def _inverse(x: ca.SX) -> ca.SX:
    return 1 / ca.if_else(ca.eq(x, 0), 1, x)


def _cross(a: ca.SX, b: ca.SX) -> ca.SX:
    return a[0] * b[1] - a[1] * b[0]


def _across(a: ca.SX) -> ca.SX:
    """Turned a quarter to the left."""
    return ca.vertcat(-a[1], a[0])
