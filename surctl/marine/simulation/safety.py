"""The no-contact claim: what the barrier guarantees in a scenario, and the `margin` that a vehicle needs to brake.

The law bounds the speed towards an obstacle by the distance to it. A real vehicle needs an additional distance, the
margin, because it does not follow this speed bound exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import ceil, degrees, floor, inf, isfinite
from typing import Any

import numpy as np

from surctl.marine.control import Barrier, Gains, Movers
from surctl.marine.control.gains import setting
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.control.stopping import BRAKE
from surctl.marine.guidance.braking import (
    LEAST_THRUST,
    Brakes,
    Watch,
    beside,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_distance_with_drag,
    tabled_stopping_distance,
)
from surctl.marine.sensing import INCIDENCE_LIMIT
from surctl.marine.simulation.echo_fit import unanswered
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import BAND, FOOTPRINT
from surctl.marine.vehicle import Vehicle, steady_speed
from surctl.marine.vehicle.dynamics import check_equation_3

_STEP = 0.002  # [m/s] between two examined speeds
_NEAR = 0.95  # share of the fastest obstacle speed: beyond it the required range grows without bound
_FINEST = 1e-4  # [m/s] resolution of the largest obstacle speed
_LIGHTEST = 1e-2  # [kg] resolution of the largest mass difference


def margin_needed(
    scenario: Scenario,
    believed: Vehicle,
    gains: Gains,
    actual: Vehicle,
    *,
    barrier: Barrier = "simple",
    turning: float = 0.0,
) -> float:
    """Return the distance [m] that the actual vehicle needs beyond the law's speed bound; inf if it cannot brake.

    It is computed as in `safety_claim`, with the law's model `believed`, but with the exact parameters of the `actual`
    vehicle: its own masses m11 and m22, and its thrust limit minus the scenario's thrust error. `turning` is the yaw
    rate of the hull while it brakes [rad/s], see `turn_rate`.
    """
    d = scenario.disturbance
    brakes = brakes_of(
        actual,
        share=1 - d.thrust_error - d.thrust_bias,
        spread=0.0,
        disturbance=d.drift_force_n + d.wave_force_n + munk(abs(actual["m11"] - actual["m22"]), turning, scenario.cap),
        current=float(np.hypot(*d.current_m_per_s)),
    )
    return max(Bound(turned(brakes, turning), Watch(), believed, gains, barrier, scenario.cap).margins(0.0).values())


def turn_rate(
    scenario: Scenario, believed: Vehicle, gains: Gains, *, sonar: bool, actual: Vehicle | None = None
) -> float:
    """Return the steady yaw rate [rad/s] of the hull during a sonar scan, or without sonar in the sharpest path corner.

    At this rate, the moment of the yaw loop equals the yaw drag of the `actual` vehicle; default: of the one that turns
    fastest within the ranges of the law's model `believed`. With `sonar`, the law turns the hull to scan.
    """
    if sonar:
        desired = min(gains["spin"], believed.steady_yaw(YAW_SHARE, scenario.cruise))
    else:
        desired = gains["k_psi"] * float(np.max(scenario.turns, initial=0.0))

    def end(name: str, which: int) -> float:
        stated = believed.parameters[name].range
        return (believed[name] if stated is None else stated[which]) if actual is None else actual[name]

    loop, linear, quadratic = believed["m44"] * gains["k_r"], end("Nr", 0), end("Nrr", 0)
    demand = (believed["Nr"] + believed["Nrr"] * desired + loop) * desired
    return min(steady_speed(demand, linear + loop, quadratic), steady_speed(end("Fr_max", 1), linear, quadratic))


def mass_difference(vehicle: Vehicle, spread: float | None = None) -> float:
    """Return the largest difference |m11 - m22| [kg] of the surge and sway masses that the true vehicle may have.

    It follows from the relative error `spread`, common to both masses, or with None from the ranges of the vehicle
    file. Equal values and ranges of both mean that both true masses are equal.
    """
    surge, sway = (vehicle.parameters[name] for name in ("m11", "m22"))
    if spread is not None:
        return abs(surge.value - sway.value) * (1 + spread)
    if (surge.value, surge.range) == (sway.value, sway.range):
        return 0.0
    (low, high), (low2, high2) = (p.range or (p.value, p.value) for p in (surge, sway))
    return float(max(high - low2, high2 - low))


def munk(difference: float, turning: float, speed: float) -> float:
    """Return the force |m11 - m22| r v [N] on a hull with yaw rate r and speed v.

    This is the largest value of the force; its direction turns with the hull.
    """
    return difference * turning * speed


def turned(brakes: Brakes, turning: float) -> Brakes:
    """Return the braking data of a turning hull, on which the thrust lag reduces the braking force.

    `analysis/15_braking_barrier/proof.md` derives this reduction.
    """
    return replace(brakes, least=brakes.least / (1 + (turning * brakes.lag) ** 2))


def _largest(enough: Callable[[float], bool], high: float, resolution: float) -> float:
    """Return the largest number up to `high` for which a margin is enough, to a resolution; 0 if there is none."""
    low = 0.0
    if not enough(0.0):
        return 0.0
    while high - low > resolution:
        middle = (low + high) / 2
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


@dataclass(frozen=True)
class Bound:
    """The law's speed bound, with the data that decide whether the law's margin is enough to brake.

    The data are those of braking and of sampling.
    """

    brakes: Brakes
    watch: Watch
    vehicle: Vehicle
    gains: Gains
    barrier: Barrier
    cap: float

    def difference(self, obstacle: float, turning: float) -> float:
        """Return the largest |m11 - m22| [kg] that the law's margin covers; inf if the hull does not turn.

        The disturbance force in `brakes` must not include the force that this mass difference causes.
        """
        if turning * self.cap <= 0:
            return inf

        def enough(difference: float) -> bool:
            disturbance = self.brakes.disturbance + munk(difference, turning, self.cap)
            turning_brakes = replace(self.brakes, disturbance=disturbance)
            return max(replace(self, brakes=turning_brakes).margins(obstacle).values()) <= self.gains["margin"]

        return _largest(enough, self.brakes.least / (turning * self.cap), _LIGHTEST)

    def limit(self, detection: float) -> float:
        """Return the largest obstacle speed [m/s] for which detection range and margin suffice; 0 if there is none."""
        most = min(_NEAR * fastest_obstacle(self.brakes), 10.0)
        return _largest(lambda speed: self.suffices(speed, detection), most, _FINEST)

    def suffices(self, obstacle: float, detection: float) -> bool:
        """Return whether detection range and margin are enough for an obstacle of the given speed [m/s]."""
        needed = range_needed(
            self.brakes, self.watch, self.cap, obstacle=obstacle, stopping=stopping_distance_with_drag
        )
        return needed <= detection and max(self.margins(obstacle).values()) <= self.gains["margin"]

    def margins(self, obstacle: float) -> Mapping[float, float]:
        """Return the margin [m] needed beyond the bound, by robot speed [m/s] up to the largest allowed speed."""
        result, top = {}, self.cap + self.watch.speed_error + self.excess(self.cap)
        distance = tabled_stopping_distance(
            self.brakes, top + self.brakes.acceleration(obstacle) * self.watch.period, obstacle=obstacle
        )
        for speed in np.linspace(-obstacle, self.cap, round((self.cap + obstacle) / _STEP) + 1).tolist():
            late = replace(self.watch, speed_error=self.watch.speed_error + self.excess(speed))
            needed = range_needed(self.brakes, late, speed, obstacle=obstacle, stopping=distance)
            result[speed] = needed - self.law_distance(speed, obstacle)
        return result

    def law_distance(self, speed: float, obstacle: float) -> float:
        """Return the distance [m] to the obstacle, without the margin, at which the law allows the given speed."""
        if self.barrier == "inertia":
            own = brakes_of(self.vehicle, share=self.gains["brake"])
            return range_needed(own, Watch(self.watch.period), speed, obstacle=obstacle)
        weakest, (_, heaviest) = self._weakest, self._masses
        closing, reaction = speed + obstacle, self.gains["reaction"]
        return closing**2 * heaviest / (2 * self.gains["brake"] * weakest) + (closing + obstacle) * reaction

    def excess(self, speed: float) -> float:
        """Return by how much [m/s] the robot exceeds a speed bound when the loop brakes with the guaranteed thrust F_b.

        `speed` is the bound [m/s]. F_b is `brakes.least`. The velocity loop compensates drag by feedforward, which acts
        against braking. So the loop commands −F_b only at an excess that corresponds to F_b plus the drag.
        """
        v, pairs = max(speed, 0.0), (("Xu", "Xuu"), ("Yv", "Yvv"))
        drag = max(self.vehicle[a] * v + self.vehicle[b] * v**2 for a, b in pairs)
        return (self.brakes.least + drag) / (self.gains["k_v"] * (1 + BRAKE) * self._masses[0])

    @cached_property
    def _weakest(self) -> float:  # the smaller thrust limit of surge and sway [N]; every speed of `margins` asks for it
        return float(min(self.vehicle.thrust_limit[:2]))

    @cached_property
    def _masses(self) -> tuple[float, float]:  # the smaller and the larger mass of surge and sway [kg]
        mass = self.vehicle.mass[:2]
        return float(min(mass)), float(max(mass))


@dataclass(frozen=True)
class Figure:
    """A number of the safety claim with its unit and meaning; the value is inf if the number is not bounded."""

    name: str
    value: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class SafetyClaim:
    """The claim that the hull never hits an obstacle if the assumptions hold.

    The claim also states whether detection range and margin are sufficient.

    Attributes:
        scenario, vehicle: names of the scenario and the vehicle.
        barrier, movers: options of the law, as for `build_law`.
        statement: the claim in words.
        assumptions: the assumptions of the claim, with their numbers.
        derived: numbers that follow from the assumptions.
        holds: whether detection range and margin are enough at every speed up to the speed cap, and no obstacle of the
            scenario contradicts what the claim assumes of surfaces.
        echoes: what the claim assumes of surfaces, if the law has sonars; else empty.
        contradicted: which obstacles of the scenario answer otherwise; empty if none does.
    """

    scenario: str
    vehicle: str
    barrier: str
    movers: str
    statement: str
    assumptions: tuple[Figure, ...]
    derived: tuple[Figure, ...]
    holds: bool
    echoes: str = ""
    contradicted: str = ""

    def __getitem__(self, name: str) -> float:
        """Return the value of an assumption or a derived number of the claim; KeyError if the name is unknown."""
        return {f.name: f.value for f in (*self.assumptions, *self.derived)}[name]

    def to_dict(self) -> dict[str, Any]:
        """Return the claim as plain data for JSON; the writer converts numbers that are not finite."""
        return asdict(self)

    def lines(self) -> list[str]:
        """Return the claim as lines of text."""
        head = f"{self.scenario} by {self.vehicle}, {self.sensed}: {self.statement}"
        rows = [
            f"  {what:<8} {f.name:<24} {f.value:8.4g} {f.unit}"
            for what, figures in (("assumes", self.assumptions), ("gives", self.derived))
            for f in figures
        ]
        speeds = "" if self.contradicted else " at every speed up to the cap"
        end = "holds" if self.holds else f"DOES NOT HOLD{speeds}: {self.shortfall}"
        return [head, *rows, *([f"  assumes  {self.echoes}"] if self.echoes else []), f"  {end}"]

    @property
    def obstacles(self) -> str:
        """The obstacles that the claim is about, in words."""
        covered = self["obstacle speed"]
        return "at rest" if self.movers == "predict" else f"that approach at up to {covered:.3g} m/s"

    @property
    def sensed(self) -> str:
        """How the law detects obstacles, in words; with true positions the detection range is inf."""
        return "by sonar" if isfinite(self["detection range"]) else "with true positions"

    @property
    def least_margin(self) -> float:
        """Least sufficient value [m] of the gain `margin`, rounded up to a whole mm; inf if no value is sufficient."""
        needed = self["margin needed"]
        return ceil(needed * 1e3 - 1e-9) / 1e3 if isfinite(needed) else inf

    @property
    def shortfall(self) -> str:
        """Text that states which numbers are insufficient, by how much, and what to change; empty for a valid claim."""
        parts = []
        if self["margin needed"] > self["margin"]:
            slow = floor(self["covered speed"] * 1e3 + 1e-9) / 1e3
            margin = self.least_margin
            remedy = f"set {setting('margin', margin)} in the gain file" if isfinite(margin) else ""
            slower = f"lower the speed cap, and a faster cruise speed, to {slow:g} m/s or less" if slow > 0 else ""
            what = (
                f"braking needs a margin of {self['margin needed']:.3g} m, and the gain margin is {self['margin']:g} m"
            )
            parts.append(f"{what}; {' or '.join(filter(None, (remedy, slower))) or 'lower the speed cap'}")
        if self["range needed"] > self["detection range"]:
            what = f"obstacles must be detected at {self['range needed']:.3g} m, and the sensors reach"
            parts.append(f"{what} {self['detection range']:.3g} m; lower the speed cap")
        if self.contradicted:
            parts.append(f"the scenario contradicts what it assumes of surfaces: {self.contradicted}")
        return "; ".join(parts)


def safety_claim(
    scenario: Scenario,
    vehicle: Vehicle,
    gains: Gains,
    *,
    barrier: Barrier = "simple",
    movers: Movers = "predict",
    watch: Watch | None = None,
    detection: float = inf,
    sideways: float = 0.0,
    spread: float | None = None,
    turning: float = 0.0,
    difference: float | None = None,
) -> SafetyClaim:
    """Return the safety claim of the guarded law for a scenario and a vehicle.

    The law bounds the speed towards an obstacle by the distance to it. The claim holds if the law's margin is at least
    the distance that the vehicle needs beyond this speed bound, with the worst values of the vehicle's parameter
    ranges. If the speed exceeds the bound by a certain excess, the velocity loop commands the least guaranteed thrust,
    and the vehicle brakes with this thrust. The required margin follows from step 4 of the proof of `guidance.braking`;
    there, the excess is an additional speed error, and drag adds to the braking force. The claim does not cover thrust
    limits that act on each axis separately: a large simultaneous sideways command may reduce the braking force. The law
    commands no sideways velocity once the vehicle is 0.02 m/s too fast.

    If the vehicle may change its depth, the claim needs two more assumptions. First, the echo sounders detect every
    obstacle over or under the hull, since the horizontal sonars do not observe that water. Second, the depth error
    stays within the vertical thickness of the sonars' fan.

    Args:
        scenario: the mission, with its speed cap, current and disturbance forces.
        vehicle: the actual vehicle, which is also the model of the law.
        barrier, movers: options of the law, as for `build_law`.
        detection: range at which the sensors certainly detect an obstacle [m].
        sideways: largest sideways speed when braking begins [m/s]; it causes a force, because drag acts on each axis
            separately.
        spread: largest relative error of mass and drag, see `brakes_of`.
        turning: yaw rate of the hull while it brakes [rad/s], see `turn_rate`.
        difference: largest |m11 - m22| [kg], which causes a force in a turn; the claim states the largest difference
            that the margin covers. With None, the function takes the mass difference of the vehicle, see
            `mass_difference`.

    Raises:
        NotApplicable: the vehicle has terms beyond equation (3) of the paper.
    """
    check_equation_3(vehicle, reverse=True)
    difference = mass_difference(vehicle, spread) if difference is None else difference
    watch, share = watch or Watch(), LEAST_THRUST if barrier == "simple" else gains["brake"]
    d = scenario.disturbance
    brakes = brakes_of(
        vehicle,
        share=share,
        spread=spread,
        disturbance=d.drift_force_n + d.wave_force_n,
        current=float(np.hypot(*d.current_m_per_s)),
    )
    level = beside(turned(brakes, turning), sideways)
    brakes = replace(level, disturbance=level.disturbance + munk(difference, turning, scenario.cap))
    bound = Bound(brakes, watch, vehicle, gains, barrier, scenario.cap)
    covered = bound.limit(detection) if movers == "barrier" else 0.0
    needed = bound.margins(covered)
    short = min((speed for speed, margin in needed.items() if margin > gains["margin"]), default=inf)
    safe = scenario.cap if short == inf else max((speed for speed in needed if speed < short), default=0.0)
    sight = range_needed(brakes, watch, scenario.cap, obstacle=covered, stopping=stopping_distance_with_drag)
    assumptions: tuple[Figure, ...] = (
        Figure(
            "obstacle speed",
            covered,
            "m/s",
            "largest speed towards the vehicle at all times, both true and as known to the law",
        ),
        Figure(
            "detection range",
            detection,
            "m",
            "distance from the hull at which an obstacle is certainly detected, at whatever angle beams meet its faces",
        ),
        Figure(
            "least thrust",
            brakes.least,
            "N",
            f"thrust that certainly acts against the motion: {share:.0%} of the stated limit",
        ),
        Figure(
            "largest thrust", brakes.most, "N", "thrust that may still act towards the obstacle when braking begins"
        ),
        Figure("thrust lag", brakes.lag, "s", "time constant of the first-order lag"),
        Figure("least mass", brakes.masses[0], "kg", "lower bound of m11 and m22"),
        Figure("largest mass", brakes.masses[1], "kg", "upper bound of m11 and m22"),
        Figure(
            "least quadratic drag", brakes.quadratic[0], "N s^2/m^2", "lower bound in surge and sway, for motion ahead"
        ),
        Figure(
            "largest quadratic drag",
            brakes.quadratic[1],
            "N s^2/m^2",
            "upper bound in surge and sway, for motion astern",
        ),
        Figure(
            "push",
            brakes.disturbance,
            "N",
            "force towards the obstacle by waves, drift, sideways drag and, in a turn, the mass difference",
        ),
        Figure("current", brakes.current, "m/s", "speed of the water towards the obstacle"),
        Figure("turn rate", turning, "rad/s", "yaw rate of the hull while it brakes"),
        Figure("mass difference", difference, "kg", "largest |m11 - m22|, which causes a force in a turn"),
        Figure("sideways speed", sideways, "m/s", "largest sideways speed when braking begins"),
        Figure("speed cap", scenario.cap, "m/s", "largest own speed"),
        Figure("sampling time", watch.period, "s", "time between two decisions of the law"),
        Figure("range error", watch.range_error, "m", "largest error of a measured range"),
        Figure("range age", watch.age, "s", "largest age of a range when the law uses it"),
        Figure("speed error", watch.speed_error, "m/s", "largest error of the measured speed"),
    )
    if scenario.depths is not None:
        coverage = "extra radius beyond the hull: the echo sounders detect every obstacle over or under this disc"
        fan = "thickness beyond the hull, above and below: the robot passes over or under obstacles outside this fan"
        assumptions += (Figure("sounder footprint", FOOTPRINT, "m", coverage), Figure("sonar fan", BAND, "m", fan))
    derived = (
        Figure("range needed", sight, "m", "distance at which that obstacle must be detected, at the speed cap"),
        Figure(
            "margin needed",
            max(0.0, *needed.values()),
            "m",
            "margin that the vehicle needs beyond the law's bound, at the worst speed",
        ),
        Figure("margin", gains["margin"], "m", "margin in the gains"),
        Figure("covered speed", max(safe, 0.0), "m/s", "own speed up to which that margin is enough"),
        Figure(
            "covered difference",
            replace(bound, brakes=level).difference(covered, turning),
            "kg",
            "mass difference up to which that margin is enough",
        ),
        Figure(
            "excess",
            bound.excess(scenario.cap),
            "m/s",
            "speed over the bound, at the cap, at which the velocity loop commands the least thrust",
        ),
        Figure(
            "drag equals thrust at",
            fastest_obstacle(brakes),
            "m/s",
            "obstacle speed from which no margin or range suffices; claims that assume more have a lower one",
        ),
    )
    what = "an obstacle at rest" if movers == "predict" else f"an obstacle that approaches at up to {covered:.3g} m/s"
    statement = f"the hull never touches {what} (one obstacle at a time, barrier {barrier})"
    sonar = isfinite(detection)
    echoes, contradicted = (_echoes(scenario, vehicle, sight), unanswered(scenario)) if sonar else ("", "")
    holds = short == inf and sight <= detection and not contradicted
    return SafetyClaim(
        scenario.name, vehicle.name, barrier, movers, statement, assumptions, derived, holds, echoes, contradicted
    )


def _echoes(scenario: Scenario, vehicle: Vehicle, sight: float) -> str:
    # what must be true of surfaces for obstacles to be detected at the distance `sight` [m]
    array = scenario.sensors.array_on(vehicle["radius"])  # refuses mounts that this hull cannot have
    at = array.corner_range(INCIDENCE_LIMIT)
    text = f"faces answer within {degrees(INCIDENCE_LIMIT):.3g} deg of their normal"
    if at >= sight:
        return text
    when = f"is heard {at:.2f} m away at best" if at > 0 else "is touched before it is heard"
    return f"{text}, and no corner points at the hull: on its bisector it {when}"
