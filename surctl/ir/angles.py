"""Sine and cosine of angles that stay near a reference angle, by a short series around that angle."""

from __future__ import annotations

from surctl.ir.folding import Numbering
from surctl.ir.program import Program

__all__ = ["nearby_angles"]

_SIN = (-1 / 6, 1 / 120, -1 / 5040, 1 / 362880)
_COS = (-1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800)


def nearby_angles(program: Program, source: int, entry: int) -> Program:
    """Replace sin(a + d) and cos(a + d), where a is an entry of an input, by the angle-sum formula and a series in d.

    The formula costs a third of a general sine. It is meant for the stages of a Runge-Kutta integrator, because there
    the angle changes little within a call. The errors of the Taylor series for sin d and cos d are |d|¹¹ / 11! and
    |d|¹² / 12!. They are less than a unit in the last place of 1 up to d = 0.18, and below 1e-11 at d = 0.5. Only sines
    and cosines of sums that contain a are replaced.

    Args:
        program: the instruction list.
        source: index of the input vector that contains the reference angle a.
        entry: index of the angle a in this input vector.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import lower, nearby_angles, replay
        >>> x = ca.SX.sym("x", 2)  # heading, turn within the step
        >>> headings = [x[0], x[0] + 0.5 * x[1], x[0] + x[1]]
        >>> plain = lower(ca.Function("ahead", [x], [ca.vertcat(*map(ca.cos, headings))]))
        >>> near = nearby_angles(plain, 0, 0)
        >>> [sum(i.op in ("sin", "cos") for i in block.instructions) for block in (plain, near)]
        [3, 2]
        >>> [replay(block, [1.0, 0.1])[0].round(6).tolist() for block in (plain, near)]
        [[0.540302, 0.497571, 0.453596], [0.540302, 0.497571, 0.453596]]
    """
    text, moved = Numbering(), list[int]()
    near: dict[int, int | None] = {}  # position → position in `text` of the distance from a; None for a itself
    for at, instruction in enumerate(program.instructions):
        if instruction.op == "input" and instruction.args == (source, entry):
            near[at] = None
        distance = near.get(instruction.args[0]) if instruction.op in ("sin", "cos") else None
        if distance is not None:
            moved.append(_turned(text, instruction.op, text.add("input", (source, entry)), distance))
            continue
        moved.append(text.copy(instruction, moved))
        known = [a for a in instruction.args if instruction.op == "add" and a in near]
        if len(known) == 1:
            (base,) = known
            step = moved[instruction.args[1] if instruction.args[0] == base else instruction.args[0]]
            so_far = near[base]
            near[at] = step if so_far is None else text.add("add", (so_far, step))
    return text.rewritten(program, moved)


def _turned(text: Numbering, op: str, angle: int, distance: int) -> int:
    """Return the position in the instruction list of sin or cos (`op`) of angle + distance."""
    square = text.add("sq", (distance,))

    def series(coefficients: tuple[float, ...]) -> int:
        value = text.constant(coefficients[-1])
        for coefficient in (*coefficients[-2::-1], 1.0):
            value = text.add("add", (text.add("mul", (value, square)), text.constant(coefficient)))
        return value

    sine, cosine = text.add("mul", (distance, series(_SIN))), series(_COS)
    own, other = text.add(op, (angle,)), text.add("cos" if op == "sin" else "sin", (angle,))
    products = text.add("mul", (own, cosine)), text.add("mul", (other, sine))
    return text.add("add" if op == "sin" else "sub", products)
