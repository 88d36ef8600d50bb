"""The directions in which a firing met a cell of the map, stored in the cell's number, for specular surfaces.

A specular surface answers only near its normal. So a later firing without an echo from a marked cell shows that the
cell is free only if the firing comes from a direction from which a surface in this cell would have answered. A surface
that answered from two directions also answers from every direction between them. A marked cell therefore stores the
sector of directions from which it was heard. Once this sector has several directions, only silence from within it, or
close to it, clears the cell.
A cleared cell stores the sector of directions from which it was silent. An echo from another direction may come from
a surface in this cell.

The number of a cell is ±(s + 2 (1 + a + 32 w)): + for a mark, − for a cleared cell; s is the strength in (0, 1], which
fades; a is the first direction of the sector, counter-clockwise, of 32; and w + 1 is the number of directions in the
sector. A number within ±1 has no sector: a cell under the hull is free from every direction.
"""

from __future__ import annotations

import casadi as ca

__all__ = [
    "BENT",
    "BESIDE",
    "DIRECTIONS",
    "MOVED",
    "NEAR",
    "PROTECTED",
    "WIDEST",
    "WIDEST_FREE",
    "bearing",
    "confirms",
    "includes",
    "level",
    "sector_with",
]

DIRECTIONS = 32
"""Number of directions of the compass, about 11 degrees each."""

WIDEST, WIDEST_FREE = 4, 24
"""Most directions that a sector has besides its first, of a mark and of a cleared cell.

A surface of the paper's simulator answers from 45 degrees."""

BESIDE = 1.0
"""Directions beside a sector that still count: the error of a direction, and of the place of a cell."""

NEAR = 10
"""Distance [cells] from the sensor within which, in a `smooth` map, no direction beside a sector counts.

The corner of a face that was heard stays marked there until the robot has passed it, although it has fallen silent."""

MOVED = 2
"""Distance [cells] behind a mark of a `smooth` map from which an echo makes `NEAR` not apply.

The surface that was marked answers, and so has moved: no face's end is in front of an echo from the same body."""

PROTECTED = 0.85
"""Strength below which any silence clears a mark of a `smooth` map: it was last heard 9 s before."""

BENT = 0.42
"""Coefficient of the cubic that makes the directions of `bearing` nearly equal in width."""


def bearing(x: ca.SX, y: ca.SX) -> ca.SX:
    """Return the direction of a vector, from 0 to `DIRECTIONS`, without trigonometric functions."""
    share = ca.fabs(y) / ca.fmax(ca.fabs(x) + ca.fabs(y), 1e-9)
    share += BENT * share * (1 - share) * (2 * share - 1)
    upper = ca.if_else(x >= 0, share, 2 - share)
    turns = ca.if_else(y >= 0, upper, 4 - upper)
    return turns * (DIRECTIONS / 4)


def level(value: ca.SX) -> ca.SX:
    """Return the strength of a mark in (0, 1], of a cleared cell in [−1, 0), or 0."""
    whole = 2 * ca.floor(ca.fabs(value) / 2)
    return value - ca.if_else(value > 0, whole, -whole)


def _sector(value: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    # whether the number has a sector; its first direction; its further directions
    stored = ca.floor(ca.fabs(value) / 2)
    further = ca.floor(ca.fmax(stored - 1, 0) / DIRECTIONS)
    return stored >= 1, stored - 1 - DIRECTIONS * further, further


def _modulo(difference: ca.SX) -> ca.SX:
    return difference - DIRECTIONS * ca.floor(difference / DIRECTIONS)


def sector_with(value: ca.SX, direction: ca.SX, *, goes_on: ca.SX, widest: int) -> ca.SX:
    """Return the absolute number, at strength 1, of a cell whose sector includes a direction (see `bearing`).

    The old sector stays if `goes_on` holds and if the new sector has at most `widest` directions besides its first.
    """
    has, first, further = _sector(value)
    now = ca.fmin(ca.floor(direction), DIRECTIONS - 1)
    after = _modulo(now - first)
    before = DIRECTIONS - after + further
    grown = ca.logic_or(after <= further, ca.logic_and(after <= widest, after <= before))
    keep = ca.logic_and(ca.logic_and(has, goes_on), ca.logic_or(grown, before <= widest))
    at = ca.if_else(ca.logic_and(keep, grown), first, now)
    count = ca.if_else(keep, ca.if_else(grown, ca.fmax(after, further), before), 0)
    return 3 + 2 * (at + DIRECTIONS * count)


def confirms(value: ca.SX) -> ca.SX:
    """Return whether a mark was heard from several directions; along the arc of an echo most marks are false."""
    return ca.floor(ca.fabs(value) / 2) > DIRECTIONS


def includes(value: ca.SX, direction: ca.SX, beside: ca.SX | float = BESIDE) -> ca.SX:
    """Return whether the sector includes a direction (see `bearing`), or is at most `beside` directions beside it."""
    has, first, further = _sector(value)
    off = _modulo(direction - first)
    inside = ca.logic_or(off <= further + 1 + beside, off >= DIRECTIONS - beside)
    return ca.logic_or(ca.logic_not(has), inside)
