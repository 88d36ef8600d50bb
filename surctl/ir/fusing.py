"""Fusion of a product and a sum that uses the product into one operation with one rounding (`fma`)."""

from __future__ import annotations

from surctl.ir.numbering import Numbering
from surctl.ir.program import Program
from surctl.ir.routine import Block, rebuilt

__all__ = ["fused"]


def fused(block: Block) -> Block:
    """Replace a b + c, a b - c and c - a b by `fma` if only sums and differences use the product a b.

    Fusion changes rounding, so `lower` does not fuse. The outputs of the fused program or routine have equal bytes on
    every machine, because IEEE 754 defines the rounding of `fma`. On a machine without an instruction for `fma`, the
    code calls the function of the C library, which is slow.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import fused, lower
        >>> x = ca.SX.sym("x", 3)
        >>> program = lower(ca.Function("f", [x], [x[0] * x[1] + x[2]]))
        >>> [[i.op for i in block.instructions if i.op != "input"] for block in (program, fused(program))]
        [['mul', 'add'], ['fma']]
    """
    return rebuilt(block, _program)


def _program(program: Program) -> Program:
    additive = _additive(program)
    text, moved = Numbering(), list[int]()
    for instruction in program.instructions:
        if instruction.op in ("add", "sub") and additive & set(instruction.args):
            left, right = instruction.args
            product, other = (right, left) if right in additive else (left, right)
            factors = [moved[a] for a in program.instructions[product].args]
            a, b = factors[0], factors[-1]
            addend = moved[other]
            if instruction.op == "sub" and product == right:
                a = text.add("neg", (a,))
            elif instruction.op == "sub":
                addend = text.add("neg", (addend,))
            moved.append(text.add("fma", (a, b, addend)))
        else:
            moved.append(text.copy(instruction, moved))
    return text.rewritten(program, moved)


def _additive(program: Program) -> set[int]:
    """Return the list positions of the products that are used only in sums and differences."""
    products = {at for at, i in enumerate(program.instructions) if i.op in ("mul", "sq")}
    for instruction in program.instructions:
        if instruction.op not in ("add", "sub", "const", "input"):
            products -= set(instruction.args)
    return products - {r for refs in program.output_refs for r in refs}
