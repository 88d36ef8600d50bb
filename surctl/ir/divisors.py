"""Replacement of several divisions by the same number with one division and several products."""

from __future__ import annotations

from collections import Counter

from surctl.ir.numbering import Numbering
from surctl.ir.program import Program

__all__ = ["shared_divisors"]


def shared_divisors(program: Program) -> Program:
    """Replace x / d by x · (1 / d) for every d that is the divisor of more than one division.

    A division takes a vector unit as long as thirty products. If 1 / d is a normal number, the replacement changes a
    quotient by at most two units in the last place. `lower` does not make this replacement, because it must not change
    any bit; and CasADi would convert x · (1 / d) back to x / d.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower, shared_divisors
        >>> x = ca.SX.sym("x", 3)
        >>> program = lower(ca.Function("unit", [x], [x[:2] / x[2]]))
        >>> [[i.op for i in block.instructions if i.op != "input"] for block in (program, shared_divisors(program))]
        [['div', 'div'], ['inv', 'mul', 'mul']]
    """
    divisors = Counter(i.args[-1] for i in program.instructions if i.op in ("div", "inv"))
    text, moved = Numbering(), list[int]()
    for instruction in program.instructions:
        if instruction.op == "div" and divisors[instruction.args[1]] > 1:
            over, under = (moved[a] for a in instruction.args)
            moved.append(text.add("mul", (over, text.add("inv", (under,)))))
        else:
            moved.append(text.copy(instruction, moved))
    return text.rewritten(program, moved)
