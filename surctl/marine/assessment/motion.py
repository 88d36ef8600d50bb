"""The nonlinear parts of a mission's assessment: region of attraction, no contact, and simulated runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from surctl.assessment.assessment import Figure, Line, Part
from surctl.assessment.figures import SATURATED
from surctl.errors import NotApplicable
from surctl.marine.control import CASCADE, Barrier, Gains, Movers, law_source
from surctl.marine.simulation import Run, SafetyClaim, Scenario, safety_claim, turn_rate
from surctl.marine.simulation.echo_fit import detection_range
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.region import RegionStatement, applicable_region, prove_statement
from surctl.own_code import label
from surctl.verification import Inapplicable

__all__ = ["DEFAULT_REGIONS", "contact_part", "judged_contact", "region_part", "runs_part"]

DEFAULT_REGIONS = ("region-cruise-20", "region-turning-20", "region-steered-20")
"""The region claims of an assessment, strongest assumption first; the first that applies is the one of a vehicle."""


def region_part(vehicle: Vehicle, gains: Gains, *, law: str, cruise: float, cap: float) -> Part:
    """Return whether a region of attraction about the path is proved, and its size."""
    if not law_source(law).parts:
        return Part((), (Line(None, f"region of attraction: no claim concerns law {label(law)}", "region"),))
    claim = applicable_region(DEFAULT_REGIONS, vehicle, gains, cruise=cruise, cap=cap)
    if not isinstance(claim, RegionStatement):
        text = f"region of attraction: not applicable to {claim.to}, because {claim.because}"
        return Part((), (Line(None, text, "region"),), claim)
    proof = prove_statement(claim, vehicle, gains, cruise=cruise, cap=cap)
    proved = proof.verdict == "proved"
    sizes = (proof.offset, max(proof.ultimate_bound)) if proved else (0.0, float("nan"))
    figures = (
        Figure("region_m", sizes[0], "m", "distance beside the path from which the return is proved", "high"),
        Figure("region_within_m", sizes[1], "m", "distance within which the motion ends, proved", "low"),
    )
    named = tuple(Figure(f.name, f.value, f.unit, f.meaning, f.better, where=claim.name) for f in figures)
    return Part(named, (Line(True if proof.useful else None, f"{claim.name}: {proof.sentence}", "region"),), proof)


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
    sight = detection_range(scenario) if sonar else float("inf")
    turning = turn_rate(scenario, vehicle, gains, sonar=sonar)
    try:
        return safety_claim(
            scenario, vehicle, gains, barrier=barrier, movers=movers, detection=sight, spread=spread, turning=turning
        )
    except NotApplicable as reason:
        return Inapplicable.of("no contact", reason)


def contact_part(
    missions: Sequence[tuple[Scenario, Vehicle]],
    gains: Gains,
    *,
    law: str,
    sonar: bool = True,
    barrier: Barrier = "simple",
    movers: Movers = "predict",
    spread: float | None = None,
) -> Part:
    """Return the no-contact claim of each mission, a scenario and its vehicle, that has obstacles."""
    met = [(scenario, vehicle) for scenario, vehicle in missions if scenario.obstacles]
    if CASCADE not in law_source(law).parts:
        text = f"no contact: not judged, because the claim concerns law guarded and this is {label(law)}"
        return Part((), (Line(None, text, "runs", counts=bool(met)),))
    claims = [judged_contact(*each, gains, sonar=sonar, barrier=barrier, movers=movers, spread=spread) for each in met]
    lines = []
    for (scenario, _), claim in zip(met, claims, strict=True):
        if isinstance(claim, Inapplicable):
            lines.append(Line(None, f"no contact in {scenario.name}: {claim.sentence}", "runs"))
            continue
        how = f"holds: margin {claim['margin']:g} m, needed {claim['margin needed']:.3g} m"
        end = how if claim.holds else f"does not hold: {claim.shortfall}"
        lines.append(Line(claim.holds, f"no contact in {scenario.name} {end}", "runs"))
    spare = [(c["margin"] - c["margin needed"], c.scenario) for c in claims if isinstance(c, SafetyClaim)]
    if not spare:
        return Part((), tuple(lines), tuple(claims))
    least, where = min(spare)
    figure = Figure("contact_margin_m", least, "m", "gain margin beyond the one that braking needs", "high", 0.0, where)
    return Part((figure,), tuple(lines), tuple(claims))


def runs_part(runs: Sequence[Run], *, extra: Sequence[bool] = ()) -> Part:
    """Return what runs show: arrival, clearance, path error, thrust at its limit; `extra` ones do not count."""
    lines = []
    apart = extra or [False] * len(runs)
    for place, (run, beside) in enumerate(zip(runs, apart, strict=True), start=1):
        m = run.metrics
        text = f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}: {m.stopped_because} at {m.time_s:.1f} s"
        text += f", least clearance {m.min_clearance_m:.3f} m"
        lines.append(Line(m.reached and m.min_clearance_m > 0, text, f"runs-{place}", counts=not beside))
        if m.axis_saturated_share > SATURATED:
            full = f"a thrust is at its limit {m.axis_saturated_share:.0%} of the time"
            text = f"{run.scenario.name}, {run.sensing}: {full}, so the linear margins do not describe this run"
            lines.append(Line(None, text, f"runs-{place}", counts=not beside))
    counted = [run for run, beside in zip(runs, apart, strict=True) if not beside]
    if not counted:
        return Part((), tuple(lines), tuple(runs))
    rows: tuple[tuple[str, str, str, Literal["high", "low"]], ...] = (
        ("time_ratio", "1", "arrival time over the ideal time (path length / cruise speed)", "low"),
        ("path_error_m", "m", "rms distance to the path", "low"),
        ("min_clearance_m", "m", "least distance to an obstacle or wall", "high"),
        ("limited_share", "1", "share of time at its limit of the thrust that is there most", "low"),
    )
    figures = []
    for name, unit, meaning, better in rows:
        values = np.array([_of(run, name) for run in counted])
        ill = np.where(np.isnan(values), -np.inf, values if better == "low" else -values)
        at = int(np.argmax(ill))
        where = counted[at].scenario.name
        figures.append(Figure(name, float(values[at]), unit, f"{meaning}, worst run", better, where=where))
    return Part(tuple(figures), tuple(lines), tuple(runs))


def _of(run: Run, name: str) -> float:
    m = run.metrics
    if name == "time_ratio":
        ideal = run.scenario.path.length / run.scenario.cruise
        return m.time_s / ideal if m.reached else float("inf")
    return m.axis_saturated_share if name == "limited_share" else float(getattr(m, name))
