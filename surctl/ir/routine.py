"""Bounded loops over nested programs: fixed arrays, explicit loop-carried state, no other memory.

A routine is a list of steps over named arrays of fixed size. Every array is written by exactly one step, as a
whole; what a loop changes from turn to turn is its carried state, and nothing else. So a routine stays plain data
that can be printed, replayed in NumPy, differentiated by CasADi and written as C, and its cost has a bound.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

from surctl.errors import InputError
from surctl.ir.program import Program

__all__ = ["Block", "Call", "Gather", "Loop", "Routine", "Step"]


@dataclass(frozen=True, slots=True)
class Call:
    """results = block(args): one array an input, one an output."""

    block: Block
    args: tuple[str, ...]
    results: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Loop:
    """At most `count` turns of a block.

    In turn k the block takes, in this order: the number k (1,) if `index`; the carried arrays; piece k of each
    sliced array; a piece of each spread array; the fixed arrays. It gives the next carried arrays, then a piece k of
    each stacked array.

    Attributes:
        block: the body, a program or a routine (loops nest).
        count: largest number of turns, at least 1.
        carried: arrays that hold the state before the first turn.
        sliced: arrays of `count` equal pieces, read one piece a turn.
        fixed: arrays that every turn reads.
        results: names of the last carried arrays, then of the stacked ones.
        index: whether the body takes the number of the turn.
        until: position in `carried` of a flag of size 1; the loop ends before the first turn that finds it other
            than 0 (a NaN too), so that a flag that is up at the start means no turn at all. No stacked arrays then.
        spread: arrays of `count` · `lanes` equal pieces; lane l of turn k reads piece k · `lanes` + l.
        lanes: number of runs of the body side by side, each on its own numbers. The body is a program then; carried
            and stacked arrays and the pieces of the sliced ones hold `lanes` numbers an entry, entry by entry; the
            fixed arrays are shared, and the index of lane l is k · `lanes` + l. No `until`.
    """

    block: Block
    count: int
    carried: tuple[str, ...]
    results: tuple[str, ...]
    sliced: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    index: bool = False
    until: int | None = None
    spread: tuple[str, ...] = ()
    lanes: int = 1


@dataclass(frozen=True, slots=True)
class Gather:
    """result = piece `index` of the source, cut in pieces of `width`.

    The index (1,) is rounded down; outside the array the nearest piece is taken, and piece 0 for a NaN. With `lanes`
    the source is one that a loop with as many lanes stacked: `lanes` pieces stand entry by entry.
    """

    source: str
    index: str
    width: int
    result: str
    lanes: int = 1


@dataclass(frozen=True)
class Routine:
    """A function of flat vectors with loops inside.

    Attributes:
        name: C identifier.
        inputs: (name, number of entries) of each input array.
        steps: run in this order.
        results: names of the arrays that are the outputs.

    Raises:
        InputError: an array that is read before it is written, written twice, or of the wrong size; it names the
            routine and the step.
    """

    name: str
    inputs: tuple[tuple[str, int], ...]
    steps: tuple[Step, ...]
    results: tuple[str, ...]

    def __post_init__(self) -> None:
        """Refuse what a back end could not run."""
        for name in self.results:
            _size(self._sizes, name, self.name)

    def sizes(self) -> dict[str, int]:
        """Number of entries of every array, inputs first, then in the order of writing."""
        return dict(self._sizes)

    @cached_property
    def _sizes(self) -> dict[str, int]:
        sizes: dict[str, int] = {}
        for name, size in self.inputs:
            _write(sizes, name, size, self.name)
        for at, step in enumerate(self.steps):
            key = f"{self.name}[{at}]"
            for name, size in written(step, sizes, key):
                _write(sizes, name, size, key)
        return sizes

    @property
    def outputs(self) -> tuple[tuple[str, int], ...]:
        """(name, number of entries) of each output array."""
        return tuple((name, self._sizes[name]) for name in self.results)

    @cached_property
    def operations(self) -> int:
        """Operations when every loop runs to its bound: the worst case, not the usual one."""
        return sum(_turns(step) * step.block.operations for step in self.steps if not isinstance(step, Gather))

    @cached_property
    def libm(self) -> frozenset[str]:
        """Names of the operations used whose last bits depend on the mathematical library."""
        return frozenset().union(*(block.libm for block in nested(self).values() if isinstance(block, Program)))

    def text(self) -> str:
        """The routine and all that it calls as text; equal texts are equal routines, on any machine."""
        texts = (block.text() if isinstance(block, Program) else own_text(block) for block in nested(self).values())
        return "\n".join(dict.fromkeys(texts))  # two equal callees are one

    def digest(self) -> str:
        """SHA-256 of `text`, in hexadecimal."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256(self.text().encode()).hexdigest()


Block: TypeAlias = Program | Routine
"""What a step can call."""

Step: TypeAlias = Call | Loop | Gather


def nested(block: Block) -> dict[int, Block]:
    """Every distinct block that this one runs, callees first, itself last; keyed by identity."""
    blocks: dict[int, Block] = {}
    _collect(block, blocks)
    return blocks


def rebuilt(block: Block, change: Callable[[Program], Program]) -> Block:
    """The block with every program in it changed, each once."""
    built: dict[int, Block] = {}
    for key, inner in nested(block).items():
        if isinstance(inner, Program):
            built[key] = change(inner)
            continue
        steps = [s if isinstance(s, Gather) else replace(s, block=built[id(s.block)]) for s in inner.steps]
        built[key] = replace(inner, steps=tuple(steps))
    return built[id(block)]


def _collect(block: Block, blocks: dict[int, Block]) -> None:
    if id(block) in blocks:
        return
    if isinstance(block, Routine):
        for step in block.steps:
            if not isinstance(step, Gather):
                _collect(step.block, blocks)
    blocks[id(block)] = block


def _turns(step: Call | Loop) -> int:
    return step.count * step.lanes if isinstance(step, Loop) else 1


def own_text(routine: Routine) -> str:
    """The routine as text, without what it calls."""
    lines = [f"routine {routine.name}"]
    lines += [f"in {name} {size}" for name, size in routine.inputs]
    lines += [_step_text(step) for step in routine.steps]
    return "\n".join([*lines, " ".join(["out", *routine.results])]) + "\n"


def _step_text(step: Step) -> str:
    if isinstance(step, Gather):
        return f"{step.result} = gather {step.source} {step.index} width {step.width} lanes {step.lanes}"
    what = f"{step.block.name}:{step.block.digest()[:16]}"
    if isinstance(step, Call):
        return f"{' '.join(step.results)} = call {what} {' '.join(step.args)}"
    return (
        f"{' '.join(step.results)} = loop {what} count {step.count} index {int(step.index)} until {step.until}"
        f" carried {' '.join(step.carried)} sliced {' '.join(step.sliced)} fixed {' '.join(step.fixed)}"
        f" spread {' '.join(step.spread)} lanes {step.lanes}"
    )


def _write(sizes: dict[str, int], name: str, size: int, key: str) -> None:
    if name in sizes:
        raise InputError("writes an array that is already there", key=key, value=name, remedy="rename the result")
    sizes[name] = size


def _size(sizes: Mapping[str, int], name: str, key: str) -> int:
    if name not in sizes:
        raise InputError("reads an array that is not written yet", key=key, value=name)
    return sizes[name]


def written(step: Step, sizes: Mapping[str, int], key: str) -> Iterator[tuple[str, int]]:
    """(name, size) of what the step writes, after a check of what it reads."""
    if isinstance(step, Gather):
        whole = step.width >= 1 and step.lanes >= 1 and not _size(sizes, step.source, key) % (step.width * step.lanes)
        if not whole or _size(sizes, step.index, key) != 1:
            raise InputError("cannot be cut in such pieces", key=key, value=step.source)
        return iter([(step.result, step.width)])
    passed = [_size(sizes, name, key) for name in step.args] if isinstance(step, Call) else _fed(step, sizes, key)
    expected = [size for _, size in step.block.inputs]
    if passed != expected:
        raise InputError(f"passes arrays of {passed} entries, {step.block.name} takes {expected}", key=key)
    outputs = [size for _, size in step.block.outputs]
    if isinstance(step, Loop):
        _check_carried(step, sizes, outputs, key)
        state = len(step.carried)
        outputs = [size * step.lanes for size in outputs]
        outputs = outputs[:state] + [step.count * size for size in outputs[state:]]
    if len(outputs) != len(step.results):
        raise InputError(f"names {len(step.results)} results, there are {len(outputs)}", key=key)
    return zip(step.results, outputs, strict=True)


def _fed(loop: Loop, sizes: Mapping[str, int], key: str) -> list[int]:
    """Sizes of what a turn passes to the body."""
    if loop.count < 1:
        raise InputError("a loop needs at least one turn", key=key, value=loop.count)
    if loop.lanes < 1 or (loop.lanes > 1 and (loop.until is not None or not isinstance(loop.block, Program))):
        raise InputError("lanes run a program side by side, all turns of it", key=key, value=loop.lanes)
    carried, pieces, spread, fixed = (
        [_size(sizes, name, key) for name in names] for names in (loop.carried, loop.sliced, loop.spread, loop.fixed)
    )
    turns = loop.count * loop.lanes
    if any(size % turns for size in (*pieces, *spread)) or any(size % loop.lanes for size in carried):
        raise InputError(f"cannot be cut in {turns} equal pieces", key=key, value=[*loop.sliced, *loop.spread])
    carried = [size // loop.lanes for size in carried]
    return [1] * loop.index + carried + [size // turns for size in (*pieces, *spread)] + fixed


def _check_carried(loop: Loop, sizes: Mapping[str, int], outputs: list[int], key: str) -> None:
    state = [_size(sizes, name, key) // loop.lanes for name in loop.carried]
    if outputs[: len(state)] != state:
        raise InputError(f"carries arrays of {state} entries, the body gives {outputs}", key=key)
    if loop.until is None:
        return
    if not 0 <= loop.until < len(state) or state[loop.until] != 1:
        raise InputError("the flag that ends a loop is a carried array of one entry", key=key, value=loop.until)
    if len(outputs) > len(state):
        raise InputError("a loop that may end early has no stacked arrays", key=key)
