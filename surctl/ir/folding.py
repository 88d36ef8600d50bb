"""Constant folding: numbers replace an input, and values that depend only on constants are computed in advance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from surctl.errors import InputError
from surctl.ir.numbering import Numbering
from surctl.ir.ops import LEAVES, OPERATIONS
from surctl.ir.program import Program

__all__ = ["with_constants"]


def with_constants(program: Program, source: int, values: Sequence[float]) -> Program:
    """Return the program with constants instead of the entries of an input, and with the constant results computed.

    The input remains in the program's list of inputs but is not read. For finite numbers, the outputs equal those of
    the original program with `values` as input, except for the sign of a zero, because x + 0 becomes x and 0 · x
    becomes 0. Constant values are computed in double; if the program is evaluated in another precision, they are then
    rounded to it.

    Args:
        program: the instruction list, without libm functions such as sin.
        source: index of the input.
        values: one number for each entry.

    Raises:
        InputError: the number of values differs from the number of entries, a value is not finite, or the program uses
            libm functions such as sin, whose last bits depend on the machine.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower, replay, with_constants
        >>> error, gains = ca.SX.sym("error", 2), ca.SX.sym("gains", 2)
        >>> program = lower(ca.Function("pd", [error, gains], [gains[0] * error[0] + gains[1] * error[1]]))
        >>> tuned = with_constants(program, 1, [1.0, 0.0])
        >>> program.operations, tuned.operations, replay(tuned, [0.3, 0.1], [1.0, 0.0])[0].tolist()
        (3, 0, [0.3])
    """
    name, size = program.inputs[source]
    if len(values) != size or not all(math.isfinite(v) for v in values):
        raise InputError(f"needs {size} finite numbers", key=f"{program.name}.{name}")
    if program.libm:
        raise InputError("uses the mathematical library", key=program.name, remedy="apply surctl.ir.without_libm first")
    text, moved = _Folding(), list[int]()
    for instruction in program.instructions:
        if instruction.op == "input" and instruction.args[0] == source:
            moved.append(text.constant(float(values[instruction.args[1]])))
        elif instruction.op in LEAVES:
            moved.append(text.copy(instruction, moved))
        else:
            moved.append(text.folded(instruction.op, tuple(moved[a] for a in instruction.args)))
    return text.rewritten(program, moved)


class _Folding(Numbering):
    """An instruction list under construction in which no operation has only constant operands."""

    def value(self, at: int) -> float | None:
        return self.instructions[at].value

    def folded(self, op: str, args: tuple[int, ...]) -> int:
        known = [self.value(a) for a in args]
        if all(v is not None for v in known):
            with np.errstate(all="ignore"):
                return self.constant(float(OPERATIONS[op].numpy(*(np.float64(v) for v in known))))
        rule = _RULES.get(op)
        simplified = rule(self, args) if rule else None
        return self.add(op, args) if simplified is None else simplified

    def is_truth(self, at: int) -> bool:
        return self.instructions[at].op in _TRUTHS

    def op(self, at: int) -> str:
        return self.instructions[at].op

    def args(self, at: int) -> tuple[int, ...]:
        return self.instructions[at].args

    def is_true(self, at: int) -> int:
        """Return the list position of the value's truth value: 0 if the value is 0, otherwise 1."""
        return at if self.is_truth(at) else self.folded("ne", (at, self.constant(0.0)))


_TRUTHS = frozenset({"lt", "le", "eq", "ne", "and", "or", "not"})
_POSITIVE = frozenset({"fabs", "sq", "sqrt"}) | _TRUTHS


def _sum(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        if text.value(one) == 0.0:
            return other
        if text.op(other) == "neg":  # x + (-y)
            return text.folded("sub", (one, text.args(other)[0]))
        if text.op(other) == "if_else_zero" and text.op(text.args(other)[1]) == "neg":
            condition, then = text.args(other)
            return text.folded("sub", (one, text.folded("if_else_zero", (condition, text.args(then)[0]))))
    return _one_condition(text, "add", args)


def _difference(text: _Folding, args: tuple[int, ...]) -> int | None:
    if text.value(args[1]) == 0.0:
        return args[0]
    if text.value(args[0]) == 0.0:
        return text.folded("neg", args[1:])
    if text.op(args[1]) == "neg":
        return text.folded("add", (args[0], text.args(args[1])[0]))
    return _one_condition(text, "sub", args)


def _one_condition(text: _Folding, op: str, args: tuple[int, ...]) -> int | None:
    """Return the sum or difference of two `if_else_zero` with equal conditions as one `if_else_zero`, or None."""
    if all(text.op(a) == "if_else_zero" for a in args) and text.args(args[0])[0] == text.args(args[1])[0]:
        inner = text.folded(op, tuple(text.args(a)[1] for a in args))
        return text.folded("if_else_zero", (text.args(args[0])[0], inner))
    return None


def _product(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        factor = text.value(one)
        if factor == 0.0:
            return text.constant(0.0)
        if factor == 1.0:
            return other
        if factor == -1.0:
            return text.folded("neg", (other,))
        if factor is not None and text.is_truth(other):
            return text.folded("if_else_zero", (other, one))
    if all(text.op(a) == "neg" for a in args):
        return text.folded("mul", tuple(text.args(a)[0] for a in args))
    return None


def _quotient(text: _Folding, args: tuple[int, ...]) -> int | None:
    return args[0] if text.value(args[1]) == 1.0 else None


def _negated(text: _Folding, args: tuple[int, ...]) -> int | None:
    inner = args[0]
    return text.args(inner)[0] if text.op(inner) == "neg" else None


def _squared(text: _Folding, args: tuple[int, ...]) -> int | None:
    return text.folded("sq", text.args(args[0])) if text.op(args[0]) in ("neg", "fabs") else None


def _size(text: _Folding, args: tuple[int, ...]) -> int | None:
    if text.op(args[0]) == "neg":
        return text.folded("fabs", text.args(args[0]))
    return args[0] if text.op(args[0]) in _POSITIVE else None


def _larger(text: _Folding, args: tuple[int, ...]) -> int | None:
    if all(text.is_truth(a) for a in args):
        return text.folded("or", args)
    value = text.value(args[1])
    return args[0] if value is not None and value <= 0.0 and text.op(args[0]) in _POSITIVE else None


def _smaller(text: _Folding, args: tuple[int, ...]) -> int | None:
    return text.folded("and", args) if all(text.is_truth(a) for a in args) else None


def _both(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        value = text.value(one)
        if value is not None:
            return text.is_true(other) if value else text.constant(0.0)
    return text.is_true(args[0]) if args[0] == args[1] else None


def _either(text: _Folding, args: tuple[int, ...]) -> int | None:
    for one, other in (args, args[::-1]):
        value = text.value(one)
        if value is not None:
            return text.constant(1.0) if value else text.is_true(other)
    return text.is_true(args[0]) if args[0] == args[1] else None


def _select(text: _Folding, args: tuple[int, ...]) -> int | None:
    condition, then, otherwise = args
    value = text.value(condition)
    if value is not None:
        return then if value else otherwise
    if then == otherwise:
        return then
    if text.op(condition) == "not":
        return text.folded("select", (text.args(condition)[0], otherwise, then))
    if text.op(then) in ("select", "if_else_zero") and text.args(then)[0] == condition:
        return text.folded("select", (condition, text.args(then)[1], otherwise))
    return text.folded("if_else_zero", (condition, then)) if text.value(otherwise) == 0.0 else None


def _only_if(text: _Folding, args: tuple[int, ...]) -> int | None:
    condition, then = args
    value = text.value(condition)
    if value is not None:
        return then if value else text.constant(0.0)
    if text.value(then) == 0.0:
        return then
    if text.op(then) in ("select", "if_else_zero") and text.args(then)[0] == condition:
        return text.folded("if_else_zero", (condition, text.args(then)[1]))
    return condition if text.value(then) == 1.0 and text.is_truth(condition) else None


_RULES: dict[str, Callable[[_Folding, tuple[int, ...]], int | None]] = {
    "add": _sum,
    "sub": _difference,
    "mul": _product,
    "div": _quotient,
    "neg": _negated,
    "sq": _squared,
    "fabs": _size,
    "fmax": _larger,
    "fmin": _smaller,
    "and": _both,
    "or": _either,
    "select": _select,
    "if_else_zero": _only_if,
}
