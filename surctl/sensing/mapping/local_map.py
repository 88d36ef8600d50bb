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
from math import isfinite

import casadi as ca

from surctl.errors import InputError
from surctl.ir import Call, Gather, Loop, Port, Program, Routine, Step, lower
from surctl.sensing.mapping.firing import BLIND, LIMITS, MIDDLE, READING, READING_SIZE, RING
from surctl.sensing.mapping.programs import BASE, BEAM, NONE, MapPrograms

__all__ = ["BLIND", "MIDDLE", "READING", "RING", "LocalMap"]

_HOLDS = 3  # cells of a block not known to be free, without which the middle of no disc two cells across lies in it
_NOWHERE = 1e6  # cells; lowest corner of a window that has never been
_WIDEST = 8  # cells side by side
_WHERE = ("is_row", "place", "walls", "slots", "corner", "corner_next")  # what a column or row follows from


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
        return _Steps(self).routine()


class _Steps:
    """The loops around the programs.

    A block of cells is left alone by what does not touch it: a loop of one turn whose flag is up at the start does
    nothing, and the flag comes from the bounds of the block's columns and rows.
    """

    def __init__(self, local_map: LocalMap) -> None:
        self.local_map, self.block, self.lanes = local_map, local_map.block, 1
        while self.lanes < _WIDEST and self.block % (2 * self.lanes) == 0:
            self.lanes *= 2
        self.programs = MapPrograms(
            slots=local_map.slots,
            side=local_map.side,
            block=self.block,
            lanes=self.lanes,
            sectors=local_map.sectors,
            fades=(local_map.dt / local_map.mark_time, local_map.dt / local_map.free_time),
            known=local_map.known,
            held=local_map.held,
        )
        self.limits, self.explained, self.explained_next, self.idle = (
            tuple(f"{name}_{s}" for s in range(local_map.slots))
            for name in ("limits", "explained", "explained_next", "idle")
        )
        # of a column or row: its base, then its beam for each firing
        self.columns, self.rows = (
            (name, *(f"{name}_beam_{s}" for s in range(local_map.slots))) for name in ("column", "row")
        )

    def routine(self) -> Routine:
        """All of it."""
        local_map, n, blocks, none = (
            self.local_map,
            self.local_map.side,
            self.local_map.blocks,
            NONE * self.local_map.sectors,
        )
        constants = _constants("constants", (0.0,), (1.0,), (0.0,) * self.lanes, NONE, none, none)
        names = ("first", "is_row", "zeros", "none", "marked_none", "unknown_none")
        shared = (*_WHERE, *self.limits, *self.columns, "column_bounds")
        steps: tuple[Step, ...] = (
            Call(constants, (), names),
            Call(self.programs.corner(), ("place", "walls"), ("corner_next",)),
            Call(self.programs.prepare(), ("place", "slots"), (*self.limits, "hull", "complete", *self.explained)),
            Loop(
                self.programs.line(),
                n // self.lanes,
                (),
                self.columns,
                fixed=("first", "first", *_WHERE[1:]),
                index=True,
                lanes=self.lanes,
            ),
            Loop(self.programs.bounds(columns=True), blocks, (), ("column_bounds",), sliced=self.columns),
            Loop(
                self._seek_row(),
                blocks,
                ("complete", *self.explained),
                ("complete_next", *self.explained_next),
                sliced=("cells",),
                fixed=("zeros", *shared),
                index=True,
                until=0,
            ),
            Loop(
                self._change_row(),
                blocks,
                ("marked_none", "unknown_none"),
                ("marked", "unknown", "cells_next"),
                sliced=("cells",),
                fixed=("zeros", "none", "hull", *self.explained_next, *shared),
                index=True,
            ),
        )
        inputs = (
            ("cells", n * n),
            ("corner", 2),
            ("place", 4),
            ("walls", 4),
            ("slots", local_map.slots * READING_SIZE),
        )
        return Routine("local_map", inputs, steps, ("cells_next", "corner_next", "marked", "unknown"))

    def _rows(self) -> tuple[Step, ...]:
        """The rows of a row of blocks, which are not worth keeping for the second pass, and their bounds."""
        fixed = ("group", *_WHERE)
        return (
            Loop(self.programs.line(), self.block, (), self.rows, fixed=fixed, index=True),
            Call(self.programs.bounds(columns=False), self.rows, ("row_bounds",)),
        )

    # --- whether a cell explains what a firing heard ------------------------------------------------------------------

    def _seek_row(self) -> Routine:
        """A row of blocks: which firings a cell explains; over once each of them has one."""
        blocks, state = self.local_map.blocks, ("complete", *self.explained)
        fixed, pieces = ("zeros", *self.limits), (*self.columns, "column_bounds")
        last = ("complete_next", *self.explained_next)
        steps = (
            *self._rows(),
            Loop(
                self._seek_block(),
                blocks,
                state,
                last,
                sliced=("cells", *pieces),
                fixed=(*fixed, *self.rows, "row_bounds"),
                until=0,
            ),
        )
        shared = ("zeros", *_WHERE, *self.limits)
        inputs = self._sized("group", *state, ("cells", blocks), *shared, *((name, blocks) for name in pieces))
        return Routine("seek_row", inputs, steps, last)

    def _seek_block(self) -> Routine:
        seek, blank = self._seek_cells(), tuple(f"blank_{s}" for s in range(self.local_map.slots))
        bounds, last = ("row_bounds", "column_bounds"), ("complete_next", *self.explained_next)
        steps: list[Step] = [Call(self.programs.blank_arc(), (*bounds, *self.limits, *self.explained), blank)]
        for s, explained in enumerate(self.explained):
            fixed = ("cells", "row", f"row_beam_{s}", "column", f"column_beam_{s}", self.limits[s], "zeros")
            results = (f"sought_{s}", self.explained_next[s])
            steps.append(Loop(seek, 1, (blank[s], explained), results, fixed=fixed, until=0))
        steps.append(Call(self.programs.all_explained(), self.explained_next, last[:1]))
        inputs = (
            "complete",
            *self.explained,
            "cells",
            *self.columns,
            "column_bounds",
            "zeros",
            *self.limits,
            *self.rows,
        )
        return Routine("seek_block", self._sized(*inputs, "row_bounds"), tuple(steps), last)

    def _seek_cells(self) -> Routine:
        """The cells of one block, for one firing."""
        row = self._over_row(self.programs.seek(), carried=("hits",))
        lines, fixed = ("cells", "row", "row_beam"), ("column", "column_beam", "limits")
        steps = (
            Loop(row, self.block, ("zeros",), ("hits",), sliced=lines, fixed=fixed),
            Call(self.programs.any_hit(), ("hits",), ("explained_next",)),
        )
        return Routine(
            "seek_cells", self._sized("flag", "explained", *lines, *fixed, "zeros"), steps, ("flag", "explained_next")
        )

    # --- what the firings change --------------------------------------------------------------------------------------

    def _change_row(self) -> Routine:
        """A row of blocks: its cells after this period, and the nearest with them."""
        blocks, best = self.local_map.blocks, ("marked", "unknown")
        fixed, pieces = ("zeros", "none", "hull", *self.explained, *self.limits), (*self.columns, "column_bounds")
        last = ("marked_next", "unknown_next", "cells_next")
        steps = (
            *self._rows(),
            Loop(
                self._change_block(),
                blocks,
                best,
                last,
                sliced=("cells", *pieces),
                fixed=(*fixed, *self.rows, "row_bounds"),
            ),
        )
        shared = ("zeros", "none", "hull", *self.explained, *_WHERE, *self.limits)
        inputs = self._sized("group", *best, ("cells", blocks), *shared, *((name, blocks) for name in pieces))
        return Routine("change_row", inputs, steps, last)

    def _change_block(self) -> Routine:
        last, bounds = ("marked_next", "unknown_next", "cells_next"), ("row_bounds", "column_bounds")
        touched = [f"cells_{k}" for k in range(self.local_map.slots + 1)]
        fade, observe, cover = self.programs.fade(), self.programs.observe(), self.programs.cover()
        idle = Call(self.programs.idle(), (*bounds, *self.limits, "hull"), (*self.idle, "idle_hull"))
        rows = Loop(self._over_row(fade), self.block, (), ("cells_0",), sliced=("cells", "row"), fixed=("column",))
        steps: list[Step] = [rows, idle]
        observe_block = self._over_block(observe)
        for s, explained in enumerate(self.explained):
            beams = (f"row_beam_{s}", f"column_beam_{s}", self.limits[s], explained)
            results = (f"observed_{s}", touched[s + 1])
            steps.append(Loop(observe_block, 1, (self.idle[s], touched[s]), results, fixed=beams, until=0))
        fixed, count = ("row", "column", "hull"), self.block * self.block // self.lanes
        tally = self.programs.tally()
        steps += [
            Loop(self._over_block(cover), 1, ("idle_hull", touched[-1]), ("covered", last[-1]), fixed=fixed, until=0),
            Loop(tally, count, ("zeros", "zeros"), ("largest", "count"), sliced=last[-1:], lanes=self.lanes),
            Call(self.programs.without(), ("largest", "count"), ("no_marked", "no_unknown")),
        ]
        for which in ("marked", "unknown"):
            results = (f"entered_{which}", f"{which}_next")
            block = self._enter(which)
            steps.append(Loop(block, 1, (f"no_{which}", which), results, fixed=(last[-1], *fixed, "none"), until=0))
        inputs = (
            "marked",
            "unknown",
            "cells",
            *self.columns,
            "column_bounds",
            "zeros",
            "none",
            "hull",
            *self.explained,
        )
        return Routine("change_block", self._sized(*inputs, *self.limits, *self.rows, "row_bounds"), tuple(steps), last)

    def _enter(self, which: str) -> Routine:
        """The nearest cell of one block, if it is the nearest so far in its direction."""
        nearest = self.programs.nearest(unknown=which == "unknown")
        steps = (
            Loop(nearest, self.block, ("none",), ("near",), sliced=("cells", "row"), fixed=("column", "hull")),
            Call(self.programs.sector(), ("near",), ("sector",)),
            Gather("best", "sector", len(NONE), "so_far"),
            Call(self.programs.farther(), ("near", "so_far"), ("farther",)),
            Loop(
                self.programs.enter(),
                1,
                ("farther", "best"),
                ("done", "best_next"),
                fixed=("near", "sector"),
                until=0,
            ),
        )
        inputs = self._sized("flag", "best", "cells", "row", "column", "hull", "none")
        return Routine(f"enter_{which}", inputs, steps, ("done", "best_next"))

    # --- from one cell to a row of a block, and to a block ------------------------------------------------------------

    def _over_row(self, program: Program, *, carried: tuple[str, ...] = ()) -> Routine:
        """A program of one cell over a row of a block: state of the lanes, cells, row, columns, the rest."""
        sizes = dict(program.inputs)
        renamed = dict(zip(sizes, carried, strict=False))
        own = tuple(name for name in sizes if name in ("cells", "column", "column_beam"))
        rest = tuple(name for name in sizes if name not in (*renamed, *own))
        results = tuple(f"{name}_next" for name in carried) or ("after",)
        loop = Loop(program, self.block // self.lanes, carried, results, sliced=own, fixed=rest, lanes=self.lanes)
        wide = {**{name: self.block * sizes[name] for name in own}, **{name: sizes[name] for name in rest}}
        wide |= {name: self.lanes * sizes[old] for old, name in renamed.items()}
        lines = tuple(name for name in rest if name in ("row", "row_beam"))
        order = (*carried, *own[:1], *lines, *own[1:], *(name for name in rest if name not in lines))
        return Routine(f"{program.name}_row", tuple((name, wide[name]) for name in order), (loop,), results)

    def _over_block(self, program: Program) -> Routine:
        """The same over a block, for a loop of one turn."""
        row = self._over_row(program)
        names = tuple(name for name, _ in row.inputs)
        lines = tuple(name for name in names if name in ("cells", "row", "row_beam"))
        fixed = tuple(name for name in names if name not in lines)
        steps = (Loop(row, self.block, (), ("after",), sliced=lines, fixed=fixed),)
        return Routine(f"{program.name}_block", self._sized("flag", *names), steps, ("flag", "after"))

    def _sized(self, *names: str | tuple[str, int]) -> tuple[tuple[str, int], ...]:
        """Input arrays with their sizes, of one block unless a number of blocks stands beside the name."""
        b, sectors = self.block, len(NONE) * self.local_map.sectors
        sizes = {"cells": b * b, "column": b * BASE, "row": b * BASE, "zeros": self.lanes, "none": len(NONE), "hull": 2}
        sizes |= dict.fromkeys(("marked", "unknown", "best"), sectors)
        sizes |= {"place": 4, "walls": 4, "slots": self.local_map.slots * READING_SIZE, "corner": 2, "corner_next": 2}
        sizes |= dict.fromkeys(("column_beam", "row_beam", *self.columns[1:], *self.rows[1:]), b * BEAM)
        sizes |= dict.fromkeys(("column_bounds", "row_bounds"), self.programs.bounds_size)
        sizes |= dict.fromkeys(("limits", *self.limits), len(LIMITS))
        listed = [(name, 1) if isinstance(name, str) else name for name in names]
        return tuple((name, count * sizes.get(name, 1)) for name, count in listed)


def _constants(name: str, *values: tuple[float, ...]) -> Program:
    vectors = [ca.DM(list(v)) for v in values]
    return lower(ca.Function(name, [], [ca.SX(m) for m in vectors], [], [f"c{k}" for k in range(len(vectors))]))
