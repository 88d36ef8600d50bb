"""Which assumptions of the safety claim a drawn flight breaks."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, pi

from surctl.errors import InputError
from surctl.simulation.fit import findings
from surctl.simulation.scenario import Scenario
from surctl.vehicle import Vehicle

__all__ = ["LEAST_THRUST", "assumptions", "braking_distance"]

LEAST_THRUST = 0.85
"""Share of the stated thrust that the claim counts on."""


def braking_distance(vehicle: Vehicle, *, speed: float, obstacle: float = 0.0) -> float:
    """Way to a stop relative to an obstacle that comes on [m]; inf when its drag eats up the thrust.

    S = m s²/(2 F') + s τ (F0 + F)/F' + (F0 + F)² τ²/(2 F' m), with s = speed + obstacle, F = 0.85 F_max,
    F' = F − D(obstacle), D(v) = X_u v + X_uu v². F0, what pushes when braking begins, is F_max: the worst.
    Surge and sway alike, the longer of both.

    Args:
        vehicle: whose stated numbers count.
        speed: of the vehicle towards the obstacle, at least 0 [m/s].
        obstacle: of the obstacle towards the vehicle, at least 0 [m/s].
    """
    lag, closing, found = vehicle["thrust_lag"], speed + obstacle, 0.0
    for mass, linear, quadratic, most in (("m11", "Xu", "Xuu", "Fu_max"), ("m22", "Yv", "Yvv", "Fv_max")):
        m, brake = vehicle[mass], LEAST_THRUST * vehicle[most]
        left = brake - vehicle[linear] * obstacle - vehicle[quadratic] * obstacle**2
        if left <= 0:
            return inf
        swing = (vehicle[most] + brake) * lag
        found = max(found, (m * closing**2 / 2 + closing * swing + swing**2 / (2 * m)) / left)
    return found


def assumptions(
    scenario: Scenario, vehicle: Vehicle, draw: Mapping[str, float], *, detection: float, fastest: float
) -> tuple[str, ...]:
    """Names of what does not hold, in a fixed order; empty when all that can be judged holds.

    `obstacle speed`: an obstacle, its drift included, goes faster than `fastest`. `detection`: the braking distance
    from the cap is longer than the detection range. `thrust`: the draw has less than 85 % of a stated limit.
    `range`: a number of the draw is outside its stated range. `hull`: by `findings` the hull fits not at
    the start or the target; whether it fits between is not judged.

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
        "detection": braking_distance(vehicle, speed=scenario.cap, obstacle=speed) > detection,
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
