"""Run an instruction list in NumPy, operation by operation, with C's semantics."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir.ops import OPERATIONS
from surctl.ir.program import Instruction, Program

__all__ = ["replay"]

Real = type[np.float64] | type[np.float32]
Value = NDArray[np.floating[Any]]


def replay(program: Program, *inputs: ArrayLike, real: Real = np.float64) -> list[Value]:
    """Outputs of the program, every intermediate rounded to `real`.

    Bit-equal to the emitted C for programs without `libm` operations; those differ in the last bits.

    Args:
        program: the instruction list.
        inputs: one array an input, shape (n,), or (batch, n) for many runs at once.
        real: np.float64 or np.float32.

    Returns:
        One array an output, shape (m,) or (batch, m).

    Raises:
        InputError: a wrong number of inputs, or an input of the wrong size.
    """
    arrays = _checked(program, inputs, real)
    batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    values: list[Value] = []
    with np.errstate(all="ignore"):  # C raises nothing for 1/0 either
        for instruction in program.instructions:
            values.append(np.asarray(_evaluate(instruction, values, arrays), dtype=real))
    return [_gather([values[r] for r in refs], batch, real) for refs in program.output_refs]


def _checked(program: Program, inputs: tuple[ArrayLike, ...], real: Real) -> list[Value]:
    if len(inputs) != len(program.inputs):
        raise InputError(f"takes {len(program.inputs)} inputs, got {len(inputs)}", key=program.name)
    arrays: list[Value] = [np.asarray(x, dtype=real) for x in inputs]
    for array, (name, size) in zip(arrays, program.inputs, strict=True):
        if array.ndim == 0 or array.shape[-1] != size:
            raise InputError(f"has shape {array.shape}, expected (…, {size})", key=f"{program.name}.{name}")
    return arrays


def _evaluate(instruction: Instruction, values: list[Value], arrays: list[Value]) -> Any:
    if instruction.op == "const":
        return instruction.value
    if instruction.op == "input":
        which, entry = instruction.args
        return arrays[which][..., entry]
    return OPERATIONS[instruction.op].numpy(*(values[a] for a in instruction.args))


def _gather(entries: list[Value], batch: tuple[int, ...], real: Real) -> Value:
    out: Value = np.empty((*batch, len(entries)), dtype=real)
    for k, entry in enumerate(entries):
        out[..., k] = entry
    return out
