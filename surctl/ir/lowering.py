"""Conversion of a CasADi function to an instruction list (`Program`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import casadi as ca

from surctl.errors import InputError, UnsupportedOperation
from surctl.ir.numbering import Numbering
from surctl.ir.ops import OPERATIONS, SUBSTITUTES
from surctl.ir.program import Instruction, Program, drop_dead

__all__ = ["lower", "lower_named"]

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
        UnsupportedOperation: an operation is not in `surctl.ir.ops.OPERATIONS`; the message names a substitute.
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
    if reciprocals:
        builder, moved = _with_reciprocals(builder)
        refs = [tuple(moved[at] for at in entries) for entries in refs]
    instructions, output_refs = drop_dead(builder.instructions, refs)
    return Program(builder.name, inputs, outputs, instructions, output_refs)


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


def _with_reciprocals(old: _Builder) -> tuple[_Builder, list[int]]:
    """Return the list in which each shared divisor is inverted once, and the new list position of each instruction."""
    divisors = [i.args[1] for i in old.instructions if i.op == "div"]
    shared = {at for at in divisors if divisors.count(at) > 1}
    new, moved = _Builder(old.name), list[int]()
    for instruction in old.instructions:
        if instruction.op == "div" and instruction.args[1] in shared:
            over, under = (moved[a] for a in instruction.args)
            moved.append(new.add("mul", (over, new.add("inv", (under,)))))
        else:
            moved.append(new.copy(instruction, moved))
    return new, moved


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
        raise InputError(
            f"is {sparsity.dim()}, not a dense column vector",
            key=f"{function.name()}.{function.name_in(k)}",
            remedy="pass a flat vector and reshape it inside",
        )
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
