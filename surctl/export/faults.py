"""Invalid inputs at every entry of the law: Python and C must both return zero thrust and a negative status."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.envelope import NULL, STALE, Envelope, anywhere
from surctl.export.fields import entries
from surctl.export.precision import Guarded, evaluated, replayed
from surctl.export.process import Controller
from surctl.export.records import Records
from surctl.ir import Real

__all__ = ["Fault", "fault_cases", "fault_failures"]

Vector = NDArray[np.float64]

_BAD = (np.nan, np.inf, -np.inf)
_TOGETHER = 256  # faults evaluated together
_AFTER = (  # faults that follow a valid step, in the order of the software-in-the-loop program
    ("the same sample again", STALE),
    ("an older sample", STALE),
    *((f"{what} = NULL", NULL) for what in ("state", "gains", "input", "output")),
)


class Fault(NamedTuple):
    """One invalid input of a step.

    Attributes:
        label: description such as "u.clearance[2] = nan".
        at: index of the invalid number in the vector that joins state, input and gains; from the length of
            this vector on, the faults that follow a valid step (such as a repeated sample) and the jumps of inputs.
        value: the invalid number.
        status: required status; None if the status that Python computes is required.
    """

    label: str
    at: int
    value: float
    status: int | None = None


def fault_cases(law: Exportable, within: Envelope | None = None, *, real: Real = "float64") -> list[Fault]:
    """Return the invalid inputs, each with an entry of state, input or gains at NaN, ±inf, or just out of range.

    The last faults follow a valid step: a repeated sample, an older sample, and NULL for state, gains, input or output.
    """
    within = within or anywhere(law).fitted(law, real)
    layouts = (("x", law.state), ("u", law.inputs), ("p", law.gains))
    members = [f"{letter}.{member}" for letter, layout in layouts for member, _ in entries(layout)]
    box = np.vstack([within.state, within.inputs, within.gains])
    cases = [Fault(f"{member} = {bad}", at, bad) for at, member in enumerate(members) for bad in _BAD]
    number, largest = np.dtype(real).type, float(np.finfo(real).max)
    for at, (member, (low, high)) in enumerate(zip(members, box, strict=True)):
        for bound, beyond in ((low, -np.inf), (high, np.inf)):
            if abs(bound) < largest:
                value = float(np.nextafter(number(bound), number(beyond)))
                cases.append(Fault(f"{member} = {value!r}, out of its range", at, value))
    size = len(members)
    cases += [Fault(label, size + k, 0.0, status) for k, (label, status) in enumerate(_AFTER)]
    return cases


def _jumps(law: Exportable, within: Envelope, u: Vector) -> Iterator[Fault]:
    # an input changes by more than its rate allows, within its range
    first = law.state.size + law.inputs.size + law.gains.size + len(_AFTER)
    members = [member for member, _ in entries(law.inputs)]
    for rate in within.rates:
        step = 1.01 * (rate.at_once + rate.per_second * law.dt) + 1e-6
        low, high = within.inputs[rate.entry]
        value = float(u[rate.entry])
        for sign in (1.0, -1.0):
            to = value + sign * step
            if low <= to <= high:
                yield Fault(f"u.{members[rate.entry]} jumps to {to!r}", first + rate.entry, to)


def fault_failures(law: Exportable, controller: Controller, records: Records) -> tuple[int, tuple[str, ...]]:
    """Return (number of faults tried, labels of the faults whose check failed).

    All faults change the record in the middle of the run. The check of a fault passes if Python and C both return a
    negative status, zero thrust and an unchanged state, and the two statuses are equal.
    """
    real = controller.bundle.real
    within = controller.bundle.envelope or anywhere(law).fitted(law, real)
    middle = len(records) // 2
    x, u, p = records.X[middle], records.U[middle], records.P[middle]
    cases = [*fault_cases(law, within, real=real), *_jumps(law, within, u)]
    record = np.concatenate([x, u, p])
    c = controller.run_faults(record, np.array([f.at for f in cases], float), np.array([f.value for f in cases]))
    statuses, safe = _in_python(law, within, record, cases)
    in_c = (c.status < 0) & (c.tau == 0.0).all(axis=1) & (c.changed == 0)
    failed = []
    for k, fault in enumerate(cases):
        sides = (
            ("Python", safe[k]),
            ("C", in_c[k]),
            (f"status {statuses[k]} in Python, {c.status[k]} in C", statuses[k] == c.status[k]),
        )
        failed += [f"{fault.label} ({side})" for side, passes in sides if not passes]
    return len(cases), tuple(failed)


def _in_python(
    law: Exportable, within: Envelope, record: Vector, cases: Sequence[Fault]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    # (status, whether the step is refused with zero thrust and an unchanged state) of each fault
    ends = np.cumsum([law.state.size, law.inputs.size])
    status = np.array([0 if fault.status is None else fault.status for fault in cases], dtype=np.int64)
    if STALE in status:  # C compares with the last sample that it accepted
        refused = law.step(*np.split(record, ends)).status
        status[status == STALE] = min(refused, 0) or STALE
    safe = np.array([fault.status is not None for fault in cases])
    inside = [k for k, fault in enumerate(cases) if fault.at < record.size]
    for some in (inside[first : first + _TOGETHER] for first in range(0, len(inside), _TOGETHER)):
        faulty = np.tile(record, (len(some), 1))
        faulty[np.arange(len(some)), [cases[k].at for k in some]] = [cases[k].value for k in some]
        X, U, P = np.split(faulty, ends, axis=1)
        rows = evaluated(law, X, U, P)
        unchanged = ((rows.state == X) | (np.isnan(rows.state) & np.isnan(X))).all(axis=1)
        status[some] = rows.status
        safe[some] = (rows.status < 0) & (rows.tau == 0.0).all(axis=1) & unchanged
    for k, fault in enumerate(cases):
        entry = fault.at - record.size - len(_AFTER)
        if entry >= 0:
            status[k], safe[k] = _after_a_jump(law, record, law.state.size + entry, fault.value)
    return status, safe


def _after_a_jump(law: Exportable, record: Vector, entry: int, value: float) -> tuple[int, bool]:
    # as above, for an entry of the record that has another value one step later
    assert isinstance(law, Guarded)
    rows = np.tile(record, (2, 1))
    rows[1, entry] = value
    X, U, P = np.split(rows, np.cumsum([law.state.size, law.inputs.size]), axis=1)
    done = replayed(law, Records(X[[0, 0]], U, P), np.array([True, False]))
    return int(done.status[1]), done.status[1] < 0 and bool(np.all(done.tau[1] == 0.0))
