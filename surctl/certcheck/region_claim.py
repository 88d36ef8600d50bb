"""What certificates of regions share: matrices, shells, and the vertices of two numbers that differ little."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any, TypeVar

from surctl.certcheck.document import Rejected, record
from surctl.certcheck.fields import number

__all__ = ["axis_pairs", "read_shells", "triangle"]

Number = TypeVar("Number", float, Fraction)


def triangle(rows: Any, size: int, where: str) -> list[list[Fraction]]:
    """Return the symmetric matrix (size, size) whose lower triangle has the given rows."""
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, size + 1)):
        raise Rejected(f"{where} must be a lower triangle with {size} rows")
    lower = [[number(entry, where, least=-(10**9)) for entry in row] for row in rows]
    return [[lower[max(i, j)][min(i, j)] for j in range(size)] for i in range(size)]


def read_shells(proof: Mapping[str, Any], most: int, rate: Fraction) -> list[tuple[Fraction, ...]]:
    """Return (low, high, growth, rate) of each shell: its levels of V, its η [1/s], and the decay rate in it [1/s].

    The shells divide V from the floor to 1. The rate is the claimed one, or a higher rate that the shell states.
    """
    shells = proof["shells"]
    if not isinstance(shells, list) or not 1 <= len(shells) <= most:
        raise Rejected(f"proof.shells must hold 1 to {most} shells")
    low, read = number(proof["floor"], "proof.floor", above=True), list[tuple[Fraction, ...]]()
    for entry in shells:
        faster = isinstance(entry, dict) and "rate" in entry
        one = record(entry, ("level", "growth", "rate") if faster else ("level", "growth"), "a shell")
        high = number(one["level"], "the level of a shell", least=low, above=True)
        pace = number(one["rate"], "the rate of a shell", least=rate) if faster else rate
        read.append((low, high, number(one["growth"], "the growth of a shell"), pace))
        low = high
    if low != 1:
        raise Rejected("the last shell must end at level 1")
    return read


def axis_pairs(ends: tuple[Number, Number], asymmetry: Number) -> list[tuple[Number, Number]]:
    """Return the vertices of {(a, b): least ≤ a, b ≤ largest, |a − b| ≤ asymmetry (a + b)/2}.

    The numbers lie between t and t ratio for some t, so at a vertex each is one of the two, for the least or largest t.
    """
    least, largest = low, high = ends
    if asymmetry < 2:
        ratio = (2 + asymmetry) / (2 - asymmetry)
        low, high = max(largest / ratio, least), min(least * ratio, largest)
    return sorted({(least, least), (least, high), (high, least), (largest, largest), (largest, low), (low, largest)})
