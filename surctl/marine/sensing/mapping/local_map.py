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
from surctl.ir import Block, Call, Gather, Loop, Port, Program, Routine, Step, lower
from surctl.marine.sensing.mapping.firing import LIMITS, READING_SIZE
from surctl.marine.sensing.mapping.programs import BASE, BEAM, NONE, MapParameters, MapPrograms

Vector: TypeAlias = NDArray[np.float64]

_NOWHERE = 1e6  # cells; lowest corner of the window before the first update
_WHERE = ("place", "walls", "slots", "corner", "corner_next", "multiple")  # inputs that determine the columns and rows
_BY_ROW = ("cells", "risen", "row", "row_beam")  # arrays of a block of which a loop over its rows uses one piece each


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

    What a firing or the hull does not touch in a block is skipped. For this purpose, flags are computed from the
    extreme values of the block's columns and rows; if a flag is set, a loop that has one iteration is not executed.
    """

    def __init__(self, local_map: LocalMap) -> None:
        self.local_map, self.block, self.programs = local_map, local_map.block, MapPrograms(local_map)
        self.limits, self.explained, self.explained_next, self.idle, self.clean = (
            tuple(f"{name}_{s}" for s in range(local_map.slots))
            for name in ("limits", "explained", "explained_next", "idle", "clean")
        )
        # base of a column or row, then its beam for each firing
        self.columns, self.rows = (
            (name, *(f"{name}_beam_{s}" for s in range(local_map.slots))) for name in ("column", "row")
        )

    def routine(self) -> Routine:
        local_map, n, none = self.local_map, self.local_map.side, NONE * self.local_map.sectors
        constants = _constants("constants", (0.0,), (1.0,), (-1.0,), NONE, none, none)
        steps: list[Step] = [
            Call(constants, (), ("zero", "one", "free", "none", "marked_none", "unknown_none")),
            Call(self.programs.corner(), ("place", "walls"), ("corner_next", "multiple")),
            Call(self.programs.prepare(), ("place", "slots"), (*self.limits, "hull", "complete", *self.explained)),
        ]
        for is_row, shared in (("zero", "of_columns"), ("one", "of_rows")):
            steps.append(Call(self.programs.axis(), (is_row, *_WHERE), (shared,)))
        steps.append(Loop(self.programs.line(), n, (), self.columns, fixed=("zero", "of_columns"), index=True))
        steps.append(Loop(self.programs.bounds(), local_map.blocks, (), ("column_bounds",), sliced=self.columns))
        searched, nearest = ("complete", *self.explained), ("marked_none", "unknown_none")
        fixed = ("zero", "free", "none", "hull", *self.explained_next, *self.limits)
        steps.append(
            self._each_row(self._seek_block(), searched, ("complete_next", *self.explained_next), self.limits, 0)
        )
        steps.append(self._each_row(self._change_block(), nearest, ("marked", "unknown", "cells_next"), fixed))
        inputs = (("cells", n * n), *self._sized("corner", "place", "walls", "slots"))
        return Routine("local_map", inputs, tuple(steps), ("cells_next", "corner_next", "marked", "unknown"))

    def _each_row(
        self, block: Routine, state: tuple[str, ...], results: tuple[str, ...], fixed: tuple[str, ...],
        until: int | None = None,
    ) -> Loop:  # fmt: skip
        """Return a loop over the rows of blocks, each with loops over its rows of cells and over its blocks."""
        blocks, columns, rows = self.local_map.blocks, (*self.columns, "column_bounds"), (*self.rows, "row_bounds")
        own = tuple(name for name, _ in block.inputs)
        carried, shared = own[: len(state)], own[len(state) + 1 + len(columns) : len(own) - len(rows)]
        last = tuple(name for name, _ in block.outputs)
        steps = (
            Loop(self.programs.line(), self.block, (), self.rows, fixed=("group", "of_rows"), index=True),
            Call(self.programs.bounds(), self.rows, rows[-1:]),
            Loop(block, blocks, carried, last, sliced=("cells", *columns), fixed=(*shared, *rows), until=until),
        )
        wide = tuple((name, blocks) for name in columns)
        inputs = self._sized("group", *carried, ("cells", blocks), *shared, *wide, "of_rows")
        row, fixed = Routine(block.name.replace("block", "row"), inputs, steps, last), (*fixed, *columns, "of_rows")
        return Loop(row, blocks, state, results, sliced=("cells",), fixed=fixed, index=True, until=until)

    # --- whether a cell explains the echo of a firing -----------------------------------------------------------------

    def _seek_block(self) -> Routine:
        blank = tuple(f"blank_{s}" for s in range(self.local_map.slots))
        bounds, last = ("row_bounds", "column_bounds"), ("complete_next", *self.explained_next)
        seek = self._over_block(self._over_row(self.programs.seek(), ("explained",)), ("explained",))
        steps: list[Step] = [Call(self.programs.blank_arc(), (*bounds, *self.limits, *self.explained), blank)]
        for s, explained in enumerate(self.explained):
            fixed = ("cells", "row", f"row_beam_{s}", "column", f"column_beam_{s}", self.limits[s])
            results = (f"sought_{s}", self.explained_next[s])
            steps.append(Loop(seek, 1, (blank[s], explained), results, fixed=fixed, until=0))
        steps.append(Call(self.programs.all_explained(), self.explained_next, last[:1]))
        inputs = ("complete", *self.explained, "cells", *self.columns, "column_bounds", *self.limits, *self.rows)
        return Routine("seek_block", self._sized(*inputs, "row_bounds"), tuple(steps), last)

    # --- what the firings change --------------------------------------------------------------------------------------

    def _change_block(self) -> Routine:
        # also updates the nearest cells found so far
        last, bounds = ("marked_next", "unknown_next", "cells_next"), ("row_bounds", "column_bounds")
        beams = tuple(name for k in range(self.local_map.slots) for name in (self.rows[k + 1], self.columns[k + 1]))
        lines, observing = ("row", "column"), (*bounds, *beams, *self.limits, *self.explained)
        fade, cover = (self._over_block(self._over_row(p)) for p in (self.programs.fade(), self.programs.cover()))
        forget = self._over_block(self.programs.forget())
        steps: list[Step] = [
            Call(self.programs.whole(), bounds, ("whole",)),
            Loop(forget, 1, ("whole", "cells"), ("forgotten", "remembered"), fixed=lines, until=0),
            Loop(self.programs.rise(), self.block, ("free",), ("most", "risen"), sliced=("remembered",)),
            Call(
                self.programs.untouched(), (*bounds, *self.limits, "hull", "most"),
                ("untouched", "idle_hull", "unmarked", "known"),
            ),
            Loop(fade, 1, ("unmarked", "risen"), ("faded", "cells_0"), fixed=("remembered",), until=0),
            Loop(
                self._observe_block(), 1, ("untouched", "unmarked", "cells_0"), ("observed", "no_marked", "cells_1"),
                fixed=observing, until=0,
            ),
            Loop(cover, 1, ("idle_hull", "cells_1"), ("covered", last[-1]), fixed=(*lines, "hull"), until=0),
        ]  # fmt: skip
        fixed = (last[-1], *lines, "hull", "none", "zero")
        for which, none, block in (
            ("marked", "no_marked", self._enter(unknown=False)), ("unknown", "known", self._enter_unknown())
        ):  # fmt: skip
            results = (f"entered_{which}", f"{which}_next")
            steps.append(Loop(block, 1, (none, which), results, fixed=fixed, until=0))
        inputs = ("marked", "unknown", "cells", *self.columns, "column_bounds", "zero", "free", "none", "hull")
        inputs += (*self.explained, *self.limits, *self.rows, "row_bounds")
        return Routine("change_block", self._sized(*inputs), tuple(steps), last)

    def _observe_block(self) -> Routine:
        # what the firings change in a block that at least one of them touches
        bounds, steps = ("row_bounds", "column_bounds"), list[Step]()
        flags = (*self.idle, *self.clean, "unmarked_next")
        steps.append(Call(self.programs.idle(), (*bounds, *self.limits, "unmarked"), flags))
        clear = self._over_block(self.programs.clear())
        observe = self._over_block(self._over_row(self._observe_cell()))
        cells, inputs = "cells", ["untouched", "unmarked", "cells", *bounds]
        for s, explained in enumerate(self.explained):
            beams = (self.rows[s + 1], self.columns[s + 1])
            fixed, cleared, after = (*beams, self.limits[s]), f"cleared_{s}", f"cells_{s}"
            steps.append(Loop(clear, 1, (self.clean[s], cells), (f"emptied_{s}", cleared), fixed=fixed, until=0))
            cells, results = after, (f"observed_{s}", after)
            steps.append(Loop(observe, 1, (self.idle[s], cleared), results, fixed=(*fixed, explained), until=0))
            inputs += beams
        inputs += (*self.limits, *self.explained)
        return Routine("observe_block", self._sized(*inputs), tuple(steps), ("untouched", "unmarked_next", cells))

    def _observe_cell(self) -> Routine:
        # most cells need no more than a glance
        glance, carried, flags = self.programs.glance(), ("finished", "glanced"), ("front", "marked")
        names = tuple(name for name, _ in glance.inputs)
        fixed = (*(name for name in names if name != "explained"), *flags)
        steps = (
            Call(glance, names, (*carried, *flags)),
            Loop(self.programs.observe(), 1, carried, ("observed", "after"), fixed=fixed, until=0),
        )
        return Routine("observe", glance.inputs, steps, ("after",))

    def _enter_unknown(self) -> Routine:
        # stores a block's nearest unknown cell, unless so few are unknown that they are ignored
        fixed = ("cells", "row", "column", "hull", "none", "zero")
        results, last = ("enough", "counted"), ("entered", "best_next")
        steps = (
            Loop(self.programs.count(), self.block, ("zero", "zero"), results, sliced=("cells",), until=0),
            Call(self.programs.few(), ("enough",), ("few",)),
            Loop(self._enter(unknown=True), 1, ("few", "best"), last, fixed=fixed, until=0),
        )
        return Routine("unknown_block", self._sized("flag", "best", *fixed), steps, last)

    def _enter(self, *, unknown: bool) -> Routine:
        """Return the routine that stores a block's nearest cell if this cell is the nearest so far in its direction."""
        nearest, fixed = self.programs.nearest(unknown=unknown), ("near", "sector")
        program, sectors = self.programs.enter(), self.local_map.sectors
        enter = Loop(program, sectors, (), ("best_next",), sliced=("best",), fixed=fixed, index=True)
        sizes = (*self._sized("flag", "best"), ("near", len(NONE)), ("sector", 1))
        every = Routine("enter_all", sizes, (enter,), ("flag", "best_next"))
        steps = (
            Loop(nearest, self.block, ("none",), ("near",), sliced=("cells", "row"), fixed=("column", "hull")),
            Call(self.programs.sector(), ("near",), ("sector",)),
            Gather("best", "sector", len(NONE), "so_far"),
            Call(self.programs.farther(), ("near", "so_far"), ("farther",)),
            Loop(every, 1, ("farther", "best"), ("done", "best_next"), fixed=fixed, until=0),
        )
        inputs = self._sized("flag", "best", "cells", "row", "column", "hull", "none", "zero")
        return Routine("enter_unknown" if unknown else "enter_marked", inputs, steps, ("done", "best_next"))

    def _over_row(self, program: Block, carried: tuple[str, ...] = ()) -> Routine:
        # the program is written for one cell
        names = tuple(name for name, _ in program.inputs)
        own = tuple(name for name in names if name in ("cells", "risen", "column", "column_beam"))
        rest = tuple(name for name in names if name not in (*carried, *own))
        results, until = _results(carried)
        loop = Loop(program, self.block, carried, results, sliced=own, fixed=rest, until=until)
        sizes = {name: size * (self.block if name in own else 1) for name, size in program.inputs}
        order = (*carried, *sorted((*own, *rest), key=lambda name: name not in _BY_ROW))
        return Routine(f"{program.name}_row", tuple((name, sizes[name]) for name in order), (loop,), results)

    def _over_block(self, row: Block, carried: tuple[str, ...] = ()) -> Routine:
        # returns the flag unchanged: it is that of the loop with one iteration that runs this routine
        names = tuple(name for name, _ in row.inputs)
        lines = tuple(name for name in names if name in _BY_ROW)
        fixed = tuple(name for name in names if name not in (*carried, *lines))
        results, until = _results(carried)
        steps = (Loop(row, self.block, carried, results, sliced=lines, fixed=fixed, until=until),)
        name = f"{row.name.removesuffix('_row')}_block"
        return Routine(name, self._sized("flag", *names), steps, ("flag", *results))

    def _sized(self, *names: str | tuple[str, int]) -> tuple[tuple[str, int], ...]:
        # sizes are for one block unless a name is given with a number of blocks
        b, sectors = self.block, len(NONE) * self.local_map.sectors
        sizes = {"column": b * BASE, "row": b * BASE, "none": len(NONE), "hull": 2, "place": 4, "walls": 4, "corner": 2}
        sizes |= dict.fromkeys(("cells", "risen"), b * b) | dict.fromkeys(("marked", "unknown", "best"), sectors)
        sizes |= {"slots": self.local_map.slots * READING_SIZE, "of_rows": self.programs.shared_size}
        sizes |= dict.fromkeys(("column_beam", "row_beam", *self.columns[1:], *self.rows[1:]), b * BEAM)
        sizes |= dict.fromkeys(("column_bounds", "row_bounds"), self.programs.bounds_size)
        sizes |= dict.fromkeys(("limits", *self.limits), len(LIMITS))
        listed = [(name, 1) if isinstance(name, str) else name for name in names]
        return tuple((name, count * sizes.get(name, 1)) for name, count in listed)


def _constants(name: str, *values: tuple[float, ...]) -> Program:
    vectors = [ca.DM(list(v)) for v in values]
    return lower(ca.Function(name, [], [ca.SX(m) for m in vectors], [], [f"c{k}" for k in range(len(vectors))]))


def _results(carried: tuple[str, ...]) -> tuple[tuple[str, ...], int | None]:
    # of a loop over rows or cells: a carried truth value ends it
    return tuple(f"{name}_next" for name in carried) or ("after",), 0 if carried else None
