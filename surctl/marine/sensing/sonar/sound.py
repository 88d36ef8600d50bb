"""The speed of sound in water, and in air for converters that assume the speed of sound in air."""

from __future__ import annotations

from math import sqrt
from typing import Literal, TypeAlias, get_args

from surctl.errors import InputError, nearest

__all__ = ["Medium", "speed_of_sound"]

Medium: TypeAlias = Literal["water", "air"]

_MARCZAK = (1.402385e3, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9)
_RANGE = {"water": (0.0, 95.0), "air": (-20.0, 50.0)}  # °C; for air a design choice: temperatures of a test site


def speed_of_sound(temperature: float, medium: Medium = "water") -> float:
    """Return the speed of sound [m/s] at a temperature [°C] and atmospheric pressure.

    For pure water: Marczak 1997, "Water as a standard in the measurements of speed of sound in liquids", J. Acoust.
    Soc. Am. 102, 2776 (0 to 95 °C, within 0.02 m/s). For dry, ideal air: 331.3·sqrt(1 + T/273.15) (−20 to 50 °C).

    Raises:
        InputError: if the medium is unknown, or the temperature is outside the range of the formula.

    Example:
        >>> from surctl.marine.sensing import speed_of_sound
        >>> round(speed_of_sound(20.0), 2), round(speed_of_sound(20.0, "air"), 2)
        (1482.38, 343.21)
    """
    if medium not in get_args(Medium):
        raise InputError("is not known", key="medium", value=medium, remedy=nearest(str(medium), get_args(Medium)))
    low, high = _RANGE[medium]
    if not low <= temperature <= high:
        raise InputError(
            f"lies outside the range of the formula for {medium}",
            key="temperature",
            value=temperature,
            remedy=f"give {low:g} to {high:g} °C",
        )
    if medium == "air":
        return 331.3 * sqrt(1.0 + temperature / 273.15)
    speed = 0.0
    for factor in reversed(_MARCZAK):
        speed = speed * temperature + factor
    return speed
