"""Defaults that a vehicle file leaves to surctl, and how much the disk margin depends on each."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from surctl.assessment.assessment import Assumption
from surctl.errors import InputError
from surctl.marine.vehicle import Vehicle
from surctl.marine.vehicle.specs import DEFAULTED
from surctl.marine.verification.linear import corner_margin, corners
from surctl.marine.verification.linear.corners import DRAG_SPREAD, MASS_SPREAD

__all__ = ["assumptions"]


def assumptions(
    vehicle: Vehicle,
    gains: Mapping[str, float] | None,
    *,
    cruise: float,
    dt: float,
    uncertainty: float | None = None,
) -> tuple[Assumption, ...]:
    """Return the defaults on which the linear loop of a vehicle depends.

    Args:
        vehicle: the vehicle.
        gains: gains of a law with the built-in cascade; None: no margins.
        cruise: cruise speed [m/s].
        dt: control period [s].
        uncertainty: relative error of mass and drag that takes the place of the ranges, or None.

    Example:
        >>> from surctl.marine.assessment import assumptions
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> rov, gains = load_vehicle("bluerov2-wu"), load_gains("default").values
        >>> [ranges] = assumptions(rov, gains, cruise=0.15, dt=0.05)
        >>> ranges.value, ranges.margins[0] > ranges.margins[2]
        ('of mass ±5% and of drag ±20%', True)
    """
    margin = partial(_margin, gains=gains, cruise=cruise, dt=dt, uncertainty=uncertainty)
    assumed = []
    for name, parameter in vehicle.parameters.items():
        if parameter.provenance == DEFAULTED and parameter.value:
            values = (vehicle.with_values({name: share * parameter.value}) for share in (0.5, 1.0, 2.0))
            half, same, double = (margin(one) for one in values)
            unit = "" if parameter.unit == "1" else f" {parameter.unit}"
            assumed.append(Assumption(name, f"= {parameter.value:g}{unit}", (half, same, double)))
    if corners(vehicle, uncertainty).assumed:
        half, same, double = (margin(vehicle, spread=share) for share in (0.5, 1.0, 2.0))
        assumed.append(
            Assumption("ranges", f"of mass ±{MASS_SPREAD:.0%} and of drag ±{DRAG_SPREAD:.0%}", (half, same, double))
        )
    return tuple(assumed)


def _margin(
    vehicle: Vehicle,
    *,
    gains: Mapping[str, float] | None,
    cruise: float,
    dt: float,
    uncertainty: float | None,
    spread: float = 1.0,
) -> float:
    if gains is None:
        return float("nan")
    try:
        worst = corner_margin(vehicle, gains, cruise=cruise, dt=dt, uncertainty=uncertainty, spread=spread)
    except InputError:  # the vehicle cannot hold the speed
        return float("nan")
    return worst.margin
