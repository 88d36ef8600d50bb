"""Vehicle files: parameters with unit, range and provenance; thrust limits from thrusters; impossible values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import degrees
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Mistakes, Quantity, Strict, pick, quoted, read_toml, validate
from surctl.marine.vehicle.specs import (
    DEFAULTED,
    NEEDED_TO_TILT,
    PARAMETERS,
    SPECS,
    TERMS,
    ParameterSpec,
    PlantForm,
)
from surctl.marine.vehicle.thruster_file import axis_ends, axis_limits, common_lag, read_actuators
from surctl.marine.vehicle.thrusters import Actuators

_NAMES = ("Fu_max", "Fv_max", "Fw_max", "Fr_max")
_ARM = 1e-6  # [m] a shorter arm gives no yaw moment


def _largest_forces(actuators: Actuators, *, stated: Container[str], source: str) -> Mapping[str, float]:
    """Return `Fu_max`, `Fv_max`, `Fw_max` [N], `Fr_max` [N m], but not `stated`: the largest value on each axis alone.

    All other axes are 0 meanwhile, and the force is available in both directions; a craft without sway force has
    `Fu_reverse` beside `Fu_max` if it is weaker astern. Fins count in yaw only, with their forces at 1 m/s.
    """
    ends = axis_ends(actuators, 1.0)
    limits = dict(zip(_NAMES, np.minimum(-ends[:, 0], ends[:, 1]).tolist(), strict=True))
    astern, ahead = (-ends[0, 0]).item(), ends[0, 1].item()
    if "Fu_max" not in stated:
        if astern <= 0 or ahead <= 0:
            missing = f"no force {'astern' if astern <= 0 else 'ahead'}"
            raise _lacks(
                actuators, 0, f"leaves the craft {missing} without another one, and the laws brake with it", source
            )
        if limits["Fv_max"] == 0 and astern < ahead:
            limits |= {"Fu_max": ahead, "Fu_reverse": astern}
    if "Fr_max" not in stated and limits["Fr_max"] <= 0:
        raise _lacks(actuators, 5, "gives no yaw moment without surge or sway force", source)
    return {name: value for name, value in limits.items() if name not in stated}


def _lacks(actuators: Actuators, row: int, problem: str, source: str) -> InputError:
    """Return the error that an axis, a row of `Thruster.columns`, has no force of its own in both directions.

    It names the thruster to change: one that pushes on this axis, if possible without force in reverse.
    """
    thrusters, fins = actuators.thrusters, actuators.fins
    pushing = [
        k for k, one in enumerate(thrusters) if (row == 5 or k not in fins) and np.abs(one.columns[row]).max() > _ARM
    ]
    if pushing:
        k = next((k for k in pushing if thrusters[k].reverse == 0), pushing[0])
        key, value = f"thruster.{k}.reverse", f"{thrusters[k].reverse:g} N"
        remedy = f"give {thrusters[k].name} a force in reverse, or add a thruster or rudder that gives it"
        return InputError(f"{thrusters[k].name} {problem}", file=source, key=key, value=value, remedy=remedy)
    if row == 0:
        value, remedy = ", ".join(actuators.names), "add a [[thruster]] with push = [1, 0, 0]"
        return InputError("no thruster pushes ahead", file=source, key="thruster", value=value, remedy=remedy)
    k = fins[0] if fins else 0
    name, at = actuators.names[k], list(thrusters[k].at)
    remedy = f"place {name} at x != 0" if fins else f"place {name} beside the middle, or add a rudder at x != 0"
    return InputError(f"{name} gives no yaw moment", file=source, key=f"thruster.{k}.at_m", value=at, remedy=remedy)


LIBRARY = Path(__file__).parent / "library"

_YAW = 3
_SLOWEST = 1e-3  # [m/s] least speed for the limits of fins, which vanish at rest
_FASTEST = 20.0  # [m/s] no craft of this project is faster


@dataclass(frozen=True)
class Parameter:
    """The value of a parameter with its unit, its range, and its provenance (where the value comes from)."""

    value: float
    unit: str
    range: tuple[float, float] | None
    provenance: str


@dataclass(frozen=True)
class Vehicle:
    """A vehicle: its name, a note, its parameters by name (in SI units), and the name of its file.

    The parameters are those of equation (3) of the paper, followed by the vehicle's optional terms (see `TERMS`).
    `actuators` holds the thrusters and the order of their allocation; None: the vehicle file describes no thrusters,
    and each axis has its own force limit. `speed` is the forward speed [m/s] at which the thrust limits of a vehicle
    with fins hold: those of its file hold at 1 m/s (see `at_speed`).
    """

    name: str
    note: str
    parameters: Mapping[str, Parameter]
    source: str = ""
    actuators: Actuators | None = None
    speed: float = 1.0

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter in its SI unit; for an unknown name, raise InputError with a similar name."""
        if name not in self.parameters:
            raise InputError("no such vehicle parameter", key=name, remedy=nearest(name, self.parameters))
        return self.parameters[name].value

    @property
    def form(self) -> PlantForm:
        """The optional terms that this vehicle has."""
        return PlantForm.of(self.parameters)

    @property
    def mass(self) -> NDArray[np.float64]:
        """Diagonal (4,) of the inertia matrix M: m11, m22, m33 [kg], m44 [kg m²]."""
        return np.array([self[k] for k in ("m11", "m22", "m33", "m44")])

    @property
    def inertia(self) -> NDArray[np.float64]:
        """The symmetric inertia matrix M (4, 4), rigid body and added mass, in kg, kg m and kg m².

        The matrix of a vehicle that rolls and pitches is (6, 6), in the order (u, v, w, r, p, q).
        """
        inertia = np.diag([*self.mass, *([0.0, 0.0] if self.form.tilts else [])])
        for i, j, name in self.form.inertia():
            inertia[i, j] = inertia[j, i] = self[name]
        return inertia

    @property
    def linear_drag(self) -> NDArray[np.float64]:
        """Linear drag coefficients (4,): Xu, Yv, Zw [N s/m], Nr [N m s]."""
        return np.array([self[k] for k in ("Xu", "Yv", "Zw", "Nr")])

    def drag_at(self, cruise: float) -> NDArray[np.float64]:
        """Return the linear drag (4,) at a forward speed [m/s], which the drag by |u| on each axis increases.

        A law whose model has no such terms uses this drag at its cruise speed.
        """
        linear = self.linear_drag
        for axis, name in self.form.ahead():
            linear[axis] += self[name] * cruise
        return linear

    @property
    def quadratic_drag(self) -> NDArray[np.float64]:
        """Quadratic drag coefficients (4,): Xuu, Yvv, Zww [N s²/m²], Nrr [N m s²]."""
        return np.array([self[k] for k in ("Xuu", "Yvv", "Zww", "Nrr")])

    @property
    def thrust_limit(self) -> NDArray[np.float64]:
        """Thrust limits (4,) that hold in both directions: largest |F_u|, |F_v|, |F_w| [N] and |F_r| [N m].

        Where the vehicle has less thrust astern than ahead, the limit is the thrust astern, because a law brakes by it.
        """
        least, most = self.thrust_range
        return np.asarray(np.minimum(-least, most), dtype=float)

    @property
    def thrust_range(self) -> NDArray[np.float64]:
        """Least and largest thrust (2, 4) in surge, sway, heave [N] and yaw [N m]; the least thrust is at most 0."""
        return self._with_reverse(np.array([self[k] for k in ("Fu_max", "Fv_max", "Fw_max", "Fr_max")]))

    @property
    def thrust_bound(self) -> NDArray[np.float64]:
        """Bounds (4,) of the thrust that reaches the plant: the thrust limits, or the most that the thrusters give."""
        return self.thrust_limit if self.actuators is None else self.actuators.most

    def at_speed(self, speed: float) -> Vehicle:
        """Return the vehicle with the thrust limits that hold at a forward speed [m/s]; without fins, the vehicle.

        The yaw moment of a rudder or another fin grows with the square of the speed.
        """
        if self.actuators is None or not self.actuators.fins or speed == self.speed:
            return self
        before, after = (axis_limits(self.actuators, max(u, _SLOWEST))[3] for u in (self.speed, speed))
        factor, known = float(after / before), self.parameters["Fr_max"]
        ends = None if known.range is None else (factor * known.range[0], factor * known.range[1])
        moment = replace(known, value=factor * known.value, range=ends)
        return replace(self, parameters={**self.parameters, "Fr_max": moment}, speed=max(speed, _SLOWEST))

    def fin_share(self, speed: float) -> float:
        """Return the share of the largest yaw moment that rudders and other fins give at a forward speed [m/s]."""
        if self.actuators is None or not self.actuators.fins:
            return 0.0
        alone, most = (axis_limits(self.actuators, u)[3] for u in (0.0, max(speed, _SLOWEST)))
        return float(1 - alone / most)

    def munk(self, cruise: float) -> float:
        """Return μ = m22 − m11 + Nuv + Nv/U [kg]: at a sway speed v, Munk moment and lift are μ u v; U: speed [m/s]."""
        return self["m22"] - self["m11"] + self.term("Nuv") + self.term("Nv") / cruise

    def centripetal(self, cruise: float) -> float:
        """Return m = m11 + Yur + Yr/U [kg]: a turn at the yaw rate r needs the sway force m u r towards its centre.

        It is negative if the fins give more than this force: the craft then drifts inwards.
        """
        return self["m11"] + self.term("Yur") + self.term("Yr") / cruise

    def term(self, name: str) -> float:
        """Return the value of an optional term in its SI unit; 0 if the vehicle does not have it."""
        return self[name] if name in self.parameters else 0.0

    @property
    def delivered_limit(self) -> NDArray[np.float64]:
        """Bounds (4,) of the thrust that the plant accepts ahead: the thrust range, or what thrusters with fins reach.

        The allocation limits each fin by the present speed, so the plant must not limit the sum again.
        """
        most: NDArray[np.float64] = self.thrust_range[1]
        if self.actuators is None or not self.actuators.fins:
            return most
        finned = np.maximum(most, _FASTEST**2 * self.actuators.most)
        return np.where(self.actuators.finned, finned, most).astype(float)

    @property
    def delivered_range(self) -> NDArray[np.float64]:
        """Least and largest thrust (2, 4) that the plant accepts: `delivered_limit`, and the stated thrust astern."""
        return self._with_reverse(self.delivered_limit)

    def _with_reverse(self, ahead: NDArray[np.float64]) -> NDArray[np.float64]:
        astern = ahead.copy()
        for axis, name in self.form.reverse():
            astern[axis] = self[name]
        return np.array([0.0 - astern, ahead])

    def steady_yaw(self, share: float, cruise: float = 0.0) -> float:
        """Return the yaw rate [rad/s] at which drag balances `share` of the largest yaw moment, in the worst case.

        At a forward speed `cruise` [m/s], the drag in yaw contains the part that grows with this speed.
        """

        def worst(name: str, which: int) -> float:
            known = self.parameters[name].range
            return self[name] if known is None else known[which]

        moment, linear, quadratic = share * worst("Fr_max", 0), worst("Nr", 1), worst("Nrr", 1)
        linear += sum(worst(name, 1) * cruise for axis, name in self.form.ahead() if axis == _YAW)
        return float(2 * moment / max(linear + np.sqrt(linear**2 + 4 * quadratic * moment), 1e-6))

    def digest(self) -> str:
        """Return the SHA-256 of all parameter names and values and the thrusters, without provenance and ranges."""
        numbers = json.dumps({name: p.value for name, p in self.parameters.items()}, sort_keys=True)
        numbers += "" if self.actuators is None else self.actuators.text()
        return hashlib.sha256(numbers.encode()).hexdigest()

    def with_values(self, values: Mapping[str, float]) -> Vehicle:
        """Return a copy with some values changed; each new value must lie in the range of its parameter."""
        changed = dict(self.parameters)
        for name, value in values.items():
            self[name]
            changed[name] = _checked(name, replace(changed[name], value=float(value)), file=self.source or self.name)
        return _possible(replace(self, parameters=changed))


class _VehicleFile(Strict):
    kind: str = Field(pattern="^vehicle$")
    name: str = Field(min_length=1)
    note: str = ""
    hull: dict[str, Quantity | str]
    inertia: dict[str, Quantity | str]
    drag: dict[str, Quantity | str]
    thrust: dict[str, Quantity | str] = Field(default_factory=dict)
    force: dict[str, Quantity | str] = Field(default_factory=dict)
    attitude: dict[str, Quantity | str] = Field(default_factory=dict)
    thruster: list[dict[str, Any]] = Field(default_factory=list)
    allocation: dict[str, Any] | None = None


def load_vehicle(name_or_path: str) -> Vehicle:
    """Load a built-in vehicle by name, or a vehicle file by path.

    Raises:
        InputError: the name is unknown, the file is unreadable, a key is missing or unknown, a unit or sign is wrong, a
            value is outside the range stated for it, or a table has no provenance.

    Example:
        >>> from surctl.marine.vehicle import load_vehicle
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
    if not model.name.isprintable():
        remedy = "leave out line breaks and other control characters"
        raise InputError("is not a name", file=source, key="name", value=model.name, remedy=remedy)
    parameters, mistakes = dict[str, Parameter](), Mistakes()
    for section in ("hull", "inertia", "drag", "thrust", "force", "attitude"):
        parameters |= _read_section(section, getattr(model, section), source, mistakes)
    mistakes.check()
    actuators = read_actuators(model.thruster, model.allocation, source=source)
    parameters |= _of_thrusters(actuators, model.thruster, parameters, source)
    for name, spec in PARAMETERS.items():
        if name in parameters:
            continue
        with mistakes.collected():
            if spec.default is None:
                remedy = f'add {name} = {{ value = ..., unit = "{spec.unit}" }} ({spec.meaning})'
                raise InputError("is missing", file=source, key=f"{spec.table}.{name}", remedy=remedy)
            parameters[name] = Parameter(spec.default, spec.unit, None, DEFAULTED)
    mistakes.check()
    ordered = {name: parameters[name] for name in SPECS if name in parameters}
    return _possible(Vehicle(model.name, model.note, ordered, source, actuators))


def _possible(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle if its terms describe a body; else raise InputError.

    Kinetic energy requires a positive definite inertia matrix everywhere in the ranges, and roll and pitch need
    inertia, weight and buoyancy.
    """
    form, file = vehicle.form, vehicle.source or vehicle.name
    for name in NEEDED_TO_TILT if form.tilts else ():
        if name not in form.terms:
            spec = TERMS[name]
            problem = "is missing in a vehicle with other terms of roll and pitch"
            remedy = f'add {name} = {{ value = ..., unit = "{spec.unit}" }} ({spec.meaning})'
            raise InputError(problem, file=file, key=f"{spec.table}.{name}", remedy=remedy)
    for which in ("value", "range"):
        _check_inertia(vehicle, which, file=file)
    return vehicle


def _check_inertia(vehicle: Vehicle, which: Literal["value", "range"], *, file: str) -> None:
    """Raise InputError if an inertia matrix is not positive definite: that of the values, or one within the ranges.

    The positive definite matrices are a convex set, and more inertia on the diagonal never leaves it. So the matrices
    with the least diagonal and each combination of ends of the couplings decide.
    """
    names = ("m11", "m22", "m33", "m44", *(("mpp", "mqq") if vehicle.form.tilts else ()))
    couplings = [entry for entry in vehicle.form.inertia() if entry[0] != entry[1]]

    def ends(name: str) -> tuple[float, ...]:
        parameter = vehicle.parameters[name]
        return (parameter.value,) if which == "value" or parameter.range is None else parameter.range

    own = [min(ends(name)) for name in names]
    for values in product(*(dict.fromkeys(ends(name)) for *_, name in couplings)) if couplings else ():
        inertia = np.diag(own)
        for (i, j, _), value in zip(couplings, values, strict=True):
            inertia[i, j] = inertia[j, i] = value
        if np.linalg.eigvalsh(inertia)[0] <= 0:
            shares = [value**2 / (own[i] * own[j]) for (i, j, _), value in zip(couplings, values, strict=True)]
            at = int(np.argmax(shares))
            (i, j, name), value = couplings[at], values[at]
            least = " at the lower ends of their ranges" if which == "range" else ""
            most = f"sqrt({names[i]} {names[j]}) = {np.sqrt(own[i] * own[j]):.4g} {TERMS[name].unit}{least}"
            raise InputError(
                "makes the inertia matrix indefinite",
                file=file,
                key=f"inertia.{name}" + (".range" if which == "range" else ""),
                value=value,
                remedy=f"alone, its size must be below {most}",
            )


def _of_thrusters(
    actuators: Actuators | None, tables: list[dict[str, Any]], stated: Mapping[str, Parameter], source: str
) -> dict[str, Parameter]:
    # the parameters of [thrust] that follow from the thrusters, where the file does not state them
    if actuators is None:
        return {}
    said = "follows from the thrusters: the largest value with 0 on all other axes"
    limits = _largest_forces(actuators, stated=stated, source=source)
    derived = {name: Parameter(v, SPECS[name].unit, None, said) for name, v in limits.items()}
    known = stated.get("thrust_lag")
    lag = common_lag(tables, known=None if known is None else known.value, source=source)
    derived |= {} if lag is None else {"thrust_lag": Parameter(lag, "s", None, "lag of every thruster")}
    return {name: _checked(name, known, file=source) for name, known in derived.items() if name not in stated}


def _read_section(
    section: str, table: Mapping[str, Quantity | str], source: str, mistakes: Mistakes
) -> dict[str, Parameter]:
    known = [name for name, spec in SPECS.items() if spec.table == section]
    shared = table.get("provenance")
    if shared is not None and (not isinstance(shared, str) or not shared.strip()):
        raise InputError(
            "must be a text", file=source, key=f"{section}.provenance", remedy="state where the numbers come from"
        )
    parameters = {}
    for name, entry in table.items():
        if name == "provenance":
            continue
        with mistakes.collected():
            with mistakes_in(source, f"{section}.{name}"):
                if name not in known:
                    raise InputError("unknown key", remedy=nearest(name, [*known, "provenance"]))
                parameter = _parameter(name, entry, shared)
            parameters[name] = _checked(name, parameter, file=source)
    return parameters


def _parameter(name: str, entry: Quantity | str, shared: str | None) -> Parameter:
    spec = SPECS[name]
    try:
        quantity = Quantity.model_validate(entry) if isinstance(entry, str) else entry
    except ValidationError:
        remedy = f'write {{ value = ..., unit = "{spec.unit}" }}'
        raise InputError("must be a value with its unit", value=entry, remedy=remedy) from None
    known = quantity.within(spec.unit)
    provenance = known.provenance or shared
    if not isinstance(provenance, str):
        remedy = f'add provenance = "..." to [{spec.table}]: who measured or derived it'
        raise InputError("has no provenance", remedy=remedy)
    return Parameter(known.value, known.unit, known.range, provenance)


def _checked(name: str, parameter: Parameter, *, file: str) -> Parameter:
    spec = SPECS[name]
    key, value = f"{spec.table}.{name}", parameter.value
    for what, number in ((key, value), *((f"{key}.range", end) for end in parameter.range or ())):
        if not spec.allows(number):
            raise InputError(f"must be {spec.bound}", file=file, key=what, value=number, remedy=spec.remedy)
    if parameter.range is not None:
        low, high = parameter.range
        if low > high:
            raise InputError(
                "is not a range", file=file, key=f"{key}.range", value=parameter.range, remedy="write [low, high]"
            )
        if not low <= value <= high:
            problem = f"lies outside its own range [{low:g}, {high:g}]"
            raise InputError(problem, file=file, key=key, value=value, remedy="widen the range or correct the value")
    return parameter


def write_vehicle(vehicle: Vehicle) -> str:
    """Return the text of a vehicle file from which the vehicle's numbers, ranges and provenances can be read again.

    Example:
        >>> from pathlib import Path
        >>> from surctl.marine.vehicle import load_vehicle, write_vehicle
        >>> heavier = load_vehicle("sur400").with_values({"m11": 60.0})
        >>> _ = Path("heavier.toml").write_text(write_vehicle(heavier))
        >>> load_vehicle("heavier.toml")["m11"]
        60.0
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # takes long

    def text(value: object) -> str:
        return value if isinstance(value, str) else json.dumps(value)

    environment = Environment(
        loader=PackageLoader("surctl.marine.vehicle", ""), undefined=StrictUndefined, finalize=text, autoescape=False,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["quoted"] = quoted
    tables: dict[str, dict[str, ParameterSpec]] = {}
    for name, spec in SPECS.items():
        if name in vehicle.parameters:
            tables.setdefault(spec.table, {})[name] = spec
    return environment.get_template("vehicle.txt").render(vehicle=vehicle, tables=tables, degrees=degrees)
