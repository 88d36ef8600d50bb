"""Routines: nested programs with bounded loops, arrays of fixed size, and no memory except the state of each loop.

A routine is a list of steps that read and write named arrays of fixed size. Exactly one step writes an array, as a
whole. Only the state of a loop (its carried arrays) changes from one iteration to the next. A routine is plain data: it
can be printed, evaluated in NumPy, differentiated by CasADi and written as C, and its number of operations is bounded.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias

from surctl.errors import InputError
from surctl.ir.procedure import Procedure
from surctl.ir.program import Program

Feed: TypeAlias = Literal["lanes", "spread", "shared"]
"""The layout of an input for SIMD lanes, one for each run.

"lanes": the numbers of all lanes for entry 0, then for entry 1, …; "spread": all entries of lane 0, then of lane 1, …;
"shared": one number for each entry, which all lanes use.
"""


@dataclass(frozen=True, slots=True)
class Call:
    """A step that calls a program or routine, results = block(args), with one array for each input and each output."""

    block: Block
    args: tuple[str, ...]
    results: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Loop:
    """A step of a routine that runs a block (program or routine) for at most `count` iterations.

    In iteration k the inputs of the block are, in this order: the number k (1,) if `index`; the carried arrays; piece k
    of each sliced array; a piece of each spread array; the fixed arrays. The outputs of the block are the next values
    of the carried arrays, then piece k of each stacked array.

    Attributes:
        block: the body, a program or a routine (loops can be nested).
        count: largest number of iterations, at least 1.
        carried: names of the arrays with the loop's state before the first iteration.
        sliced: names of arrays that are divided into `count` equal pieces; iteration k reads piece k.
        fixed: names of arrays that every iteration reads as a whole.
        results: names of the carried arrays after the last iteration, then of the stacked arrays.
        index: whether the number of the iteration is an input of the body.
        until: position in `carried` of a flag of size 1, or None. The loop ends before the first iteration at whose
            start the flag is not 0 (a NaN counts as not 0). A loop with a flag cannot have stacked arrays.
        spread: names of arrays that are divided into `count` · `lanes` equal pieces; SIMD lane l of iteration k reads
            piece k · `lanes` + l.
        lanes: number of SIMD lanes, i.e. of parallel evaluations of the body with different numbers. If it is greater
            than 1, the body must be a program, and `until` must be None. Carried arrays, stacked arrays and pieces of
            sliced arrays contain `lanes` numbers for each entry, one entry after another. All lanes read the same fixed
            arrays, and the index of lane l is k · `lanes` + l.
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
    """A step that copies piece number `index` of the array `source`, which is divided into pieces of `width` numbers.

    The index (1,) is rounded down; an index outside the array selects the nearest piece, and a NaN selects piece 0. If
    `lanes` is greater than 1, `source` is a stacked array of a loop with this number of SIMD lanes. It then consists of
    groups of `lanes` pieces, and a group contains the first entries of all its pieces, then the second entries, and so
    on.
    """

    source: str
    index: str
    width: int
    result: str
    lanes: int = 1


@dataclass(frozen=True)
class Routine:
    """A function of flat vectors that contains loops.

    Attributes:
        name: C identifier.
        inputs: (name, number of entries) of each input array.
        steps: the steps, in the order in which they run.
        results: names of the arrays that are the outputs.

    Raises:
        InputError: an array is read before it is written, written twice, or has the wrong size; the message names
            the routine and the step.
    """

    name: str
    inputs: tuple[tuple[str, int], ...]
    steps: tuple[Step, ...]
    results: tuple[str, ...]

    def __post_init__(self) -> None:
        """Raise InputError for a routine that a back end could not run."""
        for name in self.results:
            _size(self._sizes, name, self.name)

    def sizes(self) -> dict[str, int]:
        """Return the number of entries of every array: inputs first, then the arrays that the steps write, in order."""
        return dict(self._sizes)

    @cached_property
    def _sizes(self) -> dict[str, int]:
        sizes: dict[str, int] = {}
        for name, size in self.inputs:
            _write(sizes, name, size, self.name)
        for at, step in enumerate(self.steps):
            key = f"{self.name}[{at}]"
            for name, size in _written(step, sizes, key):
                _write(sizes, name, size, key)
        return sizes

    @property
    def outputs(self) -> tuple[tuple[str, int], ...]:
        """Return (name, number of entries) of each output array."""
        return tuple((name, self._sizes[name]) for name in self.results)

    @cached_property
    def operations(self) -> int:
        """Return the largest number of operations, which occurs if every loop runs all its iterations."""
        return sum(_turns(step) * step.block.operations for step in self.steps if not isinstance(step, Gather))

    @cached_property
    def libm(self) -> frozenset[str]:
        """Return the names of the operations that call libm (such as sin), whose last bits depend on the machine."""
        return frozenset().union(*(block.libm for block in nested(self).values() if isinstance(block, Program)))

    def text(self) -> str:
        """Return the routine and all that it calls as text; routines with equal texts are equal, on any machine."""
        texts = (own_text(block) if isinstance(block, Routine) else block.text() for block in nested(self).values())
        return "\n".join(dict.fromkeys(texts))  # two blocks with equal text are written once

    def digest(self) -> str:
        """Return the SHA-256 of `text`, in hexadecimal."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        return hashlib.sha256(self.text().encode()).hexdigest()


Block: TypeAlias = Program | Routine | Procedure
"""A program, routine or procedure; steps of a routine run such blocks."""

Step: TypeAlias = Call | Loop | Gather


def nested(block: Block) -> dict[int, Block]:
    """Return, by `id`, all programs and routines that a block calls, callees first; the block itself is last."""
    blocks: dict[int, Block] = {}
    _collect(block, blocks)
    return blocks


def changed_programs(block: Block, change: Callable[[Program], Block], *, lanes: bool = True) -> Block:
    """Return the block after `change` has been applied once to each program in it; `lanes`: also to those in lanes."""
    built: dict[int, Block] = {}
    for key, inner in nested(block).items():
        if not isinstance(inner, Routine):
            built[key] = change(inner) if isinstance(inner, Program) else inner
            continue
        steps = [
            step
            if isinstance(step, Gather) or (isinstance(step, Loop) and step.lanes > 1 and not lanes)
            else replace(step, block=built[id(step.block)])
            for step in inner.steps
        ]
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
    """Return the text of the routine itself, without the programs and routines that it calls."""
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
        raise InputError("writes an array that exists already", key=key, value=name, remedy="rename the result")
    sizes[name] = size


def _size(sizes: Mapping[str, int], name: str, key: str) -> int:
    if name not in sizes:
        raise InputError("reads an array that is not written before", key=key, value=name)
    return sizes[name]


def _written(step: Step, sizes: Mapping[str, int], key: str) -> Iterator[tuple[str, int]]:
    """Check the arrays that the step reads, then yield (name, size) of each array that the step writes."""
    if isinstance(step, Gather):
        whole = step.width >= 1 and step.lanes >= 1 and not _size(sizes, step.source, key) % (step.width * step.lanes)
        if not whole or _size(sizes, step.index, key) != 1:
            raise InputError("cannot be divided into such pieces", key=key, value=step.source)
        return iter([(step.result, step.width)])
    passed = [_size(sizes, name, key) for name in step.args] if isinstance(step, Call) else _fed(step, sizes, key)
    expected = [size for _, size in step.block.inputs]
    if passed != expected:
        raise InputError(f"passes arrays of {passed} entries, but {step.block.name} takes {expected}", key=key)
    outputs = [size for _, size in step.block.outputs]
    if isinstance(step, Loop):
        _check_carried(step, sizes, outputs, key)
        state = len(step.carried)
        outputs = [size * step.lanes for size in outputs]
        outputs = outputs[:state] + [step.count * size for size in outputs[state:]]
    if len(outputs) != len(step.results):
        raise InputError(f"names {len(step.results)} results, but there are {len(outputs)}", key=key)
    return zip(step.results, outputs, strict=True)


def _fed(loop: Loop, sizes: Mapping[str, int], key: str) -> list[int]:
    """Return the sizes of the arrays that an iteration passes to the loop body."""
    if isinstance(loop.block, Procedure):  # a loop passes carried arrays as inputs and outputs
        raise InputError("runs a procedure; a loop runs a program or a routine", key=key, value=loop.block.name)
    if loop.count < 1:
        raise InputError("a loop needs at least one iteration", key=key, value=loop.count)
    if loop.lanes < 1 or (loop.lanes > 1 and (loop.until is not None or not isinstance(loop.block, Program))):
        raise InputError(
            "only a program (not a routine) without early end can run in several lanes", key=key, value=loop.lanes
        )
    carried, pieces, spread, fixed = (
        [_size(sizes, name, key) for name in names] for names in (loop.carried, loop.sliced, loop.spread, loop.fixed)
    )
    turns = loop.count * loop.lanes
    if any(size % turns for size in (*pieces, *spread)) or any(size % loop.lanes for size in carried):
        raise InputError(f"cannot be divided into {turns} equal pieces", key=key, value=[*loop.sliced, *loop.spread])
    carried = [size // loop.lanes for size in carried]
    return [1] * loop.index + carried + [size // turns for size in (*pieces, *spread)] + fixed


def _check_carried(loop: Loop, sizes: Mapping[str, int], outputs: list[int], key: str) -> None:
    state = [_size(sizes, name, key) // loop.lanes for name in loop.carried]
    if outputs[: len(state)] != state:
        raise InputError(f"carries arrays of {state} entries, but the body gives {outputs}", key=key)
    if loop.until is None:
        return
    if not 0 <= loop.until < len(state) or state[loop.until] != 1:
        raise InputError("the flag that ends a loop must be a carried array of one entry", key=key, value=loop.until)
    if len(outputs) > len(state):
        raise InputError("a loop that may end early cannot have stacked arrays", key=key)
