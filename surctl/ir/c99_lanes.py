"""Writer of an instruction list as C99 for several runs in parallel, with GNU vector types or a loop over the runs.

A SIMD lane (one entry of the vectors) computes one run. Every lane performs the operations of the C text for a single
run in the same order, so all forms of the text give results with equal bytes. Truth values are bit masks until a number
is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

from surctl.ir.c99 import C_TYPE, Real, c_literal, emit_c99, expression, identifier
from surctl.ir.c99_folded import folded_lines
from surctl.ir.program import Instruction, Program

__all__ = ["GUARD", "Feed", "chooses", "emit_lanes", "emit_straight"]

GUARD = "defined(__GNUC__) && (defined(__AVX__) || defined(__ARM_NEON) || defined(__VSX__))"
"""Preprocessor condition for the text with vector types; other machines have no vector instructions for these types."""

_WIDTH = {"float64": 8, "float32": 4}
_WHOLE = {"float64": "long long", "float32": "int"}
_UNSIGNED = {"float64": "0x7fffffffffffffffLL", "float32": "0x7fffffff"}
_COMPARE = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_PLAIN = {
    "add": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "inv": "one / {0}",
    "sq": "{0} * {0}",
    "twice": "{0} + {0}",
}


@dataclass(frozen=True)
class Feed:
    """The memory layout in which the SIMD lanes (one for each run) read one input of the program.

    Attributes:
        kind: "lanes": the numbers of all lanes for entry 0, then for entry 1, …; "spread": all entries of lane 0, then
            of lane 1, …; "shared": one number for each entry, which all lanes use.
    """

    kind: str = "lanes"


def emit_lanes(
    program: Program,
    *,
    symbol: str,
    lanes: int,
    feeds: tuple[Feed, ...],
    real: Real = "float64",
    folded: bool = False,
) -> str:
    """Return a C function like that of `emit_c99`, but for `lanes` runs in parallel.

    An output contains the numbers of all lanes (runs) for entry 0, then for entry 1, and so on. An output may be the
    same array as an input of kind "lanes".

    Args:
        program: the instruction list.
        symbol: name of the C function.
        lanes: number of runs in parallel, a power of 2.
        feeds: memory layout of each input.
        real: type of the numbers.
        folded: whether to write a loop over the lanes in the style of `c99_folded`, instead of vectors.

    Raises:
        InputError: `symbol` is not a valid C identifier.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Feed, emit_lanes, lower
        >>> speed, drag = ca.SX.sym("speed"), ca.SX.sym("drag")
        >>> program = lower(ca.Function("coast", [speed, drag], [speed - drag * speed]))
        >>> print(emit_lanes(program, symbol="coast", lanes=4, feeds=(Feed(), Feed("shared")), folded=True), end="")
        /* 2 operations in each of 4 lanes; outputs may alias inputs that are not shared */
        static void coast(const double *in0, const double *in1, double *out0)
        {
            for (int lane = 0; lane < 4; ++lane) {
                out0[0 + lane] = in0[0 + lane] - in0[0 + lane] * in1[0];
            }
        }
    """
    kind = C_TYPE[real]
    arguments = [f"const {kind} *in{k}" for k in range(len(program.inputs))]
    arguments += [f"{kind} *out{k}" for k in range(len(program.outputs))]
    read = {i.args[0] for i in program.instructions if i.op == "input"}
    vectors = [] if folded else [f"#if {GUARD}", *_vectors(program, lanes, feeds, real), "#else"]
    lines = [
        f"/* {program.operations} operations in each of {lanes} lanes; outputs may alias inputs that are not shared */",
        f"static void {identifier(symbol)}({', '.join(arguments)})",
        "{",
        *(f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read),
        *vectors,
        *(_folded_loop(program, lanes, feeds, real) if folded else _loop(program, lanes, feeds, real)),
        *(["#endif"] if vectors else []),
        "}",
    ]
    return "\n".join(lines) + "\n"


_CHOICES = frozenset({"select", "if_else_zero", "fmin", "fmax", "and", "or"})


def chooses(program: Program) -> bool:
    """Return whether a compiler might translate an operation of the program to a branch."""
    return any(i.op in _CHOICES for i in program.instructions)


def emit_straight(program: Program, *, symbol: str, real: Real = "float64") -> str:
    """Return the function of `emit_c99`, computed twice in parallel so that choices are bit masks instead of branches.

    Branches would be slow: the processor mispredicts half of those that depend on the iterations of an active-set
    method, and each misprediction costs as much as twenty operations.
    """
    plain = emit_c99(program, symbol=symbol, real=real).splitlines()
    body = plain.index("{") + 1
    feeds = (Feed("shared"),) * len(program.inputs)
    idle = [line for line in plain[body:-1] if line.startswith("    (void)")]
    rest = [line for line in plain[body:-1] if not line.startswith("    (void)")]
    lines = [*plain[:body], *idle, f"#if {GUARD}", *_vectors(program, 2, feeds, real, single=True), "#else", *rest]
    return "\n".join([*lines, "#endif", "}"]) + "\n"


def _address(program: Program, lanes: int, feed: Feed, which: int, entry: int, lane: str) -> str:
    if feed.kind == "shared":
        return f"in{which}[{entry}]"
    if feed.kind == "spread":
        return f"in{which}[{program.inputs[which][1]} * {lane} + {entry}]"
    return f"in{which}[{entry * lanes} + {lane}]"


def _loop(program: Program, lanes: int, feeds: tuple[Feed, ...], real: Real) -> list[str]:
    lines = [f"    for (int lane = 0; lane < {lanes}; ++lane) {{"]
    for at, instruction in enumerate(program.instructions):
        if instruction.op == "input":
            which, entry = instruction.args
            right = _address(program, lanes, feeds[which], which, entry, "lane")
        else:
            right = expression(instruction, real)
        lines.append(f"        const {C_TYPE[real]} v{at} = {right};")
    for k, refs in enumerate(program.output_refs):
        lines += [f"        out{k}[{entry * lanes} + lane] = v{ref};" for entry, ref in enumerate(refs)]
    return [*lines, "    }"]


def _folded_loop(program: Program, lanes: int, feeds: tuple[Feed, ...], real: Real) -> list[str]:
    lines = folded_lines(
        program.instructions,
        [
            (f"out{k}[{entry * lanes} + lane]", ref)
            for k, refs in enumerate(program.output_refs)
            for entry, ref in enumerate(refs)
        ],
        address=lambda which, entry: _address(program, lanes, feeds[which], which, entry, "lane"),
        real=real,
        indent="        ",
    )
    return [f"    for (int lane = 0; lane < {lanes}; ++lane) {{", *lines, "    }"]


def _vectors(program: Program, lanes: int, feeds: tuple[Feed, ...], real: Real, *, single: bool = False) -> list[str]:
    # with `single` only the first vector entry is stored
    kind, size = C_TYPE[real], lanes * _WIDTH[real]
    ones = ", ".join([c_literal(1.0, real)] * lanes)
    lines = [
        f"    typedef {kind} vec __attribute__((vector_size({size})));",
        f"    const vec one = {{{ones}}};",
        "    (void)one;",
    ]
    head, lines = lines, []
    masks: set[int] = set()
    for at, instruction in enumerate(program.instructions):
        if instruction.op == "input":
            which, entry = instruction.args
            lines += _read(program, lanes, feeds[which], (which, entry, at))
        elif instruction.op == "const":
            numbers = ", ".join([c_literal(instruction.number, real)] * lanes)
            lines.append(f"    const vec v{at} = {{{numbers}}};")
        else:
            lines += _assignment(instruction, at, masks, lanes, real)
    for k, refs in enumerate(program.output_refs):
        for e, ref in enumerate(refs):
            to, lane = (f"out{k}[{e}]", "[0]") if single else (f"*(loose *)(out{k} + {e * lanes})", "")
            value = f"({_number(ref, masks)})" if single else _number(ref, masks)
            lines.append(f"    {to} = {value}{lane};")
    if any("loose" in line for line in lines):
        loose = f"vector_size({size}), aligned({_WIDTH[real]}), may_alias"
        head.append(f"    typedef {kind} loose __attribute__(({loose}));")
    if any("mask" in line for line in lines):
        head.append(f"    typedef {_WHOLE[real]} mask __attribute__((vector_size({size})));")
    return [*head, *lines]


def _read(program: Program, lanes: int, feed: Feed, what: tuple[int, int, int]) -> list[str]:
    which, entry, at = what
    if feed.kind == "lanes":
        return [f"    const vec v{at} = *(const loose *)(in{which} + {entry * lanes});"]
    numbers = ", ".join(_address(program, lanes, feed, which, entry, str(lane)) for lane in range(lanes))
    return [f"    const vec v{at} = {{{numbers}}};"]


def _number(at: int, masks: set[int]) -> str:
    return f"(vec)(v{at} & (mask)one)" if at in masks else f"v{at}"


def _truth(at: int, masks: set[int]) -> str:
    return f"v{at}" if at in masks else f"(mask)(v{at} != (one - one))"


def _assignment(instruction: Instruction, at: int, masks: set[int], lanes: int, real: Real) -> list[str]:
    op, args = instruction.op, instruction.args
    numbers = [_number(a, masks) for a in args]
    if op in _COMPARE:
        masks.add(at)
        return [f"    const mask v{at} = (mask)({numbers[0]} {_COMPARE[op]} {numbers[1]});"]
    if op in ("and", "or", "not"):
        truths = [_truth(a, masks) for a in args]
        masks.add(at)
        text = f"~({truths[0]})" if op == "not" else f"({truths[0]}) {'&' if op == 'and' else '|'} ({truths[1]})"
        return [f"    const mask v{at} = {text};"]
    if op in _PLAIN:
        text = _PLAIN[op].format(*numbers)
    elif op == "fabs":
        text = f"(vec)((mask){numbers[0]} & {_UNSIGNED[real]})"
    elif op in ("fmin", "fmax"):
        a, b = numbers
        text = _chosen(f"(mask)({b} < {a})" if op == "fmin" else f"(mask)({a} < {b})", b, a)
    elif op == "select":
        text = _chosen(_truth(args[0], masks), numbers[1], numbers[2])
    elif op == "if_else_zero":
        text = f"(vec)(({_truth(args[0], masks)}) & (mask){numbers[1]})"
    else:
        return _lane_by_lane(instruction, at, masks, lanes, real)
    return [f"    const vec v{at} = {text};"]


def _chosen(condition: str, then: str, otherwise: str) -> str:
    return f"(vec)((({condition}) & (mask){then}) | (~({condition}) & (mask){otherwise}))"


def _lane_by_lane(instruction: Instruction, at: int, masks: set[int], lanes: int, real: Real) -> list[str]:
    # for an operation that has no vector form in C
    text = expression(instruction, real, operand="w{}[lane]")
    copies = [f"const vec w{a} = {_number(a, masks)};" for a in sorted(set(instruction.args))]
    return [
        f"    vec v{at} = one;",
        f"    {{ {' '.join(copies)} for (int lane = 0; lane < {lanes}; ++lane) {{ v{at}[lane] = {text}; }} }}",
    ]
