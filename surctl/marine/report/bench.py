"""The design page of a law of the robot: operating points, sliders, goals, runs, assessment, saved gains."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from surctl.assessment import Assessment, assess
from surctl.errors import InputError, NotApplicable
from surctl.files import write_file
from surctl.marine.assessment import DEFAULT_REGIONS, Mission
from surctl.marine.control import Gains, law_source, load_gains, write_gains
from surctl.marine.report.files import plot_region
from surctl.marine.report.plan_view import plot_run
from surctl.marine.report.signals import run_signals
from surctl.marine.simulation import METRICS, Case, Run, Scenario, simulate
from surctl.marine.tuning import GainRange, Goal, case_loop, conditions, evaluate, gain_ranges
from surctl.marine.tuning.derived import has_tuned
from surctl.marine.tuning.evaluation import corners, judged_goals
from surctl.marine.tuning.request import default_tuned
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import steady_motion
from surctl.marine.verification.law_loop import OperatingPoint
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.region import RegionProof, RegionStatement, applicable_region
from surctl.own_code import is_own, label
from surctl.report.design_bench import RunView, Slider, SlowView, View, activity, assessed_lines, gain_file, replaceable
from surctl.report.panel import Curve, Panel, Shade
from surctl.system import LinearLoop
from surctl.tuning import Evaluation, LoopGoal
from surctl.verification import Inapplicable, Verdict, decide

_PATIENCE = 10.0  # [s] time limit of each proof
_RUN_FIGURES = (
    "time_s",
    "min_clearance_m",
    "deviation_m",
    "effort_n",
    "axis_sign_changes_per_s",
    "axis_saturated_share",
)
_THRUST = {"surge": "N", "sway": "N", "heave": "N", "yaw": "N m"}


@dataclass(frozen=True, eq=False)
class Bench:
    """Vehicle, scenario (with true positions), law and goals of the design page; methods take the values of the gains.

    Attributes:
        vehicle: the simulated vehicle, which is also the model of the controller.
        scenario: the mission.
        initial: initial gains of the page.
        stated: the goals that a set of gains should meet.
        cruise: further cruise speeds [m/s] at which the page shows the loops, besides the speeds of the scenario and
            the goals.
        law: reference of the law; empty: the default of the vehicle.
        others: further vehicles, whose loops at the scenario's speed are shown too.
        named: names or files of vehicle and scenario, for the commands that the page states; empty: their own names.
    """

    vehicle: Vehicle
    scenario: Scenario
    initial: Gains
    stated: tuple[Goal, ...] = ()
    cruise: tuple[float, ...] = ()
    law: str = ""
    others: tuple[Vehicle, ...] = ()
    named: tuple[str, str] = ("", "")
    _motions: dict[Any, OperatingPoint] = field(default_factory=dict, repr=False)

    @cached_property
    def case(self) -> Case:
        """Return the simulated case, which consists of scenario, vehicle, law and initial gains."""
        return Case(self.scenario, self.vehicle, self.initial, law=self.law)

    @cached_property
    def base(self) -> Gains:
        """Return the initial gains with the gains that only this law has."""
        return self.case.gains

    @property
    def title(self) -> str:
        """Return vehicle, scenario, law and gains."""
        about = f"{self.vehicle.name} in {self.scenario.name}, law {label(self.case.law)}"
        return f"{about}, true positions, seed 0, gains from {self.base.name}"

    @property
    def speeds(self) -> tuple[float, ...]:
        """Return the cruise speeds [m/s] at which the loops are shown, slowest first."""
        return tuple(sorted({self.scenario.cruise, *self.cruise, *(u for goal in self.stated for u in goal.cruise)}))

    @cached_property
    def _places(self) -> dict[str, tuple[float, Mapping[str, float], Vehicle | None]]:
        # speed, plant and vehicle of each operating point
        places: dict[str, tuple[float, Mapping[str, float], Vehicle | None]] = {
            f"{u:g} m/s": (u, {}, None) for u in self.speeds
        }
        u = self.scenario.cruise
        if self.own:
            places = {"its own run": (u, {}, None)}
        _, *ends = corners(self.vehicle)
        for name, plant in (("first corner", ends[:1]), ("last corner", ends[-1:])):
            places |= {name if self.own else f"{name}, {u:g} m/s": (u, one, None) for one in plant}
        return places | {f"{craft.name}, {u:g} m/s": (u, {}, craft) for craft in self.others if not self.own}

    @property
    def own(self) -> bool:
        """Whether the law is the user's own, and so linearised about the steady motion of its run."""
        return is_own(self.case.law)

    @property
    def version(self) -> int:
        """Return a number that changes when loops of equal gains change, because another run is known."""
        return len(self._motions)

    @property
    def points(self) -> tuple[str, ...]:
        """Return the names of the operating points: speeds, two corners of the vehicle's ranges, other vehicles."""
        return tuple(self._places)

    @cached_property
    def goals(self) -> tuple[LoopGoal, ...]:
        """Return the goals about the loop, each at its own speeds."""
        return tuple(
            replace(g.loop, points=(self.points[0],) if self.own else tuple(f"{u:g} m/s" for u in self._speeds(g)))
            for g in self.stated
            if g.loop is not None
        )

    def _speeds(self, goal: Goal) -> tuple[float, ...]:
        return goal.cruise or (self.scenario.cruise,)

    @cached_property
    def _judged(self) -> tuple[Goal, ...]:
        metrics = [goal for goal in self.stated if goal.loop is None]
        return judged_goals(metrics, [self.case])[0]

    def ranges(self) -> tuple[GainRange, ...]:
        """Return gains that have a slider, with its ends: the range of the law or file, or gain / 4 to 4 · gain."""
        base = self.base
        own = [name for name in law_source(self.case.law).gains if name not in default_tuned(base)]
        names = [*default_tuned(base), *own]
        return gain_ranges(base, {name: base.ranges.get(name) for name in names if base[name] > 0})

    @cached_property
    def sliders(self) -> tuple[Slider, ...]:
        """Return the gains with their ranges."""
        base = self.base
        return tuple(
            Slider(r.name, base.specs[r.name].unit, base.specs[r.name].meaning, min(r.low, base[r.name]),
                   max(r.high, base[r.name]), base[r.name])
            for r in self.ranges()
        )  # fmt: skip

    def gains(self, values: Mapping[str, float]) -> Gains:
        """Return the initial gains with some values changed."""
        return self.base.with_values(values, provenance=f"tuning page, from {self.base.name}: {self.base.provenance}")

    def loop(self, values: Mapping[str, float], point: str) -> LinearLoop:
        """Return the linear loop of the law at an operating point.

        A law of the user's own is linearised about the steady motion of its run with these gains; until they have been
        simulated, about that of the latest run.
        """
        speed, plant, craft = self._places[point]
        case = self.case if craft is None else replace(self.case, vehicle=craft)
        motion = self._motion(values) if self.own else None
        return case_loop(case, self.gains(values), cruise=speed, plant=plant, motion=motion)

    def _motion(self, values: Mapping[str, float]) -> OperatingPoint:
        if not self._motions:
            self.simulate(values)
        if not self._motions:
            raise InputError("has no steady motion", key=self.scenario.name, remedy="give a longer straight part")
        return self._motions.get(tuple(values.items()), next(reversed(self._motions.values())))

    def simulate(self, values: Mapping[str, float]) -> Run:
        """Simulate the closed loop with seed 0; the law is compiled once, with the gains as its parameters."""
        run = simulate(self.scenario, self.vehicle, gains=self.gains(values), law=self.case.build())
        key = tuple(values.items())
        if self.own and key not in self._motions:
            with suppress(InputError):  # without a steady motion, the last one stays
                self._motions[key] = steady_motion(run)
        return run

    def judge(self, values: Mapping[str, float]) -> Evaluation | None:
        """Evaluate the goals about metrics for the nominal plant and for the corners; None without such goals."""
        if not self._judged:
            return None
        evaluated = conditions([self.case], seeds=[0])
        gains = self.gains(values)
        return evaluate(self._judged, evaluated, {name: np.array([value]) for name, value in gains.values.items()})

    def run(self, values: Mapping[str, float], points: Sequence[str]) -> RunView:
        """Return the run in the scenario: figures, goals, signals, thrust activity and the plan view."""
        run = self.simulate(values)
        m = run.metrics
        rows = [("how the run ended", m.stopped_because, "outcome", "good" if m.reached else "bad")]
        for name in _RUN_FIGURES:
            unit = METRICS[name].unit
            value = float(getattr(m, name))
            rows.append((METRICS[name].meaning, f"{value:.4g}" + ("" if unit == "1" else f" {unit}"), name, ""))
        rows += self._goal_rows(values)
        dt, tau = run.law.dt, run.record.tau
        rows += [
            (f"thrust {axis}", activity(tau[:, k], dt, unit), f"act {axis}", "")
            for k, (axis, unit) in enumerate(_THRUST.items())
            if np.abs(tau[:, k]).max(initial=0.0) > 0
        ]
        text = f"Trajectory in {run.scenario.name}: {m.stopped_because} at {m.time_s:.2f} s"
        return RunView(rows, _panels(run), (plot_run(run).figure.figure, text))

    def _goal_rows(self, values: Mapping[str, float]) -> list[tuple[str, str, str, str]]:
        evaluation = self.judge(values)
        if evaluation is None:
            return []
        rows = []
        for k, goal in enumerate(evaluation.goals):
            figure, share, place = evaluation.figure[0, k], evaluation.normalised[0, k], evaluation.place[0, k]
            unit = "" if goal.unit == "1" else f" {goal.unit}"
            at = ", ".join(["", *filter(None, [goal.place_text(place)])])
            text = f"{'met' if share <= 1 else 'missed'}: {figure:.4g}{unit}, {goal.sense} {goal.limit:g}{unit}{at}"
            rows.append((f"goal {goal.name} ({goal.kind})", text, f"goal {goal.name}", "good" if share <= 1 else "bad"))
        return rows

    def verdicts(self, values: Mapping[str, float]) -> tuple[Verdict | Inapplicable, ...]:
        """Return the verdict on each claim of the library, for these gains, this vehicle and the scenario's speeds."""
        at_hand = {**self.gains(values).values, "speed": self.scenario.cruise, "speed_max": self.scenario.cap}
        claims, refused = applicable_claims(at_hand, vehicle=self.vehicle, errata=has_tuned(self.vehicle))
        decided = [decide(c, time_limit=_PATIENCE) for c in claims]
        return (*decided, *(Inapplicable.of(name, reason) for name, reason in refused.items()))

    def _statement(self, values: Mapping[str, float]) -> RegionStatement | NotApplicable:
        about: dict[str, Any] = {"law": self.case.law, "guidance": self.case.guidance}
        about |= {"cruise": self.scenario.cruise, "cap": self.scenario.cap}
        return applicable_region(DEFAULT_REGIONS, self.vehicle, self.gains(values), **about)

    def assess(self, values: Mapping[str, float]) -> Assessment:
        """Return the assessment of these gains in the scenario, with true positions."""
        speeds = (self.scenario.cruise, self.scenario.cap)
        gains, run = self.gains(values), self.simulate(values)
        subject = Mission(self.vehicle, gains, *speeds, self.case.law, scenarios=(self.scenario,), runs=(run,))
        return assess(replace(subject, sensing="truth"))

    def decide(self, values: Mapping[str, float]) -> SlowView:
        """Return the assessment and the verdicts on the claims; the picture shows the certified region."""
        assessment = self.assess(values)
        marks = {"proved": "good", "refuted": "bad"}
        claims = [
            (f"{v.claim}: {v.sentence}", "none")
            if isinstance(v, Inapplicable)
            else (f"{v.claim.name}: {v.verdict}", marks.get(v.verdict, "none"))
            for v in (self.verdicts(values) if law_source(self.case.law).parts else ())
        ]
        lines, region = [*assessed_lines(assessment), *claims], assessment.sources["region"]
        if not isinstance(region, RegionProof) or region.verdict != "proved":
            return SlowView(lines)
        ratio = 0.0 if region.ratios is None else region.ratios.falsifier
        figure = plot_region(region.certificate(), falsified=1 / ratio if ratio > 0 else None)
        return SlowView(lines, (figure, f"Region of {region.claim.name}: certified level, and least falsified level"))

    def command(self, values: Mapping[str, float], view: View) -> str:
        """Return a command for the same vehicle and gains, once they are saved as `gains.toml`."""
        craft, mission = self.named
        options = ["--vehicle", craft or self.vehicle.name, "--gains", "gains.toml", "--law", self.case.law]
        options += ["--out", "pictures"]
        if view == "run":
            words = ["simulate", mission or self.scenario.name, "--sensing", "truth"]
        else:
            words = ["verify", "--cruise", f"{self.scenario.cruise:g}", "--cap", f"{self.scenario.cap:g}"]
            statement = self._statement(values)
            if view == "decision" and not isinstance(statement, NotApplicable):
                words.insert(1, statement.name)
        return shlex.join(["surctl", *words, *options])

    def save(self, values: Mapping[str, float], file: str) -> str:
        """Write a gain file; return what to do with it."""
        path = save_gains(self.gains(values), file)
        return f"saved {path}; surctl verify --gains {path}"

    def load(self, file: str) -> dict[str, float]:
        """Read the gains of a gain file that have a slider."""
        gains = load_gains(file, own=self.base.own)
        return {one.name: float(gains[one.name]) for one in self.sliders}


def _panels(run: Run) -> list[Panel]:
    time, panels = run.record.time, list[Panel]()
    for title, unit, curves, bounds in run_signals(run):
        kind: Literal["steps", "line"] = "steps" if unit in _THRUST.values() else "line"
        lines = [Curve(time, values, label, k, kind) for label, values, k, _ in curves]
        limits = [level for label, level, _ in bounds if label != "stand-off"]
        shades = [Shade(time, np.full(len(time), one), "above" if one > 0 else "below") for one in limits]
        panels.append(Panel(f"Run: {title}", "time [s]", f"{title} [{unit}]", lines, shades))
    return panels


def save_gains(gains: Gains, file: str) -> Path:
    """Write a gain file that `load_gains` can read; return its path.

    Raises:
        InputError: the name is empty or does not end in .toml, the folder cannot be written, or a file of another kind
            has this name.
    """
    path = replaceable(gain_file(file), "gains")
    write_file(path, write_gains(gains))
    load_gains(str(path))
    return path
