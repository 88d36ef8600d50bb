"""The local map: a grid of cells that moves with the robot, how long marks last, and the nearest marks around.

A measured range d means that the cone of the beam is free up to d, and that an object lies somewhere on the arc at d.
So a reading clears the cells nearer than d and marks the cells on the arc that are not known to be free. If all cells
on the arc are known to be free (an object moved), the reading marks the whole arc. So one reading of a wide beam marks
many cells that are in fact free. As the robot turns, the edges of later cones cross these false marks and clear them
(range-only mapping; see Moravec and Elfes 1985, "High resolution maps from wide angle sonar").

The map is a window of N × N cells that moves with the robot. The map is stored as a torus: the cell (I, J) of the world
is stored at index (I mod N, J mod N). A cell that enters the window at one side replaces the cell that leaves at the
opposite side, so the size of the map does not depend on the site. If the window fits between the walls of the site, it
never extends beyond the walls, because no cells are needed there. Unknown cells in the two rows of cells beside a wall
are ignored, because the range error hides these two rows from most beams. An object there that is wider than two cells
also extends into the third row, which is not ignored. Each cell holds one number. When a cell is marked, its number
becomes 1 and fades to 0 within `mark_time`; it also stores the directions from which the cell was heard (see
`mapping.firing`). When a cell is cleared, its number becomes −1 and fades to 0 within `free_time`.
"""

from __future__ import annotations

from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Call, Gather, Loop, Port, Program, Routine, Step, lower
from surctl.marine.sensing.mapping.firing import LIMITS, READING_SIZE
from surctl.marine.sensing.mapping.programs import BASE, BEAM, NONE, MapParameters, MapPrograms

Vector: TypeAlias = NDArray[np.float64]

_NOWHERE = 1e6  # cells; lowest corner of the window before the first update
_WIDEST = 8  # largest number of cells processed together
_WHERE = ("is_row", "place", "walls", "slots", "corner", "corner_next")  # inputs that determine a column or row


class LocalMap(MapParameters):
    """The local map of a law; `MapParameters` describes its numbers of cells and its times."""

    def ports(self, prefix: str = "") -> tuple[Port, ...]:
        """Return the entries (name, shape, initial value) of the state.

        The state consists of the values of the cells, block by block and row by row, and the lowest cell of the
        window.
        """
        return (
            Port(f"{prefix}cells", (self.side * self.side,), "1", "1 marked, 0 unknown, -1 cleared; block by block"),
            Port(f"{prefix}corner", (2,), "1", "lowest cell of the window along x and y of {E}", _NOWHERE),
        )

    def routine(self) -> Routine:
        """Return the routine that updates the map by the firings of one period and finds the nearest cells.

        The inputs are `cells`, `corner`, `place`, `walls` and `slots`; the outputs are the next `cells` and `corner`,
        and `marked` and `unknown`. `cells` and `corner` are the state, see `ports`. `place` (4,) holds the robot's
        position x, y in {E} [m], the hull radius [m] and the edge length of a cell [m]. `walls` (4,) holds x_min,
        x_max, y_min, y_max of the site in {E} [m]; a site without walls needs distant walls here. `slots` (slots · 10,)
        holds the firings one after another, each with the 10 numbers of `READING`. `marked` (sectors · 3,) holds three
        numbers for each direction: the offset x, y [m] from the robot's centre to the nearest marked cell, and the
        squared distance [m²] of this cell; the squared distance is 1e6 if no cell is marked. `unknown` (sectors · 3,)
        holds the corresponding numbers for the nearest unknown cell.
        """
        return _Steps(self).routine()

    def view(self, cells: ArrayLike, corner: ArrayLike, *, edge: float = 1.0) -> tuple[Vector, Vector, Vector]:
        """Return the map in {E}: values (N, N) indexed by y, then x; coordinates x (N,) and y (N,) of the cell centres.

        Args:
            cells: (N²,) values of the cells in the state of the map.
            edge: edge length of a cell [m]; with 1 the coordinates of the centres are in cells.

        Raises:
            InputError: if an array does not have the stated size.
        """
        n, many, size = self.side, self.blocks, self.block
        stored, low = np.asarray(cells, dtype=float), np.asarray(corner, dtype=float)
        for name, array, count in (("cells", stored, n * n), ("corner", low, 2)):
            if array.shape != (count,):
                raise InputError(f"has shape {array.shape}", key=name, remedy=f"give ({count},)")
        strength = stored - np.sign(stored) * 2 * np.floor(np.abs(stored) / 2)
        torus = strength.reshape(many, many, size, size).swapaxes(1, 2).reshape(n, n)
        x, y = (low[axis] + np.arange(n) for axis in (0, 1))
        values = torus[np.ix_(np.mod(y, n).astype(int), np.mod(x, n).astype(int))]
        return values, (x + 0.5) * edge, (y + 0.5) * edge


class _Steps:
    """The loops that call the programs of the local map (`MapPrograms`) for all cells and blocks.

    Blocks of cells that the cone of a firing does not touch are skipped. For this purpose, a flag is computed from the
    extreme values of the block's columns and rows; if the flag is set, a loop that has one iteration is not executed.
    """

    def __init__(self, local_map: LocalMap) -> None:
        self.local_map, self.block, self.lanes = local_map, local_map.block, 1
        while self.lanes < _WIDEST and self.block % (2 * self.lanes) == 0:
            self.lanes *= 2
        self.programs = MapPrograms(local_map, self.lanes)
        self.limits, self.explained, self.explained_next, self.idle, self.clean = (
            tuple(f"{name}_{s}" for s in range(local_map.slots))
            for name in ("limits", "explained", "explained_next", "idle", "clean")
        )
        # base of a column or row, then its beam for each firing
        self.columns, self.rows = (
            (name, *(f"{name}_beam_{s}" for s in range(local_map.slots))) for name in ("column", "row")
        )

    def routine(self) -> Routine:
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
        # the cell rows of a row of blocks, and the bounds of these cell rows
        fixed = ("group", *_WHERE)
        return (
            Loop(self.programs.line(), self.block, (), self.rows, fixed=fixed, index=True),
            Call(self.programs.bounds(columns=False), self.rows, ("row_bounds",)),
        )

    # --- whether a cell explains the echo of a firing -----------------------------------------------------------------

    def _seek_row(self) -> Routine:
        # searches for cells that explain the firings
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
        # also updates the nearest cells found so far
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
        flags = (*self.idle, *self.clean, "idle_hull", "unmarked", "with_marks")
        tally, cover = self.programs.tally(), self.programs.cover()
        fixed, count = ("row", "column", "hull"), self.block * self.block // self.lanes
        steps: list[Step] = [
            Loop(self.programs.most(), count, ("zeros",), ("most",), sliced=("cells",), lanes=self.lanes),
            Call(self.programs.idle(), (*bounds, *self.limits, "hull", "most"), flags),
        ]
        rise, fade = (self._over_block(self.programs.fade(marks=marks)) for marks in (False, True))
        steps += [
            Loop(rise, 1, ("with_marks", "cells"), ("risen", "cells_risen"), fixed=fixed[:2], until=0),
            Loop(fade, 1, ("unmarked", "cells_risen"), ("faded", touched[0]), fixed=fixed[:2], until=0),
        ]
        clear, observe = self._over_block(self.programs.clear()), self._over_block(self.programs.observe())
        for s, explained in enumerate(self.explained):
            beams, cleared = (f"row_beam_{s}", f"column_beam_{s}", self.limits[s]), f"cleared_{s}"
            done = (f"emptied_{s}", cleared), (f"observed_{s}", touched[s + 1])
            steps.append(Loop(clear, 1, (self.clean[s], touched[s]), done[0], fixed=beams, until=0))
            steps.append(Loop(observe, 1, (self.idle[s], cleared), done[1], fixed=(*beams, explained), until=0))
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
        """Return the routine that stores a block's nearest cell if this cell is the nearest so far in its direction."""
        nearest = self.programs.nearest(unknown=which == "unknown")
        steps = (
            Loop(nearest, self.block, ("none",), ("near",), sliced=("cells", "row"), fixed=("column", "hull")),
            Call(self.programs.sector(), ("near",), ("sector",)),
            Gather("best", "sector", len(NONE), "so_far"),
            Call(self.programs.farther(), ("near", "so_far"), ("farther",)),
            Loop(
                self.programs.enter(), 1, ("farther", "best"), ("done", "best_next"), fixed=("near", "sector"), until=0
            ),
        )
        inputs = self._sized("flag", "best", "cells", "row", "column", "hull", "none")
        return Routine(f"enter_{which}", inputs, steps, ("done", "best_next"))

    # --- from one cell to a row of a block, and to a block ------------------------------------------------------------

    def _over_row(self, program: Program, *, carried: tuple[str, ...] = ()) -> Routine:
        # the program is written for one cell
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
        row = self._over_row(program)
        names = tuple(name for name, _ in row.inputs)
        lines = tuple(name for name in names if name in ("cells", "row", "row_beam"))
        fixed = tuple(name for name in names if name not in lines)
        steps = (Loop(row, self.block, (), ("after",), sliced=lines, fixed=fixed),)
        return Routine(f"{program.name}_block", self._sized("flag", *names), steps, ("flag", "after"))

    def _sized(self, *names: str | tuple[str, int]) -> tuple[tuple[str, int], ...]:
        # sizes are for one block unless a name is given with a number of blocks
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
