"""Computations of the web page for tuning, as pure functions of a `Bench` (vehicle, scenario, goals) and gains.

The web page is in the package, not among the notebooks, because an installed `surctl` must be able to serve it. The
page is in the report package, because only this package plots results and may import tuning, verification and
simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.control import Gains, load_gains, write_gains
from surctl.errors import InputError
from surctl.files import write_file
from surctl.report.locus import plot_locus
from surctl.report.loops import loop_responses, plot_bode
from surctl.report.margin_plots import plot_s_and_t, sensitivities
from surctl.report.plan_view import plot_run
from surctl.report.theme import BAD, curve, dress, legend_above, new_figure
from surctl.simulation import Case, Run, Scenario, simulate
from surctl.tuning import Evaluation, GainRange, Goal, conditions, default_tuned, evaluate, gain_ranges
from surctl.vehicle import Vehicle
from surctl.verification import (
    LINEAR_METRICS,
    LINEAR_PARAMETERS,
    Inapplicable,
    OverSpeeds,
    Verdict,
    applicable_claims,
    build_cascade,
    decide,
    linear_table,
    over_speeds,
    sweep_locus,
)
from surctl.verification.linear import slowest_mode
from surctl.verification.steps import STEP_NAMES, step_system

__all__ = ["Bench", "Steps", "plot_steps", "save_gains", "slider_steps", "step_responses"]

_STOPS = 40  # number of positions of a slider on either side of its start value
_SAMPLES = 400
_LOCUS = 41
_SMOOTH = 0.05  # largest step of a pole between two values of the gain, as a share of the pole's modulus
_PATIENCE = 10.0  # [s] time limit of each proof
_DIGITS = 4  # significant digits of slider values; the start value is not rounded


@dataclass(frozen=True, eq=False)
class Steps:
    """Responses of the closed loop to unit steps in the references.

    Attributes:
        time: (n,) times [s] by name of the stepped reference.
        value: (n,) responses by name of the stepped reference, as a share of the step height.
    """

    time: Mapping[str, NDArray[np.float64]]
    value: Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Bench:
    """The vehicle, scenario (with true positions) and goals of the tuning page; methods take the gains to evaluate.

    Attributes:
        vehicle: the simulated vehicle, which is also the model of the controller.
        scenario: the mission.
        gains: initial gains of the tuning page.
        goals: the goals that a set of gains should meet.
        cruise: further cruise speeds [m/s] at which the page shows the loops, besides the speeds of the scenario and
            the goals.
    """

    vehicle: Vehicle
    scenario: Scenario
    gains: Gains
    goals: tuple[Goal, ...]
    cruise: tuple[float, ...] = ()

    @property
    def case(self) -> Case:
        """Return the simulated case, which consists of scenario, vehicle and initial gains."""
        return Case(self.scenario, self.vehicle, self.gains)

    @property
    def dt(self) -> float:
        """Return the control period [s]."""
        return self.case.build().dt

    @property
    def speeds(self) -> tuple[float, ...]:
        """Return the cruise speeds [m/s] at which the loops are shown, slowest first."""
        return tuple(sorted({self.scenario.cruise, *self.cruise, *(u for goal in self.goals for u in goal.cruise)}))

    def ranges(self, gains: Gains) -> tuple[GainRange, ...]:
        """Return gains that have a slider, with the slider's ends: the gain file's range, or gain / 4 to 4 · gain."""
        return gain_ranges(gains, {name: gains.ranges.get(name) for name in default_tuned(gains)})

    def simulate(self, gains: Gains) -> Run:
        """Simulate the closed loop with seed 0; the law is compiled once, with the gains as its parameters."""
        return simulate(self.scenario, self.vehicle, gains=gains, law=self.case.build())

    def judge(self, gains: Gains) -> Evaluation:
        """Evaluate the goals in the scenario for the nominal plant and for the corners of the vehicle's ranges."""
        evaluated = conditions([self.case], seeds=[0])
        return evaluate(self.goals, evaluated, {name: np.array([value]) for name, value in gains.values.items()})

    def linear(self, gains: Gains) -> dict[str, float]:
        """Return the metrics of the linear loop (`LINEAR_METRICS`) at the scenario's cruise speed."""
        table = linear_table(
            self.vehicle, {}, base=gains.values, columns=tuple(LINEAR_METRICS), cruise=self.scenario.cruise, dt=self.dt
        )
        return {name: float(values[0]) for name, values in table.items()}

    def over_speeds(self, gains: Gains, columns: Collection[str]) -> OverSpeeds:
        """Return the given metrics of the linear loop (`columns` of `LINEAR_METRICS`) at all cruise speeds."""
        return over_speeds(self.vehicle, gains.values, cruise=self.speeds, dt=self.dt, columns=columns)

    def bode(self, gains: Gains, loop: str | None = None) -> Figure:
        """Plot the Bode diagram of one loop at all speeds; with `loop` None, of all loops at the scenario's speed."""
        figure = new_figure(6.4, 5.2)
        upper, lower = figure.subplots(2, 1, sharex=True)
        if loop is None:
            shown = loop_responses(self.vehicle, gains.values, cruise=self.scenario.cruise, dt=self.dt)
        else:
            at = {u: loop_responses(self.vehicle, gains.values, cruise=u, dt=self.dt) for u in self.speeds}
            shown = tuple(
                replace(one, name=f"{loop} at {u:g} m/s")
                for u, every in at.items()
                for one in every
                if one.name == loop
            )
        return plot_bode(shown, (upper, lower))

    def steps(self, gains: Gains) -> Figure:
        """Plot the step responses at all cruise speeds."""
        return plot_steps({u: step_responses(self.vehicle, gains.values, cruise=u, dt=self.dt) for u in self.speeds})

    def sensitivity(self, gains: Gains) -> Figure:
        """Plot sensitivities S and T of all loops opened together at the thrust, at each speed with a stable loop."""
        curves = sensitivities(self.vehicle, gains.values, cruise=self.speeds, dt=self.dt, places=("thrust",))
        if not curves:
            raise _unstable(self.vehicle, gains.values, cruise=self.speeds[0], dt=self.dt)
        return plot_s_and_t(curves)

    def locus(self, gains: Gains, gain: str) -> Axes:
        """Plot the closed-loop poles over the range of one gain, with the poles at its current value marked."""
        ends = next(r for r in self.ranges(self.gains) if r.name == gain)
        low, high = min(ends.low, gains[gain]), max(ends.high, gains[gain])
        values = np.union1d(np.linspace(low, high, _LOCUS), [gains[gain]])
        poles = sweep_locus(
            self.vehicle, gains.values, gain, values, smooth=_SMOOTH, cruise=self.scenario.cruise, dt=self.dt
        )
        return plot_locus(poles, unit=gains.specs[gain].unit, picked=gains[gain])

    @property
    def locus_gains(self) -> tuple[str, ...]:
        """Return the gains with a slider that influence a closed-loop pole."""
        return tuple(r.name for r in self.ranges(self.gains) if r.name in LINEAR_PARAMETERS)

    def plan(self, run: Run) -> Axes:
        """Plot the run in plan view."""
        return plot_run(run)

    def verdicts(self, gains: Gains) -> tuple[Verdict | Inapplicable, ...]:
        """Return the verdict on each claim of the library, for these gains, this vehicle and the scenario's speeds."""
        at_hand = {**gains.values, "speed": self.scenario.cruise, "speed_max": self.scenario.cap}
        claims, refused = applicable_claims(at_hand, vehicle=self.vehicle)
        decided = [decide(c, time_limit=_PATIENCE) for c in claims]
        return (*decided, *(Inapplicable.of(name, reason) for name, reason in refused.items()))


def slider_steps(about: GainRange, value: float) -> list[float]:
    """Return the values of a slider, ascending and evenly spaced in the logarithm, with `value` and both ends.

    If `value` is outside the range of the gain, the slider extends to `value`.
    """
    low, high = min(about.low, value), max(about.high, value)
    grid = np.concatenate([np.geomspace(low, value, _STOPS + 1), np.geomspace(value, high, _STOPS + 1)])
    inner = {float(f"{x:.{_DIGITS}g}") for x in grid}
    return sorted({low, value, high} | {x for x in inner if low < x < high})


def step_responses(vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float) -> Steps:
    """Return the responses to unit steps in the references of surge speed, heading and cross-track position.

    Args:
        vehicle: the vehicle.
        gains: gain values by name.
        cruise: cruise speed U [m/s].
        dt: control period [s].

    Raises:
        InputError: a gain is missing or not positive, the vehicle cannot cruise at that speed, or the loop is
            unstable.
    """
    from control import ss, step_response

    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt)
    if not cascade.stable:
        raise _unstable(vehicle, gains, cruise=cruise, dt=dt)
    time, value = {}, {}
    for name in STEP_NAMES:
        A, b, c = step_system(cascade, name)
        final = float((c @ -np.linalg.solve(A, b))[0, 0])
        metric = linear_table(vehicle, {}, base=gains, cruise=cruise, dt=dt, columns=(f"settling_time_s.{name}",))
        end = 1.6 * float(next(iter(metric.values()))[0])
        time[name] = np.linspace(0, end, _SAMPLES)
        value[name] = np.asarray(step_response(ss(A, b, c, 0), time[name]).outputs, dtype=float) / final
    return Steps(time, value)


def _unstable(vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float) -> InputError:
    mode = slowest_mode(vehicle, gains, cruise=cruise, dt=dt)
    problem = f"the closed loop is unstable at {cruise:g} m/s" + (f" ({mode.cause})" if mode.cause else "")
    return InputError(problem, key="gains", remedy=f"it is stable {mode.remedy}")


def plot_steps(data: Mapping[float, Steps]) -> Figure:
    """Plot the step responses at each cruise speed [m/s], with the ±2 % band that defines the settling time."""
    figure = new_figure(6.4, 6.2)
    axes = figure.subplots(len(STEP_NAMES), 1)
    for ax, name in zip(axes, STEP_NAMES, strict=True):
        dress(ax, x="time [s]" if ax is axes[-1] else "", y=f"{name.replace('_', ' ')} [1]")
        for k, (speed, steps) in enumerate(data.items()):
            curve(ax, steps.time[name], steps.value[name], label=f"{speed:g} m/s", k=k)
        ax.axhspan(0.98, 1.02, color=BAD, alpha=0.13, linewidth=0)
        ax.set_xlim(left=0.0)
    legend_above(axes[0], columns=5)
    return figure


def save_gains(gains: Gains, file: str) -> Path:
    """Write a gain file that `load_gains` can read; return its path.

    Raises:
        InputError: the name is empty or does not end in .toml, or the folder cannot be written.
    """
    path = Path(file.strip()).expanduser()
    if path.suffix != ".toml":
        raise InputError("is not the name of a gain file", key="save", value=file, remedy="end the path in .toml")
    write_file(path, write_gains(gains))
    load_gains(str(path))
    return path
