"""The sonars of a scenario: the array, what goes wrong with it, and when which sensor fires in the closed loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import gcd, pi
from typing import Annotated

from pydantic import Field

from surctl.errors import InputError
from surctl.files import Strict
from surctl.sensing import Fault, FaultChances, SonarArray, check_faults

__all__ = ["FIRING", "FiringPlan", "SonarTable", "Sonars", "firing_plan", "sonars_from_table"]

FIRING = 0.025
"""[s] between two instants at which sensors may fire; the plant's steps are split there."""

Positive = Annotated[float, Field(gt=0)]
Degrees = Annotated[float, Field(gt=0, lt=180)]


class SonarTable(Strict):
    """`[sonar]` of a scenario file; what is not named is as `SonarArray` has it."""

    azimuths_deg: tuple[float, ...] | None = None
    mounts_m: tuple[tuple[float, float], ...] | None = None
    order: tuple[int, ...] | None = None
    beam_deg: Degrees | None = None
    incidence_limit_deg: Degrees | None = None
    minimum_m: Positive | None = None
    blind_time_s: Positive | None = None
    maximum_m: Positive | None = None
    firing_period_s: Positive | None = None
    bits: int | None = None
    samples: int | None = None
    noise_sd_m: float | None = None
    bias_m: float | None = None
    scale: Positive | None = None
    temperature_c: float | None = None
    calibrated_for_m_per_s: Positive | None = None
    faults: tuple[Fault, ...] = ()
    chances: FaultChances = FaultChances()


@dataclass(frozen=True)
class Sonars:
    """The sonars of a scenario.

    Attributes:
        array: as they are; the hull is that of the vehicle flown, see `on`.
        faults: told beforehand.
        chances: per firing.
    """

    array: SonarArray = SonarArray()
    faults: tuple[Fault, ...] = ()
    chances: FaultChances = FaultChances()

    def on(self, hull_radius: float) -> SonarArray:
        """The array on a hull [m]."""
        return replace(self.array, hull_radius=hull_radius)

    @property
    def may_fail(self) -> bool:
        """Whether anything ever goes wrong."""
        return bool(self.faults) or any(self.chances.numbers)


_NAMES = {
    "mounts_m": "mounts",
    "order": "order",
    "minimum_m": "minimum",
    "blind_time_s": "blind_time",
    "maximum_m": "maximum",
    "firing_period_s": "firing_period",
    "bits": "bits",
    "samples": "samples",
    "noise_sd_m": "noise_sd",
    "bias_m": "bias",
    "temperature_c": "temperature",
    "calibrated_for_m_per_s": "calibrated_for",
}


def sonars_from_table(table: SonarTable, *, hull_radius: float = 0.27) -> Sonars:
    """The sonars of a scenario's table.

    Args:
        table: as it stands in the file.
        hull_radius: [m] that mounts are checked against.

    Raises:
        InputError: an array that cannot be, or cannot have these faults, or does not fit the closed loop's steps.
    """
    given = {name: getattr(table, key) for key, name in _NAMES.items() if getattr(table, key) is not None}
    for key, name in (("beam_deg", "beam_angle"), ("incidence_limit_deg", "incidence_limit")):
        value = getattr(table, key)
        if value is not None:
            given[name] = value * pi / 180.0
    if table.azimuths_deg is not None:
        given["azimuths"] = tuple(a * pi / 180.0 for a in table.azimuths_deg)
        given.setdefault("order", tuple(range(len(table.azimuths_deg))))
    array = SonarArray(hull_radius=hull_radius, **given)
    if table.scale is not None:
        if table.calibrated_for_m_per_s is not None:
            raise InputError("says the same as calibrated_for_m_per_s", key="scale", remedy="give one of them")
        array = replace(array, calibrated_for=table.scale * array.speed)
    check_faults(array, table.faults, table.chances)
    firing_plan(array)
    return Sonars(array, table.faults, table.chances)


@dataclass(frozen=True)
class FiringPlan:
    """Who fires when.

    Attributes:
        period: instants of `FIRING` after which it repeats.
        sensors: (period, k) who fires at an instant; None for nobody.
    """

    period: int
    sensors: tuple[tuple[int | None, ...], ...]

    def at(self, instant: int) -> tuple[int, ...]:
        """The sensors that fire at an instant, in their order."""
        return tuple(i for i in self.sensors[instant % self.period] if i is not None)


def firing_plan(array: SonarArray) -> FiringPlan:
    """Lay the array's firings on the closed loop's instants: several fire at one, or one every few.

    Raises:
        InputError: a period of the firings that is no such part or multiple.
    """
    ratio = array.firing_period / FIRING
    several, every = round(1 / ratio), round(ratio)
    if abs(ratio - every) < 1e-9 and every >= 1:
        period = array.size * every
        return FiringPlan(
            period, tuple((array.order[k // every] if k % every == 0 else None,) for k in range(period))
        )
    if several >= 1 and abs(1 / ratio - several) < 1e-9:
        period = array.size // gcd(array.size, several)
        rows = [[array.order[(k * several + j) % array.size] for j in range(several)] for k in range(period)]
        return FiringPlan(period, tuple(tuple(row) for row in rows))
    raise InputError(
        f"is no whole part or multiple of the loop's {FIRING:g} s",
        key="sonar.firing_period_s",
        value=array.firing_period,
        remedy="use 0.025, 0.0125 or 0.05",
    )
