"""Conduct a study in one call: sweep, gains, margins, claims, runs, export, replay in C, report; summary lines."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from surctl import __version__
from surctl.assessment import Assessment, Line, assess
from surctl.export import (
    Bundle,
    Controller,
    ExportedFile,
    Records,
    SilReport,
    build_controller,
    compare_runs,
    write_bundle,
)
from surctl.files import prepare_folder, write_file
from surctl.ir.cache import find_compiler
from surctl.marine.assessment import LoopAnalysis, Mission
from surctl.marine.control import Gains, Law, build_law, law_source, write_gains
from surctl.marine.export import build_bundle
from surctl.marine.export.origin import origin_of
from surctl.marine.simulation import Run, Scenario, findings, law_numbers, simulate
from surctl.marine.study.plan import Leg, Plan
from surctl.marine.tuning import MissionSweep, picked_gains
from surctl.marine.tuning.derived import has_tuned
from surctl.marine.verification import law_loop, over_speeds
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.region import refused_regions
from surctl.marine.verification.speeds import OverSpeeds, speeds_text
from surctl.system import LinearLoop
from surctl.tuning import LocalExecutor, SweepTable, grid, sweep
from surctl.verification import Inapplicable, LoopMargins, Verdict, decide
from surctl.verification.linear import short_margins

if TYPE_CHECKING:
    from surctl.report.document import Section


@dataclass(frozen=True)
class Loops:
    """Linear analysis of the missions that count towards the result.

    Attributes:
        analysis: the analysis at their largest cruise speed, as it was assessed.
        over: metrics of the linear loops at the cruise speeds that the plan names, or None.
        loops: the sampled loop at each speed, by name of the speed; empty if there is no analysis.
    """

    analysis: LoopAnalysis
    over: OverSpeeds | None = None
    loops: Mapping[str, LinearLoop] = field(default_factory=dict)

    @property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Delay margin and disk margin of each loop alone."""
        return self.analysis.margins

    def to_dict(self) -> dict[str, Any] | None:
        """Return the analysis of all loops together as plain data; None if there is none."""
        one = self.analysis
        if one.law is not None:
            return one.law.to_dict()
        if one.mode is None:
            return None
        nominal, worst = one.sides
        table = {"nominal": nominal.to_dict(), "worst": worst.to_dict(), "mode": one.mode.to_dict()}
        return table | ({} if self.over is None else {"speeds": self.over.to_dict()})


def loops_of(plan: Plan, gains: Gains, analysis: LoopAnalysis) -> Loops:
    """Return the control loops of a plan's vehicle with these gains."""
    if analysis.law is not None:
        return Loops(analysis, loops={analysis.law.nominal.place or "nominal": analysis.law.nominal.linear})
    if analysis.mode is None:
        return Loops(analysis)
    vehicle, law = plan.vehicle, build_law(plan.law)
    speeds = sorted({*plan.cruise, analysis.cruise}, reverse=True)
    return Loops(
        analysis,
        over_speeds(vehicle, gains.values, cruise=plan.cruise, dt=law.dt, law=plan.law) if plan.cruise else None,
        {f"{u:g} m/s": law_loop(law, vehicle, gains, cruise=u).linear for u in speeds},
    )


def summary(
    plan: Plan,
    swept: SweepTable,
    assessment: Assessment,
    loops: Loops,
    verdicts: Sequence[Verdict | Inapplicable],
    runs: Sequence[Run],
    sil: Sequence[SilReport],
) -> Assessment:
    """Return the assessment of a study with the lines of its sweep, claims, runs and export.

    Args:
        plan: the plan of the study.
        swept: the parameter sweep of the study.
        assessment: what is assessed of the vehicle with the gains of the sweep.
        loops: linear analysis of the control loops; empty if the law has no linear model.
        verdicts: verdicts on the claims of the study.
        runs: runs of the study.
        sil: software-in-the-loop (SIL) reports, one report for each run that the exported law replayed.
    """
    notes = list[Line]()
    feasible = int((swept.column("feasible") > 0.5).sum())
    points = swept.column("feasible").size
    if swept.picked is None:
        notes.append(Line(False, f"sweep: none of {points} points is feasible; the gains stay unchanged", "sweep"))
    else:
        at = list(zip(swept.axes, swept.picked, strict=True))
        chosen = ", ".join(f"{a.name} = {a.values[k]:g} {a.unit}" for a, k in at)
        edges = [a.name for a, k in at if len(a.values) > 1 and k in (0, len(a.values) - 1)]
        edge = f" (on the edge of the grid in {' and '.join(edges)}: extend the grid there)" if edges else ""
        notes.append(Line(True, f"sweep: {feasible} of {points} points are feasible; picked {chosen}{edge}", "sweep"))
    speed = max(leg.scenario.cruise for leg in plan.deciding)
    notes += _speed_notes(loops)
    decided = [v for v in verdicts if isinstance(v, Verdict)]
    unexpected = [v.claim.name for v in decided if not v.as_expected]
    counts = Counter(v.verdict for v in decided)
    text = f"claims at {speed:g} m/s: {', '.join(f'{n} {word}' for word, n in sorted(counts.items()))}, "
    text += "all as expected" if not unexpected else f"unexpected: {unexpected}"
    if decided:
        notes.append(Line(not unexpected, text, f"claims-{unexpected[0]}" if unexpected else "claims"))
    notes += [
        Line(False, f"claim {one.claim}: {one.sentence}", "claims")
        for one in verdicts
        if isinstance(one, Inapplicable) and plan.claims
    ]
    for leg in plan.legs:
        if leg.exclusion or leg.misfit:
            reason = leg.exclusion or leg.misfit
            notes.append(_remark(f"{leg.scenario.name} does not count towards the result: {reason}"))
    worst = max((max(r.tau.mixed, r.state.mixed, r.telemetry.mixed) for r in sil), default=0.0)
    steps, cases = sum(r.steps for r in sil), sum(r.fault_cases for r in sil)
    passed = bool(sil) and all(r.conclusive for r in sil)
    replays = f"{len(sil)} {'' if plan.unheard else 'sonar '}run{'s' * (len(sil) != 1)}"
    which = "that takes obstacle positions" if plan.unheard else "with perception"
    text = f"export of the law {which}: C and Python agree to {worst:.1e} over {steps} steps of {replays}; "
    notes.append(Line(passed, text + f"{cases} inputs with NaN or infinity tested", "export"))
    notes += [_remark(f"no sonars are simulated, because {plan.unheard}")] if plan.unheard else []
    return assessment.with_lines(notes + _limits(plan, runs))


def _remark(text: str, about: str = "") -> Line:
    return Line(None, text, about, counts=False)


def _limits(plan: Plan, runs: Sequence[Run]) -> list[Line]:
    """Return what the craft of the plan can and cannot do, for a craft without sway force."""
    if plan.vehicle["Fv_max"] > 0:
        return []
    crab = max((run.metrics.max_crab_angle_deg for run in runs), default=float("nan"))
    scenario = plan.deciding[0].scenario
    texts = [f.text for f in findings(scenario, plan.vehicle, gains=plan.gains) if f.level == "info"]
    return [_remark(f"limit: {text}") for text in texts] + [
        _remark(f"largest crab angle of the runs, outside avoidance: {crab:.1f} deg", "runs")
    ]


def _speed_notes(loops: Loops) -> list[Line]:
    over, mode, notes = loops.over, loops.analysis.mode, list[Line]()
    if over is not None:
        (late, late_at), (disk, disk_at) = over.worst("delay_margin_s"), over.worst("disk_margin")
        margin_text = f"least delay margin {late:.2f} s (at {late_at:g} m/s), "
        margin_text += f"least disk margin {disk:.2f} (at {disk_at:g} m/s)"
        short = short_margins((disk, f"at {disk_at:g} m/s"), (late, f"at {late_at:g} m/s"))
        margin_text += f"; too small: {short}" if short else ""
        poles = over.figures["slowest_pole_per_s"]
        held = bool((poles < 0).all())
        if not held:
            lost = [u for u, pole in zip(over.cruise, poles.tolist(), strict=True) if not pole < 0]
            bearable = "" if mode is None else f" (bearable speed {mode.bearable:.3g} m/s)"
            margin_text = f"the linear loop is unstable at {speeds_text(lost)}{bearable}; {margin_text}"
        text = f"margins at {speeds_text(over.cruise)}, worst corner: {margin_text}"
        notes.append(Line(held and not short, text, "margins"))
    return notes


def claims_of(plan: Plan, gains: Gains, fastest: Scenario) -> tuple[tuple[Verdict, ...], tuple[Inapplicable, ...]]:
    """Return the verdicts on the claims that a plan names, or that concern its vehicle, and those that do not apply.

    `fastest` is the scenario with the largest cruise speed.
    """
    if not law_source(plan.law).parts:  # the claims are about parts of the built-in laws
        return (), tuple(Inapplicable(name, _NO_PART, "this law") for name in plan.claims or ())
    at_hand = {**gains.values, "speed": fastest.cruise, "speed_max": fastest.cap}
    errata = has_tuned(plan.vehicle)  # where the paper errs concerns its own robot
    applicable, refused = applicable_claims(at_hand, plan.claims, vehicle=plan.vehicle, errata=errata)
    unfit = tuple(Inapplicable.of(name, reason) for name, reason in refused.items())
    return tuple(decide(claim) for claim in applicable), unfit


def left_out(runs: Sequence[Run]) -> tuple[Line, ...]:
    """Return summary lines on runs that were not replayed, because their sensors are not those of the exported law."""
    text = "has other sensors than the exported law and is not replayed"
    return tuple(_remark(f"{run.scenario.name} by {run.vehicle.name}, sonar, {text}", "export") for run in runs)


def with_perception(plan: Plan, leg: Leg) -> Law:
    """Return the plan's law with perception, for the sensors of the mission's scenario on the hull of its vehicle.

    If the plan simulates no sonars (`Plan.unheard`), the law takes obstacle positions. The law allocates its thrust to
    the thrusters of the vehicle, if it has any.

    Raises:
        InputError: the law cannot use the sonars of the scenario.
    """
    mission, actuators = leg.scenario, leg.vehicle.actuators
    if plan.unheard:
        return build_law(plan.law, guidance=plan.guidance, actuators=actuators)
    equipment = mission.sensors.on(leg.vehicle["radius"])
    return build_law(
        plan.law,
        sonar=True,
        equipment=equipment,
        guidance=plan.guidance,
        depths=mission.depths is not None,
        actuators=actuators,
    )


@dataclass(frozen=True, eq=False)
class _Shipment:
    """An exported law.

    Attributes:
        law: the exported law.
        bundle: the exported C code, with default gains and a default mission.
        files: paths of the written files.
        compiling: future (`concurrent.futures`) whose result is the compiled bundle.
    """

    law: Law
    bundle: Bundle
    files: tuple[ExportedFile, ...]
    compiling: Future[Controller]

    def carries(self, run: Run) -> bool:
        """Return whether a run used the exported law; its gains and mission may differ from those of the export."""
        return run.law is self.law or run.law.block.digest() == self.law.block.digest()

    def replayed(self, runs: Sequence[Run]) -> tuple[SilReport, ...]:
        """Replay the given runs of the exported law and return one report per run; wait for the compiler if necessary.

        Raises:
            SurctlError: the compiler rejects the bundle, or the compiled program crashes during a replay.
        """
        records = [Records(r.law_state, r.law_input, r.step_parameters) for r in (run.record for run in runs)]
        return compare_runs(self.compiling.result(), records)


@contextmanager
def _shipping(law: Law, gains: Gains, leg: Leg, out: Path) -> Iterator[_Shipment]:
    """Write the C code of the law to `out` and compile it in parallel with the body of the `with` statement.

    Args:
        law: the law to export.
        gains: complete gain set.
        leg: the study's mission whose scenario and vehicle become the defaults of the export.
        out: folder of the exported bundle.

    Raises:
        InputError: the folder cannot be written.
    """
    numbers = law_numbers(leg.scenario, gains, leg.vehicle)
    bundle = build_bundle(law, law.gains.unpack(numbers), origin=origin_of(law, leg.vehicle))
    files = tuple(write_bundle(bundle, out))
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch, ThreadPoolExecutor(1) as beside:
        yield _Shipment(law, bundle, files, beside.submit(build_controller, law, bundle, Path(scratch, bundle.name)))


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
    gains: Gains
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
        """Whether the study is accepted: no line that counts towards the result fails."""
        return self.assessment.accepted()

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
                "values": dict(self.gains.values),
                "provenance": self.gains.provenance,
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
    from surctl.marine.report import ReportData
    from surctl.marine.report.evidence_sections import runs_section
    from surctl.marine.report.page import write_page
    from surctl.report.document import Section

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
            gains = picked_gains(swept)
            gain_file = write_file(out / "gains.toml", write_gains(gains))
        with clock("export"):
            shipment = stack.enter_context(_shipping(sonar_laws[first], gains, legs[first], out / "export"))
        with clock("runs"):
            leg_runs = _simulate_legs(plan, legs, (laws, sonar_laws), gains, progress)
        runs = tuple(run for _, run in leg_runs)
        deciding = tuple(leg.misfit is None and run.sensing == _sensing(plan) for leg, run in leg_runs)
        with clock("assessment"):
            assessment = assess(assessed(plan, gains, runs=runs, extra=tuple(not each for each in deciding)))
            loops = loops_of(plan, gains, assessment.sources["loop"])
        with clock("claims"):
            fastest = max((leg.scenario for leg in plan.deciding), key=lambda scenario: scenario.cruise)
            verdicts, inapplicable = claims_of(plan, gains, fastest)
            regions = _unprovable_regions(plan, gains, speeds=(fastest.cruise, fastest.cap))
        sonar_runs = [run for leg, run in leg_runs if leg.misfit is None and run.sensing == _sensing(plan)]
        replayed = tuple(run for run in sonar_runs if shipment.carries(run))
        with clock("pictures of the runs"):  # in parallel with the compiler
            data = ReportData(
                title=f"Study {plan.name}",
                command=command,
                version=__version__,
                vehicle=plan.vehicle,
                gains=gains,
                speeds=(fastest.cruise, fastest.cap),
                margins=loops.margins,
                linear=loops.analysis.sides,
                loops=loops.loops,
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
    assessment = summary(plan, swept, assessment, loops, (*verdicts, *inapplicable), runs, sil)
    assessment = assessment.with_lines(left_out([run for run in sonar_runs if run not in replayed]))
    with clock("report"), saving("report"):
        data = replace(
            data,
            export=_export_section(plan, shipment, replayed, sil),
            seconds=dict(clock.seconds),
            assessment=assessment,
        )
        report = write_page(data, out / "report.html", runs=section)
    seconds = dict(clock.seconds)
    return Study(
        plan,
        swept,
        gains,
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


def _export_section(plan: Plan, shipment: _Shipment, replayed: Sequence[Run], sil: tuple[SilReport, ...]) -> Section:
    from surctl.report.system_page import export_section

    bundle = shipment.bundle
    inputs = "estimates its position and the obstacles from sonars, base station and IMU"
    if plan.unheard:
        inputs = f"takes the pose, the velocity and the obstacles as inputs, because {plan.unheard}"
    text = f"C99, double precision, prefix {bundle.name}, law {bundle.id}. The exported law {inputs}."
    runs = "; ".join(f"{k}: {run.scenario.name} by {run.vehicle.name}" for k, run in enumerate(replayed, start=1))
    return export_section(f"{text} Replayed runs: {runs}.", shipment.files, sil, folded=True)


def _sweep(plan: Plan, out: Path, workers: int, progress: Progress) -> SweepTable:
    subject = MissionSweep(plan.sweep_cases, plan.sweep_seeds, cruise=plan.cruise)
    return sweep(subject, grid(plan.grid), executor=LocalExecutor(workers), out=out, progress=progress)


def _simulate_legs(
    plan: Plan, legs: Sequence[Leg], laws: tuple[Sequence[Law], Sequence[Law]], gains: Gains, progress: Progress
) -> list[tuple[Leg, Run]]:
    # with true positions by the law in `laws[0]`, with sonar by the law in `laws[1]`
    leg_runs = []
    for leg, law_of_truth, sonar_law in zip(legs, *laws, strict=True):
        for sensing, law in (("truth", law_of_truth), ("sonar", sonar_law))[: 1 if plan.unheard else 2]:
            run = simulate(leg.scenario, leg.vehicle, gains=gains, law=law, sensing=sensing, seed=plan.seed)
            m = run.metrics
            progress(f"{leg.scenario.name} {sensing}: {m.stopped_because} at {m.time_s:.1f} s")
            leg_runs.append((leg, run))
    return leg_runs
