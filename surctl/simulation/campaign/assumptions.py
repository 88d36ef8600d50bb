"""Which assumptions of the safety claim a drawn flight breaks."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from surctl.errors import InputError
from surctl.guidance.braking import LEAST_THRUST, Watch, brakes_of, range_needed, stopping_distance_with_drag
from surctl.simulation.batch import Case
from surctl.simulation.clearance import end_findings
from surctl.simulation.margin import margin_needed, turn_rate
from surctl.simulation.world import build_world

__all__ = ["assumptions"]


def assumptions(case: Case, draw: Mapping[str, float], *, detection: float, fastest: float) -> tuple[str, ...]:
    """Names of what does not hold, in a fixed order; empty when all that can be judged holds.

    `obstacle speed`: an obstacle, its drift included, goes faster than `fastest`. `detection`: from the cap, at the
    worst of the vehicle's ranges, it needs more than the detection range to stop before that obstacle. `thrust`: the
    draw has less than 85 % of a stated limit. `range`: a number of the draw is outside its stated range. `margin`: of
    the guarded law alone: before what stands, the vehicle that is flown needs more than the law's margin to brake,
    pushed as it turns by the difference of its masses, see `margin_needed`. `hull`: by `end_findings` the hull fits
    not at the start or the target; whether it fits between is not judged.

    Args:
        case: as flown; the law believes its model, else its vehicle.
        draw: numbers of what flies that differ from its vehicle, by name, in the vehicle file's units.
        detection: range at which an obstacle is surely seen, from the hull [m].
        fastest: obstacle that the law vouches for [m/s].

    Raises:
        InputError: a number that no vehicle has.
    """
    scenario, believed = case.scenario, case.model or case.vehicle
    speeds = [
        o.speed_m_per_s or 0.0 if o.shape == "moving" else 2 * pi * o.drift_m / o.drift_period_s
        for o in scenario.obstacles
    ]
    speed = max(speeds, default=0.0)
    for name in draw:
        believed[name]  # names the nearest if there is none
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
        "margin": case.law == "guarded" and not _stops(case, draw),
        "hull": not _fits(case),
    }
    return tuple(name for name, is_broken in broken.items() if is_broken)


def _stops(case: Case, draw: Mapping[str, float]) -> bool:
    """Whether the law's margin is enough for what flies; a number that no vehicle may have is told as `range`."""
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
