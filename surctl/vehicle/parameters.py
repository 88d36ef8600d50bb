"""The parameters of a vehicle, read from a TOML file; each parameter has a unit, a range and a provenance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from surctl.errors import InputError, nearest
from surctl.files import Quantity, Strict, pick, read_toml, validate

__all__ = ["LIBRARY", "PARAMETERS", "Parameter", "ParameterSpec", "Vehicle", "load_vehicle"]

LIBRARY = Path(__file__).parent / "library"


@dataclass(frozen=True)
class ParameterSpec:
    """The definition of a vehicle parameter: its table in the file, unit, meaning, whether 0 is allowed, default."""

    table: str
    unit: str
    meaning: str
    zero_allowed: bool = False
    default: float | None = None


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


@dataclass(frozen=True)
class Parameter:
    """The value of a parameter with its unit, its range, and its provenance (where the value comes from)."""

    value: float
    unit: str
    range: tuple[float, float] | None
    provenance: str


@dataclass(frozen=True)
class Vehicle:
    """A vehicle: its name, a note, every parameter of equation (3) by name (in SI units), and the name of its file."""

    name: str
    note: str
    parameters: Mapping[str, Parameter]
    source: str = ""

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter in its SI unit; for an unknown name, raise InputError with a similar name."""
        if name not in self.parameters:
            raise InputError("no such vehicle parameter", key=name, remedy=nearest(name, self.parameters))
        return self.parameters[name].value

    @property
    def mass(self) -> NDArray[np.float64]:
        """Diagonal (4,) of the inertia matrix M: m11, m22, m33 [kg], m44 [kg m²]."""
        return np.array([self[k] for k in ("m11", "m22", "m33", "m44")])

    @property
    def linear_drag(self) -> NDArray[np.float64]:
        """Linear drag coefficients (4,): Xu, Yv, Zw [N s/m], Nr [N m s]."""
        return np.array([self[k] for k in ("Xu", "Yv", "Zw", "Nr")])

    @property
    def quadratic_drag(self) -> NDArray[np.float64]:
        """Quadratic drag coefficients (4,): Xuu, Yvv, Zww [N s²/m²], Nrr [N m s²]."""
        return np.array([self[k] for k in ("Xuu", "Yvv", "Zww", "Nrr")])

    @property
    def thrust_limit(self) -> NDArray[np.float64]:
        """Thrust limits (4,): largest |F_u|, |F_v|, |F_w| [N] and |F_r| [N m]."""
        return np.array([self[k] for k in ("Fu_max", "Fv_max", "Fw_max", "Fr_max")])

    def steady_yaw(self, share: float) -> float:
        """Return the yaw rate [rad/s] at which drag balances `share` of the largest yaw moment, in the worst case."""

        def worst(name: str, which: int) -> float:
            known = self.parameters[name].range
            return self[name] if known is None else known[which]

        moment, linear, quadratic = share * worst("Fr_max", 0), worst("Nr", 1), worst("Nrr", 1)
        return float(2 * moment / max(linear + np.sqrt(linear**2 + 4 * quadratic * moment), 1e-6))

    def digest(self) -> str:
        """Return the SHA-256 of all parameter names and values, without provenance and ranges."""
        numbers = json.dumps({name: p.value for name, p in self.parameters.items()}, sort_keys=True)
        return hashlib.sha256(numbers.encode()).hexdigest()

    def with_values(self, values: Mapping[str, float]) -> Vehicle:
        """Return a copy with some values changed; each new value must lie in the range of its parameter."""
        changed = dict(self.parameters)
        for name, value in values.items():
            self[name]
            changed[name] = _checked(name, replace(changed[name], value=float(value)), file=self.source or self.name)
        return replace(self, parameters=changed)


class _VehicleFile(Strict):
    kind: str = Field(pattern="^vehicle$")
    name: str = Field(min_length=1)
    note: str = ""
    hull: dict[str, Quantity | str]
    inertia: dict[str, Quantity | str]
    drag: dict[str, Quantity | str]
    thrust: dict[str, Quantity | str]


def load_vehicle(name_or_path: str) -> Vehicle:
    """Load a built-in vehicle by name, or a vehicle file by path.

    Raises:
        InputError: the name is unknown, the file is unreadable, a key is missing or unknown, a unit or sign is wrong, a
            value is outside the range stated for it, or a table has no provenance.

    Example:
        >>> from surctl.vehicle import load_vehicle
        >>> boat = load_vehicle("sur400")
        >>> boat["m11"], boat.parameters["m11"].unit, boat["radius"]
        (50.0, 'kg', 0.2)
    """
    path = pick(str(name_or_path), LIBRARY, what="vehicle")
    return vehicle_from_table(read_toml(path), source=str(path))


def vehicle_from_table(table: dict[str, Any], *, source: str) -> Vehicle:
    """Return a vehicle from the table of its file; `source` is the name of the file in error messages."""
    if table.get("kind") != "vehicle":
        raise InputError(
            "is not a vehicle file", file=source, key="kind", value=table.get("kind"), remedy='write kind = "vehicle"'
        )
    model = validate(table, _VehicleFile, file=source)
    parameters: dict[str, Parameter] = {}
    for section in ("hull", "inertia", "drag", "thrust"):
        parameters |= _read_section(section, getattr(model, section), source)
    for name, spec in PARAMETERS.items():
        if name in parameters:
            continue
        if spec.default is None:
            raise InputError(
                "is missing",
                file=source,
                key=f"{spec.table}.{name}",
                remedy=f'add {name} = {{ value = ..., unit = "{spec.unit}" }} ({spec.meaning})',
            )
        parameters[name] = Parameter(spec.default, spec.unit, None, "default of this toolkit")
    return Vehicle(model.name, model.note, {name: parameters[name] for name in PARAMETERS}, source)


def _read_section(section: str, table: Mapping[str, Quantity | str], source: str) -> dict[str, Parameter]:
    known = [name for name, spec in PARAMETERS.items() if spec.table == section]
    shared = table.get("provenance")
    if shared is not None and (not isinstance(shared, str) or not shared.strip()):
        raise InputError(
            "must be a text", file=source, key=f"{section}.provenance", remedy="state where the numbers come from"
        )
    parameters = {}
    for name, entry in table.items():
        if name == "provenance":
            continue
        key = f"{section}.{name}"
        if name not in known:
            raise InputError("unknown key", file=source, key=key, remedy=nearest(name, [*known, "provenance"]))
        entry = _in_own_unit(name, entry, file=source)
        provenance = entry.provenance or shared
        if not isinstance(provenance, str):
            raise InputError(
                "has no provenance",
                file=source,
                key=key,
                remedy=f'add provenance = "..." to [{section}]: who measured or derived it',
            )
        parameters[name] = _checked(name, Parameter(entry.value, entry.unit, entry.range, provenance), file=source)
    return parameters


def _in_own_unit(name: str, entry: Quantity | str, *, file: str) -> Quantity:
    spec = PARAMETERS[name]
    try:
        return (Quantity.model_validate(entry) if isinstance(entry, str) else entry).within(spec.unit)
    except ValidationError:
        raise InputError(
            "must be a value with its unit",
            file=file,
            key=f"{spec.table}.{name}",
            value=entry,
            remedy=f'write {{ value = ..., unit = "{spec.unit}" }}',
        ) from None
    except InputError as error:
        raise error.inside(file, f"{spec.table}.{name}.unit") from None


def _checked(name: str, parameter: Parameter, *, file: str) -> Parameter:
    spec = PARAMETERS[name]
    key, value = f"{spec.table}.{name}", parameter.value
    if not np.isfinite(value) or value < 0 or (value == 0 and not spec.zero_allowed):
        bound = "must be at least 0" if spec.zero_allowed else "must be greater than 0"
        raise InputError(bound, file=file, key=key, value=value, remedy=f"{spec.meaning}, in {spec.unit}")
    if parameter.range is not None:
        low, high = parameter.range
        if not (0 <= low <= high):
            raise InputError(
                "is not a range", file=file, key=f"{key}.range", value=parameter.range, remedy="write [low, high]"
            )
        if not low <= value <= high:
            raise InputError(
                f"lies outside its own range [{low:g}, {high:g}]",
                file=file,
                key=key,
                value=value,
                remedy="widen the range or correct the value",
            )
    return parameter
