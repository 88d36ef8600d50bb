"""The programs of the local map: what happens to one cell, one row of a block, one block.

`LocalMap.routine` puts them into loops. A column or a row of cells has two kinds of numbers: its base (offset from the
robot [m], square of it [m²], whether it was in the window before, square for unknown cells, which is 1e6 where nothing
counts), and for each firing its beam (share of the way along the axis [m], of the way across [m], of the squared
range [m²]). A cell's numbers are the sums of its column's and its row's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin

import casadi as ca

from surctl.ir import Program, lower_named
from surctl.sensing.mapping.firing import (
    BLIND,
    LIMITS,
    READING_SIZE,
    RING,
    cell_line,
    in_front,
    limit_values,
    named_limits,
    on_arc,
    split,
)

__all__ = ["BASE", "BEAM", "NONE", "MapPrograms"]

BASE, BEAM = 4, 3
"""Numbers of a column or row: its own, and those for each firing."""
BOUNDS = 5  # of a block's columns or rows for each firing: along, across from, to, squared range from, to

_AT_A_WALL = 2  # cells beside a wall that count for nothing: what is larger than that shows in the next one
_SLACK = 1e-3  # cells by which a wall may miss the grid
_FAR = 1e6  # m², of a block without such a cell
_TOUCHED = 0.55  # cells outside a cone at which a block is left alone; a cell on the arc is at most half a cell outside
NONE = (0.0, 0.0, _FAR)
"""Offset x, y and squared distance of a nearest cell that there is not."""


@dataclass(frozen=True, kw_only=True)
class MapPrograms:
    """The programs of a map of these sizes.

    Attributes:
        slots: most firings in one period.
        side: cells a side of the window.
        block: cells a side of a block.
        lanes: cells of a row side by side; columns stand in groups of so many, entry by entry.
        sectors: directions.
        fades: by how much a marked and a cleared cell fade in one period.
        known: least part of `free_time` that a cell must have left to count as known to be free.
        held: fewest cells not known to be free with which a block's unknown cells count.
    """

    slots: int
    side: int
    block: int
    lanes: int
    sectors: int
    fades: tuple[float, float]
    known: float
    held: int

    @cached_property
    def bounds_size(self) -> int:
        """Numbers that bound a block's columns or rows."""
        return 1 + BOUNDS * self.slots

    def corner(self) -> Program:
        """The window's lowest cell: the robot is in its middle, but where it would reach beyond the site."""
        place, walls = ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        lowest = ca.floor(walls[[0, 2]] / place[3] + _SLACK)
        end = -ca.floor(_SLACK - walls[[1, 3]] / place[3])
        middle = ca.floor(place[:2] / place[3]) - self.side // 2
        corner = ca.fmax(ca.fmin(middle, end - self.side), lowest)
        return lower_named("corner", {"place": place, "walls": walls}, {"corner": corner})

    def prepare(self) -> Program:
        """What all cells share: limits of each firing, whether its look is over before it begins, and of the hull."""
        place, slots = ca.SX.sym("place", 4), ca.SX.sym("slots", self.slots * READING_SIZE)
        hull, edge = place[2], place[3]
        limits, explained = {}, {}
        for s, slot in enumerate(split(slots, self.slots)):
            values = limit_values(slot, edge)
            limits[f"limits_{s}"] = ca.vertcat(*(values[name] for name in LIMITS))
            explained[f"explained_{s}"] = values["far"] < values["near"]  # no cell is on such an arc
        ring = hull + RING * edge
        everything = explained["explained_0"]
        for s in range(1, self.slots):
            everything = ca.logic_and(everything, explained[f"explained_{s}"])
        outputs = {**limits, "hull": ca.vertcat(hull * hull, ring * ring), "complete": everything, **explained}
        return lower_named("prepare", {"place": place, "slots": slots}, outputs)

    def line(self) -> Program:
        """Column or row `at` of a group of as many as a block has: its base, and its beam for each firing."""
        at, group, span = ca.SX.sym("at"), ca.SX.sym("group"), ca.SX.sym("span")
        place, walls = ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        slots = ca.SX.sym("slots", self.slots * READING_SIZE)
        old, new = ca.SX.sym("old", 2), ca.SX.sym("new", 2)
        n, number, second = self.side, self.block * group + at, span > 0.5

        def of(pair: ca.SX) -> ca.SX:
            return ca.if_else(second, pair[1], pair[0])

        def world(corner: ca.SX) -> ca.SX:
            return number + n * ca.floor((corner + (n - 1) - number) / n)

        cell = world(of(new))
        centre = (cell + 0.5) * place[3]
        offset = centre - of(place)
        beside = _AT_A_WALL * place[3]
        counts = ca.logic_and(centre > of(walls[[0, 2]]) + beside, centre < of(walls[[1, 3]]) - beside)
        square = offset * offset
        outputs = {"base": ca.vertcat(offset, square, world(of(old)) == cell, ca.if_else(counts, square, _FAR))}
        for s, slot in enumerate(split(slots, self.slots)):
            away, ex, ey = centre - of(slot["apex"]), slot["axis"][0], slot["axis"][1]
            # across = dx·ey − dy·ex: a row's share has the other sign
            across = ca.if_else(second, -away * ex, away * ey)
            outputs[f"beam_{s}"] = ca.vertcat(away * of(slot["axis"]), across, away * away)
        inputs = {
            **{"at": at, "group": group, "span": span, "place": place, "walls": walls},
            **{"slots": slots, "old": old, "new": new},
        }
        return lower_named("line", inputs, outputs)

    # --- which blocks a firing, or the hull, touches ------------------------------------------------------------------

    def bounds(self, *, columns: bool) -> Program:
        """Least and largest numbers of a block's columns or rows, of which cells far apart may meet in one block."""
        base = ca.SX.sym("base", BASE * self.block)
        beams = [ca.SX.sym(f"beam_{s}", BEAM * self.block) for s in range(self.slots)]

        def entries(array: ca.SX, size: int, entry: int) -> list[ca.SX]:
            return [array[self._entry(k, size, entry) if columns else size * k + entry] for k in range(self.block)]

        bounds = [_least(entries(base, BASE, 1))]
        for beam in beams:
            along, across, square = (entries(beam, BEAM, e) for e in range(BEAM))
            bounds += [_largest(along), _least(across), _largest(across), _least(square), _largest(square)]
        inputs = {"base": base, **{f"beam_{s}": beam for s, beam in enumerate(beams)}}
        return lower_named("columns_bounds" if columns else "rows_bounds", inputs, {"bounds": ca.vertcat(*bounds)})

    def idle(self) -> Program:
        """Of one block: for each firing, whether it changes no cell, and whether the hull lies on none."""
        row, column = (ca.SX.sym(name, self.bounds_size) for name in ("row_bounds", "column_bounds"))
        limits, hull = self._limits(), ca.SX.sym("hull", 2)
        outputs = {}
        for s, limit in enumerate(limits):
            beside, least, arc = self._bounded(row, column, limit, s)
            untouched = ca.logic_or(beside, ca.logic_and(arc, least >= limit["clear"]))
            outputs[f"idle_{s}"] = ca.logic_and(untouched, limit["regular"])
        outputs["idle_hull"] = row[0] + column[0] >= hull[0]
        inputs = {"row_bounds": row, "column_bounds": column, **self._limit_symbols(limits), "hull": hull}
        return lower_named("idle", inputs, outputs)

    def blank_arc(self) -> Program:
        """Of one block: for each firing, whether no cell can explain it, or one already has."""
        row, column = (ca.SX.sym(name, self.bounds_size) for name in ("row_bounds", "column_bounds"))
        limits = self._limits()
        explained = {f"explained_{s}": ca.SX.sym(f"explained_{s}") for s in range(self.slots)}
        outputs = {}
        for s, limit in enumerate(limits):
            beside, least, arc = self._bounded(row, column, limit, s)
            off = ca.logic_or(ca.logic_or(beside, arc), least > limit["cutoff"])
            outputs[f"blank_{s}"] = ca.logic_or(explained[f"explained_{s}"], ca.logic_and(off, limit["regular"]))
        inputs = {"row_bounds": row, "column_bounds": column, **self._limit_symbols(limits), **explained}
        return lower_named("blank_arc", inputs, outputs)

    def _bounded(self, row: ca.SX, column: ca.SX, limit: dict[str, ca.SX], s: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Whether all cells are beside the cone; least squared range; whether all are short of the arc or beyond.

        The same sums and products as of a cell, and rounding keeps their order: what holds for the bounds holds for
        every cell, to the last bit. All is asked so that a number that is none leaves the block to be looked at.
        """
        at = 1 + BOUNDS * s
        along, low, high, least, most = (row[at + k] + column[at + k] for k in range(BOUNDS))
        across = ca.fmax(ca.fmax(low, -high), 0)
        deepest = along * limit["sine"] - across * limit["cosine"]
        arc = ca.logic_or(least > limit["far"], most < limit["near"])
        return deepest <= 2 * _TOUCHED * limit["outside"], least, arc

    # --- what happens to a cell ---------------------------------------------------------------------------------------

    def fade(self) -> Program:
        """A cell's value after a period in which nothing is heard of it."""
        value, column, row = ca.SX.sym("value"), ca.SX.sym("column", BASE), ca.SX.sym("row", BASE)
        inputs = {"cells": value, "column": column, "row": row}
        return lower_named("fade", inputs, {"faded": self._faded(value, column, row)})

    def seek(self) -> Program:
        """Whether a cell may hold what a firing heard: on its arc, and not known to be free."""
        hit, value = ca.SX.sym("hit"), ca.SX.sym("value")
        column, across, row, down = self._cell()
        limits = ca.SX.sym("limits", len(LIMITS))
        limit, line = named_limits(limits), cell_line(across, down)
        near = ca.logic_and(self._faded(value, column, row) >= -self.known, line[2] <= limit["cutoff"])
        after = ca.logic_or(hit, ca.logic_and(on_arc(line, limit), near))
        inputs = {
            **{"hit": hit, "cells": value, "column": column, "column_beam": across},
            **{"row": row, "row_beam": down, "limits": limits},
        }
        return lower_named("seek", inputs, {"hit_next": after})

    def observe(self) -> Program:
        """A cell's value after a firing."""
        value, explained = ca.SX.sym("value"), ca.SX.sym("explained")
        _, across, _, down = self._cell()
        limits = ca.SX.sym("limits", len(LIMITS))
        limit, line = named_limits(limits), cell_line(across, down)
        marked = ca.logic_and(on_arc(line, limit), ca.logic_or(value >= -self.known, ca.logic_not(explained)))
        mark = ca.if_else(limit["ranged"], 1, ca.fmax(value, BLIND))
        after = ca.if_else(in_front(line, limit, value), -1, ca.if_else(marked, mark, value))
        inputs = {"cells": value, "column_beam": across, "row_beam": down, "limits": limits, "explained": explained}
        return lower_named("observe", inputs, {"after": after})

    def cover(self) -> Program:
        """A cell's value where the hull may be: what it lies on is free."""
        value, column, row = ca.SX.sym("value"), ca.SX.sym("column", BASE), ca.SX.sym("row", BASE)
        hull = ca.SX.sym("hull", 2)
        inputs = {"cells": value, "column": column, "row": row, "hull": hull}
        return lower_named("cover", inputs, {"after": ca.if_else(column[1] + row[1] < hull[0], -1, value)})

    def tally(self) -> Program:
        """Largest value of a block's cells, and how many are not known to be free."""
        largest, count, value = ca.SX.sym("largest"), ca.SX.sym("count"), ca.SX.sym("value")
        outputs = {"largest_next": ca.fmax(largest, value), "count_next": count + (value >= -self.known)}
        return lower_named("tally", {"largest": largest, "count": count, "cells": value}, outputs)

    # --- the nearest cell of a block ----------------------------------------------------------------------------------

    def without(self) -> Program:
        """Of one block: whether no cell is marked, and whether too few are not known to be free."""
        largest, count = ca.SX.sym("largest", self.lanes), ca.SX.sym("count", self.lanes)
        held = ca.sum1(count) < self.held
        outputs = {"no_mark": _largest(ca.vertsplit(largest)) <= 0, "no_blank": held}
        return lower_named("without", {"largest": largest, "count": count}, outputs)

    def any_hit(self) -> Program:
        """Whether any lane found a cell."""
        hits = ca.SX.sym("hits", self.lanes)
        hit = hits[0]
        for k in range(1, self.lanes):
            hit = ca.logic_or(hit, hits[k])
        return lower_named("any_hit", {"hits": hits}, {"hit": hit})

    def all_explained(self) -> Program:
        """Whether the look is over for every firing."""
        explained = [ca.SX.sym(f"explained_{s}") for s in range(self.slots)]
        complete = explained[0]
        for one in explained[1:]:
            complete = ca.logic_and(complete, one)
        return lower_named(
            "all_explained", {f"explained_{s}": one for s, one in enumerate(explained)}, {"complete": complete}
        )

    def nearest(self, *, unknown: bool) -> Program:
        """Nearest marked or unknown cell of a block so far, after one more row; of equal ones the first."""
        near, hull = ca.SX.sym("near", 3), ca.SX.sym("hull", 2)
        cells, row, columns = (
            ca.SX.sym("cells", self.block),
            ca.SX.sym("row", BASE),
            ca.SX.sym("columns", BASE * self.block),
        )
        dx, least, which = near[0], near[2], 3 if unknown else 1
        for k in range(self.block):
            value = cells[k]
            square = columns[self._entry(k, BASE, which)] + row[which]
            holds = value > 0
            if unknown:
                holds = ca.logic_and(ca.logic_and(value >= -self.known, value <= 0), square > hull[1])
            nearer = ca.logic_and(holds, square < least)
            dx = ca.if_else(nearer, columns[self._entry(k, BASE, 0)], dx)
            least = ca.if_else(nearer, square, least)
        dy = ca.if_else(least < near[2], row[0], near[1])
        inputs = {"near": near, "cells": cells, "row": row, "columns": columns, "hull": hull}
        name = "nearest_unknown" if unknown else "nearest_marked"
        return lower_named(name, inputs, {"near_next": ca.vertcat(dx, dy, least)})

    def sector(self) -> Program:
        """Number of the direction in which a cell lies."""
        near = ca.SX.sym("near", 3)
        # the side of each line through the robot that parts two directions: passed ones on this side first
        sides = []
        for k in range(self.sectors // 2):
            angle = 2 * pi * (k - 0.5) / self.sectors
            sides.append(near[1] * cos(angle) - near[0] * sin(angle) >= 0)
        passed = ca.SX(0)
        for side in sides:
            passed += side
        return lower_named(
            "sector",
            {"near": near},
            {"sector": ca.if_else(sides[0], passed - 1, self.sectors - 1 - passed)},
        )

    def farther(self) -> Program:
        """Whether a cell is no nearer than the nearest so far in its direction."""
        near, best = ca.SX.sym("near", 3), ca.SX.sym("best", 3)
        return lower_named("farther", {"near": near, "best": best}, {"farther": near[2] >= best[2]})

    def enter(self) -> Program:
        """The nearest so far in each direction, with this cell in its own."""
        flag, best = ca.SX.sym("flag"), ca.SX.sym("best", 3 * self.sectors)
        near, sector = ca.SX.sym("near", 3), ca.SX.sym("sector")
        rows = [ca.if_else(sector == k, near, best[3 * k : 3 * k + 3]) for k in range(self.sectors)]
        inputs = {"flag": flag, "best": best, "near": near, "sector": sector}
        return lower_named("enter", inputs, {"done": ca.SX(1), "best_next": ca.vertcat(*rows)})

    # --- parts --------------------------------------------------------------------------------------------------------

    def _entry(self, column: int, size: int, entry: int) -> int:
        """Where a number of one of a block's columns stands."""
        group, lane = divmod(column, self.lanes)
        return (group * size + entry) * self.lanes + lane

    def _faded(self, value: ca.SX, column: ca.SX, row: ca.SX) -> ca.SX:
        old = value * (row[2] * column[2])
        return old - ca.fmin(ca.fmax(old, -self.fades[1]), self.fades[0])

    @staticmethod
    def _cell() -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Base and beam of a column, then of a row."""
        names = (("column", BASE), ("column_beam", BEAM), ("row", BASE), ("row_beam", BEAM))
        column, across, row, down = (ca.SX.sym(name, size) for name, size in names)
        return column, across, row, down

    def _limits(self) -> list[dict[str, ca.SX]]:
        return [named_limits(ca.SX.sym(f"limits_{s}", len(LIMITS))) for s in range(self.slots)]

    @staticmethod
    def _limit_symbols(limits: list[dict[str, ca.SX]]) -> dict[str, ca.SX]:
        return {f"limits_{s}": ca.vertcat(*(one[name] for name in LIMITS)) for s, one in enumerate(limits)}


def _least(values: list[ca.SX]) -> ca.SX:
    least = values[0]
    for value in values[1:]:
        least = ca.fmin(least, value)
    return least


def _largest(values: list[ca.SX]) -> ca.SX:
    largest = values[0]
    for value in values[1:]:
        largest = ca.fmax(largest, value)
    return largest
