"""The main job in one go: sweep, pick, margins, claims, flights, export, SIL, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from surctl import __version__
from surctl.control import Law, build_law, write_gains
from surctl.export import ExportedFile, Records, SilReport, build_bundle, software_in_the_loop_runs, write_bundle
from surctl.files import prepare_folder, write_file
from surctl.ir import find_compiler
from surctl.simulation import Run, simulate
from surctl.study.plan import Plan
from surctl.tuning import LocalExecutor, SweepTable, grid, sweep
from surctl.verification import LoopMargins, Verdict, claims, closed_loop_poles, falsify, loop_margins

__all__ = ["Note", "Study", "conduct"]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Note:
    """One line of the study's summary; `passed` is None when it does not decide."""

    passed: bool | None
    text: str


@dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes:
        passed: every deciding note holds.
        notes: the summary.
        runs: flights with true positions and through the sonar, in the plan's order.
        deciding: for each run, whether it decides.
        sil: one report a deciding flight with true positions.
    """

    plan: Plan
    sweep: SweepTable
    margins: tuple[LoopMargins, ...]
    verdicts: tuple[Verdict, ...]
    runs: tuple[Run, ...]
    deciding: tuple[bool, ...]
    files: tuple[ExportedFile, ...]
    sil: tuple[SilReport, ...]
    notes: tuple[Note, ...]
    report: Path
    gain_file: Path
    seconds: dict[str, float]

    @property
    def passed(self) -> bool:
        """Whether every deciding note holds."""
        return all(note.passed is not False for note in self.notes)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; numbers that are not finite are left to the writer."""
        picked = self.sweep.picked
        return {
            "study": self.plan.name,
            "vehicle": self.plan.vehicle.name,
            "passed": self.passed,
            "summary": [asdict(note) for note in self.notes],
            "gains": {
                "file": str(self.gain_file),
                "values": dict(self.sweep.gains.values),
                "provenance": self.sweep.gains.provenance,
            },
            "sweep": {
                "axes": {axis.name: axis.values.tolist() for axis in self.sweep.axes},
                "picked": None if picked is None else list(picked),
                "cases": list(self.sweep.cases),
                "table": str(self.sweep.path),
                "columns": {name: self.sweep.column(name).tolist() for name in self.sweep.columns},
            },
            "margins": [m.to_dict() for m in self.margins],
            "verdicts": [v.to_dict() for v in self.verdicts],
            "runs": [run.to_dict() | {"decides": d} for run, d in zip(self.runs, self.deciding, strict=True)],
            "not_flown": [
                {"scenario": leg.scenario.name, "reason": leg.obstacle_to_flying}
                for leg in self.plan.legs
                if leg.obstacle_to_flying
            ],
            "export": {
                "files": [str(f.path) for f in self.files],
                "sha256": {f.path.name: f.sha256 for f in self.files},
                "sil": [report.to_dict() for report in self.sil],
            },
            "report": str(self.report),
            "seconds": self.seconds,
        }


def conduct(
    plan: Plan, out: Path, *, workers: int = 2, progress: Progress = lambda _: None, command: str = ""
) -> Study:
    """Do everything the plan says.

    Args:
        plan: the study.
        out: folder for report, gain file, sweep table and exported bundle.
        workers: processes of the sweep.
        progress: told one line at a time what is going on.
        command: the command line, for the report.

    Raises:
        InputError: the folder cannot be written, or there is no compiler. Both are found before the long work.
    """
    from surctl.report import ExportSummary, ReportData, loop_responses, write_page

    prepare_folder(out)
    find_compiler()
    law = build_law(plan.law)
    clock = _Clock(progress)
    with clock("sweep"):
        swept = _sweep(plan, out, workers, progress)
        gain_file = write_file(out / "gains.toml", write_gains(swept.gains))
    with clock("margins"):
        cruise = max(leg.scenario.cruise for leg in plan.deciding)
        margins = loop_margins(plan.vehicle, swept.gains.values, cruise=cruise, dt=law.dt)
        poles = closed_loop_poles(plan.vehicle, swept.gains.values, cruise=cruise, dt=law.dt)
    with clock("claims"):
        verdicts = tuple(falsify(claim) for claim in claims(swept.gains.values, plan.claims))
    with clock("flights"):
        runs, deciding = _fly(plan, law, swept, progress)
    with clock("export"):
        first = next(r for r, d in zip(runs, deciding, strict=True) if d)
        bundle = build_bundle(law, law.gains.unpack(first.record.law_parameters))
        files = tuple(write_bundle(bundle, out / "export"))
        sil = _sil(law, [run for run, d in zip(runs, deciding, strict=True) if d])
    notes = _notes(plan, swept, margins, verdicts, runs, deciding, sil)
    with clock("report"):
        data = ReportData(
            title=f"Study {plan.name}",
            command=command,
            version=__version__,
            vehicle=plan.vehicle,
            gains=swept.gains,
            margins=margins,
            poles=poles,
            loops=loop_responses(plan.vehicle, swept.gains.values, cruise=cruise, dt=law.dt),
            gains_file=str(gain_file),
            verdicts=verdicts,
            runs=runs,
            deciding=deciding,
            sweep=swept,
            export=ExportSummary(name=bundle.name, id=bundle.id, files=files, sil=sil),
            seconds=dict(clock.seconds),
            summary=tuple((note.passed, note.text) for note in notes),
        )
        report = write_page(data, out / "report.html")
    return Study(
        plan, swept, margins, verdicts, runs, deciding, files, sil, notes, report, gain_file, dict(clock.seconds)
    )


class _Clock:
    def __init__(self, progress: Progress) -> None:
        self.progress, self.seconds = progress, dict[str, float]()

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        self.progress(f"{stage} ...")
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 2)
        self.progress(f"{stage} done in {self.seconds[stage]:.1f} s")


def _sweep(plan: Plan, out: Path, workers: int, progress: Progress) -> SweepTable:
    return sweep(
        plan.sweep_cases,
        grid(plan.axes),
        seeds=plan.sweep_seeds,
        executor=LocalExecutor(workers),
        out=out,
        progress=progress,
    )


def _fly(plan: Plan, law: Law, swept: SweepTable, progress: Progress) -> tuple[tuple[Run, ...], tuple[bool, ...]]:
    runs, deciding = [], []
    for leg in plan.legs:
        if leg.obstacle_to_flying:
            continue
        for sensing in ("truth", "sonar"):
            flown = law if sensing == "truth" else None  # with sonars, what the scenario has of them
            run = simulate(leg.scenario, leg.vehicle, gains=swept.gains, law=flown, sensing=sensing, seed=plan.seed)
            m = run.metrics
            progress(f"{leg.scenario.name} {sensing}: {m.stopped_because} at {m.time_s:.1f} s")
            runs.append(run)
            deciding.append(sensing == "truth" and leg.misfit is None)
    return tuple(runs), tuple(deciding)


def _sil(law: Law, runs: Sequence[Run]) -> tuple[SilReport, ...]:
    records = [run.record for run in runs]
    return software_in_the_loop_runs(law, [Records(r.law_state, r.law_input, r.law_parameters) for r in records])


def _notes(
    plan: Plan,
    swept: SweepTable,
    margins: tuple[LoopMargins, ...],
    verdicts: tuple[Verdict, ...],
    runs: tuple[Run, ...],
    deciding: tuple[bool, ...],
    sil: tuple[SilReport, ...],
) -> tuple[Note, ...]:
    notes = []
    feasible = int((swept.column("feasible") > 0.5).sum())
    points = swept.column("feasible").size
    if swept.picked is None:
        notes.append(Note(False, f"sweep: none of {points} points is feasible; the gains of the file are kept"))
    else:
        at = list(zip(swept.axes, swept.picked, strict=True))
        chosen = ", ".join(f"{a.name} = {a.values[k]:g} {a.unit}" for a, k in at)
        edges = [a.name for a, k in at if len(a.values) > 1 and k in (0, len(a.values) - 1)]
        edge = f" (on the edge of the grid in {' and '.join(edges)}: a wider one may do better)" if edges else ""
        notes.append(Note(True, f"sweep: {feasible} of {points} points are feasible; picked {chosen}{edge}"))
    least = min(margins, key=lambda m: m.delay_margin_s)
    stable = all(m.stable for m in margins)
    told = f"margins: least delay margin {least.delay_margin_s:.2f} s ({least.name}), least disk margin "
    notes.append(Note(stable, told + f"{min(m.disk_margin for m in margins):.2f}"))
    unexpected = [v.claim.name for v in verdicts if not v.as_expected]
    refuted = sum(v.verdict == "refuted" for v in verdicts)
    text = f"claims: {refuted} refuted, {len(verdicts) - refuted} not refuted, "
    notes.append(Note(not unexpected, text + ("all as expected" if not unexpected else f"unexpected: {unexpected}")))
    for run, decides in zip(runs, deciding, strict=True):
        m = run.metrics
        good = m.reached and m.min_clearance_m > 0
        line = f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}: {m.stopped_because} at {m.time_s:.1f} s"
        notes.append(Note(good if decides else None, f"{line}, least clearance {m.min_clearance_m:.3f} m"))
    for leg in plan.legs:
        if leg.obstacle_to_flying or leg.misfit:
            reason = leg.obstacle_to_flying or leg.misfit
            notes.append(Note(None, f"{leg.scenario.name} does not decide: {reason}"))
    worst = max((max(r.tau.mixed, r.state.mixed, r.telemetry.mixed) for r in sil), default=0.0)
    steps, cases = sum(r.steps for r in sil), sum(r.fault_cases for r in sil)
    passed = all(r.conclusive for r in sil)
    notes.append(Note(passed, f"export: C equals Python to {worst:.1e} over {steps} steps; {cases} faults tried"))
    return tuple(notes)
