"""Writer of an instruction list as short, readable C99, also for SIMD lanes.

A value that is used once is written as an expression at its use, truth values are `int`, and one declaration covers
several local variables. The C text performs the operations of the instruction list, with equal results, if the
compiler evaluates double in double precision (FLT_EVAL_METHOD 0). A C99 pragma prevents the compiler from fusing
products and sums; GCC does not support this pragma and needs the flag `-ffp-contract=off`.

A SIMD lane (one entry of the vectors) computes one run. Every lane performs the operations of the C text for a single
run in the same order, so both forms of the text give results with equal bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

from surctl.ir.c99 import C_TYPE, WIDTH, Move, Real, broken, c_literal, identifier, move_lines, remaining, signature
from surctl.ir.program import LEAVES, Instruction, Program
from surctl.ir.routine import Feed

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


def emit_program(
    program: Program, *, symbol: str, real: Real = "float64", moves: Sequence[Move] = (), apart: bool = False
) -> str:
    """Return a C function `static void <symbol>(const double *in0, …, double *out0, …)`, to be preceded by `preamble`.

    Args:
        program: the instruction list, without instructions whose value is not used (`lower` removes them).
        symbol: name of the C function, checked by `identifier`.
        real: "float32" writes float instead of double, with literals and functions of type float.
        moves: pieces of inputs to copy as a whole, see `handed_on`; allowed only with `apart`.
        apart: whether no output overlaps an input. Otherwise the function computes all outputs before it stores any of
            them, so an output may be the same array as an input.

    Raises:
        InputError: `symbol` is not a valid C identifier.
    """
    inputs, outputs = ([size for _, size in arrays] for arrays in (program.inputs, program.outputs))
    lines = [f"/* {program.operations} operations{'' if apart else '; outputs may alias inputs'} */"]
    lines += [*signature(f"static void {identifier(symbol)}", inputs, outputs, C_TYPE[real]), "{"]
    instructions, stores = remaining(program, moves)
    read = {i.args[0] for i in instructions if i.op == "input"} | {m.input for m in moves}
    lines += [f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read]
    lines += [f"    (void)out{k};" for k, refs in enumerate(program.output_refs) if not refs]
    lines += program_lines(
        instructions,
        [(f"out{k}[{entry}]", ref) for k, entry, ref in stores],
        address=lambda which, entry: f"in{which}[{entry}]",
        real=real,
        apart=apart,
    )
    return "\n".join([*lines, *move_lines(moves), "}"]) + "\n"


def program_lines(
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


def emit_lanes(program: Program, *, symbol: str, lanes: int, feeds: tuple[Feed, ...], real: Real = "float64") -> str:
    """Return a C function like that of `emit_program`, but for `lanes` runs, with a loop over the lanes.

    An output contains the numbers of all lanes (runs) for entry 0, then for entry 1, and so on. An output may be the
    same array as an input of kind "lanes".
    """
    kind = C_TYPE[real]
    arguments = [f"const {kind} *in{k}" for k in range(len(program.inputs))]
    arguments += [f"{kind} *out{k}" for k in range(len(program.outputs))]
    read = {i.args[0] for i in program.instructions if i.op == "input"}
    outputs = enumerate(program.output_refs)
    stores = [(f"out{k}[{entry * lanes} + lane]", ref) for k, refs in outputs for entry, ref in enumerate(refs)]

    def address(which: int, entry: int) -> str:
        places = {"shared": f"{entry}", "spread": f"{program.inputs[which][1]} * lane + {entry}"}
        return f"in{which}[{places.get(feeds[which], f'{entry * lanes} + lane')}]"

    lines = [
        f"/* {program.operations} operations in each of {lanes} lanes; outputs may alias inputs that are not shared */",
        f"static void {identifier(symbol)}({', '.join(arguments)})",
        "{",
        *(f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read),
        f"    for (int lane = 0; lane < {lanes}; ++lane) {{",
        *program_lines(program.instructions, stores, address=address, real=real, indent="        "),
        "    }",
        "}",
    ]
    return "\n".join(lines) + "\n"
