"""Evaluation of an instruction list in NumPy, operation by operation, with results equal to those of C."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir.procedure import Procedure
from surctl.ir.program import OPERATIONS, Program
from surctl.ir.routine import Block, Gather, Loop, Routine

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
    arrays = _checked(program, inputs, real)
    batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
    with np.errstate(all="ignore"):  # C also reports no error for 1/0
        outputs = _run(program, arrays, real)
    return [np.array(np.broadcast_to(y, (*batch, y.shape[-1]))) for y in outputs]


def _run(block: Block, arrays: list[Value], real: Real) -> list[Value]:
    if isinstance(block, Procedure):
        return _run_procedure(block, arrays, real)
    return _run_program(block, arrays, real) if isinstance(block, Program) else _run_routine(block, arrays, real)


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


def _run_routine(routine: Routine, arrays: list[Value], real: Real) -> list[Value]:
    scope = {name: array for (name, _), array in zip(routine.inputs, arrays, strict=True)}
    for step in routine.steps:
        if isinstance(step, Gather):
            scope[step.result] = _piece(
                _plain(scope[step.source], step.width, step.lanes), scope[step.index], step.width
            )
            continue
        if isinstance(step, Loop):
            results = _run_loop(step, scope, real) if step.lanes == 1 else _run_lanes(step, scope, real)
        else:
            results = _run(step.block, [scope[name] for name in step.args], real)
        scope.update(zip(step.results, results, strict=True))
    return [scope[name] for name in routine.results]


def _run_loop(loop: Loop, scope: dict[str, Value], real: Real) -> list[Value]:
    if not loop.carried:
        return _run_at_once(loop, scope, real)
    state = [scope[name] for name in loop.carried]
    tables = [_rows(scope[name], loop.count) for name in (*loop.sliced, *loop.spread)]
    fixed = [scope[name] for name in loop.fixed]
    stacked: list[list[Value]] = []
    for turn in range(loop.count):
        running = None if loop.until is None else state[loop.until] == 0
        if running is not None and not running.any():
            break
        index = [np.full(1, turn, dtype=real)] if loop.index else []
        outputs = _run(loop.block, [*index, *state, *(table[..., turn, :] for table in tables), *fixed], real)
        fresh = outputs[: len(state)]
        if running is None or running.all():
            state = fresh
        else:  # in a batch, runs that have ended keep their state
            state = [np.where(running, a, b) for a, b in zip(fresh, state, strict=True)]
        stacked.append(outputs[len(state) :])
    return [*state, *(np.concatenate(parts, axis=-1) for parts in _broadcast(stacked))]


def _run_at_once(loop: Loop, scope: dict[str, Value], real: Real) -> list[Value]:
    """Evaluate all iterations of a loop with independent iterations at once, as an additional axis of the batch."""
    numbers: Value = np.array([[turn] for turn in range(loop.count)], dtype=real)
    tables = [_rows(scope[name], loop.count) for name in (*loop.sliced, *loop.spread)]
    outputs = _run(
        loop.block, [*[numbers] * loop.index, *tables, *(scope[name][..., None, :] for name in loop.fixed)], real
    )
    full = [part if part.ndim > 1 else part[None] for part in outputs]  # a body without inputs
    shapes = [(*part.shape[:-2], loop.count, part.shape[-1]) for part in full]
    return [np.broadcast_to(y, s).reshape(*s[:-2], -1) for y, s in zip(full, shapes, strict=True)]


def _rows(array: Value, count: int) -> Value:
    # (…, count · entries) → (…, count, entries)
    return array.reshape(*array.shape[:-1], count, -1)


def _run_lanes(loop: Loop, scope: dict[str, Value], real: Real) -> list[Value]:
    """Evaluate a loop over SIMD lanes, with all lanes at once as an additional axis of the batch."""
    lanes = loop.lanes
    state = [_by_lane(scope[name], lanes) for name in loop.carried]
    pieces = [[_by_lane(x, lanes) for x in np.split(scope[name], loop.count, axis=-1)] for name in loop.sliced]
    spread = [_cut(scope[name], loop.count, lanes) for name in loop.spread]
    fixed = [scope[name][..., None, :] for name in loop.fixed]
    stacked: list[list[Value]] = []
    for turn in range(loop.count):
        numbers: Value = np.array([[turn * lanes + k] for k in range(lanes)], dtype=real)
        arguments: list[Value] = [
            *([numbers] if loop.index else []),
            *state,
            *(x[turn] for x in (*pieces, *spread)),
            *fixed,
        ]
        outputs = _run(loop.block, arguments, real)
        state = outputs[: len(state)]
        stacked.append([_by_entry(x, lanes) for x in outputs[len(state) :]])
    return [*(_by_entry(x, lanes) for x in state), *(np.concatenate(x, axis=-1) for x in _broadcast(stacked))]


def _by_lane(array: Value, lanes: int) -> Value:
    # (…, entries · lanes), stored entry by entry, → (…, lanes, entries)
    return np.swapaxes(array.reshape(*array.shape[:-1], -1, lanes), -1, -2)


def _by_entry(array: Value, lanes: int) -> Value:
    # (…, lanes or 1, entries) → (…, entries · lanes), stored entry by entry
    array = array if array.ndim > 1 else array[None]  # a program without inputs has no axis of lanes
    full = np.broadcast_to(array, (*array.shape[:-2], lanes, array.shape[-1]))
    return np.swapaxes(full, -1, -2).reshape(*array.shape[:-2], -1)


def _cut(array: Value, count: int, lanes: int) -> list[Value]:
    # (…, count · lanes · entries) → one array (…, lanes, entries) for each iteration
    cut = array.reshape(*array.shape[:-1], count, lanes, -1)
    return [cut[..., turn, :, :] for turn in range(count)]


def _plain(source: Value, width: int, lanes: int) -> Value:
    """Return an array with one piece after another from groups of `lanes` pieces that are stored entry by entry."""
    if lanes == 1:
        return source
    blocks = source.reshape(*source.shape[:-1], -1, width, lanes)
    return np.swapaxes(blocks, -1, -2).reshape(source.shape)


def _broadcast(stacked: list[list[Value]]) -> list[list[Value]]:
    groups = []
    for parts in zip(*stacked, strict=True):
        batch = np.broadcast_shapes(*(p.shape[:-1] for p in parts))
        groups.append([np.broadcast_to(p, (*batch, p.shape[-1])) for p in parts])
    return groups


def _piece(source: Value, index: Value, width: int) -> Value:
    count = source.shape[-1] // width
    inside = np.where(index >= 1, np.where(index < count - 1, index, count - 1), 0).astype(np.intp)
    batch = np.broadcast_shapes(source.shape[:-1], index.shape[:-1])
    cut = np.broadcast_to(source, (*batch, count * width)).reshape(*batch, count, width)
    at = np.broadcast_to(inside, (*batch, 1))[..., None]
    piece: Value = np.take_along_axis(cut, np.broadcast_to(at, (*batch, 1, width)), axis=-2)[..., 0, :]
    return piece


def _checked(program: Block, inputs: tuple[ArrayLike, ...], real: Real) -> list[Value]:
    if len(inputs) != len(program.inputs):
        raise InputError(f"takes {len(program.inputs)} inputs, got {len(inputs)}", key=program.name)
    arrays: list[Value] = [np.asarray(x, dtype=real) for x in inputs]
    for array, (name, size) in zip(arrays, program.inputs, strict=True):
        if array.ndim == 0 or array.shape[-1] != size:
            raise InputError(f"has shape {array.shape}, expected (…, {size})", key=f"{program.name}.{name}")
    return arrays


_TEXTS = {
    **{op: f"{{0}} {sign} {{1}}" for op, sign in (("add", "+"), ("sub", "-"), ("mul", "*"), ("div", "/"))},
    **{op: f"{{0}} {sign} {{1}}" for op, sign in (("lt", "<"), ("le", "<="), ("eq", "=="), ("ne", "!="))},
    **{"neg": "-{0}", "sq": "{0} * {0}", "twice": "{0} + {0}", "inv": "one / {0}"},
    **{"fmin": "where({1} < {0}, {1}, {0})", "fmax": "where({0} < {1}, {1}, {0})"},  # ties as in C
    **{"and": "{0} & {1}", "or": "{0} | {1}", "not": "~{0}", "select": "where({0}, {1}, {2})"},
    "if_else_zero": "where({0}, {1}, zero)",
}
"""Python text of an operation, by its name; operations without such a text are called as functions."""

_TRUE = frozenset({"lt", "le", "eq", "ne", "and", "or", "not"})
"""Names of the operations that return a truth value."""

_TAKE_TRUTHS = {"and": (0, 1), "or": (0, 1), "not": (0,), "select": (0,), "if_else_zero": (0,)}


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
                truths = _TAKE_TRUTHS.get(op, ())
                operands = [_operand(program, a, truth=k in truths) for k, a in enumerate(args)]
                text = _TEXTS[op].format(*operands) if op in _TEXTS else f"{op}({', '.join(operands)}, dtype=real)"
            lines.append(f"    v{at} = {text}")
        names = ", ".join(_operand(program, at, truth=False) for at in range(len(program.instructions)))
        lines.append(f"    return [{names}]")
        scope: dict[str, Any] = {"where": np.where, **_CALLED}
        exec("\n".join(lines), scope)  # the text has only the names above and numbers of instructions
        cached = program.__dict__["_python"] = scope["run"]
    run: Callable[[list[Value], list[Any], Real], list[Any]] = cached
    return run


def _operand(program: Program, at: int, *, truth: bool) -> str:
    is_truth = program.instructions[at].op in _TRUE
    if truth == is_truth:
        return f"v{at}"
    return f"(v{at} != 0)" if truth else f"where(v{at}, one, zero)"


def _called(operation: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, dtype: np.asarray(operation(*args), dtype=dtype)


_CALLED = {name: _called(operation.numpy) for name, operation in OPERATIONS.items() if name not in _TEXTS}


def _stack(entries: list[Value], batch: tuple[int, ...], real: Real) -> Value:
    out: Value = np.empty((*batch, len(entries)), dtype=real)
    for k, entry in enumerate(entries):
        out[..., k] = entry
    return out
