"""Readers of what certificates of regions share; they reject wrong keys and numbers that are not decimal."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeVar

from surctl.certcheck.document import Rejected, record

__all__ = [
    "LAW", "Pair", "axis_pairs", "lag_range", "law_gains", "number", "ordered", "read_shells", "read_top", "triangle",
    "two",
]  # fmt: skip

Pair = tuple[Fraction, Fraction]
Number = TypeVar("Number", float, Fraction)

_LARGEST = 10**9


def number(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Fraction:
    """Return the printed decimal of a number; raise Rejected if the number is < least (≤ least with `above`)."""
    whole = type(value) is int and abs(value) <= _LARGEST
    if not whole and not (type(value) is float and math.isfinite(value)):
        raise Rejected(f"{where} must be a finite number of at most {_LARGEST}")
    exact = Fraction(repr(value))
    if exact < least or (above and exact == least):
        raise Rejected(f"{where} must be {'above' if above else 'at least'} {least}, not {value!r}")
    if abs(exact) > _LARGEST or (exact and abs(exact) < Fraction(1, 10**18)):
        raise Rejected(f"{where} is too large or too close to 0: {value!r}")
    return exact


def triangle(rows: Any, size: int, where: str) -> list[list[Fraction]]:
    """Return the symmetric matrix (size, size) whose lower triangle has the given rows."""
    shaped = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not shaped or [len(row) for row in rows] != list(range(1, size + 1)):
        raise Rejected(f"{where} must be a lower triangle with {size} rows")
    lower = [[number(entry, where, least=-_LARGEST) for entry in row] for row in rows]
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


def two(value: Any, where: str, *, least: Fraction | int = 0, above: bool = False) -> Pair:
    """Return two numbers, see `number`."""
    if not isinstance(value, list) or len(value) != 2:
        raise Rejected(f"{where} must have two entries")
    first, second = (number(entry, where, least=least, above=above) for entry in value)
    return first, second


def ordered(value: Any, where: str, *, above: bool = False) -> Pair:
    """Return the least and the largest value of a range, see `number`."""
    low, high = two(value, where, above=above)
    if low > high:
        raise Rejected(f"{where}: the least value exceeds the largest")
    return low, high


def lag_range(value: Any) -> Pair:
    """Return the range of the time constant of the thrust [s]; (0, 0) for thrust without lag."""
    low, high = ordered(value, "claim.vehicle.lag_s")
    if high and not low:
        raise Rejected("claim.vehicle.lag_s must be a range above 0, or [0, 0]")
    return low, high


LAW = (
    "mass_kg", "linear_drag", "quadratic_drag", "k1", "lookahead", "k_v", "k_i", "wait", "cruise", "cap", "period_s",
)  # fmt: skip
"""Entries of `claim.law` in a claim about the path-following law."""


def law_gains(law: Mapping[str, Any]) -> dict[str, Fraction]:
    """Return k1, lookahead, k_v, wait, cruise and cap, which are above 0, and the control period `period`."""
    if number(law["k_i"], "claim.law.k_i"):
        raise Rejected("claim.law.k_i must be 0: the certified loop has no integral action")
    names = ("k1", "lookahead", "k_v", "wait", "cruise", "cap")
    gains = {name: number(law[name], f"claim.law.{name}", above=True) for name in names}
    return {**gains, "period": number(law["period_s"], "claim.law.period_s")}


def axis_pairs(ends: tuple[Number, Number], asymmetry: Number) -> list[tuple[Number, Number]]:
    """Return the vertices of {(a, b): least ≤ a, b ≤ largest, |a − b| ≤ asymmetry (a + b)/2}.

    The numbers lie between t and t ratio for some t, so at a vertex each is one of the two, for the least or largest t.
    """
    least, largest = low, high = ends
    if asymmetry < 2:
        ratio = (2 + asymmetry) / (2 - asymmetry)
        low, high = max(largest / ratio, least), min(least * ratio, largest)
    return sorted({(least, least), (least, high), (high, least), (largest, largest), (largest, low), (low, largest)})


def read_top(claim: Any, system: str, excludes: Sequence[str]) -> Mapping[str, Any]:
    """Return the entries of a claim about this system; raise Rejected unless its texts and digests are as expected."""
    top = record(claim, ("system", "excludes", "vehicle", "law", "motion", "sha256_vehicle", "sha256_law"), "claim")
    if top["system"] != system:
        raise Rejected(f"claim.system {top['system']!r} is not known; known: {system}")
    if top["excludes"] != list(excludes):
        raise Rejected("claim.excludes differs from the text that this checker expects")
    for key in ("sha256_vehicle", "sha256_law"):
        if not isinstance(top[key], str) or not re.fullmatch("[0-9a-f]{64}", top[key]):
            raise Rejected(f"claim.{key} is not a SHA-256")
    return top
