"""Writer of C99 for `LANES` runs in parallel: every number becomes a vector with one entry for each run.

The C text is the same for every vector width. A prelude defines the macros of the text (LOAD, ADD, SELECT, …) for the
vector types of the compiler, or for one number at a time. Entry e of run l in an array has index e · LANES + l.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from surctl.ir.c99 import Move, c_literal, handed_on, identifier, remaining
from surctl.ir.c99_procedure import emit_procedure
from surctl.ir.c99_routine import free_name, run_alone
from surctl.ir.folding import shortened
from surctl.ir.places import carried_in_place, reads
from surctl.ir.procedure import Procedure
from surctl.ir.program import Instruction, Program
from surctl.ir.routine import Block, Call, Gather, Loop, Routine, Step, nested

_INLINE = 300  # largest number of operations of a function that may be inlined

# kinds of the operands and of the result: v is a number, m a truth value
_KINDS = {
    **dict.fromkeys(("lt", "le", "eq", "ne"), "vvm"),
    **dict.fromkeys(("and", "or"), "mmm"),
    "not": "mm",
    "select": "mvvv",
    "if_else_zero": "mvv",
}
_WORDS = {"if_else_zero": "ONLY_IF"}  # the names of all other macros are those of the operations
_IN_PLACE = {  # operations that some dialects compute number by number
    "fma": "FUSED({0}, {1}, {2})",
    "sqrt": "ROOT({0})",
    "floor": "ROUND_DOWN({0})",
    "atan2": "LIBRARY_2(atan2, {0}, {1})",
    **{name: f"LIBRARY({name}, {{0}})" for name in ("sin", "cos", "acos")},
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
    kinds = _KINDS.get(op, "v" * (len(args) + 1))
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
    writer = _Writer(identifier(symbol))
    short = shortened(block)
    alone = run_alone(short)
    writer.see(short)
    for inner in nested(short).values():
        if isinstance(inner, Routine):
            for step in inner.steps:
                if isinstance(step, Loop) and step.lanes > 1 and isinstance(step.block, Program):
                    writer.program(step.block, _strides(step))
            writer.routine(inner, last=inner is short)
        elif isinstance(inner, Procedure):
            writer.procedure(inner, last=inner is short)
        elif inner is short or inner.digest() in alone:
            writer.program(inner, (), last=inner is short)
    return Wide("\n".join(writer.chunks), writer.work[short.digest()])


def _strides(loop: Loop) -> tuple[int, ...]:
    """Return the distance between entries in each input, then each output, of a body that runs in inner SIMD lanes."""
    own = loop.index + len(loop.carried) + len(loop.sliced)
    side = (loop.lanes,) * own
    return (
        (1,) * loop.index
        + side[loop.index :]
        + (1,) * (len(loop.spread) + len(loop.fixed))
        + (loop.lanes,) * len(loop.results)
    )


class _Writer:
    """Collects the C functions written so far, their names by digest, and the memory that they need."""

    def __init__(self, symbol: str) -> None:
        self.symbol = symbol
        self.named: dict[str, str] = {}
        self.work: dict[str, int] = {}
        self.chunks: list[str] = []
        self.overlapping: set[str] = set()

    def see(self, block: Block) -> None:
        """Record the programs that are called with one array as both an input and an output."""
        self.overlapping.add(_key(block, ()))
        for inner in nested(block).values():
            if isinstance(inner, Routine):
                local = _Text(inner, self).local
                blocks = [s.block for s in inner.steps if not isinstance(s, Gather) and _overlaps(s, local)]
                self.overlapping |= {_key(block, ()) for block in blocks}

    def name(self, block: Block, strides: tuple[int, ...] = ()) -> str:
        return self.named[_key(block, strides)]

    def program(self, program: Program, strides: tuple[int, ...], *, last: bool = False) -> None:
        name = self._new(program, strides, last)
        if name:
            key = _key(program, strides)
            text, self.work[key] = _program_text(program, name, strides, overlapping=key in self.overlapping)
            self.chunks.append(text)

    def procedure(self, procedure: Procedure, *, last: bool) -> None:
        """Write the procedure for one run, and a function that calls it for one lane after another."""
        name = self._new(procedure, (), last)
        if not name:
            return
        one = f"{name}_one"
        self.chunks.append(emit_procedure(procedure, symbol=one, vectors=True))
        sizes = [size for _, size in (*procedure.inputs, *procedure.outputs)]
        split, starts = len(procedure.inputs), [sum(sizes[:k]) for k in range(len(sizes))]
        lines = [*_head(procedure, name, len(procedure.outputs))]
        lines.append("    for (int lane = 0; lane < LANES; ++lane) {")
        for k, (size, start) in enumerate(zip(sizes[:split], starts, strict=False)):
            lines.append(f"        for (int k = 0; k < {size}; ++k) {{ work[{start} + k] = in{k}[k * LANES + lane]; }}")
        lines.append(f"        {one}({', '.join(f'work + {start}' for start in starts)});")
        for k, (size, start) in enumerate(zip(sizes[split:], starts[split:], strict=True)):
            # every lane has read its inputs from memory of its own, so an output may be an input
            lines.append(
                f"        for (int k = 0; k < {size}; ++k) {{ out{k}[k * LANES + lane] = work[{start} + k]; }}"
            )
        self.chunks.append("\n".join([*lines, "    }", "}"]) + "\n")
        self.work[_key(procedure, ())] = sum(sizes)

    def routine(self, routine: Routine, *, last: bool) -> None:
        name = self._new(routine, (), last)
        if name:
            text, own = _Text(routine, self).function(name)
            inner = [self.work[_key(s.block, _lane_strides(s))] for s in routine.steps if not isinstance(s, Gather)]
            self.chunks.append(text)
            self.work[_key(routine, ())] = own + max(inner, default=0)

    def _new(self, block: Block, strides: tuple[int, ...], last: bool) -> str:
        key = _key(block, strides)
        if key in self.named:
            return ""
        base = f"{self.symbol}_{block.name}" + ("_side" if strides else "")
        self.named[key] = self.symbol if last else free_name(base, self.named)
        return self.named[key]


def _key(block: Block, strides: tuple[int, ...]) -> str:
    return block.digest() + ("" if not strides else f" {strides}")


def _overlaps(step: Step, local: Mapping[str, str]) -> bool:
    """Return whether an output array of the step may also be an input array of the step."""
    # outer inputs may alias outer outputs; loops update arrays in place
    if not isinstance(step, Call):
        return isinstance(step, Loop)
    inputs, outputs = {local[name] for name in step.args}, {local[name] for name in step.results}
    return bool(inputs & outputs) or (
        any(n.startswith("in") for n in inputs) and any(n.startswith("out") for n in outputs)
    )


def _lane_strides(step: Call | Loop) -> tuple[int, ...]:
    return _strides(step) if isinstance(step, Loop) and step.lanes > 1 else ()


class _Text:
    """Translates one routine to C."""

    def __init__(self, routine: Routine, writer: _Writer) -> None:
        self.routine, self.writer = routine, writer
        self.sizes = routine.sizes()
        self.own = 0
        self.lines: list[str] = []
        # local arrays are numbered, so that no unchecked external name enters the C text
        self.local = {name: f"in{k}" for k, (name, _) in enumerate(routine.inputs)}
        self.local |= {name: f"a{k}" for k, name in enumerate(self.sizes) if name not in self.local}
        in_place = carried_in_place(routine)
        self.local |= {result: self.local[name] for result, name in in_place.items()}
        direct = _direct(routine)
        self.local |= {name: f"out{k}" for name, k in direct.items()}
        for name in list(self.sizes)[len(routine.inputs) :]:
            if name not in in_place and name not in direct:
                self._array(self.local[name], self.sizes[name])

    def function(self, symbol: str) -> tuple[str, int]:
        """Return the C text of the function, and the size of the function's own arrays in numbers for each run."""
        routine, local = self.routine, self.local
        read = {name for step in routine.steps for name in reads(step)} | set(routine.results)
        idle = [f"    (void){name};" for name in dict.fromkeys(local[x] for x in local if x not in read)]
        body: list[str] = []
        for at, step in enumerate(routine.steps):
            body += self._step(step, at)
        for k, name in enumerate(routine.results):
            if local[name] != f"out{k}":
                body.append(f"    copy(out{k}, {local[name]}, {self.sizes[name]});")
        meaning = ", ".join(f"{local[name]}: {identifier(name)} {size}" for name, size in self.sizes.items())
        top = _head(routine, symbol, len(routine.results))
        rest = [f"    double *const rest = work + {self.own} * LANES;", "    (void)rest;"]
        comment = f"/* {meaning}; outputs may alias inputs */"
        return "\n".join([comment, *top, *self.lines, *rest, *idle, *body, "}"]) + "\n", self.own

    def _array(self, name: str, size: int) -> None:
        self.lines.append(f"    double *const {name} = work + {self.own} * LANES;")
        self.own += size

    def _step(self, step: Step, at: int) -> list[str]:
        if isinstance(step, Gather):
            return self._gather(step)
        if isinstance(step, Call):
            return [f"    {self._call(step.block, [*step.args, *step.results])}"]
        return self._loop(step, at)

    def _call(self, block: Block, names: list[str]) -> str:
        return f"{self.writer.name(block)}({', '.join([*(self.local[n] for n in names), 'rest'])});"

    def _gather(self, step: Gather) -> list[str]:
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

    def _loop(self, loop: Loop, at: int) -> list[str]:
        state = len(loop.carried)
        results = [self.local[name] for name in loop.results]
        pairs = list(zip(loop.carried, results[:state], strict=False))
        lines = [
            f"    copy({to}, {self.local[name]}, {self.sizes[name]});" for name, to in pairs if to != self.local[name]
        ]
        head = f"    for (int i = 0; i < {loop.count}; ++i) {{"
        if loop.index:
            self._array(f"turn{at}", 1)
        if loop.lanes > 1:
            return [*lines, head, *self._side_by_side(loop, at), "    }"]
        parts = [self._piece(name, loop.count) for name in (*loop.sliced, *loop.spread)]
        stacked = [self._piece(name, loop.count) for name in loop.results[state:]]
        fixed = [self.local[name] for name in loop.fixed]
        arguments = [f"turn{at}"] * loop.index + results[:state] + parts + fixed
        function = self.writer.name(loop.block)
        body = [f"        fill(turn{at}, (double)i);"] * loop.index
        in_place = f"{function}({', '.join([*arguments, *results[:state], *stacked, 'rest'])});"
        if loop.until is None:
            return [*lines, head, *body, f"        {in_place}", "    }"]
        fresh = [f"fresh{at}_{k}" for k in range(state)]
        for name, array in zip(loop.carried, fresh, strict=True):
            self._array(array, self.sizes[name])
        flag = results[loop.until]
        # the flag is updated last, since it selects the runs that have not ended
        order = [k for k in range(state) if k != loop.until] + [loop.until]
        keep = [f"            keep({results[k]}, {fresh[k]}, {flag}, {self.sizes[loop.carried[k]]});" for k in order]
        return [
            *lines,
            head,
            f"        const unsigned run = running({flag});",
            "        if (run == 0U) { break; }",
            *body,
            f"        if (run == ALL_LANES) {{ {in_place} }}",
            "        else {",
            f"            {function}({', '.join([*arguments, *fresh, 'rest'])});",
            *keep,
            "        }",
            "    }",
        ]

    def _side_by_side(self, loop: Loop, at: int) -> list[str]:
        state, count = len(loop.carried), loop.count
        results = [f"{self.local[name]} + l * LANES" for name in loop.results[:state]]
        arguments = [f"turn{at}"] * loop.index + results
        arguments += [f"{self._piece(name, count)} + l * LANES" for name in loop.sliced]
        for name in loop.spread:
            size = self.sizes[name] // (count * loop.lanes)
            arguments.append(f"{self.local[name]} + ({loop.lanes} * i + l) * {size} * LANES")
        arguments += [self.local[name] for name in loop.fixed]
        stacked = [f"{self._piece(name, count)} + l * LANES" for name in loop.results[state:]]
        function = self.writer.name(loop.block, _strides(loop))
        return [
            f"        for (int l = 0; l < {loop.lanes}; ++l) {{",
            *[f"            fill(turn{at}, (double)({loop.lanes} * i + l));"] * loop.index,
            f"            {function}({', '.join([*arguments, *results, *stacked, 'rest'])});",
            "        }",
        ]

    def _piece(self, name: str, count: int) -> str:
        return f"{self.local[name]} + {self.sizes[name] // count} * i * LANES"


def _direct(routine: Routine) -> Mapping[str, int]:
    # a program reads all inputs before it writes, so a last step that is a program may write to the outputs
    last = routine.steps[-1] if routine.steps else None
    inputs = {name for name, _ in routine.inputs}
    if not isinstance(last, Call) or not isinstance(last.block, Program) or inputs & set(routine.results):
        return {}
    return {
        name: k for k, name in enumerate(routine.results) if name in last.results and routine.results.count(name) == 1
    }
