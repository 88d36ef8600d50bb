"""The distance margin that a vehicle needs to brake, and the part due to turning with unequal masses m11, m22.

The law bounds the speed towards an obstacle by the distance to it. A real vehicle needs an additional distance, the
margin, because it does not follow this speed bound exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt

import numpy as np

from surctl.marine.control import Barrier, Gains
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.control.stopping import BRAKE
from surctl.marine.guidance.braking import (
    Brakes,
    Watch,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_distance_with_drag,
    tabled_stopping_distance,
)
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.vehicle import Vehicle

__all__ = ["Bound", "margin_needed", "mass_difference", "munk", "turn_rate", "turned"]

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

    The margin is computed as in `safety_claim`, but with the exact parameters of the actual vehicle: its own masses m11
    and m22, and its thrust limit minus the scenario's thrust error.

    Args:
        scenario, gains, barrier: same meaning as for `safety_claim`.
        believed: vehicle model that the law uses.
        actual: vehicle that brakes, with its true parameters.
        turning: yaw rate of the hull while it brakes [rad/s], see `turn_rate`.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario, margin_needed
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> weak = vehicle.with_values({"Fu_max": 2.5, "Fv_max": 2.5})  # half the thrust of the law's model
        >>> gains["margin"], [round(margin_needed(mission, vehicle, gains, actual), 3) for actual in (vehicle, weak)]
        (0.05, [0.047, 0.116])
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

    At the steady rate, the moment of the yaw loop equals the yaw drag. The steady rate differs from the desired rate if
    the yaw drag differs from that of the law's model.

    Args:
        scenario: the mission.
        believed: vehicle model that the law uses.
        gains: gains of the law.
        sonar: whether the law turns the hull to scan with its sonars.
        actual: vehicle that turns; default: the vehicle that turns fastest within the stated ranges.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario, turn_rate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle = load_scenario("tank-slalom"), load_vehicle("sur540-flooded")
        >>> [round(turn_rate(mission, vehicle, load_gains("default"), sonar=sonar), 3) for sonar in (True, False)]
        [0.257, 1.575]
    """
    if sonar:
        desired = min(gains["spin"], believed.steady_yaw(YAW_SHARE, scenario.cruise))
    else:
        legs = np.diff(scenario.path.waypoints, axis=0)
        turns = np.diff(np.arctan2(legs[:, 1], legs[:, 0]))
        desired = gains["k_psi"] * float(np.max(np.abs((turns + np.pi) % (2 * np.pi) - np.pi), initial=0.0))

    def end(name: str, which: int) -> float:
        stated = believed.parameters[name].range
        return (believed[name] if stated is None else stated[which]) if actual is None else actual[name]

    loop, linear, quadratic = believed["m44"] * gains["k_r"], end("Nr", 0), end("Nrr", 0)
    demand = (believed["Nr"] + believed["Nrr"] * desired + loop) * desired

    def held(moment: float, linear: float) -> float:
        return 2 * moment / max(linear + sqrt(linear**2 + 4 * quadratic * moment), 1e-9)

    return min(held(demand, linear + loop), held(end("Fr_max", 1), linear))


def mass_difference(vehicle: Vehicle, spread: float | None = None) -> float:
    """Return the largest difference |m11 - m22| [kg] of the surge and sway masses that the true vehicle may have.

    If the file gives surge and sway the same mass and the same range, the function assumes that both true masses are
    equal.

    Args:
        vehicle: vehicle model of the law.
        spread: largest relative error of the masses, common to m11 and m22; None: the ranges of the vehicle file hold.
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

    The module `guidance.braking` derives this reduction.
    """
    return replace(brakes, least=brakes.least / (1 + (turning * brakes.lag) ** 2))


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

        low, high = 0.0, self.brakes.least / (turning * self.cap)
        if not enough(0.0):
            return 0.0
        while high - low > _LIGHTEST:
            middle = (low + high) / 2
            low, high = (middle, high) if enough(middle) else (low, middle)
        return low

    def limit(self, detection: float) -> float:
        """Return the largest obstacle speed [m/s] for which detection range and margin suffice; 0 if there is none."""
        low, high = 0.0, min(_NEAR * fastest_obstacle(self.brakes), 10.0)
        if not self.suffices(0.0, detection):
            return 0.0
        while high - low > _FINEST:
            middle = (low + high) / 2
            low, high = (middle, high) if self.suffices(middle, detection) else (low, middle)
        return low

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
