"""The no-contact claim of `surctl verify`, for a scenario and the law's barrier."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surctl.control import Gains
    from surctl.simulation import SafetyClaim
    from surctl.vehicle import Vehicle
    from surctl.verification import Inapplicable

__all__ = ["safety_part"]


def safety_part(
    scenario: str,
    vehicle: Vehicle,
    gains: Gains,
    speeds: tuple[float, float],
    *,
    barrier: str,
    movers: str,
    spread: float | None,
) -> SafetyClaim | Inapplicable:
    """Return the claim for the mission at these speeds (cruise, cap) [m/s], or why it does not apply.

    Raises:
        InputError: `barrier` or `movers` is unknown.
    """
    from surctl.control import BARRIER_NAMES, MOVERS
    from surctl.errors import InputError, NotApplicable, nearest
    from surctl.simulation import load_scenario, safety_claim, turn_rate
    from surctl.simulation.detection import detection_range
    from surctl.verification import Inapplicable

    for key, value, known in (("barrier", barrier, BARRIER_NAMES), ("movers", movers, MOVERS)):
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(value, known))
    mission = replace(load_scenario(scenario), cruise=speeds[0], cap=speeds[1])
    sight = detection_range(mission)
    kind: dict[str, Any] = {"barrier": barrier, "movers": movers}
    turning = turn_rate(mission, vehicle, gains, sonar=True)
    try:
        return safety_claim(mission, vehicle, gains, **kind, detection=sight, spread=spread, turning=turning)
    except NotApplicable as reason:
        return Inapplicable.of("no contact", reason)
