"""Elapsed time in the exported step: after missed or refused periods, ages in the state grow and short memories end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.ir import Real

__all__ = ["RESTART", "aged", "aged_runs", "forgotten", "forgotten_runs", "longest_gap"]

Vector = NDArray[np.float64]

RESTART = 10
"""Number of older samples, after the first, whose numbers must rise before the counter counts as started again."""

_MEMORY = 0.15
"""[s] Longest gap between two accepted steps after which estimates from the last steps still describe the present."""


def longest_gap(dt: float) -> int:
    """Return the largest number of periods between two accepted steps after which short memories are kept."""
    return max(1, int(_MEMORY / dt + 1e-9))


def aged(law: Exportable, x: Vector, periods: int, *, real: Real) -> Vector:
    """Return the state (nx,) `periods` after the last accepted step, as the exported C computes it before the law.

    A part of the state with the rule `age` grows by the missed periods, up to its initial value, which is the largest
    age. A part with the rule `anew` returns to its initial value after more than `longest_gap` periods.
    """
    number = np.dtype(real).type
    out, start = np.array(x, dtype=float), np.asarray(law.initial_state(), dtype=real).astype(float)
    more = number(periods - 1) * number(law.dt)
    for port in law.state:
        part = law.state.slice(port.name)
        if port.gap == "age":
            out[part] = np.minimum(out[part].astype(real) + more, start[part].astype(real))
        elif port.gap == "anew" and periods > longest_gap(law.dt):
            out[part] = start[part]
    return out


def forgotten(law: Exportable) -> str:
    """Return the names of the parts of the state that begin anew after a long gap."""
    return ", ".join(port.name for port in law.state if port.gap == "anew")


def aged_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the largest age) of the entries of the state that grow in a gap."""
    return list(_runs(law, "age", text))


def forgotten_runs(law: Exportable, text: Callable[[float], str]) -> list[tuple[int, int, str]]:
    """Return (first index, end, C text of the initial value) of the entries that begin anew after a long gap."""
    return list(_runs(law, "anew", text))


def _runs(law: Exportable, rule: str, text: Callable[[float], str]) -> Iterator[tuple[int, int, str]]:
    start = law.initial_state()
    rules = [port.gap for port in law.state for _ in range(port.size)]
    entries = ((k, text(float(start[k]))) for k in range(law.state.size) if rules[k] == rule)
    for value, group in groupby(enumerate(entries), key=lambda item: (item[1][0] - item[0], item[1][1])):
        indices = [k for _, (k, _) in group]
        yield indices[0], indices[-1] + 1, value[1]
