"""Names, units and bounds of a vehicle's parameters, with the optional terms of coupled craft; axes without drag.

The optional terms extend equation (3) to craft whose motions are coupled (Fossen 2021, chapters 6 and 8):

- `m12` to `m34`: the entries of the symmetric inertia matrix M beside its diagonal, rigid body and added mass together.
  For a craft with a plane of symmetry through its length, m24 = m x_G − Y_ṙ couples sway and yaw.
- `Yr`, `Nv`, …: linear drag on one axis by the velocity of another one. `Yvr` is the drag |v| r on sway, and `Yuv` is
  the drag |u| v on sway, i.e. a damping that grows with the forward speed.
- `X0`, `Y0`, `Z0`, `N0`: constant force and moment, such as trim or net buoyancy.
- `Fu_reverse`, …: the largest thrust astern, where it differs from the largest thrust ahead.
- `weight`, `buoyancy`, the centres of both, and the inertia `mpp`, `mqq` about the axes of roll and pitch: the vehicle
  then rolls and pitches (six degrees of freedom), with inertia and drag about the axes of the hull. K and M are the
  moments of roll and pitch, p and q the angular velocities: `Kp`, `Mqq`, `muq` (the coupling of surge and pitch), ….

A coefficient of drag is positive if it opposes positive motion, so it is the negative of the hydrodynamic derivative
of the same name (Y_r = −`Yr`). All vectors are in the heading frame: x ahead and y to the left, both horizontal, z up;
those of a vehicle that rolls and pitches are in the frame of its hull.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from math import isfinite


@dataclass(frozen=True)
class ParameterSpec:
    """The definition of a vehicle parameter.

    Attributes:
        table: table of the vehicle file that contains the parameter.
        unit: SI unit.
        meaning: what the parameter is, for messages and tables.
        zero_allowed: whether the parameter may be 0.
        default: value if the file does not give the parameter; None: the file must give it.
        signed: whether the parameter may be negative.
    """

    table: str
    unit: str
    meaning: str
    zero_allowed: bool = False
    default: float | None = None
    signed: bool = False

    def allows(self, value: float) -> bool:
        """Return whether the parameter may have a value."""
        return isfinite(value) and (self.signed or value > 0 or (self.zero_allowed and value == 0))

    @property
    def bound(self) -> str:
        """Which values are allowed, in words."""
        return "finite" if self.signed else "at least 0" if self.zero_allowed else "greater than 0"

    @property
    def remedy(self) -> str:
        """Meaning and unit, for the message about a value that is not allowed."""
        return f"{self.meaning}, in {self.unit}"


DEFAULTED = "default of this toolkit"
"""Provenance of a parameter that the vehicle file does not state."""

PARAMETERS: Mapping[str, ParameterSpec] = {
    "radius": ParameterSpec("hull", "m", "hull radius"),
    "m11": ParameterSpec("inertia", "kg", "rigid-body plus added mass in surge"),
    "m22": ParameterSpec("inertia", "kg", "rigid-body plus added mass in sway"),
    "m33": ParameterSpec("inertia", "kg", "rigid-body plus added mass in heave"),
    "m44": ParameterSpec("inertia", "kg m^2", "rigid-body plus added moment of inertia about z"),
    "Xu": ParameterSpec("drag", "N s/m", "linear drag in surge", zero_allowed=True),
    "Yv": ParameterSpec("drag", "N s/m", "linear drag in sway", zero_allowed=True),
    "Zw": ParameterSpec("drag", "N s/m", "linear drag in heave (none in the paper)", True, 0.0),
    "Nr": ParameterSpec("drag", "N m s", "linear drag in yaw", zero_allowed=True),
    "Xuu": ParameterSpec("drag", "N s^2/m^2", "quadratic drag in surge", zero_allowed=True),
    "Yvv": ParameterSpec("drag", "N s^2/m^2", "quadratic drag in sway", zero_allowed=True),
    "Zww": ParameterSpec("drag", "N s^2/m^2", "quadratic drag in heave", zero_allowed=True),
    "Nrr": ParameterSpec("drag", "N m s^2", "quadratic drag in yaw", zero_allowed=True),
    "Fu_max": ParameterSpec("thrust", "N", "largest surge force in both directions"),
    "Fv_max": ParameterSpec("thrust", "N", "largest sway force in both directions", zero_allowed=True),
    "Fw_max": ParameterSpec("thrust", "N", "largest heave force in both directions", zero_allowed=True),
    "Fr_max": ParameterSpec("thrust", "N m", "largest yaw moment in both directions"),
    "thrust_lag": ParameterSpec("thrust", "s", "time constant of the first-order thrust lag", True, 0.3),
}
"""The parameters of equation (3) of the paper, by name."""

AXES = ("surge", "sway", "heave", "yaw", "roll", "pitch")

_FORCES, _VELOCITIES = "XYZNKM", "uvwrpq"
_TURNING = 3  # axes from this one on are angular
_LETTERS = "uvwpqr"  # order of the axes in the names of couplings with roll and pitch


def _inertia(i: int, j: int) -> tuple[str, ParameterSpec]:
    # metres appear once for each angular axis
    unit = ("kg", "kg m", "kg m^2")[(i >= _TURNING) + (j >= _TURNING)]
    if i == j:
        meaning = f"rigid-body plus added moment of inertia about the axis of {AXES[i]}"
        return f"m{2 * _VELOCITIES[i]}", ParameterSpec("inertia", unit, meaning)
    meaning = f"coupling of {AXES[i]} and {AXES[j]} in the inertia matrix"
    letters = sorted((_VELOCITIES[i], _VELOCITIES[j]), key=_LETTERS.index)
    name = f"m{i + 1}{j + 1}" if max(i, j) <= _TURNING else "m" + "".join(letters)
    return name, ParameterSpec("inertia", unit, meaning, True, signed=True)


def _drag(force: int, by: tuple[int, ...]) -> tuple[str, ParameterSpec]:
    metres = (force >= _TURNING) - sum(axis < _TURNING for axis in by)
    time = "s" if len(by) == 1 else "s^2"
    unit = "N m " + time if metres == 1 else "N " + time + {0: "", -1: "/m", -2: "/m^2"}[metres]
    letters = [_VELOCITIES[axis] for axis in by]
    factor = letters[0] if len(by) == 1 else f"|{letters[0]}| {letters[1]}"
    name = _FORCES[force] + "".join(letters)
    return name, ParameterSpec("drag", unit, f"drag on {AXES[force]} by {factor}", True, signed=True)


def _terms() -> dict[str, ParameterSpec]:
    terms: dict[str, ParameterSpec] = {}
    for axes in (4, 6):  # the terms of roll and pitch come last
        entries = [_inertia(i, j) for i, j in combinations_with_replacement(range(axes), 2) if i != j or i > _TURNING]
        for count in (1, 2):
            entries += [_drag(force, tuple(by)) for force, *by in product(range(axes), repeat=1 + count)]
        terms |= {name: spec for name, spec in entries if name not in PARAMETERS and name not in terms}
    for force, axis in enumerate(AXES[:4]):
        unit = "N m" if force == _TURNING else "N"
        what = "moment" if force == _TURNING else "force"
        name = f"{_FORCES[force]}0"
        terms[name] = ParameterSpec("force", unit, f"constant {what} in {axis}", True, signed=True)
    for limit, axis in zip(("Fu", "Fv", "Fw", "Fr"), AXES[:4], strict=True):
        spec = PARAMETERS[f"{limit}_max"]
        meaning = f"largest thrust in {axis} in the negative direction, if it differs from {limit}_max"
        terms[f"{limit}_reverse"] = ParameterSpec("thrust", spec.unit, meaning, True)
    terms["weight"] = ParameterSpec("attitude", "N", "weight of the vehicle with the water that it carries")
    terms["buoyancy"] = ParameterSpec("attitude", "N", "buoyancy of the submerged vehicle")
    for letter, what in (("g", "centre of gravity"), ("b", "centre of buoyancy"), ("t", "point of attack of thrust")):
        for axis in "xyz":
            meaning = f"{axis} of the {what} in the frame of the hull"
            terms[f"{axis}{letter}"] = ParameterSpec("attitude", "m", meaning, True, signed=True)
    return terms


TERMS: Mapping[str, ParameterSpec] = _terms()
"""The optional terms, by name. A vehicle that gives none of them has the dynamics of equation (3)."""


SPECS: Mapping[str, ParameterSpec] = {**PARAMETERS, **TERMS}
"""The parameters of equation (3) and the optional terms, by name."""


def undamped(values: Mapping[str, float]) -> tuple[str, ...]:
    """Return the axes on which a vehicle has thrust but no drag, by the values of its parameters."""
    damped = {name[0] + name[-1] for name, value in values.items() if value and SPECS[name].table == "drag"}
    pushed = zip(AXES, _FORCES, _VELOCITIES, ("Fu_max", "Fv_max", "Fw_max", "Fr_max"), strict=False)
    return tuple(axis for axis, force, by, limit in pushed if values.get(limit, 0.0) and force + by not in damped)


_TILT = {name for name, spec in TERMS.items() if spec.table == "attitude" or set(name) & set("KMpq")}
"""The terms of vehicles that roll and pitch."""

NEEDED_TO_TILT = ("mpp", "mqq", "weight", "buoyancy")
"""The terms without which roll and pitch have no dynamics."""


@dataclass(frozen=True)
class PlantForm:
    """Which optional terms the dynamics of a vehicle contain; without any, they are equation (3) of the paper.

    Attributes:
        terms: names of the optional terms, in the order of `TERMS`.
    """

    terms: tuple[str, ...] = ()

    @staticmethod
    def of(names: Iterable[str]) -> PlantForm:
        """Return the form with the optional terms among some parameter names."""
        present = set(names)
        return PlantForm(tuple(name for name in TERMS if name in present))

    @property
    def tilts(self) -> bool:
        """Whether the vehicle rolls and pitches."""
        return any(name in _TILT for name in self.terms)

    def inertia(self) -> list[tuple[int, int, str]]:
        """Return the entries of the inertia matrix beside m11 to m44 as (row, column, name), row ≤ column."""

        def axis(letter: str) -> int:
            return int(letter) - 1 if letter.isdigit() else _VELOCITIES.index(letter)

        names = [name for name in self.terms if TERMS[name].table == "inertia"]
        ends = [(axis(name[1]), axis(name[2]), name) for name in names]
        return [(min(i, j), max(i, j), name) for i, j, name in ends]

    def drag(self) -> list[tuple[int, tuple[int, ...], str]]:
        """Return the terms of drag as (axis of the force, axes of the velocities, name)."""
        return [
            (_FORCES.index(name[0]), tuple(_VELOCITIES.index(letter) for letter in name[1:]), name)
            for name in self.terms
            if TERMS[name].table == "drag"
        ]

    def ahead(self) -> list[tuple[int, str]]:
        """Return the drag on sway, heave and yaw that grows with the forward speed as (axis, name): Yuv, Zuw, Nur."""
        return [(axis, name) for axis, by, name in self.drag() if by == (0, axis) and axis <= _TURNING]

    def constant(self) -> list[tuple[int, str]]:
        """Return the constant forces as (axis, name)."""
        return [(_FORCES.index(name[0]), name) for name in self.terms if TERMS[name].table == "force"]

    def reverse(self) -> list[tuple[int, str]]:
        """Return the limits of the thrust astern as (axis, name)."""
        return [("uvwr".index(name[1]), name) for name in self.terms if TERMS[name].table == "thrust"]
