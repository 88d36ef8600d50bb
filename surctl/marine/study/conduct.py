"""Conduct a study in one call: sweep, gains, margins, claims, runs, export, replay in C, report; summary lines."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from surctl import __version__
from surctl.assessment import Assessment, Line, assess
from surctl.export import Bundle
from surctl.export.evidence import ReplayedRun
from surctl.files import write_file
from surctl.marine.assessment import LoopAnalysis, Mission
from surctl.marine.control import Gains, Law, law_source, write_gains
from surctl.marine.export import build_bundle
from surctl.marine.export.origin import origin_of
from surctl.marine.export.robot_bundle import replay_of
from surctl.marine.simulation import Run, Scenario, findings, law_numbers, simulate, vehicle_law
from surctl.marine.study.plan import Leg, Plan
from surctl.marine.tuning import MissionSweep, picked_gains
from surctl.marine.tuning.derived import has_tuned
from surctl.marine.verification import law_loop, over_speeds
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.region import refused_regions
from surctl.marine.verification.speeds import OverSpeeds, speeds_text
from surctl.study import StudyParts
from surctl.system import LinearLoop
from surctl.tuning import LocalExecutor, SweepTable, grid, sweep
from surctl.verification import Inapplicable, Verdict, decide

if TYPE_CHECKING:
    from surctl.marine.report import ReportData
    from surctl.report.document import Section


def loops_of(plan: Plan, gains: Gains, analysis: LoopAnalysis) -> tuple[OverSpeeds | None, Mapping[str, LinearLoop]]:
    """Return the figures over the cruise speeds of the plan, if it names any, and the sampled loop at each speed."""
    if analysis.loops is None:
        return None, {}
    if analysis.mode is None:
        return None, {analysis.nominal.place or "nominal": analysis.nominal.linear}
    vehicle, law = plan.vehicle, vehicle_law(plan.vehicle, plan.law)
    speeds = sorted({*plan.cruise, analysis.cruise}, reverse=True)
    over = over_speeds(vehicle, gains.values, cruise=plan.cruise, dt=law.dt, law=plan.law) if plan.cruise else None
    return over, {f"{u:g} m/s": law_loop(law, vehicle, gains, cruise=u).linear for u in speeds}


def notes_of(
    plan: Plan,
    swept: SweepTable,
    analysis: LoopAnalysis,
    over: OverSpeeds | None,
    verdicts: Sequence[Verdict | Inapplicable],
    runs: Sequence[Run],
) -> list[Line]:
    """Return the lines of a study about its sweep, its speeds, its claims, and the limits of its vehicle.

    Args:
        plan: the plan of the study.
        swept: the parameter sweep of the study.
        analysis, over: linear analysis of the control loops, and over the speeds of the plan.
        verdicts: verdicts on the claims of the study.
        runs: runs of the study.
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
    notes += _speed_notes(analysis, over)
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
    notes += [_remark(f"no sonars are simulated, because {plan.unheard}")] if plan.unheard else []
    return notes + _limits(plan, runs)


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


def _speed_notes(analysis: LoopAnalysis, over: OverSpeeds | None) -> list[Line]:
    mode, notes = analysis.mode, list[Line]()
    if over is not None:
        (late, late_at), (disk, disk_at) = over.worst("delay_margin_s"), over.worst("disk_margin")
        margin_text = f"least delay margin {late:.2f} s (at {late_at:g} m/s), "
        margin_text += f"least disk margin {disk:.2f} (at {disk_at:g} m/s)"
        short = over.short
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
    if plan.unheard:
        return vehicle_law(leg.vehicle, plan.law, guidance=plan.guidance)
    return vehicle_law(leg.vehicle, plan.law, leg.scenario, sonar=True, guidance=plan.guidance)


@dataclass(eq=False, kw_only=True)
class Study(StudyParts):
    """The study of a plan and its results; see `surctl.study.StudyParts` for those of every study.

    Attributes:
        plan: the plan of the study.
        film: whether the report shows MuJoCo's pictures of the scene beside the plan view of the decisive run.
        data: the results as the report shows them: gains that the sweep picks, runs, verdicts on the claims. A claim
            that does not concern the vehicle counts as failed if the plan names it.
        analysis, over: linear analysis of the control loops, and over the cruise speeds of the plan.
        replayed: the sonar runs that were repeated with the exported C; without sonars (`Plan.unheard`), the runs with
            true positions. These are the runs of the exported law in which the hull fits the site.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.study import Study, load_plan
        >>> from surctl.study import conduct_parts
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
        >>> study = Study(plan=load_plan("mine.toml"), workers=1)
        >>> conduct_parts(study, Path("out"))
        >>> sorted(path.name for path in Path("out").iterdir())
        ['export', 'gains.toml', 'report.html', 'sweep.nc']
        >>> study.data.verdicts[0].verdict, study.data.runs[0].metrics.stopped_because, study.sil[0].passed
        ('proved', 'reached', True)
    """

    plan: Plan
    film: bool = False
    data: ReportData = field(init=False)
    analysis: LoopAnalysis = field(init=False)
    over: OverSpeeds | None = None
    replayed: tuple[Run, ...] = ()

    @property
    def title(self) -> str:
        """Name of the plan."""
        return self.plan.name

    @property
    def _legs(self) -> tuple[Leg, ...]:
        return tuple(leg for leg in self.plan.legs if not leg.exclusion)

    def __post_init__(self) -> None:
        # the laws are built first: their errors come before the long computations
        plan, legs = self.plan, self._legs
        self._laws = [vehicle_law(leg.vehicle, plan.law, guidance=plan.guidance) for leg in legs]
        self._sonar_laws = [with_perception(plan, leg) for leg in legs]
        self._runs_section: Section | None = None
        self._first = next(k for k, leg in enumerate(legs) if leg.misfit is None)

    def export(self, out: Path) -> tuple[Law, Bundle]:
        """Pick the gains by a sweep; return the law of the first mission that counts, and its bundle."""
        from surctl.marine.report import ReportData

        self.plan = plan = self.plan.written(out / "missions")
        with self.timed("sweep"):
            job = MissionSweep(plan.sweep_cases, plan.sweep_seeds, cruise=plan.cruise)
            executor = LocalExecutor(self.workers)
            self.sweep = sweep(job, grid(plan.grid), executor=executor, out=out, progress=self.progress)
            gains, fastest = picked_gains(self.sweep), _fastest(plan)
            self.gain_file = write_file(out / "gains.toml", write_gains(gains))
            self.data = ReportData(
                title=f"Study of {self.title}", command=self.command, version=__version__, vehicle=plan.vehicle,
                gains=gains, speeds=(fastest.cruise, fastest.cap), gains_file=str(self.gain_file), sweep=self.sweep,
                film=self.film, seconds=self.seconds,
            )  # fmt: skip
        with self.timed("export"):
            law, leg = self._sonar_laws[self._first], self._legs[self._first]
            numbers = law_numbers(leg.scenario, gains, leg.vehicle)
            self._bundle = build_bundle(law, law.gains.unpack(numbers), origin=origin_of(law, leg.vehicle))
        return law, self._bundle

    def simulate(self) -> list[ReplayedRun]:
        """Simulate each mission with true positions, and with sonar; return the runs of the exported law."""
        plan, data, counts = self.plan, self.data, list[bool]()
        for leg, law_of_truth, sonar_law in zip(self._legs, self._laws, self._sonar_laws, strict=True):
            for sensing, law in (("truth", law_of_truth), ("sonar", sonar_law))[: 1 if plan.unheard else 2]:
                run = simulate(leg.scenario, leg.vehicle, gains=data.gains, law=law, sensing=sensing, seed=plan.seed)
                line = f"{leg.scenario.name} {sensing}: {run.metrics.stopped_because} at {run.metrics.time_s:.1f} s"
                line += f"; does not count: {leg.misfit}" if leg.misfit else ""
                self.progress(line)
                self.ran.append(line)
                data.runs += (run,)
                counts.append(leg.misfit is None and sensing == _sensing(plan))
        digest = self._sonar_laws[self._first].block.digest()
        data.deciding = tuple(counts)
        counted = [run for run, decides in zip(data.runs, counts, strict=True) if decides]
        self.replayed = tuple(run for run in counted if run.law.block.digest() == digest)
        self._left_out = [run for run in counted if run not in self.replayed]
        return [replay_of(run) for run in self.replayed]

    def assess(self) -> Assessment:
        """Assess the vehicle with its gains in the missions that count, decide the claims, and draw the runs."""
        from surctl.marine.report.evidence_sections import runs_section

        assert self.sweep is not None  # it picks the gains
        plan, data = self.plan, self.data
        with self.timed("assessment"):
            extra = tuple(not each for each in data.decides)
            assessment = assess(assessed(plan, data.gains, runs=data.runs, extra=extra))
            self.analysis = assessment.sources["loop"]
            self.over, data.loops = loops_of(plan, data.gains, self.analysis)
            data.linear = self.analysis.loops
        with self.timed("claims"):
            data.verdicts, data.inapplicable = claims_of(plan, data.gains, _fastest(plan))
            data.regions = _unprovable_regions(plan, data.gains)
        with self.timed("pictures of the runs"), self.saving("plots of the runs"):
            self._runs_section = runs_section(data)
        lines = notes_of(plan, self.sweep, self.analysis, self.over, (*data.verdicts, *data.inapplicable), data.runs)
        return assessment.with_lines([*lines, *left_out(self._left_out)])

    def page(self) -> str:
        """Return the page: decisive run, margins, claims, runs, sweep, export, parameters of the vehicle and gains."""
        from surctl.marine.report import render_page
        from surctl.report.study_page import export_section

        plan, bundle = self.plan, self._bundle
        inputs = "estimates its position and the obstacles from sonars, base station and IMU"
        if plan.unheard:
            inputs = f"takes the pose, the velocity and the obstacles as inputs, because {plan.unheard}"
        text = f"C99, double precision, prefix {bundle.name}, law {bundle.id}. The exported law {inputs}."
        runs = "; ".join(f"{k}: {run.scenario.name} by {run.vehicle.name}" for k, run in enumerate(self.replayed, 1))
        self.data.export = export_section(f"{text} Replayed runs: {runs}.", self.files, self.sil)
        self.data.assessment = self.assessment
        return render_page(self.data, runs=self._runs_section)

    def to_dict(self) -> dict[str, Any]:
        """Return the study as plain data; the writer converts numbers that are not finite."""
        data, swept, plan, shown, one = self.common(), self.sweep, self.plan, self.data, self.analysis
        assert swept is not None  # chosen before
        picked = None if swept.picked is None else list(swept.picked)
        gains = {"file": shown.gains_file, "values": dict(shown.gains.values), "provenance": shown.gains.provenance}
        linear = None if one.loops is None else one.loops.to_dict()
        if linear is not None:
            linear |= {} if one.mode is None else {"mode": one.mode.to_dict()}
            linear |= {} if self.over is None else {"speeds": self.over.to_dict()}
        return data | {
            "vehicle": plan.vehicle.name,
            "gains": gains,
            "sweep": data["sweep"] | {"picked": picked, "cases": list(swept.cases)},
            "margins": [m.to_dict() for m in one.margins],
            "linear": linear,
            "verdicts": [*(v.to_dict() for v in shown.verdicts), *(v.to_dict() for v in shown.inapplicable)],
            "runs": [run.to_dict() | {"decides": d} for run, d in zip(shown.runs, shown.decides, strict=True)],
            "not_simulated": [
                {"scenario": leg.scenario.name, "reason": leg.exclusion} for leg in plan.legs if leg.exclusion
            ],
            "export": data["export"] | {"sensing": _sensing(plan)},
        }


def _fastest(plan: Plan) -> Scenario:
    return max((leg.scenario for leg in plan.deciding), key=lambda scenario: scenario.cruise)


def assessed(plan: Plan, gains: Gains, *, runs: tuple[Run, ...] | None = None, extra: tuple[bool, ...] = ()) -> Mission:
    """Return the subject of a study: its vehicle with these gains, in the missions that count; see `Mission`."""
    fastest = _fastest(plan)
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


def _unprovable_regions(plan: Plan, gains: Gains) -> tuple[Inapplicable, ...]:
    """Return the region claims that cannot be proved for the vehicle, one record for each reason."""
    if not law_source(plan.law).parts:
        return ()
    fastest = _fastest(plan)
    refused = refused_regions(plan.vehicle, gains, cruise=fastest.cruise, cap=fastest.cap)
    return tuple(Inapplicable(", ".join(names), reason.because, reason.to) for reason, names in refused)


_NO_PART = "the claim is about a part of the built-in laws"


def _sensing(plan: Plan) -> Literal["truth", "sonar"]:
    # what the exported law measures
    return "truth" if plan.unheard else "sonar"
