"""What is assessed of a vehicle in missions: margins, a fault in their run, region, no contact, runs, defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from surctl.assessment import SATURATED, Assumption, Figure, Line, Part, loop_figures, loop_line
from surctl.errors import InputError, NotApplicable
from surctl.marine.control import BARRIER, Barrier, Gains, Law, Movers, default_law, law_source
from surctl.marine.guidance import Guidance, Path
from surctl.marine.simulation import Case, Disturbance, Run, SafetyClaim, Scenario, Sensing, simulate, vehicle_law
from surctl.marine.simulation.echo_fit import detection_range
from surctl.marine.simulation.explanation import stop_reason
from surctl.marine.simulation.loop import simulate_case
from surctl.marine.simulation.safety import safety_claim, turn_rate
from surctl.marine.simulation.scaling import mission_size, straight_mission
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import check_cruise
from surctl.marine.vehicle.specs import DEFAULTED
from surctl.marine.verification import law_corners, steady_motion
from surctl.marine.verification.corners import DRAG_SPREAD, MASS_SPREAD, Corners, corners
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.marine.verification.law_loop import LawLoop
from surctl.marine.verification.linear import Mode, cap_above, slowest_mode
from surctl.marine.verification.region import RegionStatement, applicable_region, prove_statement
from surctl.marine.verification.speeds import OverSpeeds, slow_margins
from surctl.own_code import label
from surctl.verification import Inapplicable, LoopCorners, LoopMargins

__all__ = [
    "DEFAULT_REGIONS",
    "LoopAnalysis",
    "Mission",
    "assumptions",
]

# Defaults that a vehicle file leaves to surctl, and how much the disk margin depends on each


def assumptions(
    vehicle: Vehicle, disk: Callable[[Corners], float] | None = None, *, uncertainty: float | None = None
) -> tuple[Assumption, ...]:
    """Return the defaults on which the linear loop of a vehicle depends.

    Args:
        vehicle: the vehicle.
        disk: function that returns the disk margin of a loop at the worst corner; None: no margins.
        uncertainty: relative error of mass and drag that takes the place of the ranges, or None.

    Example:
        >>> from surctl.marine.assessment import assumptions
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import law_corners
        >>> law, gains = build_law(), load_gains("default")
        >>> [ranges] = assumptions(
        ...     load_vehicle("bluerov2-wu"), lambda tried: law_corners(law, tried, gains, cruise=0.15).disk
        ... )
        >>> ranges.value, ranges.margins[0] > ranges.margins[2]
        ('of mass ±5% and of drag ±20%', True)
    """

    def margin(one: Vehicle, spread: float = 1.0) -> float:
        try:
            return float("nan") if disk is None else disk(corners(one, uncertainty, spread=spread))
        except InputError:  # the vehicle cannot hold the speed
            return float("nan")

    assumed = []
    for name, parameter in vehicle.parameters.items():
        if parameter.provenance == DEFAULTED and parameter.value:
            values = (vehicle.with_values({name: share * parameter.value}) for share in (0.5, 1.0, 2.0))
            half, same, double = (margin(one) for one in values)
            unit = "" if parameter.unit == "1" else f" {parameter.unit}"
            assumed.append(Assumption(name, f"= {parameter.value:g}{unit}", (half, same, double)))
    if corners(vehicle, uncertainty).assumed:
        half, same, double = (margin(vehicle, share) for share in (0.5, 1.0, 2.0))
        assumed.append(
            Assumption("ranges", f"of mass ±{MASS_SPREAD:.0%} and of drag ±{DRAG_SPREAD:.0%}", (half, same, double))
        )
    return tuple(assumed)


DEFAULT_REGIONS = ("region-cruise-20", "region-turning-20", "region-steered-20")
"""The region claims of an assessment, strongest assumption first; the first that applies is the one of a vehicle."""


def judged_contact(
    scenario: Scenario,
    vehicle: Vehicle,
    gains: Gains,
    *,
    sonar: bool = True,
    barrier: Barrier = "simple",
    movers: Movers = "predict",
    spread: float | None = None,
) -> SafetyClaim | Inapplicable:
    """Return the no-contact claim of a mission, or why it does not apply; by true positions unless `sonar`."""
    perceived: dict[str, Any] = {"detection": detection_range(scenario) if sonar else float("inf")}
    perceived["turning"] = turn_rate(scenario, vehicle, gains, sonar=sonar)
    try:
        return safety_claim(scenario, vehicle, gains, barrier=barrier, movers=movers, spread=spread, **perceived)
    except NotApplicable as reason:
        return Inapplicable.of("no contact", reason)


_OF_RUNS: tuple[tuple[str, str, str, Literal["high", "low"]], ...] = (
    ("time_ratio", "1", "arrival time over the ideal time (path length / cruise speed)", "low"),
    ("path_error_m", "m", "rms distance to the path", "low"),
    ("min_clearance_m", "m", "least distance to an obstacle or wall", "high"),
    ("limited_share", "1", "share of time at its limit of the thrust that is there most", "low"),
)


def _of(run: Run, name: str) -> float:
    m = run.metrics
    if name == "time_ratio":
        ideal = run.scenario.path.length / run.scenario.cruise
        return m.time_s / ideal if m.reached else float("inf")
    return m.axis_saturated_share if name == "limited_share" else float(getattr(m, name))


# The linear part of a mission's assessment: margins, poles and sampling of the loop of any law


@dataclass(frozen=True, eq=False)
class LoopAnalysis:
    """The linear analysis of a law about a cruise or a steady motion, at the nominal vehicle and at the worst corner.

    Attributes:
        cruise: cruise speed [m/s].
        loops: the loop, nominal and at the worst corner; None if there is no analysis.
        mode: the slowest or most unstable mode of a law that tracks; else None.
        unjudged: the reason why there is no analysis; else empty.
        failed: whether that reason is a failure of the law.
        assumptions: defaults on which the analysis depends.
        slow: the least margins over the speeds from rest to the cruise speed; None where they are not computed.
        motion: for an unstable loop about a straight cruise, how a run of the worst corner goes on, in words.
    """

    cruise: float
    loops: LoopCorners | None = None
    mode: Mode | None = None
    unjudged: str = ""
    failed: bool = False
    assumptions: tuple[Assumption, ...] = ()
    slow: OverSpeeds | None = None
    motion: str = ""

    @property
    def nominal(self) -> LawLoop:
        """The loop of the nominal vehicle, of an analysis that exists."""
        assert self.loops is not None and isinstance(self.loops.nominal, LawLoop)
        return self.loops.nominal

    @property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Margins of each loop alone, of the nominal vehicle."""
        return () if self.loops is None else self.loops.nominal.margins

    @property
    def stable(self) -> bool | None:
        """Whether the loop is stable, also at the worst corner; None if there is no analysis."""
        return None if self.loops is None else self.loops.stable

    def part(self) -> Part:
        """Return the figures and the verdict."""
        if self.unjudged:
            line = Line(False if self.failed else None, f"margins: not judged, because {self.unjudged}", "margins")
            return Part((), (replace(line, counts=self.failed),), self)
        assert self.loops is not None  # else the reason is stated
        figures = loop_figures(self.loops)
        place = f"about {self.nominal.place}" if self.nominal.place else f"at {self.cruise:g} m/s"
        mode = self.mode
        why = "; lower the cruise speed" if mode is None else f" (loop {mode.loop}): {unstable_text(mode)}"
        marginal = self.loops.marginal
        line = loop_line(figures, stable=self.loops.stable, place=place, unstable=why, marginal=marginal)
        if self.motion:
            line = replace(line, text=f"{line.text}; {self.motion}")
        lines = [line]
        if self.slow is not None and self.slow.short and line.passed:
            lines.append(Line(None, self.slow.sentence, "margins"))
        slow = () if self.slow is None else _slow_figures(self.slow)
        return Part((*figures.values(), *slow), tuple(lines), self, self.assumptions)


def _slow_figures(slow: OverSpeeds) -> tuple[Figure, ...]:
    text = "over the speeds from rest to the cruise speed, at the worst corner"
    rows = (("disk_margin", "1", "least disk margin"), ("delay_margin_s", "s", "least delay margin of one loop alone"))
    worst = ((name, unit, what, *slow.worst(name)) for name, unit, what in rows)
    return tuple(
        Figure(f"slow_{name}", value, unit, f"{what} {text}", "high", where=f"{speed:.3g} m/s")
        for name, unit, what, value, speed in worst
    )


def unstable_text(mode: Mode) -> str:
    """Return the dominant states of an unstable mode, its pole, and what stabilises the loop, as text."""
    states = ", ".join(f"{name} {share:.0%}" for name, share in list(mode.participation.items())[:3])
    return f"pole {mode.real:.3g} 1/s, dominant states {states}; stable {mode.remedy}"


def _reason(error: InputError, cruise: float) -> str:
    which = f"a cruise at {cruise:g} m/s" if error.key in (None, "cruise") else error.key
    return f"{which} {error.problem}"


# end of the first leg in hull lengths: a start on a straight path would hide that a loop is unstable
_BEND = (2.0, 0.5)


@dataclass(frozen=True, eq=False)
class Mission:
    """A vehicle with its law, gains and speeds, and the scenarios in which it runs.

    Attributes:
        vehicle, gains: the vehicle, also the model of the law, and the gains.
        cruise, cap: cruise speed and speed limit [m/s].
        law: reference of the law; empty: the default law of the vehicle.
        guidance: guidance of the law.
        scenarios: the missions.
        dt: control period [s]; None: that of the law.
        uncertainty: relative error of mass and drag; None: the ranges of the vehicle file, or the default ranges.
        sensing: what the law measures in the missions; None: sonar, if the law can use it.
        hulls: vehicle of each scenario; empty: the vehicle.
        runs: runs of the missions, if they were simulated before.
        extra: for each of these runs, whether it does not count; empty: all count.
        barrier, movers: options of the law, as for `build_law`.
    """

    vehicle: Vehicle
    gains: Gains
    cruise: float
    cap: float
    law: str = ""
    guidance: Guidance = "los"
    scenarios: tuple[Scenario, ...] = ()
    dt: float | None = None
    uncertainty: float | None = None
    sensing: Sensing | None = None
    hulls: tuple[Vehicle, ...] = ()
    runs: tuple[Run, ...] | None = None
    extra: tuple[bool, ...] = ()
    barrier: Barrier = "simple"
    movers: Movers = "predict"

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return self.vehicle.name

    @property
    def period(self) -> float:
        """Control period [s]."""
        return vehicle_law(self.vehicle, self.law).dt if self.dt is None else self.dt

    @property
    def law_ref(self) -> str:
        """Reference of the law."""
        return self.law or default_law(self.vehicle)

    @property
    def missions(self) -> tuple[tuple[Scenario, Vehicle], ...]:
        """Each scenario with its vehicle."""
        return tuple(zip(self.scenarios, self.hulls or [self.vehicle] * len(self.scenarios), strict=True))

    def parts(self) -> Mapping[str, Callable[[], Part]]:
        """Return the parts of the assessment; those about missions only if there is one."""
        parts = {"loop": self._loop, "region": self._region}
        return parts | ({"no contact": self._contact, "runs": self._runs} if self.scenarios else {})

    def _loop(self) -> Part:
        part = self._analysis().part()
        mode = part.source.mode
        text = None if mode is None else cap_above(self.vehicle, mode.bearable, cap=self.cap)
        return part if text is None else part._replace(lines=(*part.lines, Line(None, text, "cap", counts=False)))

    def _analysis(self) -> LoopAnalysis:
        """Return the linear analysis of the law.

        A law that tracks is linearised about a straight cruise by its derivatives, a law that steers there by
        differences, any other law by differences about the steadiest motion of a run.
        """
        vehicle, cruise, law, source = self.vehicle, self.cruise, self.law_ref, law_source(self.law_ref)
        period: dict[str, Any] = {} if self.dt is None else {"dt": self.dt}
        built = vehicle_law(vehicle, law, guidance=self.guidance, **period)
        ranges: dict[str, Any] = {"uncertainty": self.uncertainty}
        if source.steering is None and has_cruise_loop(law, self.guidance):
            try:
                check_cruise(vehicle, cruise)
            except InputError as error:
                return LoopAnalysis(cruise, unjudged=f"a cruise at {cruise:g} m/s {error.problem}")
            speeds: dict[str, Any] = {"cruise": cruise, "dt": built.dt, "law": law}
            values, margins = self.gains.values, partial(law_corners, built, gains=self.gains, cruise=cruise)
            analysis = LoopAnalysis(
                cruise,
                margins(corners(vehicle, self.uncertainty)),
                slowest_mode(vehicle, values, **speeds),
                assumptions=assumptions(vehicle, lambda tried: margins(tried, proved=False).disk, **ranges),
                slow=slow_margins(vehicle, values, **ranges, **speeds),
            )
            return self._with_motion(analysis, self.gains, built)
        own = self.gains.with_own(source.gains)
        if source.steering is not None:
            try:
                loops = law_corners(built, corners(vehicle, self.uncertainty), own, cruise=cruise)
            except InputError as error:
                return LoopAnalysis(cruise, unjudged=_reason(error, cruise))
            analysis = LoopAnalysis(cruise, loops, assumptions=assumptions(vehicle, **ranges))
            return self._with_motion(analysis, own, built)
        return self._about_runs(own, built)

    def _with_motion(self, analysis: LoopAnalysis, gains: Gains, law: Law) -> LoopAnalysis:
        # how a run of an unstable loop goes on: a bounded motion, such as a crab, or a departure from the path
        loops = analysis.loops
        if loops is None or loops.stable:
            return analysis
        model, tried = self.vehicle, corners(self.vehicle, self.uncertainty)
        plant = tried.vehicle(loops.corner) if loops.nominal.stable else model
        size = mission_size(model, gains, cruise=self.cruise)
        mission = straight_mission(model, cruise=self.cruise, size=size)
        first, last = mission.path.waypoints
        bend = first + 2 * size * np.array(_BEND)
        mission = replace(mission, path=Path(np.array([first, bend, last + np.array([0.0, bend[1] - first[1]])])))
        try:
            run = simulate(mission, plant, gains=gains, law=law, model=model)
        except InputError:
            return analysis
        head = f"its run after a bend of {np.degrees(np.arctan2(_BEND[1], _BEND[0])):.0f} deg, in still water,"
        late = run.record.eta[len(run.record.eta) // 2 :]
        away, m = float(np.abs(late[:, 1] - bend[1]).max()), run.metrics
        crab = f"crabs by {m.crab_angle_deg:.0f} deg (at most {m.max_crab_angle_deg:.0f})"
        text = f"stays bounded: it arrives, {crab}, and its second half is within {away:.2g} m of the path"
        if not m.reached:
            text = f"does not arrive ({m.stopped_because} at {m.time_s:.0f} s), up to {away:.3g} m from the path"
        return replace(analysis, motion=f"{head} {text}")

    def _about_runs(self, gains: Gains, law: Law) -> LoopAnalysis:
        # about the first mission with a steady motion, without waves and drift; a straight path if there is no mission
        vehicle, cruise, reason = self.vehicle, self.cruise, ""
        size = mission_size(vehicle, gains, cruise=cruise) if not self.scenarios else 0.0
        for scenario in self.scenarios or (straight_mission(vehicle, cruise=cruise, size=size),):
            calm = Disturbance(current_m_per_s=scenario.disturbance.current_m_per_s)
            mission = replace(scenario, cruise=cruise, cap=max(scenario.cap, cruise), disturbance=calm)
            run = simulate(mission, vehicle, gains=gains, law=law)
            if run.metrics.stopped_because == "fault":
                why = f"the run of {run.scenario.name} ended with a fault: {stop_reason(run)}"
                return LoopAnalysis(cruise, unjudged=why, failed=True)
            try:
                at = steady_motion(run)
                loops = law_corners(law, corners(vehicle, self.uncertainty), gains, cruise=cruise, at=at)
            except InputError as error:
                reason = reason or _reason(error, cruise)
                continue
            return LoopAnalysis(at.speed, loops, assumptions=assumptions(vehicle, uncertainty=self.uncertainty))
        return LoopAnalysis(cruise, unjudged=reason or f"law {label(law.ref)} has no steady motion")

    def _region(self) -> Part:
        # whether a region of attraction about the path is proved, and its size
        vehicle, gains = self.vehicle, self.gains
        speeds: dict[str, Any] = {"cruise": self.cruise, "cap": self.cap}
        kind: dict[str, Any] = {"law": self.law_ref, "guidance": self.guidance}
        claim = applicable_region(DEFAULT_REGIONS, vehicle, gains, **kind, **speeds)
        if not isinstance(claim, RegionStatement):
            text = f"region of attraction: not applicable to {claim.to}, because {claim.because}"
            return Part((), (Line(None, text, "region"),), claim)
        proof = prove_statement(claim, vehicle, gains, **speeds)
        sizes = (proof.offset, max(proof.ultimate_bound)) if proof.verdict == "proved" else (0.0, float("nan"))
        away = "distance beside the path from which the return is proved"
        end = "distance within which the motion ends, proved"
        figures = (
            Figure("region_m", sizes[0], "m", away, "high", where=claim.name),
            Figure("region_within_m", sizes[1], "m", end, "low", where=claim.name),
        )
        line = Line(True if proof.useful else None, f"{claim.name}: {proof.sentence}", "region")
        return Part(figures, (line,), proof)

    def _contact(self) -> Part:
        # the no-contact claim of each mission that has obstacles
        met = [(scenario, vehicle) for scenario, vehicle in self.missions if scenario.obstacles]
        if BARRIER not in law_source(self.law_ref).parts:
            text = f"no contact: not judged, because the claim concerns law guarded and this is {label(self.law_ref)}"
            return Part((), (Line(None, text, "runs", counts=bool(met)),))
        sensed = "by sonar" if self.sensed == "sonar" else "with true positions"
        kind: dict[str, Any] = {"sonar": self.sensed == "sonar", "barrier": self.barrier, "movers": self.movers}
        claims = [judged_contact(*each, self.gains, **kind, spread=self.uncertainty) for each in met]
        ranged = any(one.range is not None for one in self.vehicle.parameters.values())
        over = "over the ranges of the vehicle file" if ranged else "at the exact values of the vehicle file"
        over = over if self.uncertainty is None else f"over ±{self.uncertainty:.0%} of mass and drag"
        lines = []
        for (scenario, _), claim in zip(met, claims, strict=True):
            if isinstance(claim, Inapplicable):
                lines.append(Line(None, f"no contact in {scenario.name} {sensed}: {claim.sentence}", "runs"))
                continue
            how = f"holds for obstacles {claim.obstacles}: margin {claim['margin']:g} m, "
            how += f"needed {claim['margin needed']:.3g} m {over}, without thrust or speed sideways"
            end = how if claim.holds else f"does not hold: {claim.shortfall}"
            lines.append(Line(claim.holds, f"no contact in {scenario.name} {claim.sensed} {end}", "runs"))
        spare = [(c["margin"] - c["margin needed"], c.scenario) for c in claims if isinstance(c, SafetyClaim)]
        figures = []
        if spare:
            least, where = min(spare)
            text, where = "gain margin beyond the one that braking needs", f"{where} {sensed}"
            figures.append(Figure("contact_margin_m", least, "m", text, "high", 0.0, where))
        return Part(tuple(figures), tuple(lines), tuple(claims))

    def _runs(self) -> Part:
        # what runs show: arrival, clearance, path error, thrust at its limit
        runs = tuple(self._run(*each) for each in self.missions) if self.runs is None else self.runs
        apart, lines = self.extra or [False] * len(runs), []
        for place, (run, beside) in enumerate(zip(runs, apart, strict=True), start=1):
            m = run.metrics
            text = f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}: {m.stopped_because} at {m.time_s:.1f} s"
            text += f", least clearance {m.min_clearance_m:.3f} m"
            text += f": {why}" if (why := stop_reason(run)) else ""
            lines.append(Line(m.reached and m.min_clearance_m > 0, text, f"runs-{place}", counts=not beside))
            if m.axis_saturated_share > SATURATED:
                full = f"a thrust is at its limit {m.axis_saturated_share:.0%} of the time"
                text = f"{run.scenario.name}, {run.sensing}: {full}, so the linear margins do not describe this run"
                lines.append(Line(None, text, f"runs-{place}", counts=not beside))
        counted = [run for run, beside in zip(runs, apart, strict=True) if not beside]
        figures = []
        for name, unit, meaning, better in _OF_RUNS if counted else ():
            values = np.array([_of(run, name) for run in counted])
            ill = np.where(np.isnan(values), -np.inf, values if better == "low" else -values)
            at = int(np.argmax(ill))
            where = counted[at].scenario.name
            figures.append(Figure(name, float(values[at]), unit, f"{meaning}, worst run", better, where=where))
        return Part(tuple(figures), tuple(lines), runs)

    @property
    def sensed(self) -> Sensing:
        """What the law measures in the missions."""
        return self.sensing or ("sonar" if "sonar" in law_source(self.law_ref).sensing else "truth")

    def _run(self, scenario: Scenario, vehicle: Vehicle) -> Run:
        options: dict[str, Any] = {"guidance": self.guidance, "barrier": self.barrier, "movers": self.movers}
        return simulate_case(Case(scenario, vehicle, self.gains, self.law_ref, sensing=self.sensed, **options))


def missions_of(cases: Sequence[Case], gains: Gains) -> tuple[Mission, ...]:
    """Return the subject of each vehicle of some cases, at the largest of its cruise speeds, with these gains."""
    missions = list[Mission]()
    for name in dict.fromkeys(case.vehicle.name for case in cases):
        own = [case for case in cases if case.vehicle.name == name]
        case = max(own, key=lambda case: case.scenario.cruise)
        speeds, scenarios = (case.scenario.cruise, case.scenario.cap), tuple(one.scenario for one in own)
        mission = Mission(case.vehicle, gains, *speeds, case.law, case.guidance, scenarios)
        missions.append(replace(mission, sensing=case.sensing, barrier=case.barrier, movers=case.movers))
    return tuple(missions)
