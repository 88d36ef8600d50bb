"""The summary of a campaign: shares, percentiles, worst runs, and violated assumptions of the no-contact claim."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, NotApplicable
from surctl.marine.control import BARRIER, law_source
from surctl.marine.guidance.braking import LEAST_THRUST, Watch, brakes_of, range_needed, stopping_distance_with_drag
from surctl.marine.sensing import Reflector
from surctl.marine.sensing.sonar.returns import level_range
from surctl.marine.simulation.batch.case import Case
from surctl.marine.simulation.clearance import end_findings
from surctl.marine.simulation.metrics import METRICS, STOPS
from surctl.marine.simulation.safety import margin_needed, turn_rate
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.dynamics import check_equation_3
from surctl.tuning.statistics import Share

_FIRST = ("collided", "reached")  # true or false


@dataclass(frozen=True, eq=False)
class RunTable:
    """The results of n runs of a campaign.

    Attributes:
        seeds: (n,) seed of each run.
        figures: (n, len(METRICS)) metrics of the runs, columns in the order of `METRICS`.
        values: (n,) drawn values by parameter name.
        broken: (n,) names of the violated assumptions of each run.
    """

    seeds: NDArray[np.int64]
    figures: NDArray[np.float64]
    values: Mapping[str, NDArray[np.float64]]
    broken: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        return len(self.seeds)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return one metric (n,)."""
        return self.figures[:, list(METRICS).index(name)]

    def stopped(self, k: int) -> str:
        """Return the reason why run number k ended, one of `STOPS`."""
        return STOPS[round(float(self.column("stopped")[k]))]

    def worst(self, count: int) -> list[int]:
        """Return the indices of the worst runs: first collided runs, then runs that did not arrive, then the rest.

        Within these three groups, runs with a smaller clearance come first.
        """
        collided, reached = self.column("collided"), self.column("reached")
        order = np.lexsort((self.seeds, self.column("min_clearance_m"), reached, -collided))
        return [int(k) for k in order[:count]]

    def row(self, k: int) -> dict[str, Any]:
        """Return run k as plain data: seed, reason for its end, metrics, violated assumptions, drawn values."""
        figures = {name: float(self.figures[k, j]) for j, name in enumerate(METRICS) if name != "stopped"}
        for name in _FIRST:
            figures[name] = bool(figures[name])
        result = {"seed": int(self.seeds[k]), "stopped_because": self.stopped(k), **figures}
        draw = {name: float(column[k]) for name, column in self.values.items()}
        return {**result, "broken_assumptions": list(self.broken[k]), "draw": draw}

    def columns(self) -> dict[str, Sequence[Any]]:
        """Return all runs as columns of a table: seed, reason for the end, metrics, violated assumptions, draws."""
        figures = {name: self.column(name).tolist() for name in METRICS if name != "stopped"}
        figures |= {name: [int(value) for value in figures[name]] for name in _FIRST}
        broken = {"broken_assumptions": ["; ".join(names) for names in self.broken]}
        draws = {name: column.tolist() for name, column in self.values.items()}
        ends = [self.stopped(k) for k in range(len(self))]
        return {"seed": self.seeds.tolist(), "stopped_because": ends, **figures, **broken, **draws}


MEANINGS: Mapping[str, str] = {
    "obstacle speed": "an obstacle is faster than the claim covers",
    "detection": "stopping needs more than the detection range",
    "thrust": f"a thrust limit is below {LEAST_THRUST:.0%} of the stated one",
    "range": "a drawn number is outside its stated range",
    "margin": "braking needs more than the gain margin",
    "hull": "the hull does not fit at the start or at the target",
    "dynamics": "the vehicle has terms beyond equation (3) of the paper",
    "echoes": "some surfaces do not answer every firing, or others hide them",
}
"""What a violation of each assumption means, by the name that `assumptions` returns."""


def assumptions(case: Case, draw: Mapping[str, float], *, detection: float, fastest: float) -> tuple[str, ...]:
    """Return the names of the violated assumptions in a fixed order; empty if every checked assumption holds.

    `obstacle speed`: an obstacle moves or drifts faster than `fastest`. `detection`: with the worst values of its
    parameter ranges, the vehicle cannot stop from its largest allowed speed within the detection range, before the
    fastest obstacle reaches the hull. `thrust`: a drawn thrust limit is less than 85 % of the stated limit. `range`: a
    drawn number is outside its stated range. `margin` (guarded law only): to brake before an obstacle at rest, the
    simulated vehicle needs a larger distance than the law's gain `margin`; the function `margin_needed` computes this
    distance and includes the force on a turning hull with m11 ≠ m22. `hull`: `end_findings` reports that the hull does
    not fit at the start or at the target; gaps between start and target are not checked. `echoes`: with sonars, an
    obstacle or a wall does not answer at any angle, or a sonar hears the water surface or the floor, so that no range
    is one of certain detection.

    Args:
        case: the simulated setup; the law's model is `case.model`, or `case.vehicle` if there is no model.
        draw: randomly drawn vehicle parameters by name, in the units of the vehicle file.
        detection: range from the hull at which an obstacle is certainly detected [m].
        fastest: largest obstacle speed that the safety claim covers [m/s].
    """
    scenario, believed = case.scenario, case.model or case.vehicle
    speeds = [
        o.speed_m_per_s or 0.0 if o.shape == "moving" else 2 * pi * o.drift_m / o.drift_period_s
        for o in scenario.obstacles
    ]
    speed = max(speeds, default=0.0)
    for name in draw:
        believed[name]  # raises an error that names the nearest parameter if this one is unknown
    stated = {name: believed.parameters[name] for name in draw}
    limits = ("Fu_max", "Fv_max", "Fw_max", "Fr_max")
    broken = {
        "obstacle speed": speed > fastest,
        "detection": range_needed(
            brakes_of(believed), Watch(), scenario.cap, obstacle=speed, stopping=stopping_distance_with_drag
        )
        > detection,
        "thrust": any(draw.get(n, believed[n]) < LEAST_THRUST * believed[n] * (1 - 1e-12) for n in limits),
        "range": any(p.range is not None and not p.range[0] <= draw[n] <= p.range[1] for n, p in stated.items()),
        "margin": BARRIER in law_source(case.law).parts and not _stops(case, draw),
        "hull": not _fits(case),
        "dynamics": not (_plain(case.vehicle) and _plain(believed)),
        "echoes": case.sensing == "sonar" and not _answered(scenario),
    }
    return tuple(name for name, is_broken in broken.items() if is_broken)


def _answered(scenario: Scenario) -> bool:
    array, surfaces = scenario.sensors.equipment.array, scenario.surfaces
    if surfaces is None:
        return array.incidence_limit is None
    levels = ((1, surfaces.surface, -scenario.depth), (-1, surfaces.floor, surfaces.depth + scenario.depth))
    nearest = [level_range(array, reflector, side=side, gap=gap) for side, reflector, gap in levels]
    silent = all(distance is None or distance > array.maximum for distance in nearest)
    return silent and {*surfaces.obstacles, *surfaces.walls} == {Reflector()}


def _plain(vehicle: Vehicle) -> bool:
    try:
        check_equation_3(vehicle, reverse=True)
    except NotApplicable:
        return False
    return True


def _stops(case: Case, draw: Mapping[str, float]) -> bool:
    """Return whether the law's gain `margin` is enough for the simulated vehicle to brake before an obstacle at rest.

    For impossible parameter values the function returns True, because the assumption `range` reports these values.
    """
    believed = case.model or case.vehicle
    try:
        actual = case.vehicle.with_values(draw)
    except InputError:
        return True
    turning = turn_rate(case.scenario, believed, case.gains, sonar=case.sensing == "sonar", actual=actual)
    needed = margin_needed(case.scenario, believed, case.gains, actual, barrier=case.barrier, turning=turning)
    return needed <= case.gains["margin"]


def _fits(case: Case) -> bool:
    try:
        build_world(case.scenario, case.vehicle, seed=0)
    except InputError:  # the start lies inside an obstacle
        return False
    return not any(f.level == "error" for f in end_findings(case.scenario, case.vehicle))


_PERCENTILES = (0, 5, 25, 50, 75, 95, 100)


@dataclass(frozen=True)
class Summary:
    """Shares and percentiles of n runs.

    Attributes:
        stopped: share of the runs that ended for each reason of `STOPS`, by reason.
        time_s: percentiles of the arrival time of the runs that arrived [s]; empty if no run arrived.
        clearance_m: percentiles of the smallest clearance of all runs [m]; empty without obstacles and walls.
        broken: number of collided runs that violate an assumption, by assumption; the entry `none` counts collided runs
            that violate no assumption.
        inside: share of collided runs among the runs that violate no assumption; None if every run violates an
            assumption.
        violated: number of runs, collided or not, that violate an assumption, by assumption.
    """

    stopped: Mapping[str, Share]
    time_s: Mapping[int, float]
    clearance_m: Mapping[int, float]
    broken: Mapping[str, int]
    inside: Share | None
    violated: Mapping[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as plain data for JSON."""
        return {
            "stopped": {reason: _share_dict(share) for reason, share in self.stopped.items()},
            "collisions_within_assumptions": None if self.inside is None else _share_dict(self.inside),
            "time_s": {f"p{p}": value for p, value in self.time_s.items()},
            "min_clearance_m": {f"p{p}": value for p, value in self.clearance_m.items()},
            "collisions_by_broken_assumption": dict(self.broken),
            "runs_by_broken_assumption": dict(self.violated),
        }

    def lines(self, *, claim: bool = True) -> list[str]:
        """Return the summary as lines of text.

        If `claim` is true, the text includes the claim that the hull touches no obstacle, if the law has this claim.
        """
        lines = []
        for reason in ("collision", "time limit", "standstill", "dead end", "fault"):
            s = self.stopped[reason]
            lines.append(
                f"  {reason:<11}{s.count:>7} of {s.runs}: {s.rate:.3%}, with 95 % confidence at most {s.at_most():.3%}"
            )
        reached = self.stopped["reached"]
        lines.append(f"  {'reached':<11}{reached.count:>7} of {reached.runs}: {reached.rate:.3%}")
        for name, unit, percentiles in (("time", "s", self.time_s), ("clearance", "m", self.clearance_m)):
            if percentiles:
                values = ", ".join(f"{value:.4g} {unit} ({p} %)" for p, value in percentiles.items())
                lines.append(f"  {name:<11}{values}")
        if not claim:
            return lines
        if self.broken:
            counts = ", ".join(f"{n} {k}" for k, n in self.broken.items())
            lines.append(f"  collisions by violated assumption: {counts}")
        if self.violated:
            counts = "; ".join(f"{name}, {MEANINGS[name]} ({n} runs)" for name, n in self.violated.items())
            lines.append(f"  violated assumptions of the no-contact claim: {counts}")
        if self.inside is None:
            lines.append("  every run violates an assumption of the no-contact claim")
        else:
            s = self.inside
            lines.append(
                f"  within the assumptions of the no-contact claim: {s.count} of {s.runs} collided, "
                f"with 95 % confidence at most {s.at_most():.3%}"
            )
        return lines


def summarise(table: RunTable) -> Summary:
    """Return the summary of a table of campaign runs."""
    ended = np.round(table.column("stopped"))
    stopped = {reason: Share(int(np.sum(ended == code)), len(table)) for code, reason in enumerate(STOPS)}
    arrived = table.column("reached") > 0.5
    collided = table.column("collided") > 0.5
    holds = np.array([not names for names in table.broken])
    inside = Share(int(np.sum(collided & holds)), int(np.sum(holds))) if holds.any() else None
    broken = dict(Counter(name for k in np.flatnonzero(collided) for name in table.broken[int(k)] or ("none",)))
    violated = dict(Counter(name for names in table.broken for name in names).most_common())
    clear = table.column("min_clearance_m")
    return Summary(
        stopped,
        _percentiles(table.column("time_s")[arrived]),
        _percentiles(clear[np.isfinite(clear)]),
        broken,
        inside,
        violated,
    )


def _share_dict(share: Share) -> dict[str, float]:
    return {"count": share.count, "runs": share.runs, "rate": share.rate, "at_most_95": share.at_most()}


def _percentiles(values: NDArray[np.float64]) -> dict[int, float]:
    if not len(values):
        return {}
    return {p: float(v) for p, v in zip(_PERCENTILES, np.percentile(values, _PERCENTILES), strict=True)}
