"""Non-finite numbers at every entry of the law: both lives must answer with zero thrust."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.process import Controller, Results
from surctl.export.records import Records
from surctl.export.rendering import entries

__all__ = ["fault_cases", "fault_failures"]

Vector = NDArray[np.float64]

_BAD = (np.nan, np.inf, -np.inf)


def fault_cases(law: Exportable, records: Records) -> tuple[list[str], Records]:
    """Each entry of state, input and gains in turn NaN, +inf and −inf, on the first record.

    Returns:
        Labels such as "u.clearance[2] = nan", and one record for each.
    """
    base = (records.X[0], records.U[0], records.P[0])
    layouts = (("x", law.state), ("u", law.inputs), ("p", law.gains))
    labels: list[str] = []
    rows: list[tuple[Vector, ...]] = []
    for which, (letter, layout) in enumerate(layouts):
        for member, at in entries(layout):
            for bad in _BAD:
                labels.append(f"{letter}.{member} = {bad}")
                rows.append(tuple(_with(v, at, bad) if k == which else v for k, v in enumerate(base)))
    X, U, P = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    return labels, Records(X, U, P)


def _with(vector: Vector, at: int, value: float) -> Vector:
    changed = vector.copy()
    changed[at] = value
    return changed


def fault_failures(law: Exportable, controller: Controller, records: Records) -> tuple[int, tuple[str, ...]]:
    """(number of cases, the failed ones).

    A case passes with a negative status, zero thrust and an untouched state in both Python and C, and the
    same status in both.
    """
    labels, cases = fault_cases(law, records)
    load = np.ones(len(cases), dtype=bool)
    c_results = controller.run(cases, load=load)
    failed = [f"{label} ({side})" for k, label in enumerate(labels) for side in _failed_sides(law, cases, c_results, k)]
    return len(labels), tuple(failed)


def _failed_sides(law: Exportable, cases: Records, c: Results, k: int) -> Iterator[str]:
    step = law.step(cases.X[k], cases.U[k], cases.P[k])
    safe = _safe_test(cases.X[k])
    if not safe(step.status, step.tau, step.x_next):
        yield "Python"
    if not safe(int(c.status[k]), c.tau[k], c.state[k]):
        yield "C"
    if step.status != c.status[k]:
        yield f"status {step.status} in Python, {c.status[k]} in C"


def _safe_test(x: Vector) -> Callable[[int, Vector, Vector], bool]:
    return lambda status, tau, state: (
        status < 0 and bool(np.all(tau == 0.0)) and np.array_equal(state, x, equal_nan=True)
    )
