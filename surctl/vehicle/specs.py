"""The names of a vehicle's parameters: those of equation (3) of the paper, and the optional terms of coupled craft.

The optional terms extend equation (3) to craft whose motions are coupled (Fossen 2021, chapters 6 and 8):

- `m12` to `m34`: the entries of the symmetric inertia matrix M beside its diagonal, rigid body and added mass together.
  For a craft with a plane of symmetry through its length, m24 = m x_G − Y_ṙ couples sway and yaw.
- `Yr`, `Nv`, …: linear drag on one axis by the velocity of another one. `Yvr` is the drag |v| r on sway, and `Yuv` is
  the drag |u| v on sway, i.e. a damping that grows with the forward speed.
- `X0`, `Y0`, `Z0`, `N0`: constant force and moment, such as trim or net buoyancy.
- `Fu_reverse`, …: the largest thrust astern, where it differs from the largest thrust ahead.

A coefficient of drag is positive if it opposes positive motion, so it is the negative of the hydrodynamic derivative
of the same name (Y_r = −`Yr`). All vectors are in the heading frame: x ahead and y to the left, both horizontal, z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, product

__all__ = ["AXES", "PARAMETERS", "TERMS", "ParameterSpec", "PlantForm", "parameter_spec"]


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

AXES = ("surge", "sway", "heave", "yaw")

_FORCES, _VELOCITIES = "XYZN", "uvwr"


def _inertia(i: int, j: int) -> tuple[str, ParameterSpec]:
    # metres appear once for each index of yaw
    unit = ("kg", "kg m", "kg m^2")[(i == 3) + (j == 3)]
    meaning = f"coupling of {AXES[i]} and {AXES[j]} in the inertia matrix"
    return f"m{i + 1}{j + 1}", ParameterSpec("inertia", unit, meaning, True, signed=True)


def _drag(force: int, by: tuple[int, ...]) -> tuple[str, ParameterSpec]:
    metres = (force == 3) - sum(axis != 3 for axis in by)
    time = "s" if len(by) == 1 else "s^2"
    unit = "N m " + time if metres == 1 else "N " + time + {0: "", -1: "/m", -2: "/m^2"}[metres]
    letters = [_VELOCITIES[axis] for axis in by]
    factor = letters[0] if len(by) == 1 else f"|{letters[0]}| {letters[1]}"
    name = _FORCES[force] + "".join(letters)
    return name, ParameterSpec("drag", unit, f"drag on {AXES[force]} by {factor}", True, signed=True)


def _terms() -> dict[str, ParameterSpec]:
    terms = dict(_inertia(i, j) for i, j in combinations(range(4), 2))
    for count in (1, 2):
        for force, *by in product(range(4), repeat=1 + count):
            name, spec = _drag(force, tuple(by))
            if name not in PARAMETERS:
                terms[name] = spec
    for force, axis in enumerate(AXES):
        unit = "N m" if force == 3 else "N"
        what = "moment" if force == 3 else "force"
        name = f"{_FORCES[force]}0"
        terms[name] = ParameterSpec("force", unit, f"constant {what} in {axis}", True, signed=True)
    for limit, axis in zip(("Fu", "Fv", "Fw", "Fr"), AXES, strict=True):
        spec = PARAMETERS[f"{limit}_max"]
        meaning = f"largest thrust in {axis} in the negative direction, if it differs from {limit}_max"
        terms[f"{limit}_reverse"] = ParameterSpec("thrust", spec.unit, meaning, True)
    return terms


TERMS: Mapping[str, ParameterSpec] = _terms()
"""The optional terms, by name. A vehicle that gives none of them has the dynamics of equation (3)."""


def parameter_spec(name: str) -> ParameterSpec | None:
    """Return the definition of a parameter of equation (3) or of an optional term; None for an unknown name.

    Example:
        >>> from surctl.vehicle import parameter_spec
        >>> spec = parameter_spec("Nuv")
        >>> spec.unit, spec.meaning
        ('N s^2/m', 'drag on yaw by |u| v')
    """
    return PARAMETERS.get(name) or TERMS.get(name)


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

    def inertia(self) -> list[tuple[int, int, str]]:
        """Return the couplings of the inertia matrix as (row, column, name)."""
        return [(int(name[1]) - 1, int(name[2]) - 1, name) for name in self.terms if TERMS[name].table == "inertia"]

    def drag(self) -> list[tuple[int, tuple[int, ...], str]]:
        """Return the terms of drag as (axis of the force, axes of the velocities, name)."""
        return [
            (_FORCES.index(name[0]), tuple(_VELOCITIES.index(letter) for letter in name[1:]), name)
            for name in self.terms
            if TERMS[name].table == "drag"
        ]

    def constant(self) -> list[tuple[int, str]]:
        """Return the constant forces as (axis, name)."""
        return [(_FORCES.index(name[0]), name) for name in self.terms if TERMS[name].table == "force"]

    def reverse(self) -> list[tuple[int, str]]:
        """Return the limits of the thrust astern as (axis, name)."""
        return [("uvwr".index(name[1]), name) for name in self.terms if TERMS[name].table == "thrust"]
