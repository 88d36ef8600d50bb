"""Programs and routines as CasADi functions, for derivatives; fast calls of CasADi functions on NumPy vectors."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir.procedure import Dual, Procedure
from surctl.ir.program import Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, nested

# `binary` itself: for `a + b` CasADi first tries every other kind of argument, for ten times as long
_SYMBOLIC: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {
        "add": partial(ca.SX.binary, ca.OP_ADD),
        "sub": partial(ca.SX.binary, ca.OP_SUB),
        "mul": partial(ca.SX.binary, ca.OP_MUL),
        "div": partial(ca.SX.binary, ca.OP_DIV),
        "fma": lambda a, b, c: a * b + c,  # rounded twice: CasADi has no fma
        "neg": lambda a: -a,
        "inv": lambda a: 1 / a,
        "sq": lambda a: a * a,
        "twice": lambda a: a + a,
        "sqrt": ca.sqrt,
        "fabs": ca.fabs,
        "floor": ca.floor,
        # not ca.fmin: for signed zeros and NaN the result must be that of the C text
        "fmin": lambda a, b: ca.if_else(b < a, b, a),
        "fmax": lambda a, b: ca.if_else(a < b, b, a),
        "lt": partial(ca.SX.binary, ca.OP_LT),
        "le": partial(ca.SX.binary, ca.OP_LE),
        "eq": ca.eq,
        "ne": ca.ne,
        "and": ca.logic_and,
        "or": ca.logic_or,
        "not": ca.logic_not,
        "if_else_zero": lambda c, a: ca.if_else(c, a, 0),
        "select": ca.if_else,
        "sin": ca.sin,
        "cos": ca.cos,
        "atan2": ca.atan2,
        "acos": ca.acos,
    }
)


def to_casadi(block: Block) -> ca.Function:
    """Return a CasADi function of column vectors: SX for a program, MX with unrolled loops for a routine.

    The results equal those of `replay`, except for the sign of a zero (CasADi's `if_else` turns −0 into +0). Every loop
    runs all its iterations; once its flag is set, the state no longer changes, so the derivatives are those of the
    iterations up to then.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Loop, Routine, lower, to_casadi
        >>> v, drag = ca.SX.sym("v"), ca.SX.sym("drag")
        >>> coast = lower(ca.Function("coast", [v, drag], [v - 0.1 * drag * v]))
        >>> loop = Loop(coast, 10, ("v",), ("last",), fixed=("drag",))
        >>> speed = to_casadi(Routine("speed", (("v", 1), ("drag", 1)), (loop,), ("last",)))
        >>> start = ca.MX.sym("start")
        >>> speed(1.0, 0.5), ca.Function("slope", [start], [ca.jacobian(speed(start, 0.5), start)])(1.0)
        (DM(0.598737), DM(0.598737))
    """
    functions: dict[int, ca.Function] = {}
    for key, inner in nested(block).items():
        if isinstance(inner, Procedure):
            functions[key] = _procedure(inner)
        else:
            functions[key] = _program(inner) if isinstance(inner, Program) else _routine(inner, functions)
    return functions[id(block)]


def _procedure(procedure: Procedure) -> ca.Function:
    """Return a function that executes the procedure; its derivatives are those of the operations that it executes."""
    function = procedure.__dict__.get("_casadi")  # CasADi does not keep a function of Python alive
    if function is None:
        function = procedure.__dict__["_casadi"] = _Executed(procedure)
    inputs = [ca.MX.sym(name, size) for name, size in procedure.inputs]
    return ca.Function(procedure.name, inputs, function.call(inputs))


class _Executed(ca.Callback):
    """A procedure as a function of CasADi."""

    def __init__(self, procedure: Procedure, *, slopes: bool = False) -> None:
        ca.Callback.__init__(self)
        self.procedure, self.slopes = procedure, slopes
        self.jacobian_of: list[_Executed] = []
        self.construct(f"{procedure.name}_slopes" if slopes else procedure.name, {})

    def get_n_in(self) -> int:
        more = len(self.procedure.outputs) if self.slopes else 0
        return len(self.procedure.inputs) + more

    def get_n_out(self) -> int:
        one = len(self.procedure.outputs)
        return one * len(self.procedure.inputs) if self.slopes else one

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        ports = (*self.procedure.inputs, *self.procedure.outputs)
        return ca.Sparsity.dense(ports[i][1], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        if not self.slopes:
            return ca.Sparsity.dense(self.procedure.outputs[i][1], 1)
        output, source = divmod(i, len(self.procedure.inputs))
        return ca.Sparsity.dense(self.procedure.outputs[output][1], self.procedure.inputs[source][1])

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        split = len(self.procedure.inputs)
        flat = [[float(v) for v in np.asarray(x).ravel()] for x in arguments[:split]]
        if not self.slopes:
            return [np.array(y) for y in self.procedure.run(flat)]
        sizes = [len(x) for x in flat]
        every = np.eye(sum(sizes))
        at = iter(every)
        duals = [[Dual(v, next(at)) for v in x] for x in flat]
        with np.errstate(all="ignore"):
            outputs = self.procedure.run(duals)
        rows = [np.array([y.slope if isinstance(y, Dual) else 0 * every[0] for y in out]) for out in outputs]
        return [part for row in rows for part in np.split(row, np.cumsum(sizes)[:-1], axis=1)]

    def has_jacobian(self) -> bool:
        return not self.slopes

    def get_jacobian(
        self, name: str, inames: Sequence[str], onames: Sequence[str], opts: Mapping[str, Any]
    ) -> ca.Function:
        if not self.jacobian_of:
            self.jacobian_of.append(_Executed(self.procedure, slopes=True))
        return self.jacobian_of[0]


def _program(program: Program) -> ca.Function:
    inputs = [ca.SX.sym(name, size) for name, size in program.inputs]
    with _as_written():
        values: list[ca.SX] = []
        for instruction in program.instructions:
            if instruction.op == "const":
                values.append(ca.SX(instruction.number))
            elif instruction.op == "input":
                values.append(inputs[instruction.args[0]][instruction.args[1]])
            else:
                values.append(_SYMBOLIC[instruction.op](*(values[a] for a in instruction.args)))
    outputs = [ca.densify(ca.vertcat(ca.SX(0, 1), *(values[r] for r in refs))) for refs in program.output_refs]
    return ca.Function(program.name, inputs, outputs)


@contextmanager
def _as_written() -> Iterator[None]:
    """In the `with` block, keep CasADi from converting a product with an inverse to a division (other rounding)."""
    usual = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(usual)


def _routine(routine: Routine, functions: Mapping[int, ca.Function]) -> ca.Function:
    inputs = [ca.MX.sym(name, size) for name, size in routine.inputs]
    scope = {name: symbol for (name, _), symbol in zip(routine.inputs, inputs, strict=True)}
    for step in routine.steps:
        if isinstance(step, Gather):
            source = _plain(scope[step.source], step.width, step.lanes)
            scope[step.result] = _piece(source, scope[step.index], step.width)
            continue
        if isinstance(step, Call):
            results = _called(functions[id(step.block)], [scope[name] for name in step.args])
        elif step.lanes > 1:
            results = _side_by_side(step, functions[id(step.block)], scope)
        else:
            results = _unrolled(step, functions[id(step.block)], scope)
        scope.update(zip(step.results, results, strict=True))
    return ca.Function(routine.name, inputs, [scope[name] for name in routine.results])


def _called(function: ca.Function, arguments: list[ca.MX]) -> list[ca.MX]:
    results = function.call(arguments)
    return list(results)


def _unrolled(loop: Loop, function: ca.Function, scope: Mapping[str, ca.MX]) -> list[ca.MX]:
    state = [scope[name] for name in loop.carried]
    pieces = [ca.vertsplit(scope[name], scope[name].numel() // loop.count) for name in (*loop.sliced, *loop.spread)]
    fixed = [scope[name] for name in loop.fixed]
    stacked: list[list[ca.MX]] = []
    for turn in range(loop.count):
        index = [ca.MX(turn)] if loop.index else []
        outputs = _called(function, [*index, *state, *(piece[turn] for piece in pieces), *fixed])
        fresh = outputs[: len(state)]
        stacked.append(outputs[len(state) :])
        if loop.until is not None:
            running = state[loop.until] == 0
            fresh = [ca.if_else(running, a, b) for a, b in zip(fresh, state, strict=True)]
        state = fresh
    return [*state, *(ca.vertcat(*parts) for parts in zip(*stacked, strict=True))]


def _side_by_side(loop: Loop, function: ca.Function, scope: Mapping[str, ca.MX]) -> list[ca.MX]:
    lanes, turns = loop.lanes, loop.count * loop.lanes
    state = [[scope[name][k::lanes] for k in range(lanes)] for name in loop.carried]
    blocks = [ca.vertsplit(scope[name], scope[name].numel() // loop.count) for name in loop.sliced]
    pieces = [ca.vertsplit(scope[name], scope[name].numel() // turns) for name in loop.spread]
    fixed = [scope[name] for name in loop.fixed]
    stacked: list[list[ca.MX]] = []
    for turn in range(loop.count):
        lane_outputs = []
        for k in range(lanes):
            at = turn * lanes + k
            own = [*(x[k] for x in state), *(x[turn][k::lanes] for x in blocks), *(x[at] for x in pieces)]
            lane_outputs.append(_called(function, [*([ca.MX(at)] if loop.index else []), *own, *fixed]))
        outputs = [list(x) for x in zip(*lane_outputs, strict=True)]
        state = outputs[: len(state)]
        stacked.append([_by_entry(x) for x in outputs[len(state) :]])
    return [*(_by_entry(x) for x in state), *(ca.vertcat(*parts) for parts in zip(*stacked, strict=True))]


def _by_entry(parts: list[ca.MX]) -> ca.MX:
    """Join the arrays of all SIMD lanes to one array: entry 0 of all lanes, then entry 1 of all lanes, and so on."""
    return ca.reshape(ca.horzcat(*parts).T, -1, 1)


def _plain(source: ca.MX, width: int, lanes: int) -> ca.MX:
    """Return an array with one piece after another from groups of `lanes` pieces that are stored entry by entry."""
    if lanes == 1:
        return source
    blocks = ca.vertsplit(source, width * lanes)
    return ca.vertcat(*(ca.reshape(ca.reshape(b, lanes, width).T, -1, 1) for b in blocks))


def _piece(source: ca.MX, index: ca.MX, width: int) -> ca.MX:
    # a chain of choices, which CasADi can expand to SX
    table, at = ca.SX.sym("table", width, source.numel() // width), ca.SX.sym("at")
    piece = table[:, 0]
    for k in range(1, table.shape[1]):
        piece = ca.if_else(at >= k, table[:, k], piece)
    return _called(ca.Function("piece", [ca.vec(table), at], [piece]), [source, index])[0]


def on_vectors(function: ca.Function) -> Callable[..., list[NDArray[np.float64]]]:
    """Return a Python function of NumPy vectors (n,) that calls a CasADi function in a tenth of the usual time.

    A call of the CasADi function converts every argument to a matrix; the returned function instead writes the
    arguments into buffers that CasADi reads.

    Raises:
        InputError: an argument has another size, or the number of arguments is wrong.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import on_vectors
        >>> v = ca.SX.sym("v", 2)
        >>> on_vectors(ca.Function("drag", [v], [v * ca.norm_2(v)]))([0.3, 0.4])
        [array([0.15, 0.2 ])]
    """
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    places = [np.array(function.sparsity_out(i).find(), dtype=int) for i in range(function.n_out())]
    wholes = [function.numel_out(i) for i in range(function.n_out())]
    if any(function.nnz_in(i) != size for i, size in enumerate(sizes)):
        raise InputError("takes matrices that are not dense", key=function.name())
    bound = threading.local()  # every call needs its own buffer

    def run(*arguments: ArrayLike) -> list[NDArray[np.float64]]:
        if not hasattr(bound, "trigger"):
            bound.inputs, bound.outputs = [np.zeros(n) for n in sizes], [np.zeros(len(at)) for at in places]
            bound.buffer, bound.trigger = function.buffer()
            for i, array in enumerate(bound.inputs):
                bound.buffer.set_arg(i, memoryview(array))
            for i, array in enumerate(bound.outputs):
                bound.buffer.set_res(i, memoryview(array))
        if len(arguments) != len(sizes):
            raise InputError(f"takes {len(sizes)} inputs, got {len(arguments)}", key=function.name())
        for i, (into, argument) in enumerate(zip(bound.inputs, arguments, strict=True)):
            values = np.asarray(argument, dtype=np.float64)
            if values.size != into.size:
                raise InputError(f"has {values.size} numbers, expected {into.size}", key=function.name_in(i))
            into[:] = values.reshape(-1, order="F")
        bound.trigger()
        results = []
        for at, whole, part in zip(places, wholes, bound.outputs, strict=True):
            full = np.zeros(whole)
            full[at] = part
            results.append(full)
        return results

    return run


def on_columns(function: ca.Function) -> Callable[[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Return a Python function of points (n, N) that evaluates a CasADi function of one vector (n,) at every column.

    Each output (m,) of the CasADi function becomes an array (m, N). As with `on_vectors`, nothing is converted.
    """

    @lru_cache(maxsize=8)
    def together(count: int) -> Callable[..., list[NDArray[np.float64]]]:
        return on_vectors(function.map(count))

    def run(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        count = points.shape[1]
        return [part.reshape(-1, count, order="F") for part in together(count)(points)]

    return run
