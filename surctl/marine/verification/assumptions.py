"""Assumptions of claims: vehicles and gains to which a claim does not apply (unequal masses, integral action)."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.errors import NotApplicable
from surctl.marine.control import Gains
from surctl.marine.vehicle import PARAMETERS, Vehicle
from surctl.marine.vehicle.dynamics import check_equation_3

_ALIKE: Mapping[str, tuple[str, str]] = {
    "mass": ("m11", "m22"),
    "linear drag": ("Xu", "Yv"),
    "quadratic drag": ("Xuu", "Yvv"),
}


def check_alike(vehicle: Vehicle, *, mass_alone: bool = False, ranges: bool = False) -> None:
    """Raise NotApplicable unless surge and sway have force, equal mass and equal drag, and nothing beyond equation (3).

    Args:
        vehicle: the vehicle for which the claim is to be checked.
        mass_alone: whether to compare only the masses, so that surge and sway may have different drag.
        ranges: whether to require equal parameter ranges too, because the claim uses the ranges of surge for both axes.
    """
    check_sway_force(vehicle)
    check_equation_3(vehicle)
    for what, (surge, sway) in list(_ALIKE.items())[: 1 if mass_alone else None]:
        unit = "" if PARAMETERS[surge].unit == "1" else f" {PARAMETERS[surge].unit}"
        if vehicle[surge] != vehicle[sway]:
            values = " and ".join(f"{name} = {vehicle[name]:g}{unit}" for name in (surge, sway))
            raise NotApplicable(f"{values} differ and the claim assumes equal {what} in surge and sway")
        stated = [vehicle.parameters[name].range for name in (surge, sway)]
        if ranges and stated[0] != stated[1]:
            raise NotApplicable(
                f"the ranges of {surge} and {sway} differ ({stated[0]} and {stated[1]}{unit}) and the claim assumes "
                f"equal {what} in surge and sway"
            )


def check_sway_force(vehicle: Vehicle) -> None:
    """Raise NotApplicable for a vehicle that cannot push sideways: the claimed laws move in any direction."""
    if not vehicle["Fv_max"] > 0:
        raise NotApplicable(
            f"{vehicle.name} has no sway force (Fv_max = 0), and the claim commands velocities in any direction"
        )


def check_no_integral(gains: Gains) -> None:
    """Raise NotApplicable if the gains include integral action, because the certified loops have no integral action."""
    if gains["k_i"]:
        raise NotApplicable(
            f"k_i = {gains['k_i']:g} 1/s^2 and the claim assumes a loop without integral action", to="these gains"
        )


def nine_decimals(value: float, *, up: bool) -> float:
    """Return a value rounded to nine decimals, never beyond it in the other direction."""
    near = round(float(value), 9)
    wrong = near < value if up else near > value
    return round(near + (1e-9 if up else -1e-9), 9) if wrong else near
