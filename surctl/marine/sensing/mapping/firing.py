"""One sonar firing on the local map: which cells it marks or clears, and the directions that a mark stores.

A specular surface answers only near its normal. So a later firing without an echo from a marked cell shows that the
cell is free only if the firing comes from a direction from which a surface in this cell would have answered. A surface
that answered from two directions also answers from every direction between them. A marked cell therefore stores the
sector of directions from which it was heard. Once this sector has several directions, only silence from within it, or
close to it, clears the cell.

The number of a mark is s + 2 (1 + a + 32 w): s is the strength in (0, 1], which fades; a is the first direction of the
sector, counter-clockwise, of 32; and w + 1 is the number of directions in the sector. A number within ±1 has no sector:
the mark of a blind firing, or, below 0, a cleared cell.
"""

from __future__ import annotations

import casadi as ca

DIRECTIONS = 32
"""Number of directions of the compass, about 11 degrees each."""

WIDEST = 4
"""Most directions that a sector has besides its first.

A surface of the paper's simulator answers from 45 degrees."""

BESIDE = 1.0
"""Directions beside a sector that still count: the error of a direction, and of the place of a cell."""

NEAR = 10
"""Distance [cells] from the sensor within which no direction beside a sector counts.

The corner of a face that was heard stays marked there until the robot has passed it, although it has fallen silent."""

MOVED = 2
"""Distance [cells] behind a mark from which an echo makes `NEAR` not apply.

The surface that was marked answers, and so has moved: no face's end is in front of an echo from the same body."""

PROTECTED = 0.85
"""Strength below which any silence clears a mark: it was last heard 9 s before."""

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
    return value - 2 * ca.floor(ca.fmax(value, 0) / 2)


def _sector(value: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    # whether the number has a sector; its first direction; its further directions
    stored = ca.floor(ca.fmax(value, 0) / 2)
    further = ca.floor(ca.fmax(stored - 1, 0) / DIRECTIONS)
    return stored >= 1, stored - 1 - DIRECTIONS * further, further


def _modulo(difference: ca.SX) -> ca.SX:
    return difference - DIRECTIONS * ca.floor(difference / DIRECTIONS)


def sector_with(value: ca.SX, direction: ca.SX, *, goes_on: ca.SX) -> ca.SX:
    """Return the number, at strength 1, of a mark whose sector includes a direction (see `bearing`).

    The old sector stays if `goes_on` holds and if the new sector has at most `WIDEST` directions besides its first.
    """
    has, first, further = _sector(value)
    now = ca.fmin(ca.floor(direction), DIRECTIONS - 1)
    after = _modulo(now - first)
    before = DIRECTIONS - after + further
    grown = ca.logic_or(after <= further, ca.logic_and(after <= WIDEST, after <= before))
    keep = ca.logic_and(ca.logic_and(has, goes_on), ca.logic_or(grown, before <= WIDEST))
    at = ca.if_else(ca.logic_and(keep, grown), first, now)
    count = ca.if_else(keep, ca.if_else(grown, ca.fmax(after, further), before), 0)
    return 3 + 2 * (at + DIRECTIONS * count)


def confirms(value: ca.SX) -> ca.SX:
    """Return whether a mark was heard from several directions; along the arc of an echo most marks are false."""
    return ca.floor(value / 2) > DIRECTIONS


def includes(value: ca.SX, direction: ca.SX, beside: ca.SX) -> ca.SX:
    """Return whether the sector includes a direction (see `bearing`), or is at most `beside` directions beside it."""
    has, first, further = _sector(value)
    off = _modulo(direction - first)
    inside = ca.logic_or(off <= further + 1 + beside, off >= DIRECTIONS - beside)
    return ca.logic_or(ca.logic_not(has), inside)


READING = (
    ("apex", 2, "m, x and y in {E}"),
    ("axis", 2, "unit vector of the beam in {E}"),
    ("half", 2, "cosine and sine of half the beam's opening angle"),
    ("clear", 1, "m, the cone is free up to |clear|; 0: nowhere; below 0: blind firing, measured marks stay"),
    ("near", 1, "m, start of the marked band"),
    ("far", 1, "m, end of the marked band; below `near`: nothing is marked"),
    ("cutoff", 1, "m, a cell beyond this range does not explain the echo"),
)
"""Each group of numbers that describes a firing: name, number of values, meaning."""

BLIND = 0.25
"""Value of a cell marked by a blind firing, which only shows that an object is nearer than the blind range."""

RING = 1.5
"""Width [cells] of a ring around the hull that no beam covers fully, so no unknown cell may enter it."""

READING_SIZE = sum(size for _, size, _ in READING)

_INSIDE, _INSIDE_MORE = 0.6, 0.01  # cells, and m: minimum depth of a cell inside a beam for the beam to clear it
# minimum depth for a narrow beam, as shares of half its width: the middle clears cells; turning clears the others
_OF_THE_UNKNOWN, _OF_A_MARK = 0.4, 0.75
MIDDLE = 1.0 - _OF_THE_UNKNOWN
"""Share of a narrow beam's width in which the beam clears unknown cells."""

LIMITS = (
    *("cosine", "sine", "near", "far", "cutoff", "clear", "whole", "outside", "clears", "ranged", "regular"),
    *("axis_x", "axis_y", "moved"),
)
"""Names of the limits of a firing: squared ranges [m²]; `whole` and `outside` [m]; three numbers 0 or 1; the axis of
the beam in {E}; and the squared range [m²] from which marks in front of the echo have moved."""


def split(slots: ca.SX, count: int) -> list[dict[str, ca.SX]]:
    """Split an array of firings into one dictionary per firing, whose keys are the names in `READING`."""
    out = []
    for s in range(count):
        at, one = s * READING_SIZE, {}
        for name, size, _ in READING:
            one[name] = slots[at : at + size]
            at += size
        out.append(one)
    return out


def limit_values(slot: dict[str, ca.SX], edge: ca.SX) -> dict[str, ca.SX]:
    """Return the limits of a firing, named in `LIMITS`, for cells of the given edge length [m]."""
    cosine, sine = slot["half"][0], slot["half"][1]
    return {
        "cosine": cosine,
        "sine": sine,
        "near": slot["near"] * slot["near"],
        "far": slot["far"] * ca.fabs(slot["far"]),
        "cutoff": slot["cutoff"] * slot["cutoff"],
        "clear": slot["clear"] * slot["clear"],
        "whole": _INSIDE * edge + _INSIDE_MORE,
        "outside": -0.5 * edge,
        "clears": slot["clear"] > 0,
        "ranged": slot["clear"] >= 0,
        # the bounds of a block are valid only under these conditions
        "regular": ca.logic_and(ca.logic_and(cosine >= 0, sine >= 0), edge > 0),
        "axis_x": slot["axis"][0],
        "axis_y": slot["axis"][1],
        "moved": ca.if_else(slot["far"] > 0, ca.fmax(slot["near"] - MOVED * edge, 0), 1e3) ** 2,
    }


def named_limits(limits: ca.SX) -> dict[str, ca.SX]:
    """Return the limits of a firing as a dictionary whose keys are the names in `LIMITS`."""
    return {name: limits[k] for k, name in enumerate(LIMITS)}


def direction(column: ca.SX, row: ca.SX, limit: dict[str, ca.SX]) -> ca.SX:
    """Return the direction from a firing's apex to a cell, see `bearing`."""
    along, across = column[0] + row[0], column[1] + row[1]
    ex, ey = limit["axis_x"], limit["axis_y"]
    return bearing(along * ex + across * ey, along * ey - across * ex)


def by_direction(value: ca.SX, away: ca.SX, *, near: ca.SX, moved: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return what a firing from the direction `away` (see `bearing`) means for a cell.

    The results are: whether the cell is a mark that silence from this direction does not clear; and the cell's value
    after an echo, and after a blind firing. `near` says whether the cell is near the sensor (see `nearby`), `moved`
    whether an echo came from close behind it.
    """
    strict = ca.logic_and(near, ca.logic_not(moved))
    now, beside = level(value), includes(value, away, ca.if_else(strict, 0, BESIDE))
    mark = ca.logic_and(now > PROTECTED, confirms(value))
    lasts = ca.logic_and(mark, ca.logic_not(beside))
    return lasts, sector_with(value, away, goes_on=now > BLIND), ca.if_else(now > BLIND, value, BLIND)


def nearby(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX]) -> ca.SX:
    """Return whether a cell is nearer to the sensor than `NEAR` edges."""
    edge = -2 * limit["outside"]
    return line[2] < NEAR * NEAR * (edge * edge)


def cell_line(column: ca.SX, row: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return a cell's distance along the beam's axis [m], distance from this axis [m], and squared range [m²]."""
    return column[0] + row[0], ca.fabs(column[1] + row[1]), column[2] + row[2]


def on_arc(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX]) -> ca.SX:
    """Return whether any part of the cell may have caused the echo."""
    band = ca.logic_and(line[2] >= limit["near"], line[2] <= limit["far"])
    return ca.logic_and(_inside(line, limit) > limit["outside"], band)


def _inside(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX]) -> ca.SX:
    # distance [m] from the nearer edge of the cone
    return line[0] * limit["sine"] - line[1] * limit["cosine"]


def in_front(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX], value: ca.SX | None = None) -> ca.SX:
    """Return whether the whole cell lies deep enough inside the cone, and is nearer than the echo.

    Without a value the cell must not be marked.
    """
    share = _OF_THE_UNKNOWN if value is None else ca.if_else(value > 0, _OF_A_MARK, _OF_THE_UNKNOWN)
    deep = ca.fmin(limit["whole"], share * (line[0] * limit["sine"]))
    return ca.logic_and(_inside(line, limit) > deep, line[2] < limit["clear"])
