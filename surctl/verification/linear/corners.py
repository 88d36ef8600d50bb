"""The corners of what a vehicle may be, as far as a linear loop about cruise sees them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

from surctl.errors import InputError
from surctl.vehicle import Vehicle

__all__ = ["Corners", "corners"]

_GROUPS: tuple[tuple[str, ...], ...] = (
    ("m11",), ("m22",), ("m33",), ("m44",), ("Xu", "Xuu"), ("Yv",), ("Zw",), ("Nr",), ("thrust_lag",),
)  # fmt: skip
"""Numbers that a loop about straight cruise depends on; those of one group enter as one slope, so they go together.
Quadratic drag of sway, heave and yaw has none at rest."""

_MASSES = ("m11", "m22")


@dataclass(frozen=True, eq=False)
class Corners:
    """Vehicles to be tried, the nominal one first.

    Attributes:
        vehicles: the plants.
        text: where they come from, for a sentence: "the corners of … ".
    """

    vehicles: tuple[Vehicle, ...]
    text: str


def corners(vehicle: Vehicle, uncertainty: float | None = None, *, alike: bool = True) -> Corners:
    """The nominal vehicle and the corners around it.

    With a share: all masses (1 ± share) times the nominal ones, all drag likewise. Without one: every combination of
    the ends of the ranges that the vehicle's file states. Corners are where a linear loop is usually worst, which is
    no proof for what lies between.

    Args:
        vehicle: the nominal vehicle.
        uncertainty: share, 0 ≤ share < 1, or None for the stated ranges.
        alike: where the file gives surge and sway the same mass and range, they have the same true mass too. A body
            with more mass in sway than in surge is turned broadside by the Munk moment; False tries that as well.

    Raises:
        InputError: a share out of range.
    """
    if uncertainty is None:
        groups = list(_GROUPS)
        if alike and _alike(vehicle):
            groups = [_MASSES, *(group for group in groups if not set(group) & set(_MASSES))]
        named = [[name for name in group if vehicle.parameters[name].range is not None] for group in groups]
        free = [group for group in named if group]
        sides = product((0, 1), repeat=len(free))
        vehicles = [_with(vehicle, _ends(vehicle, free, side)) for side in sides] if free else []
        if not vehicles:
            return Corners((vehicle,), "itself alone: its file states no ranges")
        tied = ", surge and sway of one mass" if _MASSES in groups else ""
        return Corners((vehicle, *vehicles), f"the {len(vehicles)} corners of its stated ranges{tied}")
    if not 0 <= uncertainty < 1:
        raise InputError(
            "must be at least 0 and less than 1", key="uncertainty", value=uncertainty, remedy="write 0.2 for ±20 %"
        )
    factors = (1 - uncertainty, 1 + uncertainty) if uncertainty > 0 else ()
    scaled = [_scaled(vehicle, m, d) for m in factors for d in factors]
    return Corners((vehicle, *scaled), f"mass and drag off by ±{uncertainty:.0%}")


def _alike(vehicle: Vehicle) -> bool:
    surge, sway = (vehicle.parameters[name] for name in _MASSES)
    return surge.value == sway.value and surge.range == sway.range


def _ends(vehicle: Vehicle, groups: list[list[str]], side: tuple[int, ...]) -> dict[str, float]:
    values = {}
    for group, end in zip(groups, side, strict=True):
        for name in group:
            known = vehicle.parameters[name].range
            assert known is not None  # the groups hold none without
            values[name] = float(known[end])
    return values


def _scaled(vehicle: Vehicle, mass: float, drag: float) -> Vehicle:
    named = dict.fromkeys(("m11", "m22", "m33", "m44"), mass)
    named |= dict.fromkeys(("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr"), drag)
    return _with(vehicle, {name: vehicle[name] * factor for name, factor in named.items()})


def _with(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    changed = {
        name: replace(parameter, value=values[name], range=None) if name in values else parameter
        for name, parameter in vehicle.parameters.items()
    }
    return replace(vehicle, parameters=changed)
