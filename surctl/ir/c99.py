"""Writer of an instruction list as one C99 function."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from surctl.errors import InputError
from surctl.ir.c_macros import is_macro
from surctl.ir.moves import Move, move_lines, remaining
from surctl.ir.ops import OPERATIONS
from surctl.ir.program import Instruction, Program

__all__ = ["Real", "broken", "c_literal", "emit_c99", "expression", "head", "identifier", "signature"]

Real: TypeAlias = Literal["float64", "float32"]
"""Type of every number in the C text: double ("float64") or float ("float32")."""

C_TYPE: Mapping[Real, str] = MappingProxyType({"float64": "double", "float32": "float"})
"""The C type for each `Real`."""

WIDTH = 120
"""Largest number of characters in a line of C text."""

# C99, C11 and C++ keywords (headers are read by C++ too), and words that the standard headers define
_WORDS = frozenset(
    re.findall(
        r"\w+",
        """
        auto break case char const continue default do double else enum extern float for goto if inline int
        long register restrict return short signed sizeof static struct switch typedef union unsigned void
        volatile while alignas alignof asm bool catch char8_t char16_t char32_t class concept consteval
        constexpr constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit
        export false friend mutable namespace new noexcept nullptr operator private protected public
        reinterpret_cast requires static_assert static_cast template this thread_local throw true try typeid
        typename using virtual wchar_t and and_eq bitand bitor compl not not_eq or or_eq xor xor_eq main
        errno assert NULL EOF
        """,
    )
)
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def identifier(name: str) -> str:
    """Return the name if it is permitted as an identifier in generated C.

    Raises:
        InputError: the name is not a C identifier (ASCII letters, digits and underscores, a letter first, at most 63
            characters), it is a keyword of C or C++, or a header of the exported files defines it.

    Example:
        >>> from surctl.ir import identifier
        >>> identifier("depth_gain")
        'depth_gain'
        >>> identifier("double")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: name = 'double': is a reserved word in C or C++; choose another name
    """
    if not isinstance(name, str) or not _IDENTIFIER.fullmatch(name) or "__" in name:
        raise InputError(
            "is not a C identifier",
            key="name",
            value=name,
            remedy="use letters, digits and single underscores, a letter first, at most 63",
        )
    if name in _WORDS:
        raise InputError("is a reserved word in C or C++", key="name", value=name, remedy="choose another name")
    if is_macro(name):
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


def emit_c99(program: Program, *, symbol: str, real: Real = "float64", moves: Sequence[Move] = ()) -> str:
    """Return a C function `static void <symbol>(const double *in0, …, double *out0, …)`, one local variable per line.

    The function uses only local variables and exact literals. It computes all outputs before it stores any of them, so
    an output may be the same array as an input. The C text needs <math.h>. For results with identical bytes, it needs
    the compiler flag `-ffp-contract=off`.

    Args:
        program: the instruction list, without instructions whose value is not used (`lower` removes them).
        symbol: name of the C function, checked by `identifier`.
        real: "float32" writes float instead of double, with literals and functions of type float.
        moves: pieces of inputs to copy as a whole, see `handed_on`; if there are any, no output may overlap an input.

    Raises:
        InputError: `symbol` is not a valid C identifier.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import emit_c99, lower
        >>> v = ca.SX.sym("v", 2)
        >>> print(emit_c99(lower(ca.Function("speed", [v], [ca.norm_2(v)])), symbol="speed"), end="")
        /* 4 operations; outputs may alias inputs */
        static void speed(const double in0[2], double out0[1])
        {
            const double v0 = in0[0];
            const double v1 = v0 * v0;
            const double v2 = in0[1];
            const double v3 = v2 * v2;
            const double v4 = v1 + v3;
            const double v5 = sqrt(v4);
            out0[0] = v5;
        }
    """
    instructions, stores = remaining(program, moves)
    read = {i.args[0] for i in instructions if i.op == "input"} | {m.input for m in moves}
    lines = [*head(program, identifier(symbol), C_TYPE[real], apart=bool(moves)), "{"]
    lines += [f"    (void)in{k};" for k in range(len(program.inputs)) if k not in read]
    lines += [f"    (void)out{k};" for k, refs in enumerate(program.output_refs) if not refs]
    lines += [f"    const {C_TYPE[real]} v{at} = {expression(i, real)};" for at, i in enumerate(instructions)]
    lines += [f"    out{k}[{entry}] = v{ref};" for k, entry, ref in stores]
    return "\n".join([*lines, *move_lines(moves), "}"]) + "\n"


def head(program: Program, symbol: str, c_type: str, *, apart: bool = False) -> list[str]:
    """Return comment and signature of a program's C function; `apart` means that no output may overlap an input."""
    alias = "" if apart else "; outputs may alias inputs"
    read, written = ([size for _, size in arrays] for arrays in (program.inputs, program.outputs))
    return [f"/* {program.operations} operations{alias} */", *signature(f"static void {symbol}", read, written, c_type)]


def signature(start: str, inputs: Sequence[int], outputs: Sequence[int], c_type: str) -> list[str]:
    """Return the lines of a C function's signature, with arrays in0 … and out0 … and the size of each array."""
    arguments = [f"const {c_type} {_array(f'in{k}', size)}" for k, size in enumerate(inputs)]
    arguments += [f"{c_type} {_array(f'out{k}', size)}" for k, size in enumerate(outputs)]
    return broken(f"{start}(", arguments or ["void"], ")")


def _array(name: str, size: int) -> str:
    return f"{name}[{size}]" if size else f"*{name}"  # C has no empty array


def broken(start: str, items: Sequence[str], end: str, *, indent: str = "    ") -> list[str]:
    """Return `start`, the items separated by commas, and `end`, as lines; all lines except the first are indented.

    Example:
        >>> from surctl.ir.c99 import broken
        >>> broken("f(", ["x" * 60, "y" * 60], ");")[1][:8]
        '    yyyy'
    """
    lines = [start]
    for at, item in enumerate(items):
        text = f"{item}," if at + 1 < len(items) else f"{item}{end}"
        if at and len(lines[-1]) + 1 + len(text) > WIDTH:
            lines.append(f"{indent}{text}")
        else:
            lines[-1] += f" {text}" if at else text
    return lines


def expression(instruction: Instruction, real: Real = "float64", *, operand: str = "v{}") -> str:
    """Return the C text of an instruction's right-hand side; `operand` formats the list position of an operand."""
    if instruction.op == "const":
        return c_literal(instruction.number, real)
    if instruction.op == "input":
        return "in{}[{}]".format(*instruction.args)
    text = OPERATIONS[instruction.op].c99
    if real == "float32":
        text = _FUNCTION.sub(r"\1f(", _NUMBER.sub(r"\1f", text))
    return text.format(*(operand.format(a) for a in instruction.args))


_NUMBER = re.compile(r"\b(\d+\.\d+)\b")
_FUNCTION = re.compile(r"\b(sqrt|fabs|floor|fma|sin|cos|atan2|acos)\(")
