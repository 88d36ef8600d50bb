"""Operations of a function that have no finite value or derivative at a point."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Program, lower, replay

__all__ = ["undefined_operation"]

Array = NDArray[np.float64]
_NEAR = 1e-12


def undefined_operation(function: ca.Function, arguments: Sequence[Array]) -> str:
    """Return the first operation without a finite value or derivative there, as text; empty if none is found.

    Example:
        >>> import casadi as ca
        >>> import numpy as np
        >>> from surctl.system.undefined import undefined_operation
        >>> x = ca.SX.sym("x", 2)
        >>> undefined_operation(ca.Function("f", [x], [1 + ca.sqrt(x[0] * x[1])]), [np.zeros(2)])
        'sqrt(0)'
    """
    try:
        program = lower(function)
    except InputError:  # an operation that the instruction list does not support
        return ""
    count = len(program.instructions)
    every = Program(program.name, program.inputs, (("all", count),), program.instructions, (tuple(range(count)),))
    values = replay(every, *(np.array(one, dtype=float).reshape(-1) for one in arguments))[0]
    for instruction in program.instructions:
        operands = [float(values[k]) for k in instruction.args] if instruction.op not in ("const", "input") else []
        if np.isfinite(operands).all() and _singular(instruction.op, operands):
            return _text(instruction.op, operands)
    return ""


def _singular(op: str, operands: list[float]) -> bool:
    match op, operands:
        case "sqrt", [value]:
            return value < _NEAR
        case "acos", [value]:
            return abs(value) > 1 - _NEAR
        case "atan2", [y, x]:
            return abs(y) < _NEAR and abs(x) < _NEAR
        case "inv", [value]:
            return abs(value) < _NEAR
        case "div", [_, value]:
            return abs(value) < _NEAR
    return False


def _text(op: str, operands: list[float]) -> str:
    shown = [f"{round(value, 9) + 0.0:g}" for value in operands]
    return {"inv": "1/{}", "div": "{}/{}"}.get(op, op + "(" + ", ".join(["{}"] * len(shown)) + ")").format(*shown)
