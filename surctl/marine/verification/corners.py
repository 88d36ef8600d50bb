"""The corners of a vehicle's parameter ranges for the linear loop; ranges assumed where the file states none."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from surctl.errors import InputError
from surctl.marine.vehicle import TERMS, Vehicle

MASS_SPREAD, DRAG_SPREAD = 0.05, 0.2
"""Relative uncertainty of all masses and of all drag coefficients of a vehicle whose file states no ranges (*chosen*).
"""

NOMINAL = "the nominal vehicle"

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
        assumed: whether neither the vehicle file nor the caller states how far mass and drag may be off.
    """

    vehicles: tuple[Vehicle, ...]
    text: str
    labels: tuple[str, ...]
    assumed: bool = False

    @property
    def others(self) -> dict[str, Vehicle]:
        """The vehicles by label, without the nominal one."""
        return dict(zip(self.labels[1:], self.vehicles[1:], strict=True))

    @property
    def alone(self) -> Corners:
        """The nominal vehicle alone."""
        return Corners(self.vehicles[:1], f"{NOMINAL} alone", (NOMINAL,))

    def vehicle(self, label: str) -> Vehicle:
        """Return the vehicle with a label."""
        return self.others.get(label, self.vehicles[0])

    def held(self, loops: Sequence[tuple[str, object | None]], cruise: float) -> str:
        """Return `text`, and how many of the vehicles have no loop because they cannot hold a cruise speed [m/s]."""
        unable = sum(loop is None for _, loop in loops)
        return self.text + (f"; {unable} of them cannot hold {cruise:g} m/s with their thrust" if unable else "")


def corners(
    vehicle: Vehicle,
    uncertainty: float | None = None,
    *,
    known: Collection[str] = (),
    spread: float = 1.0,
) -> Corners:
    """Return the nominal vehicle and the corners of its uncertainty.

    If `uncertainty` is given, all masses are multiplied by 1 ± uncertainty, and all drag coefficients likewise.
    Otherwise the corners are all combinations of the ends of the ranges in the vehicle file; if the file states none,
    all masses are off by ±5 % and all drag coefficients by ±20 %. The masses of surge and sway vary together if the
    file gives them equal values and ranges; a difference matters, because the Munk moment turns a body broadside if its
    sway mass exceeds its surge mass. A linear loop is usually worst at a corner, but this is no proof for the values
    between the corners.

    Args:
        vehicle: the nominal vehicle.
        uncertainty: relative uncertainty, 0 ≤ uncertainty < 1, or None for the ranges of the vehicle file.
        known: parameters whose value is exact.
        spread: factor of ±5 % and ±20 %.

    Raises:
        InputError: the uncertainty is out of range.
    """
    groups = _groups(vehicle)
    if uncertainty is None and range_ends(vehicle, groups) != [{}]:
        ends = range_ends(vehicle, groups, known=known)
        if ends == [{}]:
            return Corners((vehicle,), f"{NOMINAL} alone", (NOMINAL,))
        vehicles = tuple(_with(vehicle, values) for values in ends)
        ranged = _MASSES in groups and vehicle.parameters["m11"].range is not None
        tied = ", with equal mass in surge and sway" if ranged else ""
        labels = tuple(_label(one, ends[0]) for one in vehicles)
        text = f"the {len(vehicles)} corners of its parameter ranges{tied}"
        return Corners((vehicle, *vehicles), text, (NOMINAL, *labels))
    assumed = uncertainty is None
    mass, drag = (spread * MASS_SPREAD, spread * DRAG_SPREAD) if uncertainty is None else (uncertainty, uncertainty)
    if not 0 <= mass < 1:
        raise InputError(
            "must be at least 0 and less than 1", key="uncertainty", value=uncertainty, remedy="write 0.2 for ±20 %"
        )
    signs = list(product(_factors(mass), _factors(drag)))
    scaled = [_scaled(vehicle, m, d, known) for m, d in signs]
    labels = tuple(f"mass {m - 1:+.0%}, drag {d - 1:+.0%}" for m, d in signs)
    off = f"mass and drag off by ±{mass:.0%}"
    if drag != mass:
        off = f"mass off by ±{mass:.0%} and drag by ±{drag:.0%}"
    return Corners((vehicle, *scaled), f"the corners with {off}", (NOMINAL, *labels), assumed)


def _groups(vehicle: Vehicle) -> list[tuple[str, ...]]:
    # each optional term is a group of its own
    groups = [*_GROUPS, *((name,) for name in (*_terms(vehicle, "inertia"), *_terms(vehicle, "drag")))]
    surge, sway = (vehicle.parameters[name] for name in _MASSES)
    if (surge.value, surge.range) == (sway.value, sway.range):
        return [_MASSES, *(group for group in groups if not set(group) & set(_MASSES))]
    return groups


def _factors(share: float) -> tuple[float, ...]:
    return (1 - share, 1 + share) if share > 0 else ()


def _label(vehicle: Vehicle, names: Iterable[str]) -> str:
    units = {name: vehicle.parameters[name].unit for name in names}
    return ", ".join(f"{name} = {vehicle[name]:.4g}" + (f" {u}" if u != "1" else "") for name, u in units.items())


def range_ends(
    vehicle: Vehicle, groups: Iterable[Sequence[str]], *, known: Collection[str] = ()
) -> list[dict[str, float]]:
    """Return all combinations of the ends of a vehicle's ranges; the parameters of one group take the same end.

    Parameters without a range, and those that are `known`, are in none of them.
    """
    each: list[tuple[dict[str, float], ...]] = []
    for group in groups:
        ranges = {name: vehicle.parameters[name].range for name in group if name not in known}
        ends = [{name: float(span[side]) for name, span in ranges.items() if span is not None} for side in (0, 1)]
        each.append(tuple(ends) if ends[0] else ({},))
    return [{name: value for part in one for name, value in part.items()} for one in product(*each)]


def _scaled(vehicle: Vehicle, mass: float, drag: float, known: Collection[str]) -> Vehicle:
    named = dict.fromkeys(("m11", "m22", "m33", "m44", *_terms(vehicle, "inertia")), mass)
    named |= dict.fromkeys(("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", *_terms(vehicle, "drag")), drag)
    return _with(vehicle, {name: vehicle[name] * factor for name, factor in named.items() if name not in known})


def _terms(vehicle: Vehicle, table: str) -> list[str]:
    return [name for name in vehicle.form.terms if TERMS[name].table == table]


def _with(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    changed = {
        name: replace(parameter, value=values[name], range=None) if name in values else parameter
        for name, parameter in vehicle.parameters.items()
    }
    return replace(vehicle, parameters=changed)
