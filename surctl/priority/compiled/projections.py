"""The projections of the NSB law, equation (16) of the paper, with loops; module `sweep` has them without.

`projections` and `checks` return procedures, whose code does not grow with the number of velocities.
"""

from __future__ import annotations

from surctl.ir.procedure import Procedure, back, sqrt, within
from surctl.priority.hierarchy import memory
from surctl.priority.hierarchy.kernel import sound
from surctl.priority.shapes import StackShape


class Memory:
    """Constants, arrays and variables of the projections; sizes are in `projections`."""

    n: int  # velocities
    p: int  # levels, numbered from 2, as are their rows, as in package `hierarchy`
    highest: int  # first level
    b: int  # rows of the largest level
    w: list[float]
    J: list[float]
    lower: list[float]
    upper: list[float]
    z: list[float]
    first: list[int]  # first row of each level, and the end
    is_set: list[int]
    least: float  # square of the damping
    rest: list[float]  # by how much z misses the desired value of each row of a level
    y: list[float]
    L: list[float]  # J Jᵀ = L D Lᵀ; or P T, the Jacobian in the coordinates Q
    D: list[float]
    inverse: list[float]
    Q: list[float]  # orthonormal basis of the rows of a level
    P: list[float]
    T: list[float]


class Checked(memory.Memory):
    """What `check` writes."""

    sound: list[float]
    zero: list[float]
    none: list[float]


def solve_gram(s: Memory, base: int, cnt: int) -> None:
    """Move z by Jᵀ(J Jᵀ + λ²I)⁻¹ rest, or, without damping, by the part of the rows that depend on no row above."""
    for i in within(0, cnt, s.b):
        for j in within(0, i + 1, s.b):
            total = s.least if i == j else 0.0
            for q in range(s.n):
                total += s.J[(base + i) * s.n + q] * s.J[(base + j) * s.n + q]
            s.L[i * s.b + j] = total
    for j in within(0, cnt, s.b):
        own = s.L[j * s.b + j]
        pivot = own
        for q in within(0, j, s.b):
            pivot -= s.L[j * s.b + q] * s.L[j * s.b + q] * s.D[q]
        if s.least > 0.0:
            pivot = pivot if pivot > s.least else s.least
        s.D[j] = pivot
        s.inverse[j] = 1.0 / pivot if pivot > 1e-12 * own + 1e-30 or s.least > 0.0 else 0.0
        for i in within(j + 1, cnt, s.b):
            e = s.L[i * s.b + j]
            for q in within(0, j, s.b):
                e -= s.L[i * s.b + q] * s.L[j * s.b + q] * s.D[q]
            s.L[i * s.b + j] = e * s.inverse[j]
    for i in within(0, cnt, s.b):
        e = s.rest[i]
        for j in within(0, i, s.b):
            e -= s.L[i * s.b + j] * s.y[j]
        s.y[i] = e
    for i in back(0, cnt, s.b):
        e = s.y[i] * s.inverse[i]
        for j in within(i + 1, cnt, s.b):
            e -= s.L[j * s.b + i] * s.y[j]
        s.y[i] = e
    for q in range(s.n):
        for i in within(0, cnt, s.b):
            s.z[q] += s.J[(base + i) * s.n + q] * s.y[i]


def solve_split(s: Memory, base: int, cnt: int) -> None:
    """Move z by the shortest velocity that minimises ‖J z − x‖, from the decomposition J = P T Q of module `sweep`."""
    longest = 0.0
    for i in within(0, cnt, s.b):
        square = 0.0
        for q in range(s.n):
            square += s.J[(base + i) * s.n + q] * s.J[(base + i) * s.n + q]
        longest = square if square > longest else longest
    longest = sqrt(longest)
    scale = 1.0 / longest if longest > 1e-15 else 0.0
    for i in within(0, cnt, s.b):
        for q in range(s.n):
            s.Q[i * s.n + q] = scale * s.J[(base + i) * s.n + q]
        for turn in range(2):
            for j in within(0, i, s.b):
                part = 0.0
                for q in range(s.n):
                    part += s.Q[j * s.n + q] * s.Q[i * s.n + q]
                for q in range(s.n):
                    s.Q[i * s.n + q] -= part * s.Q[j * s.n + q]
            square = 0.0
            for q in range(s.n):
                square += s.Q[i * s.n + q] * s.Q[i * s.n + q]
            length = sqrt(square)
            part = 1.0 / length if length > (1e-10 if turn == 0 else 0.0) else 0.0
            for q in range(s.n):
                s.Q[i * s.n + q] = part * s.Q[i * s.n + q]
        for j in within(0, i + 1, s.b):
            part = 0.0
            for q in range(s.n):
                part += scale * s.J[(base + i) * s.n + q] * s.Q[j * s.n + q]
            s.L[i * s.b + j] = part
    for j in within(0, cnt, s.b):
        for i in within(0, cnt, s.b):
            s.P[j * s.b + i] = s.L[i * s.b + j] if i >= j else 0.0
        for turn in range(2):
            for i in within(0, j, s.b):
                part = 0.0
                for q in within(0, cnt, s.b):
                    part += s.P[i * s.b + q] * s.P[j * s.b + q]
                s.T[i * s.b + j] = part if turn == 0 else s.T[i * s.b + j] + part
                for q in within(0, cnt, s.b):
                    s.P[j * s.b + q] -= part * s.P[i * s.b + q]
        square = 0.0
        for q in within(0, cnt, s.b):
            square += s.P[j * s.b + q] * s.P[j * s.b + q]
        length = sqrt(square)
        s.inverse[j] = 1.0 / length if length > 0.0 else 0.0
        for q in within(0, cnt, s.b):
            s.P[j * s.b + q] = s.P[j * s.b + q] * s.inverse[j]
        part = 0.0
        for q in within(0, cnt, s.b):
            part += s.P[j * s.b + q] * s.rest[q]
        for q in within(0, cnt, s.b):
            s.rest[q] -= part * s.P[j * s.b + q]
        s.y[j] = part * scale
    for j in back(0, cnt, s.b):
        e = s.y[j]
        for i in within(j + 1, cnt, s.b):
            e -= s.T[j * s.b + i] * s.y[i]
        s.y[j] = e * s.inverse[j]
    for i in within(0, cnt, s.b):
        for q in range(s.n):
            s.z[q] += s.Q[i * s.n + q] * s.y[i]


def arrange(_s: object) -> None:
    """Write the structure of the levels; `projections` puts a function for its levels in the place of this one."""


def project(s: Memory) -> None:
    """Project w on one level after another, from the lowest up."""
    arrange(s)
    for q in range(s.n):
        s.z[q] = s.w[q]
    for level in back(s.highest, s.p, s.p):
        base = s.first[level] - 2
        cnt = s.first[level + 1] - 2 - base
        for i in within(0, cnt, s.b):
            value = 0.0
            for q in range(s.n):
                value += s.J[(base + i) * s.n + q] * s.z[q]
            to = s.lower[base + i]
            if s.is_set[level] != 0:
                to = value if value > to else to
                to = s.upper[base + i] if to > s.upper[base + i] else to
            s.rest[i] = to - value
        if cnt == 1 or s.least > 0.0:
            solve_gram(s, base, cnt)
        else:
            solve_split(s, base, cnt)


def check(s: Checked) -> None:
    """Write whether the numbers of the levels are finite and their bounds in order, and zeros."""
    arrange(s)
    s.sound[0] = 1.0 * sound(s)
    s.none[0] = 0.0
    for q in range(s.n):
        s.zero[q] = 0.0


def projections(shape: StackShape, *, damping: float, highest: int = 0) -> Procedure:
    """Return the procedure with the ports of the program `sweep.sweep`."""
    n, b = shape.n, max(level.rows for level in shape.levels)
    return Procedure.of(
        "projections",
        [_arranged(shape, f"    s.least = {float(damping) ** 2!r}"), solve_gram, solve_split, project],
        inputs=(("w", n), *shape.inputs),
        outputs=(("z", n),),
        sizes={"n": n, "p": len(shape.levels) + 2, "b": b, "highest": highest + 2},
        reals={
            "least": 0, "rest": b, "y": b, "L": b * b, "D": b, "inverse": b, "Q": b * n, "P": b * b, "T": b * b,
        },
        wholes=_places(shape),
    )  # fmt: skip


def checks(shape: StackShape) -> Procedure:
    """Return the procedure with the ports of the program `sweep.gate`."""
    return Procedure.of(
        "checks",
        [_arranged(shape), sound, check],
        inputs=shape.inputs,
        outputs=(("sound", 1), ("zero", shape.n), ("none", 1)),
        sizes={"n": shape.n, "p": len(shape.levels) + 2, "b": max(level.rows for level in shape.levels)},
        reals={},
        wholes=_places(shape),
    )


def _arranged(shape: StackShape, *more: str) -> str:
    starts = (*shape.starts, shape.rows)
    lines = [f"    s.first[{place}] = {start + 2}" for place, start in enumerate(starts, 2)]
    lines += [f"    s.is_set[{place}] = {int(level.is_set)}" for place, level in enumerate(shape.levels, 2)]
    return "\n".join(["def arrange(s):", *lines, *more])


def _places(shape: StackShape) -> dict[str, int]:
    return {"first": len(shape.levels) + 3, "is_set": len(shape.levels) + 2}
