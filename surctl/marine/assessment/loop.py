"""The linear part of a mission's assessment: margins, poles and sampling of the loop of any law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from surctl.assessment.assessment import Assumption, Figure, Line, Part
from surctl.assessment.figures import loop_figures, loop_line
from surctl.errors import InputError
from surctl.marine.assessment.assumptions import assumptions
from surctl.marine.assessment.unstable import motion_text
from surctl.marine.control import Gains, Law, build_law, law_source
from surctl.marine.guidance import Guidance
from surctl.marine.simulation import Disturbance, Run, Scenario, mission_size, simulate, stop_reason, straight_mission
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.linearise import check_cruise
from surctl.marine.verification import LawCorners, closed_loop_poles, law_corners, steady_motion, worst_margins
from surctl.marine.verification.cascade import has_cascade
from surctl.marine.verification.linear import (
    LinearSide,
    Mode,
    corners,
    linear_side,
    slowest_mode,
    worst_linear_side,
)
from surctl.own_code import label
from surctl.verification import LoopMargins

__all__ = ["LoopAnalysis", "analyse_loop", "loop_part"]


@dataclass(frozen=True, eq=False)
class LoopAnalysis:
    """The linear analysis of a law about a cruise or a steady motion, at the nominal vehicle and at the worst corner.

    Attributes:
        cruise: cruise speed [m/s].
        margins: margins of each loop alone, of the nominal vehicle, or the least over a stated uncertainty.
        sides: all loops together, nominal and worst corner; empty for a law that is linearised numerically.
        poles: closed-loop poles [rad/s] of the nominal vehicle; None for such a law.
        mode: the slowest or most unstable mode; None for such a law.
        law: the sampled loop of such a law, or None.
        unjudged: the reason why there is no analysis; else empty.
        failed: whether that reason is a failure of the law.
        assumptions: defaults on which the analysis depends.
        motion: for an unstable loop about a straight cruise, how a run of the worst corner goes on, in words.
    """

    cruise: float
    margins: tuple[LoopMargins, ...] = ()
    sides: tuple[LinearSide, ...] = ()
    poles: Any = None
    mode: Mode | None = None
    law: LawCorners | None = None
    unjudged: str = ""
    failed: bool = False
    uncertainty: float | None = None
    assumptions: tuple[Assumption, ...] = ()
    motion: str = ""

    @property
    def stable(self) -> bool | None:
        """Whether the loop is stable, also at the worst corner; None if there is no analysis."""
        if self.law is not None:
            return self.law.stable
        return all(side.stable for side in self.sides) if self.sides else None

    def part(self) -> Part:
        """Return the figures and the verdict."""
        if self.unjudged:
            line = Line(False if self.failed else None, f"margins: not judged, because {self.unjudged}", "margins")
            return Part((), (replace(line, counts=self.failed),), self)
        figures = self._figures()
        place = f"at {self.cruise:g} m/s"
        if self.law is not None and self.law.nominal.place:
            place = f"about {self.law.nominal.place}"
        mode = self.mode
        why = "; lower the cruise speed" if mode is None else f" (loop {mode.loop}): {unstable_text(mode)}"
        line = loop_line(figures, stable=self.stable is not False, place=place, unstable=why)
        if self.motion:
            line = replace(line, text=f"{line.text}; {self.motion}")
        return Part(tuple(figures.values()), (line,), self, self.assumptions)

    def _figures(self) -> dict[str, Figure]:
        if self.law is not None:
            nominal, worst, corner = self.law.nominal.disk, self.law.disk, self.law.corner
            slowest = (self.law.nominal.slowest_per_s, self.law.slowest_per_s)
        else:
            first, last = self.sides
            nominal, worst, corner = first.disk, last.disk, last.corner or "the nominal vehicle"
            slowest = (first.slowest_per_s, last.slowest_per_s)
        which = f"mass and drag off by ±{self.uncertainty:.0%}" if self.uncertainty else "nominal vehicle"
        return loop_figures((nominal, worst), slowest, self.margins, corner=corner, which=which)


def unstable_text(mode: Mode) -> str:
    """Return the dominant states of an unstable mode, its pole, and what stabilises the loop, as text."""
    states = ", ".join(f"{name} {share:.0%}" for name, share in list(mode.participation.items())[:3])
    return f"pole {mode.real:.3g} 1/s, dominant states {states}; stable {mode.remedy}"


def loop_part(*arguments: Any, **options: Any) -> Part:
    """Return the part of an assessment; for the arguments see `analyse_loop`."""
    return analyse_loop(*arguments, **options).part()


def analyse_loop(
    vehicle: Vehicle,
    gains: Gains,
    *,
    law: str,
    cruise: float,
    dt: float | None = None,
    guidance: Guidance = "los",
    uncertainty: float | None = None,
    missions: Sequence[Scenario] = (),
) -> LoopAnalysis:
    """Return the linear analysis of a law.

    A law with the built-in cascade is linearised by formulae, a law that steers numerically about a straight cruise,
    any other law numerically about the steadiest motion of a run.

    Args:
        vehicle: nominal plant and model of the controller.
        gains: the gains.
        law: reference of the law.
        cruise: cruise speed [m/s].
        dt: control period [s]; None: that of the law.
        guidance: guidance of the law.
        uncertainty: relative error of mass and drag; None: the ranges of the vehicle file, or the default (`corners`).
        missions: scenarios of the run, the first with a steady motion, without waves and drift; none: a straight path
            in open water.

    Raises:
        InputError: the law is a user's own and fails.
    """
    source = law_source(law)
    built = build_law(law, guidance=guidance) if dt is None else build_law(law, guidance=guidance, dt=dt)
    if source.steering is None and has_cascade(law, guidance):
        try:
            check_cruise(vehicle, cruise)
        except InputError as error:
            return LoopAnalysis(cruise, unjudged=f"a cruise at {cruise:g} m/s {error.problem}")
        speeds: dict[str, Any] = {"cruise": cruise, "dt": built.dt}
        values = gains.values
        analysis = LoopAnalysis(
            cruise,
            worst_margins(vehicle, values, uncertainty=uncertainty or 0.0, **speeds),
            (
                linear_side(vehicle, values, **speeds),
                worst_linear_side(corners(vehicle, uncertainty), values, **speeds),
            ),
            closed_loop_poles(vehicle, values, **speeds),
            slowest_mode(vehicle, values, **speeds),
            uncertainty=uncertainty,
            assumptions=assumptions(vehicle, values, uncertainty=uncertainty, **speeds),
        )
        return _with_motion(analysis, analysis.sides[-1].at, vehicle, gains, built)
    own = gains.with_own(source.gains)
    if source.steering is not None:
        try:
            loops = law_corners(built, vehicle, own, cruise=cruise, uncertainty=uncertainty)
        except InputError as error:
            return LoopAnalysis(cruise, unjudged=_reason(error, cruise))
        assumed = assumptions(vehicle, None, cruise=cruise, dt=built.dt, uncertainty=uncertainty)
        analysis = LoopAnalysis(cruise, loops.nominal.margins, law=loops, assumptions=assumed)
        return _with_motion(analysis, loops.at, vehicle, own, built)
    return _about_runs(built, vehicle, own, cruise=cruise, uncertainty=uncertainty, missions=missions)


def _with_motion(analysis: LoopAnalysis, worst: Vehicle | None, model: Vehicle, gains: Gains, law: Law) -> LoopAnalysis:
    if analysis.stable is not False:
        return analysis
    nominal = analysis.sides[0].stable if analysis.law is None else analysis.law.nominal.stable
    plant = worst if nominal and worst is not None else model
    return replace(analysis, motion=motion_text(plant, model, gains, law=law, cruise=analysis.cruise))


def _about_runs(
    law: Law,
    vehicle: Vehicle,
    gains: Gains,
    *,
    cruise: float,
    uncertainty: float | None,
    missions: Sequence[Scenario],
) -> LoopAnalysis:
    reason = ""
    for mission in missions or (None,):
        run = _run(law, vehicle, gains, cruise=cruise, mission=mission)
        if run.metrics.stopped_because == "fault":
            why = f"the run of {run.scenario.name} ended with a fault: {stop_reason(run)}"
            return LoopAnalysis(cruise, unjudged=why, failed=True)
        try:
            at = steady_motion(run)
            loops = law_corners(law, vehicle, gains, cruise=cruise, uncertainty=uncertainty, at=at)
        except InputError as error:
            reason = reason or _reason(error, cruise)
            continue
        assumed = assumptions(vehicle, None, cruise=at.speed, dt=law.dt, uncertainty=uncertainty)
        return LoopAnalysis(at.speed, loops.nominal.margins, law=loops, assumptions=assumed)
    return LoopAnalysis(cruise, unjudged=reason or f"law {label(law.ref)} has no steady motion")


def _reason(error: InputError, cruise: float) -> str:
    which = f"a cruise at {cruise:g} m/s" if error.key in (None, "cruise") else error.key
    return f"{which} {error.problem}"


def _run(law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, mission: Scenario | None) -> Run:
    if mission is None:
        scenario = straight_mission(vehicle, cruise=cruise, size=mission_size(vehicle, gains, cruise=cruise))
    else:
        calm = Disturbance(current_m_per_s=mission.disturbance.current_m_per_s)
        scenario = replace(mission, cruise=cruise, cap=max(mission.cap, cruise), disturbance=calm)
    return simulate(scenario, vehicle, gains=gains, law=law)
