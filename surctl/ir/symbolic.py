"""Programs and routines as CasADi functions, for derivatives; fast calls of CasADi functions on NumPy vectors."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property, lru_cache, partial
from types import MappingProxyType
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir.native import runnable
from surctl.ir.procedure import Dual, Procedure
from surctl.ir.program import LIBM, Program
from surctl.ir.replay import Arrays, run_routine
from surctl.ir.routine import Block, Feed, Routine, nested

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
        **{name: getattr(ca, name) for name in LIBM},
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

    @cached_property
    def _values(self) -> Callable[..., list[Any]]:
        return runnable(self.procedure, quick=True)

    def eval(self, arguments: Sequence[ca.DM]) -> list[Any]:
        split = len(self.procedure.inputs)
        flat = [np.asarray(x).ravel().tolist() for x in arguments[:split]]
        if not self.slopes:
            return self._values(*flat)
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
    outputs = run_routine(routine, [[x] for x in inputs], _Symbols(functions))
    return ca.Function(routine.name, inputs, [column for (column,) in outputs])


_Columns: TypeAlias = list[ca.MX]


class _Symbols(Arrays[_Columns]):
    """Symbolic column vectors, one for each lane."""

    def __init__(self, functions: Mapping[int, ca.Function]) -> None:
        self.functions = functions

    def call(self, block: Block, arguments: list[_Columns], lanes: int) -> list[_Columns]:
        results = (self.functions[id(block)].call([each[k] for each in arguments]) for k in range(lanes))
        return [list(columns) for columns in zip(*results, strict=True)]

    def numbers(self, values: Sequence[float]) -> _Columns:
        return [ca.MX(value) for value in values]

    def spread(self, array: _Columns, lanes: int, layout: Feed) -> _Columns:
        (column,) = array
        if lanes == 1 or layout == "shared":
            return array * lanes
        return self._cut(column, lanes) if layout == "spread" else [column[k::lanes] for k in range(lanes)]

    def flat(self, array: _Columns, lanes: int, layout: Feed) -> _Columns:
        return [ca.vertcat(*array) if layout == "spread" else ca.reshape(ca.horzcat(*array).T, -1, 1)]

    def pieces(self, array: _Columns, count: int) -> Sequence[_Columns]:
        return [[piece] for piece in self._cut(array[0], count)]

    @staticmethod
    def _cut(column: ca.MX, count: int) -> _Columns:
        return list(ca.vertsplit(column, column.numel() // count)) if column.numel() else [column] * count

    def join(self, parts: Sequence[_Columns]) -> _Columns:
        return [ca.vertcat(*(part[0] for part in parts))]

    def until(self, flag: _Columns, fresh: Callable[[], list[_Columns]], state: Sequence[_Columns]) -> list[_Columns]:
        running = flag[0] == 0
        return [[ca.if_else(running, a[0], b[0])] for a, b in zip(fresh(), state, strict=True)]

    def piece(self, source: _Columns, index: _Columns, width: int) -> _Columns:
        # a chain of choices, which CasADi can expand to SX
        table, at = ca.SX.sym("table", width, source[0].numel() // width), ca.SX.sym("at")
        piece = table[:, 0]
        for k in range(1, table.shape[1]):
            piece = ca.if_else(at >= k, table[:, k], piece)
        return list(ca.Function("piece", [ca.vec(table), at], [piece]).call([source[0], index[0]]))


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
