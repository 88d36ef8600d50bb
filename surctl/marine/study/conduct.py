"""Conduct a study in one call: sweep, choice of gains, margins, claims, runs, export, SIL test, and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from surctl import __version__
from surctl.assessment import Assessment, Line, assess
from surctl.export import ExportedFile, SilReport
from surctl.files import prepare_folder, write_file
from surctl.ir import find_compiler
from surctl.marine.assessment import Mission
from surctl.marine.control import Gains, Law, build_law, law_source, write_gains
from surctl.marine.simulation import Run, simulate
from surctl.marine.study.loops import Loops, loops_of
from surctl.marine.study.notes import left_out, summary
from surctl.marine.study.plan import Leg, Plan
from surctl.marine.study.shipping import Shipment, shipping, with_perception
from surctl.marine.tuning import SweepTable, has_tuned, sweep
from surctl.marine.verification import applicable_claims
from surctl.marine.verification.region import refused_regions
from surctl.tuning import LocalExecutor, grid
from surctl.verification import Inapplicable, Verdict, decide

if TYPE_CHECKING:
    from surctl.marine.report import ExportSummary

__all__ = ["Study", "conduct"]

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes:
        assessment: the figures and the lines of the summary, worst first.
        runs: simulated runs with true positions and with sonar, in the plan's order.
        inapplicable: claims that do not concern the vehicle, each with the reason; such a claim counts as failed if the
            plan names it.
        deciding: for each run, whether the run counts towards the result of the study.
        replayed: the sonar runs that were repeated with the exported C; without sonars (`Plan.unheard`), the runs with
            true positions. These are the runs of the exported law in which the hull fits the site.
        loops: linear analysis of the control loops; empty if the law has no linear model.
        sil: software-in-the-loop (SIL) reports, one report for each replayed run.
        report: the written page; None if it could not be drawn or written.
    """

    plan: Plan
    sweep: SweepTable
    loops: Loops
    verdicts: tuple[Verdict, ...]
    inapplicable: tuple[Inapplicable, ...]
    runs: tuple[Run, ...]
    deciding: tuple[bool, ...]
    replayed: tuple[Run, ...]
    files: tuple[ExportedFile, ...]
    sil: tuple[SilReport, ...]
    assessment: Assessment
    report: Path | None
    gain_file: Path
    seconds: dict[str, float]

    @property
    def passed(self) -> bool:
        """Whether no line that counts towards the result fails."""
        return self.assessment.passed is not False

    @property
    def notes(self) -> tuple[Line, ...]:
        """The lines of the summary, worst first."""
        return self.assessment.lines

    def to_dict(self) -> dict[str, Any]:
        """Return the study as plain data; the writer converts numbers that are not finite."""
        picked = self.sweep.picked
        return {
            "study": self.plan.name,
            "vehicle": self.plan.vehicle.name,
            "passed": self.passed,
            "banner": self.assessment.banner,
            "figures": self.assessment.to_dict()["figures"],
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
            "margins": [m.to_dict() for m in self.loops.margins],
            "linear": self.loops.to_dict(),
            "verdicts": [*(v.to_dict() for v in self.verdicts), *(v.to_dict() for v in self.inapplicable)],
            "runs": [run.to_dict() | {"decides": d} for run, d in zip(self.runs, self.deciding, strict=True)],
            "not_simulated": [
                {"scenario": leg.scenario.name, "reason": leg.exclusion} for leg in self.plan.legs if leg.exclusion
            ],
            "export": {
                "files": [str(f.path) for f in self.files],
                "sha256": {f.path.relative_to(self.files[0].path.parent).as_posix(): f.sha256 for f in self.files},
                "sensing": _sensing(self.plan),
                "sil": [
                    {"scenario": run.scenario.name, "vehicle": run.vehicle.name, **report.to_dict()}
                    for run, report in zip(self.replayed, self.sil, strict=True)
                ],
            },
            "report": None if self.report is None else str(self.report),
            "seconds": self.seconds,
        }


def conduct(
    plan: Plan,
    out: Path,
    *,
    workers: int = 2,
    progress: Progress = lambda _: None,
    command: str = "",
    film: bool = False,
    saving: Callable[[str], AbstractContextManager[object]] = nullcontext,
) -> Study:
    """Conduct all parts of the study that the plan contains and return the finished study.

    Args:
        plan: the plan of the study to conduct.
        out: output folder for report, gain file, sweep table and exported C bundle.
        workers: number of processes that compute the sweep.
        progress: function that receives one line of text at each step of the work.
        command: the command line that the report shows.
        film: whether the report shows MuJoCo's pictures of the scene beside the plan view of the decisive run.
        saving: returns a context for the named part of the report, which may suppress the errors of that part.

    Raises:
        InputError: the folder cannot be written, there is no compiler, or the law cannot use the
            sonars of a scenario. All these errors are raised before the long computations start.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.study import conduct, load_plan
        >>> _ = Path("mine.toml").write_text('''
        ... kind = "study"
        ... name = "mine"
        ... vehicle = "sur400"
        ... law = "paper"
        ... claims = ["m-norm-corrected"]
        ... [[runs]]
        ... scenario = "pool-speed-010"
        ... [sweep]
        ... axes = [{ gain = "k_v", values = [1.5] }]
        ... ''')
        >>> study = conduct(load_plan("mine.toml"), Path("out"), workers=1)
        >>> sorted(path.name for path in Path("out").iterdir())
        ['export', 'gains.toml', 'report.html', 'sweep.nc']
        >>> study.verdicts[0].verdict, study.runs[0].metrics.stopped_because, study.sil[0].passed
        ('proved', 'reached', True)
    """
    from surctl.marine.report import ReportData, runs_section, write_page
    from surctl.report.document import Section, checks_of

    find_compiler()
    prepare_folder(out)
    plan = plan.written(out / "missions")
    clock, legs = _Clock(progress), tuple(leg for leg in plan.legs if not leg.exclusion)
    laws = tuple(build_law(plan.law, guidance=plan.guidance, actuators=leg.vehicle.actuators) for leg in legs)
    sonar_laws = tuple(with_perception(plan, leg) for leg in legs)  # errors here come before the long work
    first = next(k for k, leg in enumerate(legs) if leg.misfit is None)
    with ExitStack() as stack:
        with clock("sweep"):
            swept = _sweep(plan, out, workers, progress)
            gain_file = write_file(out / "gains.toml", write_gains(swept.gains))
        with clock("export"):
            shipment = stack.enter_context(shipping(sonar_laws[first], swept.gains, legs[first], out / "export"))
        with clock("runs"):
            leg_runs = _simulate_legs(plan, legs, (laws, sonar_laws), swept, progress)
        runs = tuple(run for _, run in leg_runs)
        deciding = tuple(leg.misfit is None and run.sensing == _sensing(plan) for leg, run in leg_runs)
        with clock("assessment"):
            assessment = assess(assessed(plan, swept.gains, runs=runs, extra=tuple(not each for each in deciding)))
            loops = loops_of(plan, swept.gains, assessment.sources["loop"], dt=laws[0].dt)
        with clock("claims"):
            # claims about braking take a minute and stay undecided: check them only if the plan names them
            fastest = max((leg.scenario for leg in plan.deciding), key=lambda scenario: scenario.cruise)
            at_hand = {**swept.gains.values, "speed": fastest.cruise, "speed_max": fastest.cap}
            applicable, refused = applicable_claims(at_hand, plan.claims, vehicle=plan.vehicle)
            inapplicable = tuple(Inapplicable.of(name, reason) for name, reason in refused.items())
            if not law_source(plan.law).parts:  # the claims are about parts of the built-in laws
                named = plan.claims or ()
                applicable, inapplicable = (), tuple(Inapplicable(name, _NO_PART, "this law") for name in named)
            elif plan.claims is None and not has_tuned(plan.vehicle):  # the paper's claims are about its own robot
                applicable, inapplicable = (), ()
            verdicts = tuple(decide(claim) for claim in applicable if plan.claims or claim.paper)
            regions = _unprovable_regions(plan, swept.gains, speeds=(fastest.cruise, fastest.cap))
        sonar_runs = [run for leg, run in leg_runs if leg.misfit is None and run.sensing == _sensing(plan)]
        replayed = tuple(run for run in sonar_runs if shipment.carries(run))
        with clock("pictures of the runs"):  # in parallel with the compiler
            data = ReportData(
                title=f"Study {plan.name}",
                command=command,
                version=__version__,
                vehicle=plan.vehicle,
                gains=swept.gains,
                speeds=(fastest.cruise, fastest.cap),
                margins=loops.margins,
                linear=loops.analysis.sides,
                poles=loops.analysis.poles,
                loops=loops.responses,
                gains_file=str(gain_file),
                verdicts=verdicts,
                inapplicable=inapplicable,
                regions=regions,
                runs=runs,
                deciding=deciding,
                sweep=swept,
                film=film,
            )
            section, report = Section("runs", "Closed-loop runs", ()), None
            with saving("plots of the runs"):
                section = runs_section(data)
        with clock("software in the loop"):
            sil = shipment.replayed(replayed)
    assessment = summary(
        plan,
        swept,
        assessment,
        loops,
        (*verdicts, *inapplicable),
        runs,
        sil,
    )
    assessment = assessment.with_lines(left_out([run for run in sonar_runs if run not in replayed]))
    with clock("report"), saving("report"):
        data = replace(
            data,
            export=_export_summary(plan, shipment, replayed, sil),
            seconds=dict(clock.seconds),
            banner=assessment.banner,
            summary=checks_of(assessment),
        )
        report = write_page(data, out / "report.html", runs=section)
    seconds = dict(clock.seconds)
    return Study(
        plan,
        swept,
        loops,
        verdicts,
        inapplicable,
        runs,
        deciding,
        replayed,
        shipment.files,
        sil,
        assessment,
        report,
        gain_file,
        seconds,
    )


def assessed(plan: Plan, gains: Gains, *, runs: tuple[Run, ...] | None = None, extra: tuple[bool, ...] = ()) -> Mission:
    """Return the subject of a study: its vehicle with these gains, in the missions that count; see `Mission`."""
    fastest = max((leg.scenario for leg in plan.deciding), key=lambda scenario: scenario.cruise)
    return Mission(
        plan.vehicle,
        gains,
        fastest.cruise,
        fastest.cap,
        plan.law,
        plan.guidance,
        tuple(leg.scenario for leg in plan.deciding),
        sensing="truth" if plan.unheard else None,
        hulls=tuple(leg.vehicle for leg in plan.deciding),
        runs=runs,
        extra=extra,
    )


def _unprovable_regions(plan: Plan, gains: Gains, *, speeds: tuple[float, float]) -> tuple[Inapplicable, ...]:
    """Return the region claims that cannot be proved for the vehicle, one record for each reason."""
    if not law_source(plan.law).parts:
        return ()
    refused = refused_regions(plan.vehicle, gains, cruise=speeds[0], cap=speeds[1])
    return tuple(Inapplicable(", ".join(names), reason.because, reason.to) for reason, names in refused)


_NO_PART = "the claim is about a part of the built-in laws"


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


def _sensing(plan: Plan) -> Literal["truth", "sonar"]:
    # what the exported law measures
    return "truth" if plan.unheard else "sonar"


def _export_summary(
    plan: Plan, shipment: Shipment, replayed: Sequence[Run], sil: tuple[SilReport, ...]
) -> ExportSummary:
    from surctl.marine.report import ExportSummary

    status = "The exported law estimates its position and the obstacles from sonars, base station and IMU."
    if plan.unheard:
        status = f"The exported law takes the pose, the velocity and the obstacles as inputs, because {plan.unheard}."
    status += " Replayed runs: "
    status += "; ".join(f"{k}: {run.scenario.name} by {run.vehicle.name}" for k, run in enumerate(replayed, start=1))
    bundle = shipment.bundle
    return ExportSummary(name=bundle.name, id=bundle.id, files=shipment.files, sil=sil, status=f"{status}.")


def _sweep(plan: Plan, out: Path, workers: int, progress: Progress) -> SweepTable:
    return sweep(
        plan.sweep_cases,
        grid(plan.grid),
        seeds=plan.sweep_seeds,
        cruise=plan.cruise,
        executor=LocalExecutor(workers),
        out=out,
        progress=progress,
    )


def _simulate_legs(
    plan: Plan, legs: Sequence[Leg], laws: tuple[Sequence[Law], Sequence[Law]], swept: SweepTable, progress: Progress
) -> list[tuple[Leg, Run]]:
    # with true positions by the law in `laws[0]`, with sonar by the law in `laws[1]`
    leg_runs = []
    for leg, law_of_truth, sonar_law in zip(legs, *laws, strict=True):
        for sensing, law in (("truth", law_of_truth), ("sonar", sonar_law))[: 1 if plan.unheard else 2]:
            run = simulate(leg.scenario, leg.vehicle, gains=swept.gains, law=law, sensing=sensing, seed=plan.seed)
            m = run.metrics
            progress(f"{leg.scenario.name} {sensing}: {m.stopped_because} at {m.time_s:.1f} s")
            leg_runs.append((leg, run))
    return leg_runs
