"""The margin that a vehicle needs beyond the law's bound, and what a hull of two masses that turns adds to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np

from surctl.control import Barrier, Gains
from surctl.control.ports import YAW_SHARE
from surctl.control.stopping import BRAKE
from surctl.guidance.braking import (
    Brakes,
    Watch,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_distance_with_drag,
    tabled_stopping_distance,
)
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["Bound", "margin_needed", "mass_difference", "munk", "turn_rate", "turned"]

_STEP = 0.002  # [m/s] between the speeds that are looked at
_NEAR = 0.95  # of the fastest obstacle: nearer to it the range that is needed grows without end
_FINEST = 1e-4  # [m/s] to which the largest obstacle speed is told
_LIGHTEST = 1e-2  # [kg] to which the largest difference of masses is told


def margin_needed(
    scenario: Scenario,
    believed: Vehicle,
    gains: Gains,
    actual: Vehicle,
    *,
    barrier: Barrier = "simple",
    turning: float = 0.0,
) -> float:
    """Margin [m] that one vehicle with these very numbers needs beyond the law's bound; inf where it cannot brake.

    As in `safety_claim`, with the masses as different as they are and the thrust that the scenario's error leaves.

    Args:
        scenario, gains, barrier: as there.
        believed: what the law believes in.
        actual: what brakes.
        turning: see `turn_rate`.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario, margin_needed
        >>> from surctl.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> weak = vehicle.with_values({"Fu_max": 2.5, "Fv_max": 2.5})  # half the thrust that the law believes in
        >>> gains["margin"], [round(margin_needed(mission, vehicle, gains, flown), 3) for flown in (vehicle, weak)]
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
    """Yaw rate [rad/s] that the hull comes to when it looks around (sonar), else in the path's sharpest corner.

    The rate that is asked for is met where the yaw loop's moment is the drag's, which the law believes another one.

    Args:
        scenario: the mission.
        believed: what the law believes in.
        gains: of the law.
        sonar: whether it looks around.
        actual: what turns; default: whatever turns the most of the stated ranges.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario, turn_rate
        >>> from surctl.vehicle import load_vehicle
        >>> mission, vehicle = load_scenario("tank-slalom"), load_vehicle("sur540-flooded")
        >>> [round(turn_rate(mission, vehicle, load_gains("default"), sonar=sonar), 3) for sonar in (True, False)]
        [0.257, 1.575]
    """
    if sonar:
        desired = min(gains["spin"], believed.steady_yaw(YAW_SHARE))
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
    """Largest |m11 - m22| [kg] that the true vehicle may have.

    Where the file gives surge and sway one mass and one range, the true vehicle has one mass too.

    Args:
        vehicle: what is believed.
        spread: share by which both masses together may be off; None takes the ranges of the vehicle file.
    """
    surge, sway = (vehicle.parameters[name] for name in ("m11", "m22"))
    if spread is not None:
        return abs(surge.value - sway.value) * (1 + spread)
    if (surge.value, surge.range) == (sway.value, sway.range):
        return 0.0
    (low, high), (low2, high2) = (p.range or (p.value, p.value) for p in (surge, sway))
    return float(max(high - low2, high2 - low))


def munk(difference: float, turning: float, speed: float) -> float:
    """Most [N] by which a hull of two masses that turns is pushed: |m11 - m22| r v, in a direction that turns too."""
    return difference * turning * speed


def turned(brakes: Brakes, turning: float) -> Brakes:
    """What the lag leaves of a force against the motion when the hull turns under it, see `guidance.braking`."""
    return replace(brakes, least=brakes.least / (1 + (turning * brakes.lag) ** 2))


@dataclass(frozen=True)
class Bound:
    """The law's bound, and what it must be compared with."""

    brakes: Brakes
    watch: Watch
    vehicle: Vehicle
    gains: Gains
    barrier: Barrier
    cap: float

    def difference(self, obstacle: float, turning: float) -> float:
        """Largest |m11 - m22| [kg] that the margin suffices for, of brakes that leave it out; inf without turning."""
        if turning * self.cap <= 0:
            return inf

        def enough(difference: float) -> bool:
            pushed = replace(self.brakes, disturbance=self.brakes.disturbance + munk(difference, turning, self.cap))
            return max(replace(self, brakes=pushed).margins(obstacle).values()) <= self.gains["margin"]

        low, high = 0.0, self.brakes.least / (turning * self.cap)
        if not enough(0.0):
            return 0.0
        while high - low > _LIGHTEST:
            middle = (low + high) / 2
            low, high = (middle, high) if enough(middle) else (low, middle)
        return low

    def limit(self, detection: float) -> float:
        """Largest speed [m/s] of an obstacle that range and margin suffice for; 0 if not even for one at rest."""
        low, high = 0.0, min(_NEAR * fastest_obstacle(self.brakes), 10.0)
        if not self.suffices(0.0, detection):
            return 0.0
        while high - low > _FINEST:
            middle = (low + high) / 2
            low, high = (middle, high) if self.suffices(middle, detection) else (low, middle)
        return low

    def suffices(self, obstacle: float, detection: float) -> bool:
        """Whether range and margin do, before an obstacle of that speed [m/s]."""
        needed = range_needed(
            self.brakes, self.watch, self.cap, obstacle=obstacle, stopping=stopping_distance_with_drag
        )
        return needed <= detection and max(self.margins(obstacle).values()) <= self.gains["margin"]

    def margins(self, obstacle: float) -> Mapping[float, float]:
        """Own speed up to the cap → margin [m] that is needed beyond the bound."""
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
        """What the law keeps beside its margin when it goes as fast as it lets itself [m]."""
        if self.barrier == "inertia":
            own = brakes_of(self.vehicle, share=self.gains["brake"])
            return range_needed(own, Watch(self.watch.period), speed, obstacle=obstacle)
        weakest, heaviest = float(min(self.vehicle.thrust_limit[:2])), float(max(self.vehicle.mass[:2]))
        closing, reaction = speed + obstacle, self.gains["reaction"]
        return closing**2 * heaviest / (2 * self.gains["brake"] * weakest) + (closing + obstacle) * reaction

    def excess(self, speed: float) -> float:
        """Speed above the bound at which the velocity loop, which feeds drag forward, asks for the least thrust."""
        v, pairs = max(speed, 0.0), (("Xu", "Xuu"), ("Yv", "Yvv"))
        drag = max(self.vehicle[a] * v + self.vehicle[b] * v**2 for a, b in pairs)
        return (self.brakes.least + drag) / (self.gains["k_v"] * (1 + BRAKE) * float(min(self.vehicle.mass[:2])))
