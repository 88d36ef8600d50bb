"""Tables `[sonar]`, `[base_station]` and `[own_state]` of a scenario file, with refusals; when each sonar fires."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field, replace
from math import degrees, gcd, inf, nextafter, pi
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from surctl.errors import InputError, check_known, mistakes_in
from surctl.files import Strict
from surctl.marine.sensing import (
    REFLECTORS,
    BaseStation,
    Delivery,
    Equipment,
    Fault,
    FaultChances,
    OwnState,
    Reflector,
    SonarArray,
)
from surctl.marine.sensing.sonar.faults import check_faults
from surctl.marine.simulation.reflectors import ECHOES

T = TypeVar("T")

FIRING = 0.025
"""Time [s] between two instants at which sonars may fire; the plant is integrated from one to the next."""

_PERIOD = 0.05  # [s] control period; messages of the base station arrive at its multiples

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Degrees = Annotated[float, Field(gt=0, lt=180)]


class SonarTable(Strict):
    """The table `[sonar]` of a scenario file; missing keys have the defaults of `SonarArray`."""

    azimuths_deg: tuple[float, ...] | None = None
    mounts_m: tuple[tuple[float, float], ...] | None = None
    order: tuple[int, ...] | None = None
    beam_deg: Degrees | None = None
    pitch_deg: float | None = None
    incidence_limit_deg: Degrees | None = None
    echoes: Literal["ideal", "webots", "specular", "diffuse"] | None = None
    floor_m: NotNegative | None = None
    search_limit_s: Positive | None = None
    minimum_m: Positive | None = None
    blind_time_s: Positive | None = None
    maximum_m: Positive | None = None
    firing_period_s: Positive | None = None
    cycle_limit_s: Positive | None = None
    bits: int | None = None
    step_m: Positive | None = None
    samples: int | None = None
    noise_sd_m: float | None = None
    bias_m: float | None = None
    scale: Positive | None = None
    temperature_c: float | None = None
    calibrated_for_m_per_s: Positive | None = None
    faults: tuple[Fault, ...] = ()
    chances: FaultChances = FaultChances()


class _DeliveryTable(Strict):
    period_s: Positive | None = None
    latency_s: NotNegative | None = None
    loss: NotNegative | None = None
    gaps_s: tuple[tuple[float, float], ...] = ()


class StationTable(_DeliveryTable):
    """The table `[base_station]` of a scenario file: messages of the base station about moving obstacles."""

    position_sd_m: NotNegative = 0.01
    velocity_sd_m_per_s: NotNegative = 0.01


class OwnStateTable(_DeliveryTable):
    """The table `[own_state]` of a scenario file: measurements of camera and IMU, or the true state."""

    truth: bool = False
    position_sd_m: NotNegative = 0.01
    yaw_sd_rad: NotNegative = 0.01
    rate_sd_rad_per_s: NotNegative = 0.005


@dataclass(frozen=True)
class Sensors:
    """The sensors of a scenario.

    Attributes:
        equipment: the actual sensors, which are also the law's sensor model; the method `on` adds the vehicle's hull.
        faults: sonar faults that are scheduled in the scenario.
        chances: probabilities of random sonar faults at each firing.
        echoes: name of an echo model of `ECHOES` other than `ideal` and `webots`, which the `incidence_limit` of the
            array describes; empty: surfaces answer as this limit says.
        source: file of the scenario, for messages.
    """

    equipment: Equipment = field(default_factory=Equipment)
    faults: tuple[Fault, ...] = ()
    chances: FaultChances = field(default_factory=FaultChances)
    echoes: str = ""
    source: str = field(default="", repr=False, compare=False)

    def on(self, hull_radius: float) -> Equipment:
        """Return the equipment on a hull of the given radius [m].

        The radius matters only if the mounting points of the sonars are stated.

        Raises:
            InputError: a mounting point is inside the hull, or the hull hides the sonar's beam; the error names
                file, table and key.
        """
        if self.equipment.array.mounts is None:
            return self.equipment
        return replace(self.equipment, array=self.array_on(hull_radius))

    def array_on(self, hull_radius: float) -> SonarArray:
        """Return the sonars on a hull of the given radius [m]; InputError as for `on`."""
        with mistakes_in(self.source or None):
            return _in_table("sonar", lambda: replace(self.equipment.array, hull_radius=hull_radius))

    def hearing(self, echoes: str) -> Sensors:
        """Return the sensors with an echo model by name (a key of `ECHOES`).

        Raises:
            InputError: the name is unknown.
        """
        check_known(echoes, ECHOES, key="echoes")
        simple, limit = _simple(echoes)
        array = replace(self.equipment.array, incidence_limit=limit)
        return replace(self, equipment=replace(self.equipment, array=array), echoes="" if simple else echoes)

    def check_floor(self, deepest: float) -> None:
        """Raise InputError if the floor that the law assumes is above z = `deepest` [m]."""
        floor = self.equipment.floor
        if floor is not None and floor < -deepest:
            problem = f"is above the robot, which goes down to z = {deepest:g} m"
            remedy = f"give the depth of the floor below the water surface, at least {-deepest:g} m"
            raise InputError(problem, key="sonar.floor_m", value=floor, remedy=remedy)

    @property
    def echo_model(self) -> str:
        """Name of the echo model, or the largest angle of incidence at which surfaces answer."""
        limit = self.equipment.array.incidence_limit
        if self.echoes or limit is None:
            return self.echoes or "ideal"
        return next((name for name in ECHOES if _simple(name) == (True, limit)), f"within {degrees(limit):.4g} deg")


_SONAR = {
    "mounts_m": "mounts",
    "order": "order",
    "minimum_m": "minimum",
    "blind_time_s": "blind_time",
    "maximum_m": "maximum",
    "firing_period_s": "firing_period",
    "cycle_limit_s": "cycle_limit",
    "bits": "bits",
    "step_m": "step",
    "samples": "samples",
    "noise_sd_m": "noise_sd",
    "bias_m": "bias",
    "temperature_c": "temperature",
    "calibrated_for_m_per_s": "calibrated_for",
}
_ANGLES = {
    "azimuths_deg": "azimuths",
    "beam_deg": "beam_angle",
    "pitch_deg": "pitch",
    "incidence_limit_deg": "incidence_limit",
}
_DELIVERY = {"period_s": "period", "latency_s": "latency", "loss": "loss", "gaps_s": "gaps"}
_STATION = {"position_sd_m": "position_sd", "velocity_sd_m_per_s": "velocity_sd"}
_OWN = {"position_sd_m": "position_sd", "yaw_sd_rad": "yaw_sd", "rate_sd_rad_per_s": "rate_sd"}
"""Field of each key of a table of a scenario file; `_ANGLES` are keys in degrees, of fields in radians."""

_KEYS = {name: key for key, name in (_SONAR | _ANGLES | _DELIVERY).items()}
_BESIDE = 4  # floating-point neighbours on each side that may convert to the same angle


def _read(table: Strict, keys: Mapping[str, str]) -> dict[str, Any]:
    return {name: getattr(table, key) for key, name in keys.items() if getattr(table, key) is not None}


def _written(sensor: object, keys: Mapping[str, str]) -> dict[str, Any]:
    return {key: getattr(sensor, name) for key, name in keys.items() if getattr(sensor, name) is not None}


def sensor_tables(sensors: Sensors) -> dict[str, dict[str, Any]]:
    """Return the tables of a scenario file that describe the sensors; see `sensors_from_tables`."""
    equipment, array, station = sensors.equipment, sensors.equipment.array, sensors.equipment.station
    sonar = _written(array, _SONAR) | {key: _in_degrees(a) for key, a in _written(array, _ANGLES).items()}
    sonar |= {"echoes": sensors.echoes} if sensors.echoes else {}
    sonar["floor_m"] = 0.0 if equipment.floor is None else equipment.floor
    sonar |= {} if equipment.search_limit is None else {"search_limit_s": equipment.search_limit}
    sonar["faults"] = [fault.model_dump(exclude_none=True) for fault in sensors.faults]
    sonar["chances"] = sensors.chances.model_dump()
    messages, own = _written(station.messages, _DELIVERY), equipment.own
    measured = {"truth": True} if own is None else _written(own, _OWN) | _written(own.fixes, _DELIVERY)
    return {"sonar": sonar, "base_station": _written(station, _STATION) | messages, "own_state": measured}


def _in_degrees(angle: Any) -> Any:
    """Return an angle [rad], or each of several, in degrees.

    Whoever reads the file and converts the degrees to radians gets exactly this angle, or the nearest possible angle.
    """
    if isinstance(angle, tuple):
        return [_in_degrees(one) for one in angle]
    exact = degrees(angle)
    near, low, high = [round(exact, 9), exact], exact, exact
    for _ in range(_BESIDE):
        low, high = nextafter(low, -inf), nextafter(high, inf)
        near += [low, high]
    return min(near, key=lambda candidate: abs(candidate * pi / 180.0 - angle))


def sensors_from_tables(sonar: SonarTable, station: StationTable, own: OwnStateTable, *, depth: float) -> Sensors:
    """Return the sensors that the tables of a scenario file describe; `depth` is that of the site [m]."""
    array = _in_table("sonar", lambda: _array(sonar), stated=sonar.model_fields_set)
    messages, fixes = _delivery("base_station", station), _delivery("own_state", own)
    equipment = Equipment(
        array=array,
        station=BaseStation(**_read(station, _STATION), messages=messages),
        own=None if own.truth else OwnState(**_read(own, _OWN), fixes=fixes),
        floor=(depth if sonar.floor_m is None else sonar.floor_m) or None,
        search_limit=sonar.search_limit_s,
    )
    echoes = sonar.echoes if sonar.echoes is not None and not _simple(sonar.echoes)[0] else ""
    return Sensors(equipment, sonar.faults, sonar.chances, echoes)


def _delivery(table: str, stated: _DeliveryTable) -> Delivery:
    def checked() -> Delivery:
        delivery = Delivery(**_read(stated, _DELIVERY))
        for steps in (delivery.late, delivery.every):  # both refuse what is no multiple of the period
            steps(_PERIOD)
        return delivery

    return _in_table(table, checked)


def _simple(echoes: str) -> tuple[bool, float | None]:
    """Return whether an incidence limit describes an echo model, and this limit [rad], None for any incidence."""
    reflector, model = REFLECTORS[ECHOES[echoes].upright], ECHOES[echoes]
    simple = model.level == "silent" and reflector == Reflector(reflector.incidence_limit)
    return simple, reflector.incidence_limit if simple else None


def _in_table(table: str, make: Callable[[], T], *, stated: Set[str] = frozenset()) -> T:
    """Return what `make` returns; its errors name the keys of the file's table, of which `stated` are in the file."""
    try:
        return make()
    except InputError as error:
        problem, value, remedy = error.problem, error.value, error.remedy
        name, *others = (error.key or "").removeprefix("array.").removeprefix("delivery.").split(", ")
        if others:  # an error may name several fields: take the first one in the file, and state the others
            values = dict(zip((name, *others), value, strict=True))  # type: ignore[call-overload]
            name = next((one for one in values if _KEYS[one] in stated), name)
            value = values.pop(name)
            problem += "".join(f", and {_KEYS[one]} is {other:g}" for one, other in values.items())
        remedy = None if remedy is None else remedy.replace("or None ", "or leave the key out ")  # TOML has no None
        if name in _ANGLES.values():  # the file has degrees, the sonars have radians
            problem, remedy = (
                problem.replace("0 and pi", "0 and 180").replace("180/2", "90"),
                (remedy or "").replace("radians", "degrees"),
            )
            value = round(degrees(value), 6) if isinstance(value, float) else value
        raise InputError(problem, key=f"{table}.{_KEYS.get(name, name)}", value=value, remedy=remedy) from None


def _array(table: SonarTable) -> SonarArray:
    values = _read(table, _SONAR)
    for name, value in _read(table, _ANGLES).items():
        values[name] = tuple(a * pi / 180.0 for a in value) if isinstance(value, tuple) else value * pi / 180.0
    if table.echoes is not None:
        if table.incidence_limit_deg is not None:
            raise InputError("sets the same quantity as incidence_limit_deg", key="echoes", remedy="remove one")
        values["incidence_limit"] = _simple(table.echoes)[1]
    if table.azimuths_deg is not None:
        values.setdefault("order", tuple(range(len(table.azimuths_deg))))
    if table.mounts_m is not None:
        values["hull_radius"] = 0.0  # the vehicle defines the hull radius, see `Sensors.on`
    array = SonarArray(**values)
    if table.scale is not None:
        if table.calibrated_for_m_per_s is not None:
            raise InputError("sets the same quantity as calibrated_for_m_per_s", key="scale", remedy="remove one")
        array = replace(array, calibrated_for=table.scale * array.speed)
    check_faults(array, table.faults, table.chances)
    firing_plan(array)
    return array


@dataclass(frozen=True)
class FiringPlan:
    """The firing plan: which sonars fire at each instant of the closed loop.

    Attributes:
        period: number of firing instants (`FIRING` s apart) after which the plan repeats.
        sensors: (period, k) indices of the k sonars that fire at each instant; None if no sonar fires.
    """

    period: int
    sensors: tuple[tuple[int | None, ...], ...]

    def at(self, instant: int) -> tuple[int, ...]:
        """Return the indices of the sonars that fire at a given instant, in their firing order."""
        return tuple(i for i in self.sensors[instant % self.period] if i is not None)


def firing_plan(array: SonarArray) -> FiringPlan:
    """Return the firing plan: several sonars fire at every instant, or one sonar fires every few instants."""
    ratio = array.firing_period / FIRING
    several, every = round(1 / ratio), round(ratio)
    if abs(ratio - every) < 1e-9 and every >= 1:
        period = array.size * every
        return FiringPlan(period, tuple((array.order[k // every] if k % every == 0 else None,) for k in range(period)))
    if several >= 1 and abs(1 / ratio - several) < 1e-9:
        period = array.size // gcd(array.size, several)
        rows = [[array.order[(k * several + j) % array.size] for j in range(several)] for k in range(period)]
        return FiringPlan(period, tuple(tuple(row) for row in rows))
    problem = f"is neither a multiple nor an integer fraction of the loop's {FIRING:g} s"
    raise InputError(problem, key="firing_period", value=array.firing_period, remedy="use 0.025, 0.0125 or 0.05")
