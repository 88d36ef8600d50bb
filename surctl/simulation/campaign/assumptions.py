"""Which assumptions of the safety claim a drawn flight breaks."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from surctl.errors import InputError
from surctl.guidance.braking import LEAST_THRUST, Watch, brakes_of, range_needed, stopping_way
from surctl.simulation.fit import findings
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["assumptions"]


def assumptions(
    scenario: Scenario, vehicle: Vehicle, draw: Mapping[str, float], *, detection: float, fastest: float
) -> tuple[str, ...]:
    """Names of what does not hold, in a fixed order; empty when all that can be judged holds.

    `obstacle speed`: an obstacle, its drift included, goes faster than `fastest`. `detection`: from the cap, at the
    worst of the vehicle's ranges, it needs more than the detection range to stop before that obstacle. `thrust`: the
    draw has less than 85 % of a stated limit. `range`: a number of the draw is outside its stated range. `hull`: by
    `findings` the hull fits not at the start or the target; whether it fits between is not judged.

    Args:
        scenario: as flown.
        vehicle: what the law believes.
        draw: numbers of what flies that differ from it, by name, in the vehicle file's units.
        detection: range at which an obstacle is surely seen, from the hull [m].
        fastest: obstacle that the law vouches for [m/s].

    Raises:
        InputError: a number that no vehicle has.
    """
    speeds = [
        o.speed_m_per_s or 0.0 if o.shape == "moving" else 2 * pi * o.drift_m / o.drift_period_s
        for o in scenario.obstacles
    ]
    speed = max(speeds, default=0.0)
    for name in draw:
        vehicle[name]  # names the nearest if there is none
    stated = {name: vehicle.parameters[name] for name in draw}
    limits = ("Fu_max", "Fv_max", "Fw_max", "Fr_max")
    broken = {
        "obstacle speed": speed > fastest,
        "detection": range_needed(brakes_of(vehicle), Watch(), scenario.cap, obstacle=speed, way=stopping_way)
        > detection,
        "thrust": any(draw.get(n, vehicle[n]) < LEAST_THRUST * vehicle[n] * (1 - 1e-12) for n in limits),
        "range": any(p.range is not None and not p.range[0] <= draw[n] <= p.range[1] for n, p in stated.items()),
        "hull": not _fits(scenario, vehicle),
    }
    return tuple(name for name, is_broken in broken.items() if is_broken)


def _fits(scenario: Scenario, vehicle: Vehicle) -> bool:
    try:
        found = findings(scenario, vehicle)
    except InputError:  # the start lies inside an obstacle
        return False
    return not any(f.level == "error" and (f.key == "path_m" or f.key.startswith("obstacles.")) for f in found)
