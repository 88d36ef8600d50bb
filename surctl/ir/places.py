"""Memory for the arrays of a routine: in the routine's inputs, in its outputs, or in its own memory.

Every array is written once, by one step. So a copy is needed only if a step would overwrite data that is still used. A
step that only copies pieces of arrays (a move) becomes no C function. The rules:

- if moves copy a piece of an array to a new array, the new array is a pointer into the old array;
- if moves join several arrays to one array, these arrays are written directly into the joined array;
- a result of the routine is written directly to the routine's output;
- a loop updates its carried state array in place if no later step reads the initial array or a piece of it;
- arrays that are never needed at the same time share memory.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from surctl.ir.c99 import Move, only_moves
from surctl.ir.procedure import Procedure
from surctl.ir.program import Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, nested

Overlaps = Mapping[str, frozenset[tuple[int, int]]]
"""For each block by its digest, the pairs (output, input) for which a caller passes the same array."""


_WORTH_SHARING = 100  # sharing memory must save at least this many numbers


def reads(step: Step) -> tuple[str, ...]:
    """Return the names of the arrays that a step reads.

    Example:
        >>> from surctl.ir import Gather, reads
        >>> reads(Gather("points", "nearest", 2, "point"))
        ('points', 'nearest')
    """
    if isinstance(step, Gather):
        return (step.source, step.index)
    return step.args if isinstance(step, Call) else (*step.carried, *step.sliced, *step.spread, *step.fixed)


def _writes(step: Step) -> tuple[str, ...]:
    return (step.result,) if isinstance(step, Gather) else step.results


def inlined(step: Step) -> tuple[Move, ...]:
    """Return the moves of a call that only moves data and so needs no C function; return () for any other step."""
    if isinstance(step, Call) and isinstance(step.block, Program):
        return only_moves(step.block)
    return ()


def overlapping(block: Block) -> Overlaps:
    """Return for each loop body the pairs (output, input) that share an array, because the loop updates it in place."""
    overlaps: dict[str, frozenset[tuple[int, int]]] = {}
    for inner in nested(block).values():
        for step in inner.steps if isinstance(inner, Routine) else ():
            if isinstance(step, Loop) and step.carried:
                pairs = frozenset((k, step.index + k) for k in range(len(step.carried)))
                overlaps[step.block.digest()] = overlaps.get(step.block.digest(), frozenset()) | pairs
    return overlaps


def carried_in_place(routine: Routine, root: Callable[[str], str] = str) -> dict[str, str]:
    """Return the pairs (final state array, initial state array) of loops in which both can share memory.

    Memory is shared if only the loop reads the initial array. `root` returns the array of which an array is a piece.
    """
    inputs = {name for name, _ in routine.inputs}
    origin: dict[str, str] = {}
    for at, step in enumerate(routine.steps):
        if not isinstance(step, Loop):
            continue
        later = {root(name) for other in routine.steps[at + 1 :] for name in reads(other)}
        later |= set(routine.results)
        now = [root(name) for name in reads(step)]
        for name, result in zip(step.carried, step.results, strict=False):
            if now.count(name) == 1 and name not in later and name not in inputs:
                origin[result] = origin.get(name, name)
    return origin


@dataclass(frozen=True)
class Places:
    """The assignment of the arrays of one routine to memory.

    Attributes:
        routine: the routine whose arrays are placed.
        overlaps: pairs (output, input) of the routine that may be the same array; all other pairs are distinct arrays.
    """

    routine: Routine
    overlaps: frozenset[tuple[int, int]] = frozenset()

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Return the number of entries of each array."""
        return self.routine.sizes()

    @cached_property
    def of(self) -> dict[str, tuple[str, int]]:
        """Return, for each array, its C array (`in0` …, `out0` … or an own array) and its start index there."""
        return {name: self._place(name) for name in self.sizes}

    @cached_property
    def own(self) -> dict[str, int]:
        """Return the sizes of the routine's own arrays by name."""
        arrays = {self.of[name][0]: self.sizes[name] for name in self.sizes if self.of[name] == (self._own(name), 0)}
        return arrays | {f"held{k}": self.sizes[self.routine.results[k]] for k in self.held}

    @cached_property
    def pool(self) -> tuple[dict[str, int], int]:
        """Return the start of each own array in shared memory (empty if nothing is shared), and the memory's size."""
        lives: dict[str, tuple[int, int, int]] = {}
        end = len(self.routine.steps)
        last = dict.fromkeys(self.routine.results, end)
        for at, step in enumerate(self.routine.steps):
            for name in (*reads(step), *_writes(step)):
                array = self.of[name][0]
                if array in self.own:
                    first = lives[array][1] if array in lives else at
                    lives[array] = self.own[array], first, max(at, last.get(name, 0), lives.get(array, (0, 0, 0))[2])
        lives |= {array: (size, 0, end) for array, size in self.own.items() if array not in lives}
        starts, size = _overlaid(lives)
        return (starts, size) if sum(self.own.values()) - size >= _WORTH_SHARING else ({}, sum(self.own.values()))

    @cached_property
    def held(self) -> tuple[int, ...]:
        """Return the indices of the outputs whose values are in an input that another output may overwrite."""
        if not self.overlaps:
            return ()
        return tuple(k for k, name in enumerate(self.routine.results) if self.of[name][0].startswith("in"))

    def root(self, name: str) -> str:
        """Return the array of which the array `name` is a piece; for a whole array, return `name`."""
        while name in self._views or name in self._parts:
            name = (self._views.get(name) or self._parts[name])[0]
        return name

    def _own(self, name: str) -> str:
        return f"a{list(self.sizes).index(self._in_place.get(name, name))}"

    def _place(self, name: str) -> tuple[str, int]:
        names = [name for name, _ in self.routine.inputs]
        if name in names:
            return f"in{names.index(name)}", 0
        final = self._final.get(self._in_place.get(name, name), name)
        inside = self._views.get(final) or self._parts.get(final)
        if inside:
            base, start = self._place(inside[0])
            return base, start + inside[1]
        return (f"out{self._direct[final]}" if final in self._direct else self._own(name)), 0

    @cached_property
    def _views(self) -> dict[str, tuple[str, int]]:
        """Return, for each piece of an array, the array that contains the piece and the index of its first entry."""
        views: dict[str, tuple[str, int]] = {}
        for step in self.routine.steps:
            for move in inlined(step):
                assert isinstance(step, Call)
                result = step.results[move.output]
                if move.count == self.sizes[result] and result not in self.routine.results:
                    views[result] = step.args[move.input], move.start
        return views

    @cached_property
    def _parts(self) -> dict[str, tuple[str, int]]:
        """Return, for each part written directly into a joined array, the joined array and the part's start index."""
        parts: dict[str, tuple[str, int]] = {}
        excluded = {*(name for name, _ in self.routine.inputs), *self.routine.results, *self._views}
        for step in self.routine.steps:
            for move in inlined(step):
                assert isinstance(step, Call)
                name, whole = step.args[move.input], step.results[move.output]
                if name not in excluded and whole not in self._views and move.count == self.sizes[name]:
                    parts[name] = whole, move.to
                    excluded.add(name)
        return parts

    @cached_property
    def _in_place(self) -> dict[str, str]:
        return carried_in_place(self.routine, self.root)

    @cached_property
    def _final(self) -> dict[str, str]:
        """Return, for each array that loops update in place, its last name by its first (a loop renames the array)."""
        return {first: name for name, first in self._in_place.items()}

    @cached_property
    def _direct(self) -> dict[str, int]:
        """Return, for each array written directly to an output of the routine, the index of this output."""
        results = self.routine.results
        inputs = {name for name, _ in self.routine.inputs}
        direct = {name: results.index(name) for name in results if name not in inputs}
        for k, j in self.overlaps:
            if results[k] in direct and not self._harmless(results[k], self.routine.inputs[j][0]):
                del direct[results[k]]
        return direct

    def _harmless(self, result: str, source: str) -> bool:
        """Return whether `result` may overwrite `source`: no step reads `source` after the loop that updates it."""
        first = min(at for at, step in enumerate(self.routine.steps) if self._inside(result, step))
        steps = self.routine.steps[first:]
        later = [*(self.root(name) for step in steps for name in reads(step)), *self.routine.results]
        if source not in later:
            return True
        loop = steps[0]
        return (
            isinstance(loop, Loop)
            and later.count(source) == 1
            and (source, result)
            in zip(
                loop.carried,
                (self._final.get(self._in_place.get(name, name), name) for name in loop.results),
                strict=False,
            )
        )

    def _inside(self, result: str, step: Step) -> bool:
        for name in _writes(step):
            while name != result:
                final = self._final.get(self._in_place.get(name, name), name)
                after = self._parts[final][0] if final in self._parts else final
                if after == name:
                    break
                name = after
            if name == result:
                return True
        return False


def _overlaid(lives: Mapping[str, tuple[int, int, int]]) -> tuple[dict[str, int], int]:
    """Return the position of each array in shared memory, and the memory's size; arrays in use together do not overlap.

    Args:
        lives: for each array, its size, the number of the first step that needs it, and the number of the last step.
    """
    starts: dict[str, int] = {}
    # large arrays first, since small ones fit into the gaps
    for array, (size, first, last) in sorted(lives.items(), key=lambda entry: -entry[1][0]):
        occupied = sorted(
            (starts[other], starts[other] + lives[other][0])
            for other in starts
            if lives[other][1] <= last and first <= lives[other][2]
        )
        at = 0
        for begin, end in occupied:
            if begin - at >= size:
                break
            at = max(at, end)
        starts[array] = at
    return starts, max((starts[array] + lives[array][0] for array in starts), default=0)


def memory(block: Block) -> int:
    """Return how many numbers the inputs, outputs and own arrays along the deepest chain of calls contain.

    A number has 8 bytes, or 4 bytes in float32. Intermediate values that the compiler stores on the stack are not
    included.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Call, Routine, lower, memory
        >>> x = ca.SX.sym("x", 100)
        >>> half, total = lower(ca.Function("half", [x], [x / 2])), lower(ca.Function("total", [x], [ca.sum1(x)]))
        >>> steps = (Call(half, ("x",), ("halves",)), Call(total, ("halves",), ("sum",)))
        >>> memory(total), memory(Routine("mean", (("x", 100),), steps, ("sum",)))  # the latter keeps 100 halves
        (101, 201)
    """
    known = overlapping(block)
    ports = sum(size for _, size in (*block.inputs, *block.outputs))
    return ports + _deepest(block, known)


def _deepest(block: Block, overlaps: Overlaps) -> int:
    if isinstance(block, Procedure):
        return block.stored
    if not isinstance(block, Routine):
        return 0
    own = Places(block, overlaps.get(block.digest(), frozenset())).pool[1]
    turns = max((step.lanes for step in block.steps if isinstance(step, Loop) and step.index), default=0)
    called = [step.block for step in block.steps if not isinstance(step, Gather)]
    return own + turns + max((_deepest(inner, overlaps) for inner in called), default=0)
