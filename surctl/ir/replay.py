"""Evaluation of an instruction list in NumPy, operation by operation, with results equal to those of C."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir.procedure import Procedure
from surctl.ir.program import IN_PYTHON, OPERATIONS, TRUTHS, Program
from surctl.ir.routine import Block, Feed, Gather, Loop, Routine

Real = type[np.float64] | type[np.float32]
Value = NDArray[np.floating[Any]]


def replay(program: Block, *inputs: ArrayLike, real: Real = np.float64) -> list[Value]:
    """Return the outputs of the program, with every intermediate value rounded to `real`.

    If the program has no `libm` operations, the outputs equal those of the generated C code to the last bit. The last
    bits of `libm` operations such as sin can differ.

    Args:
        inputs: one array for each input, shape (n,), or (batch, n) for many runs at once.

    Returns:
        One array for each output, shape (m,) or (batch, m).

    Raises:
        InputError: the number of inputs or the size of an input is wrong.

    Example:
        >>> import casadi as ca
        >>> import numpy as np
        >>> from surctl.ir import lower, replay
        >>> x = ca.SX.sym("x", 2)
        >>> program = lower(ca.Function("total", [x], [x[0] + x[1]]))
        >>> [replay(program, [0.1, 0.2], real=real)[0].tolist() for real in (np.float64, np.float32)]
        [[0.30000000000000004], [0.30000001192092896]]
    """
    arrays = checked(program.name, program.inputs, inputs, real)
    batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    with np.errstate(all="ignore"):  # C also reports no error for 1/0
        outputs = _run(program, arrays, real)
    return [np.array(np.broadcast_to(y, (*batch, y.shape[-1]))) for y in outputs]


def _run(block: Block, arrays: list[Value], real: Real) -> list[Value]:
    if isinstance(block, Procedure):
        return _run_procedure(block, arrays, real)
    return (
        _run_program(block, arrays, real) if isinstance(block, Program) else run_routine(block, arrays, _Numbers(real))
    )


def _run_procedure(procedure: Procedure, arrays: list[Value], real: Real) -> list[Value]:
    batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    outputs: list[Value] = [np.empty((*batch, size), dtype=real) for _, size in procedure.outputs]
    whole = [np.broadcast_to(a, (*batch, a.shape[-1])) for a in arrays]
    for run in np.ndindex(batch):
        # Python's floats are several times as fast as NumPy's
        own = [a[run].tolist() if real is np.float64 else list(a[run]) for a in whole]
        for output, values in zip(outputs, procedure.run(own), strict=True):
            output[run] = values
    return outputs


def _run_program(program: Program, arrays: list[Value], real: Real) -> list[Value]:
    constants = [real(i.value) for i in program.instructions if i.op == "const"]
    values = _python(program)(arrays, constants, real)
    batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    return [_stack([values[r] for r in refs], batch, real) for refs in program.output_refs]


T = TypeVar("T")


class Arrays(ABC, Generic[T]):
    """What the steps of a routine do with arrays of a type T; a block may run for several lanes at once."""

    @abstractmethod
    def call(self, block: Block, arguments: list[T], lanes: int) -> list[T]:
        """Return the outputs of a block."""

    @abstractmethod
    def numbers(self, values: Sequence[float]) -> T:
        """Return one number for each lane."""

    @abstractmethod
    def spread(self, array: T, lanes: int, layout: Feed) -> T:
        """Return an array with this layout in the form for lanes."""

    @abstractmethod
    def flat(self, array: T, lanes: int, layout: Feed) -> T:
        """Return the inverse of `spread`."""

    @abstractmethod
    def pieces(self, array: T, count: int) -> Sequence[T]:
        """Return an array in equal pieces."""

    @abstractmethod
    def join(self, parts: Sequence[T]) -> T:
        """Return the array that consists of these pieces."""

    @abstractmethod
    def until(self, flag: T, fresh: Callable[[], list[T]], state: Sequence[T]) -> list[T] | None:
        """Return the state `fresh()` where the flag is 0, and elsewhere the old one; None if it is 0 nowhere."""

    @abstractmethod
    def piece(self, source: T, index: T, width: int) -> T:
        """Return the piece of a `Gather` with one lane."""


def run_routine(routine: Routine, inputs: Sequence[T], arrays: Arrays[T]) -> list[T]:
    """Return the outputs of a routine."""
    scope = {name: array for (name, _), array in zip(routine.inputs, inputs, strict=True)}
    for step in routine.steps:
        if isinstance(step, Gather):
            source, lanes = scope[step.source], step.lanes
            if lanes > 1:
                groups = arrays.pieces(source, routine.sizes()[step.source] // (step.width * lanes))
                rows = (arrays.flat(arrays.spread(group, lanes, "lanes"), lanes, "spread") for group in groups)
                source = arrays.join(list(rows))
            scope[step.result] = arrays.piece(source, scope[step.index], step.width)
            continue
        if isinstance(step, Loop):
            results = _turns(step, scope, arrays)
        else:
            results = arrays.call(step.block, [scope[name] for name in step.args], 1)
        scope.update(zip(step.results, results, strict=True))
    return [scope[name] for name in routine.results]


def _turns(loop: Loop, scope: Mapping[str, T], arrays: Arrays[T]) -> list[T]:
    """Return the results of a loop; independent iterations are computed at once, each in a lane."""
    count, lanes, held = loop.count, loop.lanes, len(loop.carried)
    if not held and lanes == 1:
        own = [arrays.numbers(range(count))] if loop.index else []
        own += [arrays.spread(scope[name], count, "spread") for name in (*loop.sliced, *loop.spread)]
        own += [arrays.spread(scope[name], count, "shared") for name in loop.fixed]
        return [arrays.flat(part, count, "spread") for part in arrays.call(loop.block, own, count)]
    state = [arrays.spread(scope[name], lanes, "lanes") for name in loop.carried]
    spread: tuple[Feed, Feed] = ("lanes", "spread")
    tables = [
        (arrays.pieces(scope[name], count), layout)
        for layout, names in zip(spread, (loop.sliced, loop.spread), strict=True)
        for name in names
    ]
    fixed = [arrays.spread(scope[name], lanes, "shared") for name in loop.fixed]
    stacked: list[list[T]] = []
    for turn in range(count):
        own = [arrays.numbers(range(lanes * turn, lanes * (turn + 1)))] if loop.index else []
        own += [*state, *(arrays.spread(table[turn], lanes, layout) for table, layout in tables), *fixed]
        call = partial(arrays.call, loop.block, own, lanes)
        outputs = call() if loop.until is None else arrays.until(state[loop.until], call, state)
        if outputs is None:
            break
        state = outputs[:held]
        stacked.append([arrays.flat(part, lanes, "lanes") for part in outputs[held:]])
    return [*(arrays.flat(part, lanes, "lanes") for part in state), *map(arrays.join, zip(*stacked, strict=True))]


class _Numbers(Arrays[Value]):
    """Arrays of numbers (…, entries) with a batch of runs; (…, lanes, entries) for several lanes."""

    def __init__(self, real: Real) -> None:
        self.real = real

    def call(self, block: Block, arguments: list[Value], lanes: int) -> list[Value]:
        return _run(block, arguments, self.real)

    def numbers(self, values: Sequence[float]) -> Value:
        column: Value = np.array([[value] for value in values], dtype=self.real)
        return column if len(column) > 1 else column[0]

    def spread(self, array: Value, lanes: int, layout: Feed) -> Value:
        if lanes == 1:
            return array
        if layout == "shared":
            return array[..., None, :]
        by_lane = layout == "spread"
        whole = array.reshape(*array.shape[:-1], *((lanes, -1) if by_lane else (-1, lanes)))
        return whole if by_lane else np.swapaxes(whole, -1, -2)

    def flat(self, array: Value, lanes: int, layout: Feed) -> Value:
        if lanes == 1:
            return array
        array = array if array.ndim > 1 else array[None]  # a block without inputs has no axis of lanes
        whole = np.broadcast_to(array, (*array.shape[:-2], lanes, array.shape[-1]))
        return (whole if layout == "spread" else np.swapaxes(whole, -1, -2)).reshape(*whole.shape[:-2], -1)

    def pieces(self, array: Value, count: int) -> Sequence[Value]:
        return np.split(array, count, axis=-1)

    def join(self, parts: Sequence[Value]) -> Value:
        batch = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        return np.concatenate([np.broadcast_to(part, (*batch, part.shape[-1])) for part in parts], axis=-1)

    def until(self, flag: Value, fresh: Callable[[], list[Value]], state: Sequence[Value]) -> list[Value] | None:
        running = flag == 0
        if not running.any():
            return None
        # in a batch, runs that have ended keep their state
        return fresh() if running.all() else [np.where(running, a, b) for a, b in zip(fresh(), state, strict=True)]

    def piece(self, source: Value, index: Value, width: int) -> Value:
        count = source.shape[-1] // width
        inside = np.where(index >= 1, np.where(index < count - 1, index, count - 1), 0).astype(np.intp)
        batch = np.broadcast_shapes(source.shape[:-1], index.shape[:-1])
        cut = np.broadcast_to(source, (*batch, count * width)).reshape(*batch, count, width)
        at = np.broadcast_to(inside, (*batch, 1))[..., None]
        piece: Value = np.take_along_axis(cut, np.broadcast_to(at, (*batch, 1, width)), axis=-2)[..., 0, :]
        return piece


def checked(
    name: str, ports: tuple[tuple[str, int], ...], inputs: tuple[ArrayLike, ...], dtype: Real | np.dtype[Any]
) -> list[Value]:
    """Return the inputs of a block as arrays (…, n); InputError for another number of inputs, or another size."""
    if len(inputs) != len(ports):
        raise InputError(f"takes {len(ports)} inputs, got {len(inputs)}", key=name)
    arrays: list[Value] = [np.asarray(x, dtype=dtype) for x in inputs]
    for array, (port, size) in zip(arrays, ports, strict=True):
        if array.ndim == 0 or array.shape[-1] != size:
            raise InputError(f"has shape {array.shape}, expected (…, {size})", key=f"{name}.{port}")
    return arrays


def _python(program: Program) -> Callable[[list[Value], list[Any], Real], list[Any]]:
    """Return a Python function that computes the values of all instructions from inputs and constants."""
    cached = program.__dict__.get("_python")
    if cached is None:
        lines, constants = ["def run(inputs, constants, real):", "    zero, one = real(0), real(1)"], 0
        for at, instruction in enumerate(program.instructions):
            op, args = instruction.op, instruction.args
            if op == "const":
                text, constants = f"constants[{constants}]", constants + 1
            elif op == "input":
                text = f"inputs[{args[0]}][..., {args[1]}]"
            else:
                kinds = zip(args, OPERATIONS[op].kinds, strict=False)
                text = OPERATIONS[op].python.format(*(_operand(program, a, truth=kind == "m") for a, kind in kinds))
            lines.append(f"    v{at} = {text}")
        names = ", ".join(_operand(program, at, truth=False) for at in range(len(program.instructions)))
        lines.append(f"    return [{names}]")
        scope = dict(IN_PYTHON)
        exec("\n".join(lines), scope)  # the text has only the names above and numbers of instructions
        cached = program.__dict__["_python"] = scope["run"]
    run: Callable[[list[Value], list[Any], Real], list[Any]] = cached
    return run


def _operand(program: Program, at: int, *, truth: bool) -> str:
    is_truth = program.instructions[at].op in TRUTHS
    if truth == is_truth:
        return f"v{at}"
    return f"(v{at} != 0)" if truth else f"where(v{at}, one, zero)"


def _stack(entries: list[Value], batch: tuple[int, ...], real: Real) -> Value:
    out: Value = np.empty((*batch, len(entries)), dtype=real)
    for k, entry in enumerate(entries):
        out[..., k] = entry
    return out
