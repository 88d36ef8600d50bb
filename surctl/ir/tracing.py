"""CasADi expressions to instruction lists, with loops: `fold`, `each`, `repeat`, `only_if`, `picked`.

CasADi's SX has no loops: a Python loop that builds expressions is unrolled, so the generated code grows with the number
of iterations. While a `Recording` is open, `repeat`, `fold`, `each` and `only_if` call the loop body once, on new
symbols, and return symbols for the results of the loop; `picked` returns symbols for the row of a table.
`Recording.block` converts expressions in such symbols to a routine. Without a recording, these functions unroll the
loop, so that the expressions can be evaluated or differentiated directly.

A loop body may use any expression from outside the body. A value that does not depend on the table rows or the state of
a loop is computed once, before the loop. A value that only a conditional (`only_if`) needs is computed inside the
conditional. Equal expressions are computed only once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar, Token
from types import MappingProxyType, TracebackType
from typing import Any, TypeAlias, overload

import casadi as ca

from surctl.errors import InputError, UnsupportedOperation
from surctl.ir.elementary import COMPOSED
from surctl.ir.folding import Numbering, shared_divisors
from surctl.ir.nesting import Key, Traced, routine
from surctl.ir.program import OPERATIONS, SUBSTITUTES, Instruction, Program, drop_dead
from surctl.ir.routine import Block

_NAMES: Mapping[int, str] = MappingProxyType(
    {int(getattr(ca, n)): n[3:].lower() for n in dir(ca) if n.startswith("OP_")}
)


def lower(function: ca.Function, *, reciprocals: bool = False) -> Program:
    """Return the instruction list of a function of dense vectors.

    Equal subexpressions are computed once. The four operations of CasADi's `if_else` become one `select`; it preserves
    the sign of a zero, whereas the sum that CasADi evaluates does not. Instructions that no output needs are removed.
    Structural zeros of an output become the constant 0.

    Args:
        function: SX function, or an MX function that expands to one.
        reciprocals: whether several divisions by the same divisor become products with its inverse, which is faster but
            rounds once more. (CasADi itself converts such products to divisions.)

    Raises:
        UnsupportedOperation: an operation is neither in `surctl.ir.program.OPERATIONS` nor in
            `surctl.ir.elementary.COMPOSED`.
        InputError: an input that is not a dense column vector.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower
        >>> v = ca.SX.sym("v", 2)
        >>> print(lower(ca.Function("speed", [v], [ca.norm_2(v)])).text(), end="")
        program speed
        in0 i0 2
        v0 = in0[0]
        v1 = sq v0
        v2 = in0[1]
        v3 = sq v2
        v4 = add v1 v3
        v5 = sqrt v4
        out0 o0 v5
    """
    sx = _expanded(function)
    inputs = tuple((str(sx.name_in(k)), _dense_size(sx, k)) for k in range(sx.n_in()))
    builder = _Builder(str(sx.name()))
    stored = _walk(sx, builder)
    refs = [_dense_refs(sx, k, stored, builder) for k in range(sx.n_out())]
    outputs = tuple((str(sx.name_out(k)), len(refs[k])) for k in range(sx.n_out()))
    program = Program(builder.name, inputs, outputs, *drop_dead(builder.instructions, refs))
    return shared_divisors(program) if reciprocals else program


def lower_named(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX | float]) -> Program:
    """Return the instruction list that computes the named outputs from the named input columns; outputs become dense.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower_named
        >>> v = ca.SX.sym("v", 2)
        >>> print(lower_named("across", {"v": v}, {"left": -v[1]}).text(), end="")
        program across
        in0 v 2
        v0 = in0[1]
        v1 = neg v0
        out0 left v1
    """
    dense = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": True}))


def _expanded(function: ca.Function) -> ca.Function:
    if function.is_a("SXFunction"):
        return function
    try:
        return function.expand()
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise UnsupportedOperation(
            f"cannot be expanded to scalar operations ({reason})",
            key=str(function.name()),
            remedy="build it from SX expressions without solvers or external calls",
        ) from None


def _dense_size(function: ca.Function, k: int) -> int:
    sparsity = function.sparsity_in(k)
    if sparsity.numel() and not (sparsity.is_dense() and sparsity.is_column()):
        problem = f"is {sparsity.dim()}, not a dense column vector"
        remedy = "pass a flat vector and reshape it inside"
        raise InputError(problem, key=f"{function.name()}.{function.name_in(k)}", remedy=remedy)
    return int(sparsity.numel())


def _dense_refs(
    function: ca.Function, k: int, stored: Mapping[tuple[int, int], int], builder: _Builder
) -> tuple[int, ...]:
    # column by column; a structural zero is the constant 0
    sparsity = function.sparsity_out(k)
    at = {entry: nz for nz, entry in enumerate(sparsity.find())}
    return tuple(stored[k, at[entry]] if entry in at else builder.constant(0.0) for entry in range(sparsity.numel()))


def _walk(function: ca.Function, builder: _Builder) -> dict[tuple[int, int], int]:
    """Pass every instruction to the builder; return the list position of each (output, index of the nonzero)."""
    slot: dict[int, int] = {}  # CasADi reuses work slots: each write gives a slot a new value
    stored: dict[tuple[int, int], int] = {}
    identity, operands, results = function.instruction_id, function.instruction_input, function.instruction_output
    for k in range(function.n_instructions()):
        op = _NAMES.get(identity(k), "unknown")
        args, result = operands(k), results(k)
        if op == "output":
            stored[int(result[0]), int(result[1])] = slot[args[0]]
        elif op == "input":
            slot[result[0]] = builder.add("input", (int(args[0]), int(args[1])))
        elif op == "const":
            slot[result[0]] = builder.constant(float(function.instruction_constant(k)))
        elif op in OPERATIONS:
            slot[result[0]] = builder.add(op, tuple([slot[a] for a in args]))
        elif op in COMPOSED:
            slot[result[0]] = COMPOSED[op](builder, *[slot[a] for a in args])
        else:
            raise UnsupportedOperation(
                f"operation {op!r} is not supported by the instruction list",
                key=builder.name,
                remedy=SUBSTITUTES.get(op, "rewrite it with the supported operations: " + ", ".join(OPERATIONS)),
            )
    return stored


class _Builder(Numbering):
    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name

    def constant(self, value: float) -> int:
        if math.isnan(value):
            raise UnsupportedOperation(
                "contains a NaN constant", key=self.name, remedy="find the expression that is undefined"
            )
        return super().constant(value)

    def add(self, op: str, args: tuple[int, ...]) -> int:
        chosen = self._as_select(*args) if op == "add" else None
        return super().add(op, args) if chosen is None else super().add("select", chosen)

    def _as_select(self, left: int, right: int) -> tuple[int, int, int] | None:
        """Return (c, a, b) if the sum is `if_else_zero(c, a) + if_else_zero(not c, b)`, otherwise None."""
        first, second = self.instructions[left], self.instructions[right]
        if first.op != "if_else_zero" or second.op != "if_else_zero":
            return None
        (c, a), (d, b) = first.args, second.args
        if self._is_not(d, c):
            return c, a, b
        if self._is_not(c, d):
            return d, b, a
        return None

    def _is_not(self, at: int, of: int) -> bool:
        return self.instructions[at] == Instruction("not", (of,))


Vectors: TypeAlias = Sequence[ca.SX]

_open: ContextVar[Recording | None] = ContextVar("recording", default=None)


_Loop: TypeAlias = Traced[ca.SX, ca.SX]


class Recording:
    """Records loops in its `with` block, and converts expressions that use loop results to a program or routine.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Recording, fold, replay
        >>> points, here = ca.SX.sym("points", 5, 2), ca.SX.sym("here", 2)
        >>> with Recording() as recording:
        ...     nearest = fold(
        ...         "nearest", lambda least, point: ca.fmin(least, ca.norm_2(point - here)), ca.SX(100), points
        ...     )
        >>> block = recording.block("watch", {"points": ca.vec(points.T), "here": here}, {"nearest": nearest})
        >>> print(block.text().splitlines()[0], "…", block.operations)
        program watch_before_nearest … 35
        >>> [float(replay(block, [3, 4, 1, 0, 2, 0, 0, 3, 9, 9], at)[0][0]) for at in ([0, 0], [2, 1])]
        [1.0, 1.0]
    """

    def __init__(self) -> None:
        self._loops: list[_Loop] = []
        self._depth = 0
        self._token: Token[Recording | None] | None = None

    def __enter__(self) -> Recording:
        self._token = _open.set(self)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        assert self._token is not None
        _open.reset(self._token)

    def block(self, name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, ca.SX]) -> Block:
        """Return the outputs as a program, or as a routine if loops are needed.

        Args:
            name: name of the program or routine; the name of an inner block begins with this name, or is the name of a
                loop.
            inputs: symbols (n, 1) by name.
            outputs: expressions by name; an output vector contains the columns of its expression, one after another.

        Raises:
            InputError, UnsupportedOperation: as in `lower`; also if an expression contains a symbol that is neither an
                input nor a result of a loop.
        """
        dense = [ca.densify(_sx(value)) for value in outputs.values()]
        loops = self._reached(dense)
        arguments = [*inputs.values(), *(s for loop in loops for s in (*loop.own, *loop.results))]
        results = [*dense, *(e for loop in loops for e in (*loop.before, *loop.after))]
        names = [*inputs, *(f"loop{k}" for k in range(len(arguments) - len(inputs)))]
        try:
            output_names = [*outputs, *(f"of_loop{k}" for k in range(len(results) - len(outputs)))]
            function = ca.Function(name, arguments, results, names, output_names)
        except RuntimeError as error:
            free = re.search(r"variables \[(.*?)\] are free", str(error))
            which = f": {free[1]}" if free else ""
            problem = f"uses symbols that are not its arguments{which}"
            raise InputError(problem, key=name, remedy="compute the results from the arguments") from None
        program = lower(function)
        if not loops:
            return program
        traced: list[Traced[int, Key]] = []
        argument, result = len(inputs), len(dense)
        for loop in loops:
            keys = iter(program.output_refs[result:])
            state, tables, after, rows = (
                tuple(next(keys) for _ in part) for part in (loop.state, loop.tables, loop.next, loop.rows)
            )
            held = argument + len(loop.own)
            own, ends = tuple(range(argument, held)), tuple(range(held, held + len(loop.results)))
            traced.append(Traced(loop.name, loop.depth, loop.count, own, ends, state, tables, after, rows, loop.until))
            argument, result = held + len(ends), result + len(loop.before) + len(loop.after)
        refs = {out: program.output_refs[k] for k, out in enumerate(outputs)}
        return routine(name, program, len(inputs), refs, traced)

    def trace(
        self,
        name: str,
        body: Callable[..., tuple[Vectors, Vectors]],
        state: Vectors,
        tables: Vectors,
        count: int,
        until: int | None,
    ) -> tuple[list[ca.SX], list[ca.SX]]:
        """Call the loop body once, on new symbols, and record the loop."""
        self._depth += 1
        held = [ca.SX.sym("s", part.numel()) for part in state]
        rows = [ca.SX.sym("t", table.shape[1]) for table in tables]
        after, collected = body(*held, *rows)
        self._depth -= 1
        after, collected = _columns(after), _columns(collected)
        _check(name, state, after, collected, until)
        results = [ca.SX.sym("r", part.numel()) for part in state]
        stacked = [ca.SX.sym("r", count * part.numel()) for part in collected]
        loop = _Loop(
            name,
            self._depth + 1,
            count,
            (*held, *rows),
            (*results, *stacked),
            tuple(state),
            tuple(ca.vec(table.T) for table in tables),
            tuple(after),
            tuple(collected),
            until,
        )
        self._loops.append(loop)
        return results, [ca.reshape(s, part.numel(), count).T for s, part in zip(stacked, collected, strict=True)]

    def pick(self, name: str, table: ca.SX, index: ca.SX) -> ca.SX:
        """Record that a table row is read, and return the row."""
        row = ca.SX.sym("r", table.shape[1])
        self._loops.append(
            _Loop(name, self._depth + 1, 0, (), (row,), (ca.densify(index),), (ca.vec(table.T),), (), (), None)
        )
        return row

    def _reached(self, outputs: Vectors) -> list[_Loop]:
        # in the order in which the loops were traced
        of = {s.element_hash(): k for k, loop in enumerate(self._loops) for r in loop.results for s in ca.symvar(r)}
        reached: set[int] = set()
        todo = list(outputs)
        while todo:
            symbols = ca.symvar(ca.vertcat(*todo))
            needed = {of[h] for s in symbols if (h := s.element_hash()) in of} - reached
            reached |= needed
            todo = [e for k in needed for e in (*self._loops[k].before, *self._loops[k].after)]
        return [self._loops[k] for k in sorted(reached)]


def repeat(
    name: str,
    body: Callable[..., tuple[Vectors, Vectors]],
    state: Vectors,
    tables: Vectors = (),
    *,
    count: int | None = None,
    until: int | None = None,
) -> tuple[list[ca.SX], list[ca.SX]]:
    """Call a loop body for each row of the tables in turn, and return the final state and the stacked rows.

    Args:
        name: C identifier of the loop body.
        body: function of the parts of the state and the table rows; returns the parts of the next state and the rows to
            stack. All are columns.
        state: parts of the state before the first iteration, as columns.
        tables: tables (iterations, width); iteration k reads row k of each table, as a column.
        count: number of iterations if there is no table.
        until: position in `state` of a flag (1, 1); no further iteration runs once the flag is not 0. A loop with a
            flag cannot stack rows.

    Returns:
        The state after the last iteration, and the stacked tables (iterations, width).

    Raises:
        InputError: tables of different length, a state that changes its size, or neither a table nor a count.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import repeat
        >>> table = ca.DM([[1, 2], [3, 4]])
        >>> (total,), (products,) = repeat(
        ...     "sums", lambda total, row: ((total + row[0],), (row[0] * row[1],)), [ca.SX(0)], [ca.SX(table)]
        ... )
        >>> float(total), ca.DM(products).full().ravel().tolist()  # unrolled, since no recording is open
        (4.0, [2.0, 12.0])
    """
    state, tables = _columns(state), [ca.densify(_sx(table)) for table in tables]
    lengths = {int(table.shape[0]) for table in tables} | ({count} if count is not None else set())
    if len(lengths) != 1:
        raise InputError(f"runs over tables of {sorted(lengths)} rows", key=name, remedy="use tables of equal length")
    turns = lengths.pop()
    recording = _open.get()
    if recording is not None and turns and (turns > 1 or until is not None):
        return recording.trace(name, body, state, tables, turns, until)
    stacked: list[list[ca.SX]] = []
    for turn in range(turns):
        after, collected = body(*state, *(table[turn, :].T for table in tables))
        after, collected = _columns(after), _columns(collected)
        _check(name, state, after, collected, until)
        if until is not None:
            runs = state[until] == 0
            after = [ca.if_else(runs, new, old) for new, old in zip(after, state, strict=True)]
        state = after
        stacked.append(collected)
    return list(state), [ca.vertcat(*(part.T for part in parts)) for parts in zip(*stacked, strict=True)]


@overload
def fold(name: str, body: Callable[..., ca.SX], state: ca.SX, *tables: ca.SX) -> ca.SX: ...


@overload
def fold(name: str, body: Callable[..., Vectors], state: Vectors, *tables: ca.SX) -> list[ca.SX]: ...


def fold(
    name: str, body: Callable[..., ca.SX | Vectors], state: ca.SX | Vectors, *tables: ca.SX
) -> ca.SX | list[ca.SX]:
    """Call a loop body for each table row in turn; return the final state as a column or a list, like `state`.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import fold
        >>> float(fold("sum", lambda total, row: total + ca.sumsqr(row), ca.SX(0), ca.SX([[1, 2], [3, 4]])))
        30.0
    """

    def one(*arguments: ca.SX) -> tuple[Vectors, Vectors]:
        after: Any = body(*arguments)
        return [after], []

    def several(*values: ca.SX) -> tuple[Vectors, Vectors]:
        after = body(*values)
        assert not isinstance(after, ca.SX)
        return after, []

    if isinstance(state, ca.SX):
        return repeat(name, one, [state], tables)[0][0]
    return repeat(name, several, state, tables)[0]


def each(name: str, body: Callable[..., Vectors], *tables: ca.SX) -> list[ca.SX]:
    """Return tables (iterations, width): row k contains the values that the loop body returns for row k of the tables.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import each
        >>> (squares,) = each("square", lambda row: [row * row], ca.SX([[1, 2], [3, 4]]))
        >>> ca.DM(squares).full().tolist()
        [[1.0, 4.0], [9.0, 16.0]]
    """
    return repeat(name, lambda *arguments: ((), body(*arguments)), [], tables)[1]


def only_if(name: str, condition: ca.SX, body: Callable[[], Vectors], otherwise: Vectors) -> list[ca.SX]:
    """Return the values of `body` if the condition holds (`body` runs only then), otherwise the values `otherwise`.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import only_if
        >>> [float(v) for c in (1, 0) for v in only_if("root", ca.SX(c), lambda: [ca.sqrt(ca.SX(4))], [ca.SX(-1)])]
        [2.0, -1.0]
    """
    alternatives = _columns(otherwise)
    (_, *values), _ = repeat(
        name, lambda *_: ((ca.SX(1), *body()), ()), [ca.logic_not(condition), *alternatives], count=1, until=0
    )
    return values


def picked(name: str, table: ca.SX, index: ca.SX) -> ca.SX:
    """Return row number `index` of a table, as a column; the first row has the number 0.

    The index is rounded down; outside the table the nearest row is read, and for a NaN the first row.

    Args:
        table: (rows, width), at least one row.

    Raises:
        InputError: the table has no rows.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import picked
        >>> ca.DM(picked("second", ca.SX([[1, 2], [3, 4], [5, 6]]), ca.SX(1))).full().ravel().tolist()
        [3.0, 4.0]
    """
    table = ca.densify(_sx(table))
    if not table.shape[0]:
        raise InputError("reads a row of an empty table", key=name, remedy="use a table with at least one row")
    recording = _open.get()
    if recording is not None:
        return recording.pick(name, table, index)
    row = table[0, :].T
    for k in range(1, table.shape[0]):
        row = ca.if_else(index >= k, table[k, :].T, row)
    return row


def tabulated(rows: Iterable[Iterable[ca.SX | float]], width: int = 0) -> ca.SX:
    """Return a table with one row for each item of `rows` (columns or numbers); (0, width) if `rows` is empty.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import tabulated
        >>> ca.DM(tabulated([(ca.SX([1, 2]), 3.0), (ca.SX([4, 5]), 6.0)])).full().tolist()
        [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    """
    listed = [ca.vertcat(*(ca.vec(_sx(part)) for part in row)).T for row in rows]
    return ca.densify(ca.vertcat(*listed)) if listed else ca.SX.zeros(0, width)


def _columns(values: Vectors) -> list[ca.SX]:
    return [ca.densify(ca.vec(_sx(value))) for value in values]


def _sx(value: ca.SX | float) -> ca.SX:
    # a conversion of a matrix that is SX already costs as much as any other
    return value if isinstance(value, ca.SX) else ca.SX(value)


def _check(name: str, state: Vectors, after: Vectors, collected: Vectors, until: int | None) -> None:
    before, behind = [part.numel() for part in state], [part.numel() for part in after]
    if before != behind:
        raise InputError(f"changes the sizes of its state from {before} to {behind}", key=name)
    if until is not None and (before[until] != 1 or collected):
        raise InputError("ends at a flag: the flag must be one number, and no tables can be stacked", key=name)
