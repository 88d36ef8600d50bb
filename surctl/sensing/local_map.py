"""Carve and mark: a small world-fixed map around the robot, from ranges alone.

A range d says that nothing stands in the cone short of d, and that something stands somewhere on the arc at d. So a
reading clears the cells short of it and marks those on the arc that are not known to be free; when all of them are
(something moved), it marks the whole arc. One reading of a wide beam thus marks far too much: as the robot turns, the
edges of other cones cross the false marks and clear them (range-only mapping; cf. Moravec and Elfes 1985, "High
resolution maps from wide angle sonar").

The map is a torus: world cell (I, J) lives at (I mod N, J mod N), the window moves with the robot, and a cell that
comes in at one side takes the place of the one that leaves at the other. So its size does not depend on the site.
Where it would reach beyond the site's walls it stays inside: nothing is to be known there, and it holds more of what is
before the robot. Nor does it matter what is unknown in the two cells beside a wall, which few beams see between wall
and range error: anything more than two cells across that stands there also stands in the third.
A cell holds one number: 1 just marked, fading to 0 in `mark_time`; −1 just cleared, fading to 0 in `free_time`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite, pi, sin

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Call, Loop, Port, Program, Routine, Step, lower

__all__ = ["MIDDLE", "READING", "LocalMap"]

READING = (
    ("apex", 2, "m, x and y in {E}"),
    ("axis", 2, "unit vector of the beam in {E}"),
    ("half", 2, "cosine and sine of half the beam's angle"),
    ("clear", 1, "m, range short of which the cone is free; 0: none; below 0: blind, it leaves what was ranged"),
    ("near", 1, "m, where the marked band begins"),
    ("far", 1, "m, where it ends; below `near`: nothing is marked"),
    ("reach", 1, "m, range beyond which a cell does not explain the echo"),
)
"""One firing: name, numbers, meaning."""

BLIND = 0.25
"""A mark of a firing that only said that something is nearer than its blind range."""

RING = 1.5
"""Cells beside the hull that no beam sees whole: what is unknown there does not count, so none may come in unknown."""

_READING_SIZE = sum(size for _, size, _ in READING)
_INSIDE, _INSIDE_MORE = 0.6, 0.01  # cells, and m: how deep inside a beam a cell must lie to be cleared
# of half the beam's width, where the beam is narrower than that: its middle clears, its turn shows the rest
_OF_THE_UNKNOWN, _OF_A_MARK = 0.4, 0.75
MIDDLE = 1.0 - _OF_THE_UNKNOWN
"""Share of a narrow beam's width that clears what is unknown."""
_HOLDS = 3  # cells of a block not known to be free, without which the middle of no disc two cells across lies in it
_AT_A_WALL = 2  # cells beside a wall that count for nothing: what is larger than that shows in the next one
_SLACK = 1e-3  # cells by which a wall may miss the grid
_LINE = 4  # numbers of a column or row beside those of each firing
_NOWHERE = 1e6  # cells; lowest corner of a window that has never been
_FAR = 1e6  # m², of a block without such a cell


@dataclass(frozen=True, kw_only=True)
class LocalMap:
    """The map's fixed sizes and times.

    Attributes:
        dt: period of the updates [s].
        slots: most firings in one period.
        blocks: blocks a side.
        block: cells a side of a block; of each block the nearest marked and the nearest unknown cell is kept.
        sectors: directions in which the nearest is told, a multiple of 4.
        mark_time: [s] for which a mark stands (*chosen*).
        free_time: [s] after which a cleared cell counts for nothing any more (*chosen*).
        known: part of `free_time`, counted from its end, in which it no longer counts as known to be free (*chosen*).
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
        """Check the values; InputError names the wrong one."""
        for name in ("dt", "mark_time", "free_time"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError("must be greater than 0", key=f"map.{name}", value=value, remedy="give s")
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
        """Cells a side N."""
        return self.blocks * self.block

    @property
    def held(self) -> int:
        """Fewest cells not known to be free with which a block's unknown cells count.

        A disc two cells across touches the cell of its middle and the four beside it, three of them in one block at
        the least: so nothing that large hides where less than that is unknown.
        """
        return min(_HOLDS, self.block * self.block)

    @property
    def memory(self) -> float:
        """Time [s] for which a cleared cell counts as known."""
        return (1.0 - self.known) * self.free_time

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """The state: the cells, block after block (row by row, and so inside a block), and the window's corner."""
        return (
            Port(f"{prefix}cells", (self.side * self.side,), "1", "1 marked … 0 unknown … -1 cleared, block by block"),
            Port(f"{prefix}corner", (2,), "1", "lowest cell of the window along x and y of {E}", _NOWHERE),
        )

    def routine(self) -> Routine:
        """(cells, corner, place, walls, slots) → (cells, corner, marked, unknown).

        `place` (4,): the robot's x, y in {E} [m], hull radius [m], edge of a cell [m]. `walls` (4,): x_min, x_max,
        y_min, y_max of the site in {E} [m]; far away where there are none. `slots` (slots · 10,): one firing after the
        other, see `READING`. `marked` and `unknown` (sectors · 3,): for each direction the offset x, y from the robot's
        centre to the nearest such cell [m] and its squared distance [m²], 1e6 when there is none.
        """
        n, blocks = self.side, self.blocks
        line, spans, fixed = self._line(), ("columns", "rows"), ("place", "slots")
        look = self._row(self._look(), carried=("found",), made=("found_last",))
        change = self._sorted(self._row(self._change(), carried=(), made=("cells_next", "near")))
        none = (0.0, 0.0, _FAR) * self.sectors
        constants = _constants("constants", (0.0,), (1.0,), (0.0,) * self.slots, none, none)
        where = ("place", "walls", "slots", "corner", "corner_next")
        steps: tuple[Step, ...] = (
            Call(constants, (), ("is_columns", "is_rows", "found", "marked_none", "unknown_none")),
            Call(self._corner(), ("place", "walls"), ("corner_next",)),
            *(Loop(line, n, (), (span,), fixed=(f"is_{span}", *where), index=True) for span in spans),
            Loop(look, blocks, ("found",), ("found_last",), sliced=("cells", "rows"), fixed=(*fixed, "columns")),
            Loop(
                change,
                blocks,
                ("marked_none", "unknown_none"),
                ("marked", "unknown", "cells_next"),
                sliced=("cells", "rows"),
                fixed=(*fixed, "found_last", "columns"),
            ),
        )
        inputs = (("cells", n * n), ("corner", 2), ("place", 4), ("walls", 4), ("slots", self.slots * _READING_SIZE))
        return Routine("local_map", inputs, steps, ("cells_next", "corner_next", "marked", "unknown"))

    @property
    def _line_size(self) -> int:
        return _LINE + 3 * self.slots

    def _corner(self) -> Program:
        """The window's lowest cell: the robot is in its middle, but where it would reach beyond the site."""
        place, walls = ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        lowest = ca.floor(walls[[0, 2]] / place[3] + _SLACK)
        end = -ca.floor(_SLACK - walls[[1, 3]] / place[3])
        middle = ca.floor(place[:2] / place[3]) - self.side // 2
        corner = ca.fmax(ca.fmin(middle, end - self.side), lowest)
        return _lowered("corner", {"place": place, "walls": walls}, {"corner": corner})

    def _line(self) -> Program:
        """One column or row: offset of its centres from the robot, its square, whether it was there before, whether
        it counts; and for each firing its share of the way along the beam, of that across, and of the squared distance.
        """
        at, span = ca.SX.sym("at"), ca.SX.sym("span")
        place, walls = ca.SX.sym("place", 4), ca.SX.sym("walls", 4)
        slots = ca.SX.sym("slots", self.slots * _READING_SIZE)
        old, new = ca.SX.sym("old", 2), ca.SX.sym("new", 2)
        n, second = self.side, span > 0.5

        def of(pair: ca.SX) -> ca.SX:
            return ca.if_else(second, pair[1], pair[0])

        def world(corner: ca.SX) -> ca.SX:
            return at + n * ca.floor((corner + (n - 1) - at) / n)

        cell = world(of(new))
        centre = (cell + 0.5) * place[3]
        offset = centre - of(place)
        beside = _AT_A_WALL * place[3]
        counts = ca.logic_and(centre > of(walls[[0, 2]]) + beside, centre < of(walls[[1, 3]]) - beside)
        parts = [offset, offset * offset, world(of(old)) == cell, counts]
        for slot in self._split(slots):
            away, ex, ey = centre - of(slot["apex"]), slot["axis"][0], slot["axis"][1]
            # across = dx·ey − dy·ex: a row's share has the other sign
            parts += [away * of(slot["axis"]), ca.if_else(second, -away * ex, away * ey), away * away]
        inputs = {"at": at, "span": span, "place": place, "walls": walls, "slots": slots, "old": old, "new": new}
        return _lowered("line", inputs, {"line": ca.vertcat(*parts)})

    def _row(self, block: Program, *, carried: tuple[str, ...], made: tuple[str, ...]) -> Routine:
        """A row of blocks."""
        given = dict(block.inputs)
        fixed = tuple(k for k in given if k not in (*carried, "cells", "columns"))
        loop = Loop(block, self.blocks, carried, made, sliced=("cells", "columns"), fixed=fixed)
        wide = {k: given[k] * self.blocks for k in ("cells", "columns")}
        order = (*carried, "cells", "rows", *(k for k in fixed if k != "rows"), "columns")
        return Routine(f"{block.name}_row", tuple((k, wide.get(k, given[k])) for k in order), (loop,), made)

    def _sorted(self, row: Routine) -> Routine:
        """A row of blocks, whose nearest cells are sorted in at once: those of all rows need not be kept."""
        best = ("marked_none", "unknown_none")
        sort = Loop(self._sort(), self.blocks, best, ("marked", "unknown"), sliced=("near",))
        inputs = (*((name, 3 * self.sectors) for name in best), *row.inputs)
        return Routine(row.name, inputs, (*row.steps, sort), ("marked", "unknown", "cells_next"))

    def _look(self) -> Program:
        """Whether a cell on a firing's arc may hold what it heard: one that is not known to be free."""
        found = ca.SX.sym("found", self.slots)
        symbols = self._block_symbols()
        after = ca.SX(found)
        for value, line, slots in self._each(symbols):
            maybe = value >= -self.known
            for s, slot in enumerate(slots):
                near = ca.logic_and(maybe, line[s][2] <= slot["reach"] * slot["reach"])
                here = ca.logic_and(self._on_arc(line[s], slot, symbols["place"][3]), near)
                after[s] = ca.logic_or(after[s], here)
        return _lowered("look", {"found": found, **symbols}, {"found_last": after})

    def _change(self) -> Program:
        """The cells after this period's firings, and the nearest marked and unknown one of the block."""
        found = ca.SX.sym("found", self.slots)
        symbols = self._block_symbols()
        hull, edge = symbols["place"][2], symbols["place"][3]
        ring = hull + RING * edge
        inside, beyond = hull * hull, ring * ring
        cells, count = [], ca.SX(0)
        near = [ca.SX([0.0, 0.0, _FAR]), ca.SX([0.0, 0.0, _FAR])]
        for k, (value, line, slots) in enumerate(self._each(symbols)):
            dx, dy, square, inner = self._offset(symbols, k)
            for s, slot in enumerate(slots):
                marked = ca.logic_and(
                    self._on_arc(line[s], slot, edge), ca.logic_or(value >= -self.known, ca.logic_not(found[s]))
                )
                mark = ca.if_else(slot["clear"] >= 0, 1, ca.fmax(value, BLIND))
                value = ca.if_else(self._in_front(line[s], slot, edge, value), -1, ca.if_else(marked, mark, value))
            value = ca.if_else(square < inside, -1, value)
            cells.append(value)
            count += value >= -self.known
            here = ca.vertcat(dx, dy, square)
            blank = ca.logic_and(ca.logic_and(value >= -self.known, value <= 0), ca.logic_and(square > beyond, inner))
            for which, holds in enumerate((value > 0, blank)):
                nearer = ca.logic_and(holds, square < near[which][2])
                near[which] = ca.if_else(nearer, here, near[which])
        near[1][2] = ca.if_else(count < self.held, _FAR, near[1][2])
        return _lowered("change", {**symbols, "found": found}, {"after": ca.vertcat(*cells), "near": ca.vertcat(*near)})

    def _block_symbols(self) -> dict[str, ca.SX]:
        b, size = self.block, self._line_size
        return {
            "cells": ca.SX.sym("cells", b * b),
            "columns": ca.SX.sym("columns", b * size),
            "rows": ca.SX.sym("rows", b * size),
            "place": ca.SX.sym("place", 4),
            "slots": ca.SX.sym("slots", self.slots * _READING_SIZE),
        }

    def _offset(self, symbols: dict[str, ca.SX], k: int) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """x, y, squared distance from the robot, and whether the cell counts."""
        size = self._line_size
        row, column = symbols["rows"][(k // self.block) * size :], symbols["columns"][(k % self.block) * size :]
        return column[0], row[0], column[1] + row[1], ca.logic_and(column[3], row[3])

    def _each(self, symbols: dict[str, ca.SX]) -> list[tuple[ca.SX, list[ca.SX], list[dict[str, ca.SX]]]]:
        """For each cell of a block: its faded value, (along, |across|, squared range) for each firing, the firings."""
        size, slots = self._line_size, self._split(symbols["slots"])
        out = []
        for k in range(self.block * self.block):
            row = symbols["rows"][(k // self.block) * size : (k // self.block + 1) * size]
            column = symbols["columns"][(k % self.block) * size : (k % self.block + 1) * size]
            old = symbols["cells"][k] * (row[2] * column[2])
            faded = old - ca.fmin(ca.fmax(old, -self.dt / self.free_time), self.dt / self.mark_time)
            lines = []
            for s in range(self.slots):
                a, b = (part[_LINE + 3 * s : _LINE + 3 + 3 * s] for part in (row, column))
                lines.append(ca.vertcat(a[0] + b[0], ca.fabs(a[1] + b[1]), a[2] + b[2]))
            out.append((faded, lines, slots))
        return out

    @staticmethod
    def _inside(line: ca.SX, slot: dict[str, ca.SX]) -> ca.SX:
        """Distance into the cone from its nearer edge [m]."""
        return line[0] * slot["half"][1] - line[1] * slot["half"][0]

    def _in_front(self, line: ca.SX, slot: dict[str, ca.SX], edge: ca.SX, value: ca.SX) -> ca.SX:
        """Whether the whole cell is free: half a cell inside the cone, short of what was heard."""
        whole, beam = _INSIDE * edge + _INSIDE_MORE, line[0] * slot["half"][1]
        deep = ca.fmin(whole, ca.if_else(value > 0, _OF_A_MARK, _OF_THE_UNKNOWN) * beam)
        short = ca.logic_and(line[2] < slot["clear"] * slot["clear"], ca.logic_or(slot["clear"] > 0, value <= BLIND))
        return ca.logic_and(self._inside(line, slot) > deep, short)

    def _on_arc(self, line: ca.SX, slot: dict[str, ca.SX], edge: ca.SX) -> ca.SX:
        """Whether any of the cell may be what was heard."""
        band = ca.logic_and(line[2] >= slot["near"] * slot["near"], line[2] <= slot["far"] * ca.fabs(slot["far"]))
        return ca.logic_and(self._inside(line, slot) > -0.5 * edge, band)

    def _split(self, slots: ca.SX) -> list[dict[str, ca.SX]]:
        out = []
        for s in range(self.slots):
            at, one = s * _READING_SIZE, {}
            for name, size, _ in READING:
                one[name] = slots[at : at + size]
                at += size
            out.append(one)
        return out

    def _sort(self) -> Program:
        """Nearest of all blocks so far in each direction."""
        best = [ca.SX.sym("marked", 3 * self.sectors), ca.SX.sym("unknown", 3 * self.sectors)]
        near = ca.SX.sym("near", 6)
        after = []
        for which in range(2):
            here = near[3 * which : 3 * which + 3]
            # the side of each line through the robot that parts two directions
            sides = []
            for k in range(self.sectors // 2):
                angle = 2 * pi * (k - 0.5) / self.sectors
                sides.append(here[1] * cos(angle) - here[0] * sin(angle) >= 0)
            sides += [ca.logic_not(side) for side in sides]
            rows = []
            for k in range(self.sectors):
                inside = ca.logic_and(sides[k], ca.logic_not(sides[(k + 1) % self.sectors]))
                old = best[which][3 * k : 3 * k + 3]
                rows.append(ca.if_else(ca.logic_and(inside, here[2] < old[2]), here, old))
            after.append(ca.vertcat(*rows))
        inputs = {"marked_none": best[0], "unknown_none": best[1], "near": near}
        return _lowered("sort", inputs, {"marked": after[0], "unknown": after[1]})


def _constants(name: str, *values: tuple[float, ...]) -> Program:
    made = [ca.DM(list(v)) for v in values]
    return lower(ca.Function(name, [], [ca.SX(m) for m in made], [], [f"c{k}" for k in range(len(made))]))


def _lowered(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> Program:
    made = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), made, list(inputs), list(outputs), {"cse": True}))
