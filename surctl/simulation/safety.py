"""What the barrier guarantees of a scenario, with the assumptions that it rests on: the safety claim as data."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import inf, isfinite
from typing import Any

import numpy as np

from surctl.control import Barrier, Gains, Movers
from surctl.guidance.braking import (
    LEAST_THRUST,
    Watch,
    beside,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_distance_with_drag,
)
from surctl.simulation.column import BAND, FOOTPRINT
from surctl.simulation.margin import Bound, mass_difference, munk, turned
from surctl.simulation.scenario import Scenario
from surctl.simulation.toml_text import toml_text
from surctl.vehicle import Vehicle

__all__ = ["Figure", "SafetyClaim", "safety_claim"]


@dataclass(frozen=True)
class Figure:
    """A number with its unit; inf where there is no bound."""

    name: str
    value: float
    unit: str
    meaning: str


@dataclass(frozen=True)
class SafetyClaim:
    """An obstacle is never hit, as long as the assumptions hold; whether the law's numbers suffice for that.

    Attributes:
        scenario, vehicle: names.
        barrier, movers: of the law, see `build_law`.
        statement: in words.
        assumptions: what must hold, with numbers.
        derived: what follows.
        holds: whether range and margin suffice at every speed up to the cap.
    """

    scenario: str
    vehicle: str
    barrier: str
    movers: str
    statement: str
    assumptions: tuple[Figure, ...]
    derived: tuple[Figure, ...]
    holds: bool

    def __getitem__(self, name: str) -> float:
        """Value of an assumption or of what is derived; KeyError without one."""
        return {f.name: f.value for f in (*self.assumptions, *self.derived)}[name]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; numbers that are not finite are left to the writer."""
        return asdict(self)

    def to_toml(self) -> str:
        """The claim as a file; a number without a bound is the text "inf"."""

        def rows(figures: tuple[Figure, ...]) -> list[dict[str, Any]]:
            return [{**asdict(f), "value": f.value if isfinite(f.value) else str(f.value)} for f in figures]

        table = {**self.to_dict(), "assumptions": rows(self.assumptions), "derived": rows(self.derived)}
        return toml_text({"kind": "safety claim", **table})

    def lines(self) -> list[str]:
        """A few lines of text."""
        head = f"{self.scenario} by {self.vehicle}: {self.statement}"
        rows = [
            f"  {what:<8} {f.name:<24} {f.value:8.4g} {f.unit}"
            for what, figures in (("assumes", self.assumptions), ("gives", self.derived))
            for f in figures
        ]
        return [head, *rows, f"  {'holds' if self.holds else 'DOES NOT HOLD at every speed up to the cap'}"]


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
    """The claim about the guarded law.

    The margin must be what a vehicle needs beyond the law's bound, at the worst of its ranges, if it brakes with the
    least thrust once it is faster than the bound by what the velocity loop takes to ask for that (step 4 of
    `guidance.braking`, with that excess as a further speed error, and the help of drag). Not covered: thrust is clipped
    axis by axis, so that a large command sideways at the same time may take from the force against it; the law asks for
    nothing sideways once it is 0.02 m/s too fast.

    A change of depth rests on two assumptions more: that the echo sounders hear all that stands over or under the hull
    (the sonars that look ahead say nothing of that water), and that depth is kept within the sonars' fan.

    Args:
        scenario: the mission: cap, current, forces.
        vehicle: that flies it, and that the law believes in.
        gains: of the law.
        barrier, movers: of the law.
        watch: what it knows; default: everything, every 0.05 s.
        detection: range at which an obstacle is surely seen [m].
        sideways: largest sideways speed when braking begins [m/s]; drag by axis then pushes.
        spread: see `brakes_of`.
        turning: rate at which the hull turns while it brakes [rad/s], see `turn_rate`.
        difference: largest |m11 - m22| [kg]; turning, it pushes, and the claim tells how much of it is covered.
            None takes the vehicle's, see `mass_difference`.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario, safety_claim
        >>> from surctl.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> for barrier in ("simple", "inertia"):
        ...     claim = safety_claim(mission, vehicle, gains, barrier=barrier)
        ...     print(f"{barrier}: {claim.holds}, needs {claim['margin needed']:.3f} m, has {claim['margin']} m")
        simple: False, needs 0.053 m, has 0.05 m
        inertia: True, needs 0.019 m, has 0.05 m
    """
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
    short = [speed for speed, margin in needed.items() if margin > gains["margin"]]
    sight = range_needed(brakes, watch, scenario.cap, obstacle=covered, stopping=stopping_distance_with_drag)
    assumptions: tuple[Figure, ...] = (
        Figure("obstacle speed", covered, "m/s", "largest towards the vehicle, for ever, and as the law is told"),
        Figure("detection range", detection, "m", "from the hull, at which an obstacle is surely seen"),
        Figure("least thrust", brakes.least, "N", f"against the motion: {share:.0%} of the stated"),
        Figure("largest thrust", brakes.most, "N", "that still pushes when braking begins"),
        Figure("thrust lag", brakes.lag, "s", "first order"),
        Figure("least mass", brakes.masses[0], "kg", "of m11 and m22"),
        Figure("largest mass", brakes.masses[1], "kg", "of m11 and m22"),
        Figure("least quadratic drag", brakes.quadratic[0], "N s^2/m^2", "surge and sway, ahead"),
        Figure("largest quadratic drag", brakes.quadratic[1], "N s^2/m^2", "surge and sway, astern"),
        Figure("push", brakes.disturbance, "N", "towards the obstacle, of waves, drift and drag of sideways motion"),
        Figure("current", brakes.current, "m/s", "towards the obstacle"),
        Figure("turn rate", turning, "rad/s", "of the hull while it brakes"),
        Figure("mass difference", difference, "kg", "largest |m11 - m22|; turning, it pushes by speed and turn rate"),
        Figure("sideways speed", sideways, "m/s", "largest when braking begins"),
        Figure("speed cap", scenario.cap, "m/s", "largest own speed"),
        Figure("sampling time", watch.period, "s", "between two decisions"),
        Figure("range error", watch.range_error, "m", "largest"),
        Figure("range age", watch.age, "s", "largest when it is used"),
        Figure("speed error", watch.speed_error, "m/s", "largest"),
    )
    if scenario.depths is not None:
        coverage = "wider than the hull: all that stands over or under that disc is heard by the echo sounders"
        fan = "beyond the hull, above and below: what ends further off is passed over or under"
        assumptions += (Figure("sounder footprint", FOOTPRINT, "m", coverage), Figure("sonar fan", BAND, "m", fan))
    derived = (
        Figure("range needed", sight, "m", "to be read at the cap before that obstacle"),
        Figure("margin needed", max(needed.values()), "m", "beyond the law's bound, at the worst speed"),
        Figure("margin", gains["margin"], "m", "the gains have"),
        Figure("covered speed", min(short, default=scenario.cap), "m/s", "up to which that margin is enough"),
        Figure(
            "covered difference",
            replace(bound, brakes=level).difference(covered, turning),
            "kg",
            "of the masses up to which that margin is enough",
        ),
        Figure(
            "excess",
            bound.excess(scenario.cap),
            "m/s",
            "over the bound at the cap at which the velocity loop asks for the least thrust",
        ),
        Figure("fastest obstacle", fastest_obstacle(brakes), "m/s", "for which braking guarantees anything"),
    )
    what = "what stands" if movers == "predict" else f"what comes on with at most {covered:.3g} m/s"
    statement = f"the hull never touches {what}, one obstacle at a time, barrier {barrier}"
    return SafetyClaim(
        scenario.name, vehicle.name, barrier, movers, statement, assumptions, derived, not short and sight <= detection
    )
