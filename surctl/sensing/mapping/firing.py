"""One firing as the local map sees it: its numbers, and what they say of one cell."""

from __future__ import annotations

import casadi as ca

__all__ = [
    "BLIND",
    "LIMITS",
    "MIDDLE",
    "READING",
    "READING_SIZE",
    "RING",
    "cell_line",
    "in_front",
    "limit_values",
    "named_limits",
    "on_arc",
    "split",
]

READING = (
    ("apex", 2, "m, x and y in {E}"),
    ("axis", 2, "unit vector of the beam in {E}"),
    ("half", 2, "cosine and sine of half the beam's angle"),
    ("clear", 1, "m, range short of which the cone is free; 0: none; below 0: blind, it leaves what was ranged"),
    ("near", 1, "m, where the marked band begins"),
    ("far", 1, "m, where it ends; below `near`: nothing is marked"),
    ("cutoff", 1, "m, range beyond which a cell does not explain the echo"),
)
"""One firing: name, numbers, meaning."""

BLIND = 0.25
"""A mark of a firing that only said that something is nearer than its blind range."""

RING = 1.5
"""Cells beside the hull that no beam sees whole: what is unknown there does not count, so none may come in unknown."""

READING_SIZE = sum(size for _, size, _ in READING)

_INSIDE, _INSIDE_MORE = 0.6, 0.01  # cells, and m: how deep inside a beam a cell must lie to be cleared
# of half the beam's width, where the beam is narrower than that: its middle clears, its turn shows the rest
_OF_THE_UNKNOWN, _OF_A_MARK = 0.4, 0.75
MIDDLE = 1.0 - _OF_THE_UNKNOWN
"""Share of a narrow beam's width that clears what is unknown."""

LIMITS = ("cosine", "sine", "near", "far", "cutoff", "clear", "whole", "outside", "clears", "ranged", "regular")
"""Numbers of a firing that all cells share: ranges squared [m²], `whole` and `outside` in m, the last three 0 or 1."""


def split(slots: ca.SX, count: int) -> list[dict[str, ca.SX]]:
    """The firings by the names of `READING`."""
    out = []
    for s in range(count):
        at, one = s * READING_SIZE, {}
        for name, size, _ in READING:
            one[name] = slots[at : at + size]
            at += size
        out.append(one)
    return out


def limit_values(slot: dict[str, ca.SX], edge: ca.SX) -> dict[str, ca.SX]:
    """`LIMITS` of a firing, for cells of that edge [m]."""
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
        # the bounds of a block hold for these alone
        "regular": ca.logic_and(ca.logic_and(cosine >= 0, sine >= 0), edge > 0),
    }


def named_limits(limits: ca.SX) -> dict[str, ca.SX]:
    """`LIMITS` by name."""
    return {name: limits[k] for k, name in enumerate(LIMITS)}


def cell_line(column: ca.SX, row: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Way along the beam's axis, way across [m], squared range [m²]."""
    return column[0] + row[0], ca.fabs(column[1] + row[1]), column[2] + row[2]


def on_arc(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX]) -> ca.SX:
    """Whether any of the cell may be what was heard."""
    band = ca.logic_and(line[2] >= limit["near"], line[2] <= limit["far"])
    return ca.logic_and(_inside(line, limit) > limit["outside"], band)


def _inside(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX]) -> ca.SX:
    """Distance into the cone from its nearer edge [m]."""
    return line[0] * limit["sine"] - line[1] * limit["cosine"]


def in_front(line: tuple[ca.SX, ca.SX, ca.SX], limit: dict[str, ca.SX], value: ca.SX) -> ca.SX:
    """Whether the whole cell is free: half a cell inside the cone, short of what was heard."""
    beam = line[0] * limit["sine"]
    deep = ca.fmin(limit["whole"], ca.if_else(value > 0, _OF_A_MARK, _OF_THE_UNKNOWN) * beam)
    short = ca.logic_and(line[2] < limit["clear"], ca.logic_or(limit["clears"], value <= BLIND))
    return ca.logic_and(_inside(line, limit) > deep, short)
