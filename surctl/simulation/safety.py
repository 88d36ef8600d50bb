"""What the barrier guarantees of a scenario, with the assumptions that it rests on: the safety claim as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import inf, isfinite
from typing import Any

import numpy as np

from surctl.control import Barrier, Gains, Movers
from surctl.control.stopping import BRAKE
from surctl.guidance.braking import (
    LEAST_THRUST,
    Brakes,
    Watch,
    beside,
    brakes_of,
    fastest_obstacle,
    range_needed,
    stopping_way,
)
from surctl.simulation.scenario import Scenario
from surctl.simulation.toml_text import toml_text
from surctl.vehicle import Vehicle

__all__ = ["Figure", "SafetyClaim", "safety_claim"]

_STEP = 0.002  # [m/s] between the speeds that are looked at
_NEAR = 0.95  # of the fastest obstacle: nearer to it the range that is needed grows without end
_FINEST = 1e-4  # [m/s] to which the largest obstacle speed is told


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

        told = {**self.to_dict(), "assumptions": rows(self.assumptions), "derived": rows(self.derived)}
        return toml_text({"kind": "safety claim", **told})

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
) -> SafetyClaim:
    """The claim about the guarded law.

    The margin must be what a vehicle needs beyond the law's bound, at the worst of its ranges, if it brakes with the
    least thrust once it is faster than the bound by what the velocity loop takes to ask for that (step 4 of
    `guidance.braking`, with that excess as a further speed error, and the help of drag). Not covered: thrust is clipped
    axis by axis, so that a large command sideways at the same time may take from the force against it.

    Args:
        scenario: the mission: cap, current, forces.
        vehicle: that flies it, and that the law believes in.
        gains: of the law.
        barrier, movers: of the law.
        watch: what it knows; default: everything, every 0.05 s.
        detection: range at which an obstacle is surely seen [m].
        sideways: largest sideways speed when braking begins [m/s]; drag by axis then pushes.
        spread: see `brakes_of`.
    """
    watch, share = watch or Watch(), LEAST_THRUST if barrier == "simple" else gains["brake"]
    d = scenario.disturbance
    brakes = brakes_of(
        vehicle,
        share=share,
        spread=spread,
        push=d.drift_force_n + d.wave_force_n,
        current=float(np.hypot(*d.current_m_per_s)),
    )
    brakes = beside(brakes, sideways)
    bound = _Bound(brakes, watch, vehicle, gains, barrier, scenario.cap)
    covered = bound.limit(detection) if movers == "barrier" else 0.0
    needed = bound.margins(covered)
    short = [speed for speed, margin in needed.items() if margin > gains["margin"]]
    reach = range_needed(brakes, watch, scenario.cap, obstacle=covered, way=stopping_way)
    assumptions = (
        Figure("obstacle speed", covered, "m/s", "largest towards the vehicle, for ever, and as the law is told"),
        Figure("detection range", detection, "m", "from the hull, at which an obstacle is surely seen"),
        Figure("least thrust", brakes.least, "N", f"against the motion: {share:.0%} of the stated"),
        Figure("largest thrust", brakes.most, "N", "that still pushes when braking begins"),
        Figure("thrust lag", brakes.lag, "s", "first order"),
        Figure("least mass", brakes.masses[0], "kg", "m11 = m22"),
        Figure("largest mass", brakes.masses[1], "kg", "m11 = m22"),
        Figure("least quadratic drag", brakes.quadratic[0], "N s^2/m^2", "surge and sway, ahead"),
        Figure("largest quadratic drag", brakes.quadratic[1], "N s^2/m^2", "surge and sway, astern"),
        Figure("push", brakes.push, "N", "towards the obstacle, of waves, drift and drag of sideways motion"),
        Figure("current", brakes.current, "m/s", "towards the obstacle"),
        Figure("sideways speed", sideways, "m/s", "largest when braking begins"),
        Figure("speed cap", scenario.cap, "m/s", "largest own speed"),
        Figure("sampling time", watch.period, "s", "between two decisions"),
        Figure("range error", watch.range_error, "m", "largest"),
        Figure("range age", watch.age, "s", "largest when it is used"),
        Figure("speed error", watch.speed_error, "m/s", "largest"),
    )
    derived = (
        Figure("range needed", reach, "m", "to be read at the cap before that obstacle"),
        Figure("margin needed", max(needed.values()), "m", "beyond the law's bound, at the worst speed"),
        Figure("margin", gains["margin"], "m", "the gains have"),
        Figure("covered speed", min(short, default=scenario.cap), "m/s", "up to which that margin is enough"),
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
        scenario.name, vehicle.name, barrier, movers, statement, assumptions, derived, not short and reach <= detection
    )


@dataclass(frozen=True)
class _Bound:
    """The law's bound, and what it must be compared with."""

    brakes: Brakes
    watch: Watch
    vehicle: Vehicle
    gains: Gains
    barrier: Barrier
    cap: float

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
        reach = range_needed(self.brakes, self.watch, self.cap, obstacle=obstacle, way=stopping_way)
        return reach <= detection and max(self.margins(obstacle).values()) <= self.gains["margin"]

    def margins(self, obstacle: float) -> Mapping[float, float]:
        """Own speed up to the cap → margin [m] that is needed beyond the bound."""
        found = {}
        for speed in np.linspace(-obstacle, self.cap, round((self.cap + obstacle) / _STEP) + 1).tolist():
            late = replace(self.watch, speed_error=self.watch.speed_error + self.excess(speed))
            needed = range_needed(self.brakes, late, speed, obstacle=obstacle, way=stopping_way)
            found[speed] = needed - self.kept(speed, obstacle)
        return found

    def kept(self, speed: float, obstacle: float) -> float:
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
