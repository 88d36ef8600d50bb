"""Writer of C99 for `LANES` runs in parallel: every number becomes a vector with one entry for each run.

The C text is the same for every vector width. A prelude defines the macros of the text (LOAD, ADD, SELECT, …) for the
vector types of the compiler, or for one number at a time. Entry e of run l in an array has index e · LANES + l.
"""

from __future__ import annotations

from collections.abc import Sequence

from surctl.ir.c99 import Move, c_literal, handed_on, identifier, remaining
from surctl.ir.c99_procedure import emit_procedure
from surctl.ir.c99_routine import RoutineText, Writer, feeds_of, function_key
from surctl.ir.folding import shortened
from surctl.ir.procedure import Procedure
from surctl.ir.program import LIBM, OPERATIONS, Instruction, Program
from surctl.ir.routine import Block, Gather, Loop, Routine

_INLINE = 300  # largest number of operations of a function that may be inlined

_WORDS = {"if_else_zero": "ONLY_IF"}  # the names of all other macros are those of the operations
_IN_PLACE = {  # operations that some dialects compute number by number
    "fma": "FUSED({0}, {1}, {2})",
    "sqrt": "ROOT({0})",
    "floor": "ROUND_DOWN({0})",
    "atan2": "LIBRARY_2(atan2, {0}, {1})",
    **{name: f"LIBRARY({name}, {{0}})" for name in LIBM - {"atan2"}},
}


def _large(block: Block) -> bool:
    """Return whether a function must not be inlined; a procedure counts as large, because its bound takes seconds."""
    steps = block.steps if isinstance(block, Routine) else ()
    inner = any(_large(step.block) for step in steps if not isinstance(step, Gather))
    return inner or isinstance(block, Procedure) or block.operations > _INLINE


def _head(block: Block, symbol: str, outputs: int) -> list[str]:
    """Return the signature of a C function, and its opening brace."""
    arguments = [f"const double *in{k}" for k in range(len(block.inputs))]
    arguments += [f"double *out{k}" for k in range(outputs)]
    apart = "APART " if _large(block) else ""
    return [f"{apart}static void {symbol}({', '.join([*arguments, 'double *work'])})", "{"]


def _program_text(
    program: Program, symbol: str, strides: tuple[int, ...] = (), *, overlapping: bool = True
) -> tuple[str, int]:
    """Return the C text of the function, and the size of the memory that the function needs, in numbers for each run.

    Pieces of inputs that the program only copies are copied as a whole. If an output may be the same array as an input
    (`overlapping`), these pieces are copied through `work`, because the function must read them before it writes.

    Args:
        strides: for a loop body that runs in inner SIMD lanes, the distance between two entries of each input, then of
            each output; nothing is then copied as a whole. If empty, all distances are 1.
        overlapping: whether the function is called with one array as both an input and an output.
    """
    moves = () if strides else handed_on(program)
    before, after, held = [], [], 0
    for m in moves:
        to, source = (f"out{m.output}", m.to), (f"in{m.input}", m.start)
        if overlapping:
            before.append(_copied(("work", held), source, m.count))
            after.append(_copied(to, ("work", held), m.count))
            held += m.count
        else:
            before.append(_copied(to, source, m.count))
    all_strides = strides or (1,) * (len(program.inputs) + len(program.outputs))
    return _text(program, symbol, all_strides, moves, before, after), held


def _copied(to: tuple[str, int], source: tuple[str, int], count: int) -> str:
    return f"    copy({to[0]} + {to[1]} * LANES, {source[0]} + {source[1]} * LANES, {count});"


def _text(
    program: Program,
    symbol: str,
    strides: tuple[int, ...],
    moves: Sequence[Move],
    before: Sequence[str],
    after: Sequence[str],
) -> str:
    # the lines `before` and `after` copy the pieces in `moves`
    instructions, stored = remaining(program, moves)
    read = {i.args[0] for i in instructions if i.op == "input"} | {m.input for m in moves}
    lines = [
        f"/* {program.operations} operations; outputs may alias inputs */",
        *_head(program, symbol, len(program.outputs)),
        "    (void)work;",
        *(f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read),
        *(f"    (void)out{k};" for k, entries in enumerate(program.output_refs) if not entries),
        *before,
    ]
    if stored:
        lines.append("    EACH_LANE {")
        truths: set[int] = set()
        for at, instruction in enumerate(instructions):
            lines.append("        " + _assignment(instruction, at, truths, strides))
        for k, e, ref in stored:
            lines.append(f"        STORE(out{k}, {e * strides[len(program.inputs) + k]}, {_number(ref, truths)});")
        lines.append("    }")
    return "\n".join([*lines, *after, "}"]) + "\n"


def _assignment(instruction: Instruction, at: int, truths: set[int], strides: tuple[int, ...]) -> str:
    op, args = instruction.op, instruction.args
    if op == "const":
        return f"const vec v{at} = SET({c_literal(instruction.number)});"
    if op == "input":
        return f"const vec v{at} = LOAD(in{args[0]}, {args[1] * strides[args[0]]});"
    kinds = OPERATIONS[op].kinds
    operands = [_truth(a, truths) if kind == "m" else _number(a, truths) for a, kind in zip(args, kinds, strict=False)]
    if op in _IN_PLACE:
        return f"vec v{at} = {operands[0]}; {_IN_PLACE[op].format(f'v{at}', *operands[1:])};"
    word = _WORDS.get(op, op.upper())
    if kinds[-1] == "m":
        truths.add(at)
    return f"const {'truth' if kinds[-1] == 'm' else 'vec'} v{at} = {word}({', '.join(operands)});"


def _number(at: int, truths: set[int]) -> str:
    return f"NUMBER(v{at})" if at in truths else f"v{at}"


def _truth(at: int, truths: set[int]) -> str:
    return f"v{at}" if at in truths else f"TRUTH(v{at})"


class Wide:
    """C text of a program or routine for many runs in parallel.

    Attributes:
        text: C functions, callees first; the last is `static void <symbol>(const double *in0, …, double *out0, …,
            double *work)`. Its outputs may be the same arrays as its inputs.
        work: required size of the argument `work`, in numbers for each run; the function stores its local arrays in
            `work` instead of on the stack.
    """

    def __init__(self, text: str, work: int) -> None:
        self.text, self.work = text, work


def emit_wide(block: Block, *, symbol: str) -> Wide:
    """Return C text of a program or routine and of all that it calls; blocks with equal text become one function."""
    writer, short = _Writer(identifier(symbol), "float64"), shortened(block)
    writer.write(short)
    return Wide("\n".join(writer.parts[""].functions), writer.work[short.digest()])


class _Writer(Writer):
    """Writes functions for `LANES` runs; `work` is the memory that each needs, by its key."""

    def write(self, block: Block) -> None:
        self.work: dict[str, int] = {}
        super().write(block)

    def function(self, block: Block, name: str, *, last: bool) -> str:
        key = block.digest()
        if isinstance(block, Program):
            overlapping = last or key in self.overlapping
            text, self.work[key] = _program_text(block, name, overlapping=overlapping)
            return text
        if isinstance(block, Routine):
            if last:  # the outputs may be the inputs
                sizes = [size for _, size in block.inputs]
                pairs = {(k, j) for k, (_, size) in enumerate(block.outputs) for j, n in enumerate(sizes) if n == size}
                self.overlapping = {**self.overlapping, key: self.overlapping.get(key, frozenset()) | pairs}
            routine = _RoutineText(block, name, self)
            text = routine.text()
            inner = [
                self.work[function_key(s)]
                for s in block.steps
                if not isinstance(s, Gather) and function_key(s) in self.work
            ]
            self.work[key] = routine.own + max(inner, default=0)
            return text
        sizes = [size for _, size in (*block.inputs, *block.outputs)]
        self.work[key] = sum(sizes)
        return _procedure_text(block, name, sizes)

    def lanes_function(self, loop: Loop, program: Program, name: str) -> str:
        text, self.work[function_key(loop)] = _program_text(program, name, _strides(loop))
        return text


def _procedure_text(procedure: Procedure, name: str, sizes: Sequence[int]) -> str:
    """Return the procedure for one run, and a function that calls it for one lane after another."""
    one, split, starts = f"{name}_one", len(procedure.inputs), [sum(sizes[:k]) for k in range(len(sizes))]
    lines = [*_head(procedure, name, len(procedure.outputs)), "    for (int lane = 0; lane < LANES; ++lane) {"]
    for k, (size, start) in enumerate(zip(sizes[:split], starts, strict=False)):
        lines.append(f"        for (int k = 0; k < {size}; ++k) {{ work[{start} + k] = in{k}[k * LANES + lane]; }}")
    lines.append(f"        {one}({', '.join(f'work + {start}' for start in starts)});")
    for k, (size, start) in enumerate(zip(sizes[split:], starts[split:], strict=True)):
        # every lane has read its inputs from memory of its own, so an output may be an input
        lines.append(f"        for (int k = 0; k < {size}; ++k) {{ out{k}[k * LANES + lane] = work[{start} + k]; }}")
    return "\n".join([emit_procedure(procedure, symbol=one, vectors=True), *lines, "    }", "}"]) + "\n"


def _strides(loop: Loop) -> tuple[int, ...]:
    """Return the distance between entries in each input, then each output, of a body that runs in inner SIMD lanes."""
    read = (loop.lanes if feed == "lanes" else 1 for feed in feeds_of(loop))
    return (*read, *(loop.lanes,) * len(loop.results))


class _RoutineText(RoutineText):
    """Translates one routine to C; its own arrays are in the argument `work`, of which it needs `own` numbers a run."""

    def __init__(self, routine: Routine, symbol: str, writer: Writer) -> None:
        super().__init__(routine, symbol, writer)
        starts, self.own = self.places.pool
        at = 0
        for name, size in self.places.own.items() if not starts else ():
            starts, at = {**starts, name: at}, at + size
        self.starts = dict(starts)

    def head(self) -> list[str]:
        lines = [*self.comment(), *_head(self.routine, self.symbol, len(self.routine.results))]
        lines += [f"    double *const {name} = work + {at} * LANES;" for name, at in self.starts.items()]
        rest = [f"    double *const rest = work + {self.own} * LANES;", "    (void)rest;"]
        return [*lines, *self.declared_pointers(), *rest]

    def _array(self, name: str, size: int) -> str:
        """Return the name of one more array in `work`."""
        self.starts[name] = self.own
        self.own += size
        return name

    def at(self, array: str, start: int) -> str:
        return f"{array} + {start} * LANES"

    def copy(self, to: tuple[str, int], source: tuple[str, int], size: int) -> str:
        return f"    copy({', '.join(self.at(*place) if place[1] else place[0] for place in (to, source))}, {size});"

    def call(self, start: str, function: str, arguments: list[str]) -> list[str]:
        return super().call(start, function, [*arguments, "rest"])

    def part(self, name: str, count: int) -> str:
        return f"{super().part(name, count)} * LANES"

    def gather(self, step: Gather) -> list[str]:
        index, source, result = (self.local[name] for name in (step.index, step.source, step.result))
        last = self.sizes[step.source] // step.width - 1
        first = f"{step.width} * at"
        if step.lanes > 1:
            first = f"{step.width * step.lanes} * (at / {step.lanes}) + at % {step.lanes}"
        return [
            "    for (int lane = 0; lane < LANES; ++lane) {",
            f"        const int at = piece({index}[lane], {c_literal(float(last))});",
            f"        const double *from = {source} + ({first}) * LANES + lane;",
            f"        for (int k = 0; k < {step.width}; ++k) {{",
            f"            {result}[k * LANES + lane] = from[{step.lanes} * k * LANES];",
            "        }",
            "    }",
        ]

    def loop(self, loop: Loop, at: int) -> list[str]:
        count, lanes, state = loop.count, loop.lanes, [self.local[name] for name in loop.results[: len(loop.carried)]]
        side = " + l * LANES" if lanes > 1 else ""
        turn = [self._array(f"turn{at}", 1)] if loop.index else []
        pieces = [f"{self.part(name, count)}{side}" for name in loop.sliced]
        pieces += [self._spread(name, loop) for name in loop.spread]
        arguments = [*turn, *(f"{name}{side}" for name in state), *pieces, *(self.local[name] for name in loop.fixed)]
        stacked = [f"{self.part(name, count)}{side}" for name in loop.results[len(state) :]]
        function = self.writer.named[function_key(loop)]
        body = [f"        fill({turn[0]}, (double)({f'{lanes} * i + l' if side else 'i'}));"] if turn else []
        body += self.call("        ", function, [*arguments, *(f"{name}{side}" for name in state), *stacked])
        if side:
            body = [f"        for (int l = 0; l < {lanes}; ++l) {{", *(f"    {line}" for line in body), "        }"]
        if loop.until is not None:
            body = self._masked(loop, at, body, arguments)
        return [*self.begun(loop, {}), f"    for (int i = 0; i < {count}; ++i) {{", *body, "    }"]

    def _spread(self, name: str, loop: Loop) -> str:
        if loop.lanes == 1:
            return self.part(name, loop.count)
        size = self.sizes[name] // (loop.count * loop.lanes)
        return f"{self.local[name]} + ({loop.lanes} * i + l) * {size} * LANES"

    def _masked(self, loop: Loop, at: int, whole: list[str], arguments: list[str]) -> list[str]:
        """Return the C lines of an iteration in which runs that have ended keep their state."""
        assert loop.until is not None
        # by place, not by name: several entries of the state may begin with the same array
        fresh = [self._array(f"fresh{at}_{k}", self.sizes[name]) for k, name in enumerate(loop.carried)]
        flag = self.local[loop.results[loop.until]]
        # the flag is updated last, since it selects the runs that have not ended
        order = [k for k in range(len(fresh)) if k != loop.until] + [loop.until]
        targets = [(self.local[loop.results[k]], fresh[k], self.sizes[loop.carried[k]]) for k in order]
        index = whole[: int(loop.index)]
        return [
            f"        const unsigned run = running({flag});",
            "        if (run == 0U) { break; }",
            *index,
            "        if (run == ALL_LANES) {",
            *(f"    {line}" for line in whole[len(index) :]),
            "        } else {",
            *self.call("            ", self.writer.named[function_key(loop)], [*arguments, *fresh]),
            *(f"            keep({to}, {new}, {flag}, {size});" for to, new, size in targets),
            "        }",
        ]
