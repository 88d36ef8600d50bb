"""The corners of a vehicle's parameter ranges, for the parameters that affect the linear loop about cruise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

from surctl.errors import InputError
from surctl.vehicle import TERMS, Vehicle

__all__ = ["Corners", "corners"]

_GROUPS: tuple[tuple[str, ...], ...] = (
    ("m11",), ("m22",), ("m33",), ("m44",), ("Xu", "Xuu"), ("Yv",), ("Zw",), ("Nr",), ("thrust_lag",),
)  # fmt: skip
"""The parameters that affect the linear loop about straight cruise. The parameters of one group affect the loop through
one drag slope, so they take the same end of their ranges. The quadratic drag of sway, heave and yaw is omitted, because
its slope is 0 at zero velocity."""

_MASSES = ("m11", "m22")


@dataclass(frozen=True, eq=False)
class Corners:
    """The vehicles of a worst-case analysis; the nominal vehicle is first.

    Attributes:
        vehicles: the plants.
        text: description of the vehicles that fits into a sentence, such as "the corners of …".
        labels: for each vehicle, the parameters in which it differs from the nominal vehicle, as text.
    """

    vehicles: tuple[Vehicle, ...]
    text: str
    labels: tuple[str, ...] = ()

    def label(self, vehicle: Vehicle) -> str:
        """Return the label of one of the vehicles; its name if the vehicles have no labels."""
        at = next(k for k, one in enumerate(self.vehicles) if one is vehicle)
        return self.labels[at] if self.labels else vehicle.name


def corners(
    vehicle: Vehicle, uncertainty: float | None = None, *, alike: bool = True, drag: float | None = None
) -> Corners:
    """Return the nominal vehicle and the corners of its uncertainty.

    If `uncertainty` is given, all masses are multiplied by 1 ± uncertainty, and all drag coefficients likewise.
    Otherwise the corners are all combinations of the ends of the ranges in the vehicle file. A linear loop is usually
    worst at a corner, but this is no proof for the values between the corners.

    Args:
        vehicle: the nominal vehicle.
        uncertainty: relative uncertainty, 0 ≤ uncertainty < 1, or None for the ranges of the vehicle file.
        alike: whether to vary the masses of surge and sway together if the vehicle file gives them equal values and
            equal ranges. False varies the two masses independently; a difference matters, because the Munk moment turns
            a body broadside if its sway mass exceeds its surge mass.
        drag: relative uncertainty of the drag, if it differs from `uncertainty`.

    Raises:
        InputError: the uncertainty is out of range.
    """
    if uncertainty is None:
        # each optional term is a group of its own
        groups = [*_GROUPS, *((name,) for name in (*_terms(vehicle, "inertia"), *_terms(vehicle, "drag")))]
        if alike and _alike(vehicle):
            groups = [_MASSES, *(group for group in groups if not set(group) & set(_MASSES))]
        named = [[name for name in group if vehicle.parameters[name].range is not None] for group in groups]
        free = [group for group in named if group]
        sides = product((0, 1), repeat=len(free))
        vehicles = [_with(vehicle, _ends(vehicle, free, side)) for side in sides] if free else []
        if not vehicles:
            return Corners((vehicle,), "the nominal vehicle alone, because its file states no ranges")
        tied = ", with equal mass in surge and sway" if _MASSES in groups else ""
        labels = tuple(_label(one, free) for one in vehicles)
        text = f"the {len(vehicles)} corners of its parameter ranges{tied}"
        return Corners((vehicle, *vehicles), text, ("nominal", *labels))
    if not 0 <= uncertainty < 1:
        raise InputError(
            "must be at least 0 and less than 1", key="uncertainty", value=uncertainty, remedy="write 0.2 for ±20 %"
        )
    masses, drags = (_factors(share) for share in (uncertainty, uncertainty if drag is None else drag))
    scaled = [_scaled(vehicle, m, d) for m in masses for d in drags]
    labels = tuple(f"mass {m - 1:+.0%}, drag {d - 1:+.0%}" for m in masses for d in drags)
    off = f"mass and drag off by ±{uncertainty:.0%}"
    if drag is not None:
        off = f"mass off by ±{uncertainty:.0%} and drag by ±{drag:.0%}"
    return Corners((vehicle, *scaled), f"the corners with {off}", ("nominal", *labels))


def _factors(share: float) -> tuple[float, ...]:
    return (1 - share, 1 + share) if share > 0 else ()


def _label(vehicle: Vehicle, groups: list[list[str]]) -> str:
    units = {name: vehicle.parameters[name].unit for group in groups for name in group}
    return ", ".join(f"{name} = {vehicle[name]:.4g}" + (f" {u}" if u != "1" else "") for name, u in units.items())


def _alike(vehicle: Vehicle) -> bool:
    surge, sway = (vehicle.parameters[name] for name in _MASSES)
    return surge.value == sway.value and surge.range == sway.range


def _ends(vehicle: Vehicle, groups: list[list[str]], side: tuple[int, ...]) -> dict[str, float]:
    values = {}
    for group, end in zip(groups, side, strict=True):
        for name in group:
            known = vehicle.parameters[name].range
            assert known is not None  # every parameter of the groups has a range
            values[name] = float(known[end])
    return values


def _scaled(vehicle: Vehicle, mass: float, drag: float) -> Vehicle:
    named = dict.fromkeys(("m11", "m22", "m33", "m44", *_terms(vehicle, "inertia")), mass)
    named |= dict.fromkeys(("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", *_terms(vehicle, "drag")), drag)
    return _with(vehicle, {name: vehicle[name] * factor for name, factor in named.items()})


def _terms(vehicle: Vehicle, table: str) -> list[str]:
    return [name for name in vehicle.form.terms if TERMS[name].table == table]


def _with(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    changed = {
        name: replace(parameter, value=values[name], range=None) if name in values else parameter
        for name, parameter in vehicle.parameters.items()
    }
    return replace(vehicle, parameters=changed)
