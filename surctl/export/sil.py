"""Software in the loop: C with a state of its own against Python over recorded runs, and with invalid inputs."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.bundle import build_bundle
from surctl.export.contract import Exportable, command_word, entries
from surctl.export.envelope import NULL, STALE, AnyRecord, Envelope, Records, Rows, anywhere, as_records
from surctl.export.precision import Guarded, evaluated, replayed, rounded
from surctl.export.process import Controller, build_controller
from surctl.ir import Real
from surctl.ir.cache import compiler_version

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


TOLERANCE = 1e-12
"""Largest difference that passes: relative for numbers above 1, absolute for others."""

_BLOCK = 256  # number of steps that are compared at once
_JUMP = 1e-9  # a recorded state that differs more than this from the law's own next state was set from outside


@dataclass(frozen=True)
class Difference:
    """Largest difference of one kind of number over a run.

    Attributes:
        absolute: max |C − Python|.
        relative: max |C − Python| / |Python|, over numbers that are not 0 in Python.
        mixed: max |C − Python| / max(1, |Python|), which is compared with `TOLERANCE`.
        step: index of the step with the largest mixed difference, None if all numbers are equal.
    """

    absolute: float
    relative: float
    mixed: float
    step: int | None


@dataclass(frozen=True)
class SilReport:
    """Verdict of one software-in-the-loop run.

    Attributes:
        steps: number of steps T.
        resets: number of steps whose recorded state does not follow from the previous step; there, C continues from the
            recorded state. Steps at which the law's host moved the window of its waypoints do not count.
        tau, state, telemetry: largest differences of thrust, of state and of telemetry.
        status_mismatches: number of steps at which C and Python return different status codes.
        fault_cases: number of invalid inputs tried in C and in Python, see `faults`.
        fault_failures: invalid inputs that did not give zero thrust, a negative status and an unchanged state.
        self_test: whether the exported self-test passes.
        code_bytes: size of code and constants, None when unknown.
        command: word for tau in the summary: "thrust", or "command" for a controller of another plant.
    """

    name: str
    id: str
    steps: int
    resets: tuple[int, ...]
    tau: Difference
    state: Difference
    telemetry: Difference
    status_mismatches: int
    fault_cases: int
    fault_failures: tuple[str, ...]
    self_test: bool
    compiler: str
    code_bytes: int | None
    command: str = "thrust"

    @property
    def passed(self) -> bool:
        """Return whether every difference is within `TOLERANCE` and every other check holds."""
        near = all(d.mixed <= TOLERANCE for d in (self.tau, self.state, self.telemetry))
        return near and self.status_mismatches == 0 and not self.fault_failures and self.self_test

    @property
    def exact(self) -> bool:
        """True if C passed, was also compared with Python in accepted steps, and no number differs."""
        return self.conclusive and not any(part.absolute for part in (self.tau, self.state, self.telemetry))

    @property
    def conclusive(self) -> bool:
        """Return whether the test passed, and C continued from its own state at every step after the first."""
        return self.passed and not self.resets

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON, with the mixed differences."""
        return {
            "passed": self.conclusive,
            "steps": self.steps,
            "tau": self.tau.mixed,
            "state": self.state.mixed,
            "telemetry": self.telemetry.mixed,
            "status_mismatches": self.status_mismatches,
            "fault_cases": self.fault_cases,
            "fault_failures": list(self.fault_failures),
            "compiler": self.compiler,
            "code_bytes": self.code_bytes,
        }

    def summary(self) -> str:
        """Return the report as a few lines of text."""
        size = "" if self.code_bytes is None else f", {self.code_bytes} bytes of code and constants"
        resets = f", state loaded anew {len(self.resets)} times" if self.resets else ""
        lines = [
            f"SIL {self.name}: {'passed' if self.passed else 'FAILED'} over {self.steps} steps{resets}",
            f"  largest difference (limit {TOLERANCE:g}): {self.command} {self.tau.mixed:.1e}, "
            f"state {self.state.mixed:.1e}, telemetry {self.telemetry.mixed:.1e}",
            f"  status: {self.status_mismatches} of {self.steps} steps differ; "
            f"self-test {'ok' if self.self_test else 'FAILED'}",
            f"  bad inputs: {self.fault_cases} cases, {len(self.fault_failures)} failures",
            f"  {self.compiler}{size}",
        ]
        lines += [f"  failed: {label}" for label in self.fault_failures[:5]]
        return "\n".join(lines)


def software_in_the_loop(
    law: Exportable, records: AnyRecord, *, workdir: Path | str | None = None, real: Real = "float64"
) -> SilReport:
    """Export the law, compile it, and compare it with Python over a recorded run.

    C starts from the first recorded state and then steps on its own; only the inputs come from the record. Python is
    evaluated on each recorded state. If a recorded state does not follow from the previous step (because the controller
    was reset, or another run begins), C continues from the recorded state; the report counts such steps.

    Args:
        law: the control law.
        records: (x, u, p) of each step, `Records`, or the `Record` of a system.
        workdir: folder for the bundle and the program, which stay there; None uses a temporary folder.
        real: precision of the bundle; Python rounds the result of every operation to this precision.

    Raises:
        ToolMissing: there is no compiler.
        SurctlError: the compiler refuses the bundle, or the program crashes.
        InputError: the records do not fit the law.

    Example:
        >>> from surctl.export import Records, software_in_the_loop
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> cart = cart_system()
        >>> report = software_in_the_loop(cart.controller, Records(*run_system(cart, 2.0).controller))
        >>> report.passed, report.tau.mixed, len(report.fault_failures)
        (True, 0.0, 0)
    """
    recorded = as_records(law, records)
    gains = recorded.P[0]  # the bundle is built with the gains of the first record
    if not np.all(np.isfinite(gains)):
        raise InputError("the first record's gains are not finite", key="records.P", remedy="give finite gains")
    bundle = build_bundle(law, law.gains.unpack(gains), real=real)
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        folder = Path(scratch) / bundle.name if workdir is None else Path(workdir)
        controller = build_controller(law, bundle, folder)
        return compare_runs(controller, [recorded])[0]


def compare_runs(controller: Controller, runs: Sequence[AnyRecord]) -> tuple[SilReport, ...]:
    """Return the report of `software_in_the_loop` for each recorded run of a controller that is already compiled.

    Raises:
        SurctlError: the program crashes.
        InputError: the records do not fit the law.

    Example:
        >>> from pathlib import Path
        >>> from surctl.export import Records, build_controller, compare_runs
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> cart = cart_system()
        >>> controller = build_controller(cart.controller, build_bundle(cart.controller, {"k": 1.0}), Path("brake"))
        >>> [report] = compare_runs(controller, [Records(*run_system(cart, 2.0).controller)])
        >>> report.passed, report.steps, report.tau.mixed
        (True, 20, 0.0)
    """
    self_test = controller.self_test()
    return tuple(_compare(controller, as_records(controller.law, run), self_test=self_test) for run in runs)


def _compare(controller: Controller, run: Records, *, self_test: bool) -> SilReport:
    law = controller.law
    if controller.bundle.real != "float64":
        run = _on_its_own(controller, run)
    rows = evaluated(law, run.X, run.U, run.P)
    load = _resets(run, rows)
    python = replayed(law, run, load, rows=rows)
    c = controller.run(run, load=load)
    cases, failures = fault_failures(law, controller, run)
    done = python.status >= 0  # a refused step has no telemetry
    return SilReport(
        name=controller.bundle.name,
        id=controller.bundle.id,
        steps=len(run),
        resets=tuple(int(k) for k in np.flatnonzero(load & ~_moved(law, run)) if k > 0),
        tau=_difference(c.tau, python.tau),
        state=_difference(c.state, python.state),
        telemetry=_difference(c.telemetry[done], python.telemetry[done]),
        status_mismatches=int(np.sum(python.status != c.status)),
        fault_cases=cases,
        fault_failures=failures,
        self_test=self_test,
        compiler=compiler_version(),
        code_bytes=controller.code_bytes,
        command=command_word(law),
    )


def _on_its_own(controller: Controller, run: Records) -> Records:
    """Return the recorded inputs with the states that C computes; in float32 these differ from the recorded states.

    Python computes each step from these states, so every wrong step of C is detected. If no step is wrong, C and Python
    agree over the whole run.
    """
    first = np.zeros(len(run), dtype=bool)
    first[0] = True
    states = controller.run(run, load=first).state
    return Records(*(rounded(v) for v in (np.vstack([run.X[:1], states[:-1]]), run.U, run.P)))


def _resets(run: Records, python: Rows) -> NDArray[np.bool_]:
    # (T,): C is loaded at the first step and at each step whose state does not follow from the previous step
    load = np.zeros(len(run), dtype=bool)
    load[0] = True
    load[1:] = ~(_mixed(run.X[1:], python.state[:-1]) <= _JUMP).all(axis=1)
    return load


def _moved(law: Exportable, run: Records) -> NDArray[np.bool_]:
    # (T,): steps at which the host fed other waypoints, and changed the arc lengths in the state with them
    if "waypoints" not in law.gains:
        return np.zeros(len(run), dtype=bool)
    waypoints = run.P[:, law.gains.slice("waypoints")]
    return np.append(False, np.any(waypoints[1:] != waypoints[:-1], axis=1))


def _difference(mine: Vector, theirs: Vector) -> Difference:
    # `_BLOCK` steps at a time, to bound the memory
    absolute = relative = worst = 0.0
    step = None
    for first in range(0, len(mine) if mine.size else 0, _BLOCK):
        have, want = mine[first : first + _BLOCK], theirs[first : first + _BLOCK]
        gap, mixed, size = _gap(have, want), _mixed(have, want), np.abs(want)
        share = np.divide(gap, size, out=np.zeros_like(gap), where=size > 0.0)
        absolute, relative = max(absolute, float(gap.max())), max(relative, float(share.max()))
        if float(mixed.max()) > worst:
            worst, step = float(mixed.max()), first + int(np.argmax(mixed.max(axis=1)))
    return Difference(absolute, relative, worst, step)


def _gap(have: Vector, want: Vector) -> Vector:
    # 0 for two equal or two NaN entries, inf if only one of the two entries is finite
    same = (have == want) | (np.isnan(have) & np.isnan(want))
    with np.errstate(invalid="ignore"):
        gap: Vector = np.where(same, 0.0, np.abs(have - want))
    return np.where(np.isnan(gap), np.inf, gap)


def _mixed(have: Vector, want: Vector) -> Vector:
    scale = np.where(np.isfinite(want), np.maximum(1.0, np.abs(want)), 1.0)
    return _gap(have, want) / scale
