"""Check which assumptions of the safety claim (the hull never hits an obstacle) a random run violates."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi

from surctl.errors import InputError, NotApplicable
from surctl.marine.control import BARRIER, law_source
from surctl.marine.guidance.braking import LEAST_THRUST, Watch, brakes_of, range_needed, stopping_distance_with_drag
from surctl.marine.sensing import Reflector, level_range
from surctl.marine.simulation.batch import Case
from surctl.marine.simulation.clearance import end_findings
from surctl.marine.simulation.margin import margin_needed, turn_rate
from surctl.marine.simulation.scenario import Scenario
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import Vehicle, check_equation_3

__all__ = ["MEANINGS", "assumptions"]

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

    Raises:
        InputError: the drawn parameters contain an unknown vehicle parameter.
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
