"""Non-finite numbers at every entry of the law: both lives must answer with zero thrust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.process import Controller
from surctl.export.records import Records
from surctl.export.rendering import entries

__all__ = ["fault_cases", "fault_failures"]

Vector = NDArray[np.float64]

_BAD = (np.nan, np.inf, -np.inf)


def fault_cases(law: Exportable) -> tuple[list[str], Vector, Vector]:
    """Each entry of state, input and gains in turn NaN, +inf and −inf.

    Returns:
        Labels such as "u.clearance[2] = nan"; for each the entry of (state, input, gains) end to end, and the number.
    """
    layouts = (("x", law.state), ("u", law.inputs), ("p", law.gains))
    members = [f"{letter}.{member}" for letter, layout in layouts for member, _ in entries(layout)]
    labels = [f"{member} = {bad}" for member in members for bad in _BAD]
    return labels, np.repeat(np.arange(len(members), dtype=float), len(_BAD)), np.tile(_BAD, len(members))


def fault_failures(law: Exportable, controller: Controller, records: Records) -> tuple[int, tuple[str, ...]]:
    """(number of cases, the failed ones), all on the first record.

    A case passes with a negative status, zero thrust and an untouched state in both Python and C, and the
    same status in both.
    """
    labels, at, values = fault_cases(law)
    record = np.concatenate([records.X[0], records.U[0], records.P[0]])
    c = controller.run_faults(record, at, values)
    ends = np.cumsum([law.state.size, law.inputs.size])
    failed = []
    for k, label in enumerate(labels):
        faulty = record.copy()
        faulty[int(at[k])] = values[k]
        x, u, p = np.split(faulty, ends)
        step = law.step(x, u, p)
        kept = np.array_equal(step.x_next, x, equal_nan=True)
        sides = (
            ("Python", _safe(step.status, step.tau) and kept),
            ("C", _safe(int(c.status[k]), c.tau[k]) and c.changed[k] == 0),
            (f"status {step.status} in Python, {c.status[k]} in C", step.status == c.status[k]),
        )
        failed += [f"{label} ({side})" for side, passes in sides if not passes]
    return len(labels), tuple(failed)


def _safe(status: int, tau: Vector) -> bool:
    return status < 0 and bool(np.all(tau == 0.0))
