"""The CasADi programs of the local map, each for one cell, one row of a block of cells, or one block of cells.

`LocalMap.routine` calls these programs in loops. For each column and each row of cells, there is a vector called base
and, for each firing, a vector called beam. The base holds four numbers: the offset of the column or row from the robot
[m]; the square of the offset [m²]; whether the column or row was in the previous window; and the square of the offset
again, or 1e6 if unknown cells in this column or row are ignored. The beam holds what the column or row contributes to
three distances of a cell: along the beam's axis [m], from this axis [m], and the squared range [m²]. The sum of the
vectors of a cell's column and row gives the squared distance of the cell from the robot and the beam of the cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce
from math import cos, pi, sin

import casadi as ca

from surctl.errors import InputError, check_number
from surctl.ir import Program, lower_named
from surctl.marine.sensing.mapping.firing import (
    BLIND,
    LIMITS,
    READING_SIZE,
    RING,
    by_direction,
    cell_line,
    direction,
    in_front,
    level,
    limit_values,
    named_limits,
    nearby,
    on_arc,
    split,
)

BASE, BEAM = 4, 3
"""Number of values in the base of a column or row, and in the beam of a column or row for one firing."""
_BOUNDS = 5  # per firing, for the columns or rows of a block: most along, least, most across, least, most squared range

_AT_A_WALL = 2  # cells beside a wall where unknown cells are ignored: a larger object also extends into the third cell
_HOLDS = 3  # cells; a disc two cells wide with its centre in a block touches at least this many of its cells
_SLACK = 1e-3  # cells; a wall may be this far from a grid line
_FAR = 1e6  # m², squared distance for a block without a marked or unknown cell
_TOUCHED = 0.55  # cells; a block this far outside a cone is skipped (cells on the arc are at most 0.5 outside)
NONE = (0.0, 0.0, _FAR)
"""Offset x, y and squared distance that are returned if no marked or unknown cell exists."""


@dataclass(frozen=True, kw_only=True)
class MapParameters:
    """The numbers of cells of a `LocalMap`, and its times.

    Attributes:
        dt: period of the updates [s].
        slots: largest number of firings in one period.
        blocks: number of blocks (square groups of cells) along one side of the map.
        block: number of cells along one side of a block, a square group of cells; in each block the map finds the
            nearest marked cell and the nearest unknown cell.
        sectors: number of directions in which the map returns the nearest cells, a multiple of 4.
        mark_time: time [s] until a marked cell has faded to 0 (design choice).
        free_time: time [s] until a cleared cell has faded to 0 (design choice).
        known: fraction of `free_time` (design choice); in this last part of `free_time`, a cleared cell no longer
            counts as known to be free.
    """

    dt: float
    slots: int = 2
    blocks: int = 12
    block: int = 4
    sectors: int = 16
    mark_time: float = 60.0
    free_time: float = 60.0
    known: float = 0.3

    def __post_init__(self) -> None:
        for name in ("dt", "mark_time", "free_time"):
            check_number(f"map.{name}", getattr(self, name), unit="s")
        for name in ("slots", "blocks", "block"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise InputError("must be a whole number, at least 1", key=f"map.{name}", value=value)
        if not isinstance(self.sectors, int) or self.sectors < 4 or self.sectors % 4:
            raise InputError("must be a multiple of 4", key="map.sectors", value=self.sectors)
        if not 0 < self.known < 1:
            raise InputError("must lie between 0 and 1", key="map.known", value=self.known)

    @property
    def side(self) -> int:
        """Number N of cells along one side of the map."""
        return self.blocks * self.block

    @property
    def held(self) -> int:
        """Number of cells not known to be free below which the unknown cells of a block are ignored.

        Of the five cells that a disc two cells wide touches, the centre's and its neighbours, at least three lie in one
        block. So no object of this size can hide in blocks with fewer such cells.
        """
        return min(_HOLDS, self.block * self.block)

    @property
    def memory(self) -> float:
        """Time [s] for which a cleared cell counts as known to be free."""
        return (1.0 - self.known) * self.free_time


class MapPrograms:
    """The programs of a local map."""

    def __init__(self, local_map: MapParameters) -> None:
        self.block, self.slots = local_map.block, local_map.slots
        self.sectors, self.side, self.held = local_map.sectors, local_map.side, local_map.held
        self.known = local_map.known
        # amounts by which the value of a marked cell and of a cleared cell approach 0 in one period
        self.fades = (local_map.dt / local_map.mark_time, local_map.dt / local_map.free_time)

    @cached_property
    def bounds_size(self) -> int:
        """Number of extreme values that `bounds` returns for a block's columns or rows."""
        return 2 + _BOUNDS * self.slots

    @property
    def shared_size(self) -> int:
        """Number of values that `axis` returns for all columns or all rows."""
        return 7 + 3 * self.slots

    def corner(self) -> Program:
        """Program that computes the window's lowest cell, and the highest multiples of N not above its indices.

        The robot is at the centre of the window, unless the window would then extend beyond a wall of the site.
        """
        place, walls = ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        lowest = ca.floor(walls[[0, 2]] / place[3] + _SLACK)
        end = -ca.floor(_SLACK - walls[[1, 3]] / place[3])
        middle = ca.floor(place[:2] / place[3]) - self.side // 2
        corner = ca.fmax(ca.fmin(middle, end - self.side), lowest)
        multiple = self.side * ca.floor(corner / self.side)
        return lower_named("corner", {"place": place, "walls": walls}, {"corner": corner, "multiple": multiple})

    def prepare(self) -> Program:
        """Program that computes the limits of firings and hull, and tests whether a firing marks no cell."""
        place, slots = ca.SX.sym("place", 4), ca.SX.sym("slots", self.slots * READING_SIZE)
        hull, edge = place[2], place[3]
        limits, explained = {}, {}
        for s, slot in enumerate(split(slots, self.slots)):
            values = limit_values(slot, edge)
            limits[f"limits_{s}"] = ca.vertcat(*(values[name] for name in LIMITS))
            explained[f"explained_{s}"] = values["far"] < values["near"]  # no cell is on an empty arc
        ring = hull + RING * edge
        complete = reduce(ca.logic_and, explained.values())
        outputs = {**limits, "hull": ca.vertcat(hull * hull, ring * ring), "complete": complete, **explained}
        return lower_named("prepare", {"place": place, "slots": slots}, outputs)

    def axis(self) -> Program:
        """Program that computes the numbers of `line` that all columns share, or all rows if `is_row` is 1."""
        is_row, place, walls = ca.SX.sym("is_row"), ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        slots = ca.SX.sym("slots", self.slots * READING_SIZE)
        old, new, multiple = (ca.SX.sym(name, 2) for name in ("old", "new", "multiple"))

        def of(pair: ca.SX) -> ca.SX:
            return ca.if_else(is_row > 0.5, pair[1], pair[0])

        beside = _AT_A_WALL * place[3]
        ends = of(walls[[0, 2]]) + beside, of(walls[[1, 3]]) - beside
        shared = [of(place), place[3], *ends, of(old), of(new), of(multiple)]
        for slot in split(slots, self.slots):
            ahead = slot["axis"]
            # across = dx·ey − dy·ex
            shared += [of(slot["apex"]), of(ahead), of(ca.vertcat(ahead[1], -ahead[0]))]
        inputs = {"is_row": is_row, "place": place, "walls": walls, "slots": slots}
        inputs |= {"old": old, "new": new, "multiple": multiple}
        return lower_named("axis", inputs, {"shared": ca.vertcat(*shared)})

    def line(self) -> Program:
        """Program that computes the base and the beams of a column or row, number `at` in the block `group`."""
        at, group, shared, n = ca.SX.sym("at"), ca.SX.sym("group"), ca.SX.sym("shared", self.shared_size), self.side
        place, edge, lowest, highest, old, new, multiple, *beams = ca.vertsplit(shared)
        cell = multiple + (self.block * group + at)
        cell += ca.if_else(cell < new, n, 0)
        stays = ca.logic_and(cell >= old, cell <= old + (n - 1))
        centre = (cell + 0.5) * edge
        offset = centre - place
        counts = ca.logic_and(centre > lowest, centre < highest)
        square = offset * offset
        outputs = {"base": ca.vertcat(offset, square, stays, ca.if_else(counts, square, _FAR))}
        for s in range(self.slots):
            apex, ahead, aside = beams[3 * s : 3 * s + 3]
            away = centre - apex
            outputs[f"beam_{s}"] = ca.vertcat(away * ahead, away * aside, away * away)
        return lower_named("line", {"at": at, "group": group, "shared": shared}, outputs)

    # --- which blocks a firing, or the hull, touches ------------------------------------------------------------------

    def bounds(self) -> Program:
        """Program that computes the extreme values of base and beams over the columns or rows of a block.

        The last value is 1 if all of them were in the previous window.
        """
        base = ca.SX.sym("base", BASE * self.block)
        beams = [ca.SX.sym(f"beam_{s}", BEAM * self.block) for s in range(self.slots)]

        def entries(array: ca.SX, size: int, entry: int) -> list[ca.SX]:
            return [array[size * k + entry] for k in range(self.block)]

        bounds = [reduce(ca.fmin, entries(base, BASE, 1))]
        for beam in beams:
            along, across, square = (entries(beam, BEAM, e) for e in range(BEAM))
            bounds.append(reduce(ca.fmax, along))
            bounds += [reduce(extreme, values) for values in (across, square) for extreme in (ca.fmin, ca.fmax)]
        bounds.append(reduce(ca.fmin, entries(base, BASE, 2)))
        inputs = {"base": base, **{f"beam_{s}": beam for s, beam in enumerate(beams)}}
        return lower_named("bounds", inputs, {"bounds": ca.vertcat(*bounds)})

    def whole(self) -> Program:
        """Program that tests whether all cells of a block were in the previous window."""
        row, column = (ca.SX.sym(name, self.bounds_size) for name in ("row_bounds", "column_bounds"))
        return lower_named(
            "whole", {"row_bounds": row, "column_bounds": column}, {"whole": ca.fmin(row[-1], column[-1])}
        )

    def untouched(self) -> Program:
        """Program that tests what a block does not need.

        The outputs are 1 if no firing touches the block, if the hull covers none of it, if no mark in it lasts, and if
        none of its cells is unknown.
        """
        row, column = (ca.SX.sym(name, self.bounds_size) for name in ("row_bounds", "column_bounds"))
        limits, hull, most = self._limits(), ca.SX.sym("hull", 2), ca.SX.sym("most")
        off = [self._untouched(*self._bounded(row, column, limit, s), limit) for s, limit in enumerate(limits)]
        outputs = {
            "untouched": reduce(ca.logic_and, off),
            "idle_hull": row[0] + column[0] >= hull[0],
            "unmarked": most <= self.fades[1],
            "known": most < -self.known,
        }
        bounds = {"row_bounds": row, "column_bounds": column}
        inputs = {**bounds, **self._limit_symbols(limits), "hull": hull, "most": most}
        return lower_named("untouched", inputs, outputs)

    def idle(self) -> Program:
        """Program that tests for each firing whether a block does not need `observe`, and whether it needs no `clear`.

        Where a block has no marks and no firing can mark one, `clear` is enough instead of `observe`; the last output
        is then 1.
        """
        row, column = (ca.SX.sym(name, self.bounds_size) for name in ("row_bounds", "column_bounds"))
        limits, unmarked = self._limits(), ca.SX.sym("unmarked")
        plain, untouched = unmarked, []
        for s, limit in enumerate(limits):
            beside, least, arc = self._bounded(row, column, limit, s)
            untouched.append(self._untouched(beside, least, arc, limit))
            plain = ca.logic_and(plain, ca.logic_and(ca.logic_or(beside, arc), limit["regular"]))
        outputs = {f"idle_{s}": ca.logic_or(off, plain) for s, off in enumerate(untouched)}
        outputs |= {f"clean_{s}": ca.logic_or(off, ca.logic_not(plain)) for s, off in enumerate(untouched)}
        bounds = {"row_bounds": row, "column_bounds": column}
        inputs = {**bounds, **self._limit_symbols(limits), "unmarked": unmarked}
        return lower_named("idle", inputs, {**outputs, "unmarked_next": plain})

    def blank_arc(self) -> Program:
        """Program that tests whether no cell of a block can explain a firing, or another cell already explains it."""
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
        """Return whether a block lies beside the cone, its least squared range, and whether none of it is on the arc.

        The extreme values of the block's columns and rows go through the same sums and products as a single cell, and
        rounding preserves the order of values: what holds for them holds for every cell. Every condition is false for
        NaN, so a block with NaN is not skipped.
        """
        at = 1 + _BOUNDS * s
        along, low, high, least, most = (row[at + k] + column[at + k] for k in range(_BOUNDS))
        across = ca.fmax(ca.fmax(low, -high), 0)
        deepest = along * limit["sine"] - across * limit["cosine"]
        arc = ca.logic_or(least > limit["far"], most < limit["near"])
        return deepest <= 2 * _TOUCHED * limit["outside"], least, arc

    @staticmethod
    def _untouched(beside: ca.SX, least: ca.SX, arc: ca.SX, limit: dict[str, ca.SX]) -> ca.SX:
        off = ca.logic_or(beside, ca.logic_and(arc, least >= limit["clear"]))
        return ca.logic_and(off, limit["regular"])

    # --- what happens to a cell ---------------------------------------------------------------------------------------

    def forget(self) -> Program:
        """Program that computes the values of a row of cells after the window has moved: new cells are unknown."""
        cells, row = ca.SX.sym("cells", self.block), ca.SX.sym("row", BASE)
        columns = ca.SX.sym("column", BASE * self.block)
        remembered = [_remembered(cells[k], columns[BASE * k : BASE * (k + 1)], row) for k in range(self.block)]
        return lower_named(
            "forget", {"cells": cells, "row": row, "column": columns}, {"remembered": ca.vertcat(*remembered)}
        )

    def rise(self) -> Program:
        """Program that computes the values of a row of cells, if no mark lasts, after a period without a firing.

        It also extends by this row the search for the block's largest value before the limit 0; a mark that lasts is
        larger than the amount by which a cleared cell approaches 0.
        """
        most, cells = ca.SX.sym("most"), ca.SX.sym("cells", self.block)
        grown = cells + self.fades[1]
        outputs = {"most_next": reduce(ca.fmax, ca.vertsplit(grown), most), "risen": ca.fmin(grown, 0)}
        return lower_named("rise", {"most": most, "cells": cells}, outputs)

    def fade(self) -> Program:
        """Program that computes a cell's value after a period in which no firing observes the cell."""
        value, risen = ca.SX.sym("value"), ca.SX.sym("risen")
        return lower_named("fade", {"risen": risen, "cells": value}, {"faded": self._faded(value, risen)})

    def seek(self) -> Program:
        """Program that tests whether a cell may have caused an echo: it is on the arc and not known to be free."""
        hit, value = ca.SX.sym("hit"), ca.SX.sym("value")
        column, across, row, down = self._cell()
        limits = ca.SX.sym("limits", len(LIMITS))
        limit, line = named_limits(limits), cell_line(across, down)
        old = _remembered(value, column, row)
        faded = self._faded(old, ca.fmin(old + self.fades[1], 0))
        near = ca.logic_and(faded >= -self.known, line[2] <= limit["cutoff"])
        after = ca.logic_or(hit, ca.logic_and(on_arc(line, limit), near))
        inputs = {
            **{"explained": hit, "cells": value, "column": column, "column_beam": across},
            **{"row": row, "row_beam": down, "limits": limits},
        }
        return lower_named("seek", inputs, {"hit_next": after})

    def clear(self) -> Program:
        """Program that computes the values of a row of cells without marks after a firing that marks nothing near."""
        cells, limits = ca.SX.sym("cells", self.block), ca.SX.sym("limits", len(LIMITS))
        down, columns = ca.SX.sym("row_beam", BEAM), ca.SX.sym("column_beam", BEAM * self.block)
        limit, after = named_limits(limits), []
        for k in range(self.block):
            line = cell_line(columns[BEAM * k : BEAM * (k + 1)], down)
            after.append(ca.if_else(in_front(line, limit), -1, cells[k]))
        inputs = {"cells": cells, "row_beam": down, "column_beam": columns, "limits": limits}
        return lower_named("clear", inputs, {"after": ca.vertcat(*after)})

    def glance(self) -> Program:
        """Program that computes a cell's value after a firing that neither marks it nor is in front of its mark.

        The first output tests for this. The last ones say whether the firing is in front of the cell, and marks it.
        """
        value, explained = ca.SX.sym("value"), ca.SX.sym("explained")
        _, across, _, down = self._cell()
        limits = ca.SX.sym("limits", len(LIMITS))
        limit, line, mark = named_limits(limits), cell_line(across, down), value > 0
        front = in_front(line, limit, value)
        marked = ca.logic_and(on_arc(line, limit), ca.logic_or(value >= -self.known, ca.logic_not(explained)))
        finished = ca.logic_not(ca.logic_or(marked, ca.logic_and(front, mark)))
        after = ca.if_else(ca.logic_and(front, ca.logic_not(mark)), -1, value)
        inputs = {"cells": value, "column_beam": across, "row_beam": down, "limits": limits, "explained": explained}
        return lower_named("glance", inputs, {"finished": finished, "after": after, "front": front, "marked": marked})

    def observe(self) -> Program:
        """Program that computes a cell's value after a firing, where `glance` has not finished it."""
        value, front, marked = (ca.SX.sym(name) for name in ("value", "front", "marked"))
        _, across, _, down = self._cell()
        limits = ca.SX.sym("limits", len(LIMITS))
        limit, line = named_limits(limits), cell_line(across, down)
        away, near, moved = direction(across, down, limit), nearby(line, limit), line[2] > limit["moved"]
        lasts, remark, blind = by_direction(value, away, near=near, moved=moved)
        cleared = ca.logic_or(limit["clears"], level(value) <= BLIND)
        free = ca.logic_and(ca.logic_and(front, cleared), ca.logic_not(lasts))
        after = ca.if_else(free, -1, ca.if_else(marked, ca.if_else(limit["ranged"], remark, blind), value))
        inputs = {"finished": ca.SX.sym("finished"), "glanced": ca.SX.sym("glanced"), "cells": value}
        inputs |= {"column_beam": across, "row_beam": down, "limits": limits, "front": front, "marked": marked}
        return lower_named("observe", inputs, {"observed": ca.SX(1), "after": after})

    def cover(self) -> Program:
        """Program that computes a cell's value near the hull: a cell that the hull covers becomes free."""
        value, column, row = ca.SX.sym("value"), ca.SX.sym("column", BASE), ca.SX.sym("row", BASE)
        hull = ca.SX.sym("hull", 2)
        inputs = {"cells": value, "column": column, "row": row, "hull": hull}
        return lower_named("cover", inputs, {"after": ca.if_else(column[1] + row[1] < hull[0], -1, value)})

    # --- the nearest cell of a block ----------------------------------------------------------------------------------

    def count(self) -> Program:
        """Program that extends by a row the count of a block's cells not known to be free, and tests for enough."""
        count, cells = ca.SX.sym("count"), ca.SX.sym("cells", self.block)
        after = count + ca.sum1(cells >= -self.known)
        inputs = {"enough": ca.SX.sym("enough"), "count": count, "cells": cells}
        return lower_named("count", inputs, {"enough_next": after >= self.held, "count_next": after})

    def few(self) -> Program:
        """Program that tests whether a block has so few cells not known to be free that they are ignored."""
        enough = ca.SX.sym("enough")
        return lower_named("few", {"enough": enough}, {"few": ca.logic_not(enough)})

    def all_explained(self) -> Program:
        """Program that tests whether every firing is explained by some cell, so that the search can end."""
        explained = {f"explained_{s}": ca.SX.sym(f"explained_{s}") for s in range(self.slots)}
        return lower_named("all_explained", explained, {"complete": reduce(ca.logic_and, explained.values())})

    def nearest(self, *, unknown: bool) -> Program:
        """Program that extends the search for a block's nearest marked or unknown cell by one row of cells.

        Of several equally near cells, the first cell counts.
        """
        near, hull = ca.SX.sym("near", 3), ca.SX.sym("hull", 2)
        cells, row, columns = (
            ca.SX.sym("cells", self.block),
            ca.SX.sym("row", BASE),
            ca.SX.sym("columns", BASE * self.block),
        )
        dx, least, which = near[0], near[2], 3 if unknown else 1
        for k in range(self.block):
            value = cells[k]
            square = columns[BASE * k + which] + row[which]
            nearer = square < least  # most cells fail this test, which comes first
            if unknown:
                blank = ca.logic_and(value >= -self.known, value <= 0)
                nearer = ca.logic_and(ca.logic_and(nearer, square > hull[1]), blank)
            else:
                nearer = ca.logic_and(nearer, value > 0)
            dx = ca.if_else(nearer, columns[BASE * k], dx)
            least = ca.if_else(nearer, square, least)
        dy = ca.if_else(least < near[2], row[0], near[1])
        inputs = {"near": near, "cells": cells, "row": row, "columns": columns, "hull": hull}
        name = "nearest_unknown" if unknown else "nearest_marked"
        return lower_named(name, inputs, {"near_next": ca.vertcat(dx, dy, least)})

    def sector(self) -> Program:
        """Program that computes the index of the direction in which a cell lies."""
        near = ca.SX.sym("near", 3)
        # side of the cell relative to each line through the robot that separates two directions
        sides = []
        for k in range(self.sectors // 2):
            angle = 2 * pi * (k - 0.5) / self.sectors
            sides.append(near[1] * cos(angle) - near[0] * sin(angle) >= 0)
        passed = ca.SX(0)
        for side in sides:
            passed += side
        return lower_named(
            "sector", {"near": near}, {"sector": ca.if_else(sides[0], passed - 1, self.sectors - 1 - passed)}
        )

    def farther(self) -> Program:
        """Program that tests whether a cell is at least as far as the nearest cell found so far in its direction."""
        near, best = ca.SX.sym("near", 3), ca.SX.sym("best", 3)
        return lower_named("farther", {"near": near, "best": best}, {"farther": near[2] >= best[2]})

    def enter(self) -> Program:
        """Program that computes the nearest cell found so far in the direction `at`, after the nearest of a block."""
        at, best, near, sector = (
            ca.SX.sym(name, size) for name, size in (("at", 1), ("best", 3), ("near", 3), ("sector", 1))
        )
        inputs = {"at": at, "best": best, "near": near, "sector": sector}
        return lower_named("enter", inputs, {"best_next": ca.if_else(sector == at, near, best)})

    # --- parts --------------------------------------------------------------------------------------------------------

    def _faded(self, old: ca.SX, risen: ca.SX) -> ca.SX:
        return ca.if_else(old > 0, ca.if_else(level(old) <= self.fades[0], 0, old - self.fades[0]), risen)

    @staticmethod
    def _cell() -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        names = (("column", BASE), ("column_beam", BEAM), ("row", BASE), ("row_beam", BEAM))
        column, across, row, down = (ca.SX.sym(name, size) for name, size in names)
        return column, across, row, down

    def _limits(self) -> list[dict[str, ca.SX]]:
        return [named_limits(ca.SX.sym(f"limits_{s}", len(LIMITS))) for s in range(self.slots)]

    @staticmethod
    def _limit_symbols(limits: list[dict[str, ca.SX]]) -> dict[str, ca.SX]:
        return {f"limits_{s}": ca.vertcat(*one.values()) for s, one in enumerate(limits)}


def _remembered(value: ca.SX, column: ca.SX, row: ca.SX) -> ca.SX:
    return value * (row[2] * column[2])
