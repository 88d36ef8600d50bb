"""Active-set step of module `dual_step` for two unknowns by Cramer's rule, with half as many sequential operations."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

__all__ = ["Planar", "planar"]


class Planar(NamedTuple):
    """Relation of the normal of the entering row, which becomes active, to the normals of the active rows.

    Attributes:
        apart: component of the entering normal outside the span of the active normals, times the length of the first
            active normal.
        first: squared length of the first active normal.
        r: coefficients of the entering normal as a combination of the active normals, 0 for an unused entry. ratios:
            multipliers divided by r.
        full: (2,), displacement of the unknowns that satisfies the entering row, for a violation of 1. rate: (2,),
            component of the entering normal outside the span of the active normals.
        whole: change of the multiplier in this displacement, for a violation of 1.
    """

    apart: ca.SX
    first: ca.SX
    r: list[ca.SX]
    ratios: list[ca.SX]
    full: ca.SX
    rate: ca.SX
    whole: ca.SX


def planar(normals: list[ca.SX], numbers: list[ca.SX], multipliers: list[ca.SX], entering: ca.SX) -> Planar:
    """Compute the step for at most two active rows; unused entries of the lists have number 0 and are last.

    A perpendicular vector replaces a missing normal. All divisions that depend on the entering row can run in parallel.
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
    """Return the vector (2,) rotated by 90° counter-clockwise."""
    return ca.vertcat(-a[1], a[0])
