"""Writer of one instruction list as a C99 function that processes all parallel runs, with the macros of `c99_words`."""

from __future__ import annotations

from collections.abc import Sequence

from surctl.ir.c99 import c_literal
from surctl.ir.moves import Move, handed_on, remaining
from surctl.ir.program import Instruction, Program
from surctl.ir.routine import Block

__all__ = ["head", "program_text"]

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


def head(block: Block, symbol: str, outputs: int, operations: int) -> list[str]:
    """Return the signature of a C function, and its opening brace."""
    arguments = [f"const double *in{k}" for k in range(len(block.inputs))]
    arguments += [f"double *out{k}" for k in range(outputs)]
    apart = "APART " if operations > _INLINE else ""
    return [f"{apart}static void {symbol}({', '.join([*arguments, 'double *work'])})", "{"]


def program_text(
    program: Program, symbol: str, strides: tuple[int, ...] = (), *, overlapping: bool = True
) -> tuple[str, int]:
    """Return the C text of the function, and the size of the memory that the function needs, in numbers for each run.

    Pieces of inputs that the program only copies are copied as a whole. If an output may be the same array as an input
    (`overlapping`), these pieces are copied through `work`, because the function must read them before it writes.

    Args:
        program: the instruction list.
        symbol: name of the function.
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
        *head(program, symbol, len(program.outputs), program.operations),
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
