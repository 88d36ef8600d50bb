"""C99 text of numbers, signatures and copies; names in C: reserved words and macros are refused."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from importlib.resources import files
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from surctl.errors import InputError
from surctl.ir.folding import Numbering
from surctl.ir.program import Instruction, Program, drop_dead


def _listed(file: str) -> str:
    return files("surctl.ir").joinpath(file).read_text(encoding="utf-8")


_WORDS = frozenset(_listed("words.txt").split())
"""Keywords of C99, C11 and C++ (headers are read by C++ too), and words that the standard headers define."""

_MACROS, _FAMILIES = frozenset(_listed("macros.txt").split()), re.compile(_listed("macro_families.txt"), re.VERBOSE)


def _is_macro(name: str) -> bool:
    """Return whether a header of the exported files, or a compiler, may define the name as a macro.

    The headers are those of C99, C11, C++17, POSIX and Arduino, with and without the extensions of GNU.
    """
    return name in _MACROS or _FAMILIES.fullmatch(name) is not None


_FEW = 8  # largest number of pieces of a program of moves that is written inline at its call
_LEAST = 8  # from this many entries on, one call that copies is shorter than one line for each entry
_LEAST_LOOP = 4  # from this many entries on, one loop that copies is shorter than one line for each entry


@dataclass(frozen=True)
class Move:
    """Copy of entries `start`, `start` + `step`, … of an input to entries `to`, `to` + `to_step`, … of an output."""

    output: int
    to: int
    input: int
    start: int
    count: int
    to_step: int = 1
    step: int = 1

    @property
    def entries(self) -> range:
        """Return the indices of the entries in the output."""
        return range(self.to, self.to + self.to_step * self.count, self.to_step)


def rearranged(name: str, inputs: Mapping[str, int], outputs: Mapping[str, Sequence[tuple[str, int, int]]]) -> Program:
    """Return a program that copies pieces of its inputs, faster to build than from a CasADi function.

    `inputs` are sizes; each output has pieces in order: name of the input, first entry, entry after the last.
    """
    code, which = Numbering(), {array: k for k, array in enumerate(inputs)}
    refs = [
        tuple([code.add("input", (which[array], entry)) for array, first, end in pieces for entry in range(first, end)])
        for pieces in outputs.values()
    ]
    sizes = tuple((output, len(entries)) for output, entries in zip(outputs, refs, strict=True))
    return Program(name, tuple(inputs.items()), sizes, tuple(code.instructions), tuple(refs))


def handed_on(program: Program, *, strided: bool = False) -> tuple[Move, ...]:
    """Return the moves of at least 8 entries, in output order; with `strided`, of at least 4 entries and any step."""
    return tuple(
        move
        for output in range(len(program.outputs))
        for move in (_strided(program, output) if strided else _of(program, output))
    )


def only_moves(program: Program) -> tuple[Move, ...]:
    """Return the moves, in output order, of a program that is only a few moves; return () for any other program."""
    if any(i.op != "input" for i in program.instructions) or not all(program.output_refs):
        return ()
    moves = tuple(move for output in range(len(program.outputs)) for move in _of(program, output, 1))
    return moves if len(moves) <= _FEW else ()


def _of(program: Program, output: int, least: int = _LEAST) -> Iterator[Move]:
    refs, at = program.output_refs[output], 0
    while at < len(refs):
        count = 1
        first = program.instructions[refs[at]]
        if first.op == "input":
            while at + count < len(refs):
                following = program.instructions[refs[at + count]]
                if following.op != "input" or following.args != (first.args[0], first.args[1] + count):
                    break
                count += 1
            if count >= least:
                yield Move(output, at, first.args[0], first.args[1], count)
        at += count


def _strided(program: Program, output: int) -> Iterator[Move]:
    """Yield the longest possible moves to an output, with step 1 in the input or in the output."""
    loads = {
        at: i.args
        for at, ref in enumerate(program.output_refs[output])
        if (i := program.instructions[ref]).op == "input"
    }
    where: dict[tuple[int, ...], list[int]] = {}
    for at, args in loads.items():
        where.setdefault(args, []).append(at)
    free = set(loads)
    for at in loads:
        if at not in free:
            continue
        which, start = loads[at]
        steps = {(1, loads[at + 1][1] - start)} if at + 1 in free and loads[at + 1][0] == which else set()
        steps |= {(other - at, 1) for other in where.get((which, start + 1), ()) if other > at and other in free}
        best = Move(output, at, which, start, 1)
        for to_step, step in sorted(steps):
            count = 1
            while at + to_step * count in free and loads[at + to_step * count] == (which, start + step * count):
                count += 1
            if count > best.count:
                best = Move(output, at, which, start, count, to_step, step)
        if best.count >= _LEAST_LOOP:
            free -= set(best.entries)
            yield best


def remaining(
    program: Program, moves: Sequence[Move]
) -> tuple[tuple[Instruction, ...], tuple[tuple[int, int, int], ...]]:
    """Return the program without the moves: instructions, and (output, entry, list position) of each other value."""
    moved = {(m.output, e) for m in moves for e in m.entries}
    stored = [(k, e) for k, refs in enumerate(program.output_refs) for e in range(len(refs)) if (k, e) not in moved]
    refs: list[tuple[int, ...]] = [(program.output_refs[k][e],) for k, e in stored]
    instructions, positions = drop_dead(list(program.instructions), refs)
    return instructions, tuple((k, e, ref) for (k, e), (ref,) in zip(stored, positions, strict=True))


def move_lines(moves: Sequence[Move]) -> list[str]:
    """Return the C99 lines of the moves, for outputs that do not alias inputs."""
    return [
        copy_loop(entry(f"out{m.output}", m.to, m.to_step), entry(f"in{m.input}", m.start, m.step), m.count)
        for m in moves
    ]


def entry(array: str, first: int, step: int = 1) -> str:
    """Return the start of the C text of an array entry; the caller appends the loop counter and the closing bracket."""
    return "".join([array, "[", f"{first} + " if first else "", f"{step} * " if step != 1 else ""])


def copy_loop(to: str, source: str, count: int) -> str:
    """Return a C99 loop that copies `count` numbers; `to` and `source` are texts returned by `entry`.

    The comment in the loop is for Frama-C, which regards an array as fully written only after it has unrolled the loop.
    """
    return f"    /*@ loop unroll {count}; */\n    for (int k = 0; k < {count}; ++k) {{ {to}k] = {source}k]; }}"


Real: TypeAlias = Literal["float64", "float32"]
"""Type of every number in the C text: double ("float64") or float ("float32")."""

C_TYPE: Mapping[Real, str] = MappingProxyType({"float64": "double", "float32": "float"})
"""The C type for each `Real`."""

WIDTH = 120
"""Largest number of characters in a line of C text."""

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def identifier(name: str) -> str:
    """Return the name if it is permitted as an identifier in generated C."""
    if not isinstance(name, str) or not _IDENTIFIER.fullmatch(name) or "__" in name:
        remedy = "use letters, digits and single underscores, a letter first, at most 63"
        raise InputError("is not a C identifier", key="name", value=name, remedy=remedy)
    if name in _WORDS:
        raise InputError("is a reserved word in C or C++", key="name", value=name, remedy="choose another name")
    if _is_macro(name):
        raise InputError("is a macro in C, C++ or their headers", key="name", value=name, remedy="choose another name")
    return name


def c_literal(value: float, real: Real = "float64") -> str:
    """Return a C99 literal of exactly this value (rounded to `real`): decimal if exact and short, else hexadecimal.

    Example:
        >>> from surctl.ir import c_literal
        >>> c_literal(0.25), c_literal(0.1), c_literal(0.1, "float32")
        ('0.25', '0x1.999999999999ap-4', '0x1.99999ap-4f')
    """
    if math.isnan(value):
        raise InputError("NaN has no C literal", remedy="find the expression that is undefined")
    with np.errstate(over="ignore"):
        value = float(value if real == "float64" else np.float32(value))
    tail = "" if real == "float64" else "f"
    if math.isinf(value):
        # not HUGE_VAL, which avr-libc lacks
        return ("-" if value < 0 else "") + ("INFINITY" if real == "float32" else "(double)INFINITY")
    short = repr(value)
    if Decimal(short) == Decimal(value) and len(short) <= 12:
        return short + tail
    mantissa, _, exponent = value.hex().partition("p")
    return f"{mantissa.rstrip('0').rstrip('.')}p{exponent}{tail}"


def signature(start: str, inputs: Sequence[int], outputs: Sequence[int], c_type: str) -> list[str]:
    """Return the lines of a C function's signature, with arrays in0 … and out0 … and the size of each array."""
    arguments = [f"const {c_type} {_array(f'in{k}', size)}" for k, size in enumerate(inputs)]
    arguments += [f"{c_type} {_array(f'out{k}', size)}" for k, size in enumerate(outputs)]
    return broken(f"{start}(", arguments or ["void"], ")")


def _array(name: str, size: int) -> str:
    return f"{name}[{size}]" if size else f"*{name}"  # C has no empty array


def broken(start: str, items: Sequence[str], end: str, *, indent: str = "    ") -> list[str]:
    """Return `start`, the items separated by commas, and `end`, as lines; all lines except the first are indented."""
    lines = [start]
    for at, item in enumerate(items):
        text = f"{item}," if at + 1 < len(items) else f"{item}{end}"
        if at and len(lines[-1]) + 1 + len(text) > WIDTH:
            lines.append(f"{indent}{text}")
        else:
            lines[-1] += f" {text}" if at else text
    return lines
