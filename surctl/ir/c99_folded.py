"""Writer of an instruction list as short, readable C99; also for SIMD lanes, and without branches.

A value that is used once is written as an expression at its use, truth values are `int`, and one declaration covers
several local variables. The C text performs the same operations as that of `emit_c99`, with equal results, if the
compiler evaluates double in double precision (FLT_EVAL_METHOD 0). A C99 pragma prevents the compiler from fusing
products and sums; GCC does not support this pragma and needs the flag `-ffp-contract=off`.

A SIMD lane (one entry of the vectors) computes one run. Every lane performs the operations of the C text for a single
run in the same order, so all forms of the text give results with equal bytes. Truth values are bit masks until a number
is needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

from surctl.ir.c99 import (
    C_TYPE,
    WIDTH,
    Move,
    Real,
    broken,
    c_literal,
    emit_c99,
    expression,
    head,
    identifier,
    move_lines,
    remaining,
)
from surctl.ir.program import LEAVES, Instruction, Program

_COMPARE = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_LOGIC = {"and": "&&", "or": "||"}
_BINARY = {"add": ("+", 6), "sub": ("-", 6), "mul": ("*", 7), "div": ("/", 7)}
_HELPERS = {
    "fmin": "({0} a, {0} b) {{ return (b < a) ? b : a; }}",
    "fmax": "({0} a, {0} b) {{ return (a < b) ? b : a; }}",
    "sq": "({0} a) {{ return a * a; }}",
}
# Used on processors without a floor instruction, whose library function is long. The bytes equal those of floor, also
# for the sign of a zero. Comparisons guard the cast against values that no int has; Frama-C can follow them.
_FLOOR = """#if defined(__GNUC__)
__attribute__((noinline)) /* inlined, it is repeated at every use */
#endif
static float floor_of(float a)
{
    float whole;
    if (!(a == a) || (a <= -8388608.0f) || (8388608.0f <= a)) { return a; } /* NaN, or no fraction */
    whole = (float)(int)a;
    return (whole == a) ? a : ((whole > a) ? whole - 1.0f : whole);
}"""
PRAGMA = "#if !defined(__GNUC__) || defined(__clang__)\n#pragma STDC FP_CONTRACT OFF\n#endif"
_CALLS = {
    "float64": {"fmin": "min_of", "fmax": "max_of", "sq": "square_of"},
    "float32": {"fmin": "float_min_of", "fmax": "float_max_of", "sq": "float_square_of"},
}

_ATOM, _SIGNED, _TEST, _CHOICE = 9, 8, 5, 2
_OPERAND = 6  # from this rank on, an operand of a comparison, a choice or a logical operation needs no parentheses
_LONGEST = 120  # largest number of characters of an expression that is inlined
_SHORT = 8  # up to this many characters, an expression is inlined at more than one use
_LONG_LITERAL = 12  # a constant with more characters that is used twice gets a name


@dataclass(frozen=True, slots=True)
class _Text:
    text: str
    rank: int = _ATOM  # precedence
    truth: bool = False  # whether the expression has type int and value 0 or 1


def preamble(programs: Iterable[Program], real: Real = "float64") -> str:
    """Return the C text that must precede these programs: the pragma and the small functions that they call."""
    programs = tuple(programs)
    return "".join(f"{text}\n" for text in (PRAGMA, *inline_helpers(programs, real), *own_helpers(programs, real)))


def inline_helpers(programs: Iterable[Program], real: Real = "float64") -> list[str]:
    """Return the C text of each small inline function that these programs call.

    Files of several controllers that form one compilation unit share these functions: a macro marks each.
    """
    used = _operations(programs)
    kind = C_TYPE[real]
    called = [(_CALLS[real][op], text.format(kind)) for op, text in _HELPERS.items() if op in used]
    return [
        f"#ifndef SURCTL_{name.upper()}\n#define SURCTL_{name.upper()}\nstatic inline {kind} {name}{text}\n#endif"
        for name, text in called
    ]


def own_helpers(programs: Iterable[Program], real: Real = "float64") -> list[str]:
    """Return the C text of each small function that every file with these programs defines for itself."""
    return [_FLOOR] if real == "float32" and "floor" in _operations(programs) else []


def _operations(programs: Iterable[Program]) -> set[str]:
    return {i.op for program in programs for i in program.instructions}


def emit_folded(
    program: Program, *, symbol: str, real: Real = "float64", moves: Sequence[Move] = (), apart: bool = False
) -> str:
    """Return a C function `static void <symbol>(const double *in0, …, double *out0, …)`, to be preceded by `preamble`.

    `moves` (see `handed_on`) are allowed only with `apart`, which says that no output overlaps an input.
    """
    lines = [*head(program, identifier(symbol), C_TYPE[real], apart=apart), "{"]
    instructions, stores = remaining(program, moves)
    read = {i.args[0] for i in instructions if i.op == "input"} | {m.input for m in moves}
    lines += [f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read]
    lines += [f"    (void)out{k};" for k, refs in enumerate(program.output_refs) if not refs]
    lines += folded_lines(
        instructions,
        [(f"out{k}[{entry}]", ref) for k, entry, ref in stores],
        address=lambda which, entry: f"in{which}[{entry}]",
        real=real,
        apart=apart,
    )
    return "\n".join([*lines, *move_lines(moves), "}"]) + "\n"


def folded_lines(
    instructions: Sequence[Instruction],
    stores: Sequence[tuple[str, int]],
    *,
    address: Callable[[int, int], str],
    real: Real,
    apart: bool = False,
    indent: str = "    ",
) -> list[str]:
    """Return the C lines of an instruction list: declarations of local variables, then assignments to outputs.

    Args:
        stores: the assignments to outputs, in order: (C text of the left-hand side, list position of the value).
        address: function of (index of the input, index of the entry) that returns the C text of the entry.
        apart: whether an assignment to an output may read inputs, because none of the assignments overwrites an input.
    """
    folder = _Folder(instructions, stores, address, real, apart)
    folder.fold()
    lines = _declarations(folder.locals, C_TYPE[real], indent)
    return [*lines, *_statements([f"{to} = {folder.number(ref).text};" for to, ref in stores], indent)]


def _declarations(named: Sequence[tuple[bool, str]], kind: str, indent: str) -> list[str]:
    # successive variables of one type share a declaration
    lines: list[str] = []
    for truth, group in groupby(named, key=itemgetter(0)):
        start = f"{indent}const {'int' if truth else kind} "
        lines += broken(start, [text for _, text in group], ";", indent=f"{indent}    ")
    return lines


def _statements(each: Sequence[str], indent: str) -> list[str]:
    lines: list[str] = []
    for text in each:
        if lines and len(lines[-1]) + 1 + len(text) <= WIDTH:
            lines[-1] += f" {text}"
        else:
            lines.append(f"{indent}{text}")
    return lines


class _Folder:
    """Builds the C text of every instruction, and declares local variables for values that are not inlined."""

    def __init__(
        self,
        instructions: Sequence[Instruction],
        stores: Sequence[tuple[str, int]],
        address: Callable[[int, int], str],
        real: Real,
        apart: bool,
    ) -> None:
        self.instructions, self.address, self.real = instructions, address, real
        stored = [ref for _, ref in stores]
        self.uses = Counter(stored)
        self.uses.update(arg for i in instructions if i.op not in LEAVES for arg in i.args)
        # all values are computed before the first store, which may hold the expression of its own value
        self.named = set() if apart else {ref for ref in stored if ref != stored[0] or self.uses[ref] > 1}
        self.texts: list[_Text] = []
        self.locals: list[tuple[bool, str]] = []  # (whether a truth value, "name = expression")

    def fold(self) -> None:
        for at, instruction in enumerate(self.instructions):
            text = self._expression(instruction)
            if not self._stays(at, instruction, text):
                name = f"{'t' if text.truth else 'v'}{len(self.locals)}"
                self.locals.append((text.truth, f"{name} = {text.text}"))
                text = _Text(name, truth=text.truth)
            self.texts.append(text)

    def _stays(self, at: int, instruction: Instruction, text: _Text) -> bool:
        """Return whether the expression is written where it is used, without a local variable."""
        if instruction.op == "const":
            return self.uses[at] < 2 or len(text.text) <= _LONG_LITERAL
        if at in self.named:
            return False
        if instruction.op == "input":
            return True
        if instruction.op == "neg" and len(text.text) <= _SHORT:
            return True
        if text.truth and len(text.text) <= 2 * _SHORT:
            return self.uses[at] <= 2
        return self.uses[at] == 1 and len(text.text) <= _LONGEST

    def number(self, at: int) -> _Text:
        text = self.texts[at]
        if not text.truth:
            return text
        one, none = c_literal(1.0, self.real), c_literal(0.0, self.real)
        return _Text(f"{_within(text, _OPERAND)} ? {one} : {none}", _CHOICE)

    def _truth(self, at: int) -> _Text:
        text, instruction = self.texts[at], self.instructions[at]
        if text.truth:
            return text
        if instruction.op == "const":
            return _Text(str(int(instruction.value != 0.0)), truth=True)
        return _Text(f"{_within(text, _OPERAND)} != {c_literal(0.0, self.real)}", _TEST, truth=True)

    def _expression(self, instruction: Instruction) -> _Text:
        op, args = instruction.op, instruction.args
        if op == "const":
            literal = c_literal(instruction.number, self.real)
            return _Text(literal, _SIGNED if literal.startswith("-") else _ATOM)
        if op == "input":
            return _Text(self.address(*args))
        if op in _LOGIC:
            left, right = (_within(self._truth(a), _OPERAND) for a in args)
            return _Text(f"{left} {_LOGIC[op]} {right}", 3, truth=True)
        if op == "not":
            return _Text(f"!{_within(self._truth(args[0]), _ATOM)}", _SIGNED, truth=True)
        if op in ("select", "if_else_zero"):
            return self._choice(*args)
        return self._arithmetic(op, [self.number(a) for a in args])

    def _choice(self, condition: int, then: int, otherwise: int | None = None) -> _Text:
        one = self.number(then)
        other = _Text(c_literal(0.0, self.real)) if otherwise is None else self.number(otherwise)
        parts = (_within(part, _OPERAND) for part in (self._truth(condition), one, other))
        return _Text("{} ? {} : {}".format(*parts), _CHOICE)

    def _arithmetic(self, op: str, operands: list[_Text]) -> _Text:
        if op in _COMPARE:
            left, right = (_within(g, _OPERAND) for g in operands)
            return _Text(f"{left} {_COMPARE[op]} {right}", _TEST, truth=True)
        if op in _BINARY:
            sign, rank = _BINARY[op]
            text = f"{_within(operands[0], rank)} {sign} {_within(operands[1], rank + 1)}"
            return _Text(text, rank)
        if op in ("inv", "twice"):  # doubling a number is exact, also as part of a sum
            left = c_literal(1.0, self.real) + " /" if op == "inv" else c_literal(2.0, self.real) + " *"
            return _Text(f"{left} {_within(operands[0], _SIGNED)}", 7)
        if op == "neg":
            return _Text(f"-{_within(operands[0], _ATOM)}", _SIGNED)
        name = (
            "floor_of"
            if op == "floor" and self.real == "float32"
            else _CALLS[self.real].get(op) or (op if self.real == "float64" else f"{op}f")
        )
        return _Text(f"{name}({', '.join(g.text for g in operands)})")


def _within(text: _Text, least: int) -> str:
    return text.text if text.rank >= least else f"({text.text})"


_GUARD = "defined(__GNUC__) && (defined(__AVX__) || defined(__ARM_NEON) || defined(__VSX__))"
"""Preprocessor condition for the text with vector types; other machines have no vector instructions for these types."""

_WIDTH = {"float64": 8, "float32": 4}
_WHOLE = {"float64": "long long", "float32": "int"}
_UNSIGNED = {"float64": "0x7fffffffffffffffLL", "float32": "0x7fffffff"}

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
    program: Program, *, symbol: str, lanes: int, feeds: tuple[Feed, ...], real: Real = "float64", folded: bool = False
) -> str:
    """Return a C function like that of `emit_c99`, but for `lanes` runs in parallel.

    An output contains the numbers of all lanes (runs) for entry 0, then for entry 1, and so on. An output may be the
    same array as an input of kind "lanes". With `folded`, the text is a loop over the lanes, without vectors.
    """
    kind = C_TYPE[real]
    arguments = [f"const {kind} *in{k}" for k in range(len(program.inputs))]
    arguments += [f"{kind} *out{k}" for k in range(len(program.outputs))]
    read = {i.args[0] for i in program.instructions if i.op == "input"}
    vectors = [] if folded else [f"#if {_GUARD}", *_vectors(program, lanes, feeds, real), "#else"]
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
    lines = [*plain[:body], *idle, f"#if {_GUARD}", *_vectors(program, 2, feeds, real, single=True), "#else", *rest]
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
