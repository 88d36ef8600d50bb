"""Units as files write them: "0.54 m", "12 kgf", "5 cm"; everything inside is SI and radians."""

from __future__ import annotations

import math
import re
from functools import cache
from typing import TYPE_CHECKING, Any

from surctl.errors import InputError

if TYPE_CHECKING:
    from pint import UnitRegistry

__all__ = ["SUFFIXES", "converted_by_suffix", "in_unit", "number_and_unit", "suffix_unit"]

SUFFIXES = {
    "_m_per_s": "m/s",
    "_rad_per_s": "rad/s",
    "_n_per_s": "N/s",
    "_deg": "deg",
    "_rad": "rad",
    "_m": "m",
    "_s": "s",
    "_n": "N",
}
"""Ending of a file's key and the unit that it stands for, the longest ending first."""

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_MOST = 40  # characters of a unit: what is longer is no unit, and not worth a parser's time
_UNIT = re.compile(r"[A-Za-zµΩ°%][\w\s*/^().°%µ-]*|1(?:\s*/\s*[\w\s*/^().-]+)?")


@cache
def _registry() -> UnitRegistry[Any]:
    import pint  # half a second, and only files in other units need it

    return pint.UnitRegistry()


def number_and_unit(text: str) -> tuple[float, str]:
    """ "0.54 m" → (0.54, "m"); the unit may be empty.

    Raises:
        InputError: no number at the start.

    Example:
        >>> from surctl.units import number_and_unit
        >>> number_and_unit("0.54 m"), number_and_unit("12 kgf"), number_and_unit("3")
        ((0.54, 'm'), (12.0, 'kgf'), (3.0, ''))
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputError("is no number with its unit", value=text, remedy='write it like "0.54 m"')
    return float(match.group(1)), match.group(2)


def in_unit(value: float, unit: str, target: str) -> float:
    """The value in the unit `wanted`; the same number, bit for bit, where the units are the same.

    Angles count as plain numbers (rad/s and 1/s are the same unit), as in the law's equations.

    Raises:
        InputError: an unknown unit, or one of another dimension.

    Example:
        >>> from surctl.units import in_unit
        >>> in_unit(54.0, "cm", "m"), round(in_unit(0.5, "kgf", "N"), 4)
        (0.54, 4.9033)
    """
    if unit == target or (target == "1" and not unit.strip()):
        return value
    import pint

    remedy = f"give it in {target}"
    if not unit.strip():
        raise InputError("has no unit", value=value, remedy=remedy)
    if len(unit) > _MOST or not _UNIT.fullmatch(unit):
        raise InputError("is no unit", value=unit, remedy=remedy)
    try:
        # decimal prefixes as one factor, so that 15 cm is 0.15 m to the last bit
        factor = float(_registry().Quantity(1.0, unit).to(target).magnitude)
    except pint.DimensionalityError:
        raise InputError("wrong unit", value=unit, remedy=remedy) from None
    except Exception:  # the parser of another library: whatever it says, the text is no unit
        raise InputError("is no unit", value=unit, remedy=remedy) from None
    inverse = round(1.0 / factor) if factor else 0
    if factor < 1 and inverse and math.isclose(1.0 / inverse, factor, rel_tol=1e-15):
        return value / inverse
    return value * factor


def suffix_unit(key: str) -> str | None:
    """The unit that a key's ending stands for: `depth_m` → m; None without such an ending.

    Example:
        >>> from surctl.units import suffix_unit
        >>> suffix_unit("depth_m"), suffix_unit("cruise_m_per_s"), suffix_unit("name")
        ('m', 'm/s', None)
    """
    return next((unit for ending, unit in SUFFIXES.items() if key.endswith(ending)), None)


def converted_by_suffix(table: Any, *, key: str = "") -> Any:
    """A file's table with every text like "15 cm" under a key like `depth_m` as a number in the key's unit.

    Raises:
        InputError: such a text that is no number with a unit of the right dimension; it names the key.

    Example:
        >>> from surctl.units import told_by_suffix
        >>> told_by_suffix({"depth_m": "-15 cm", "cruise_m_per_s": "20 cm/s", "name": "pool"})
        {'depth_m': -0.15, 'cruise_m_per_s': 0.2, 'name': 'pool'}
    """
    if isinstance(table, dict):
        return {name: converted_by_suffix(inner, key=f"{key}.{name}" if key else name) for name, inner in table.items()}
    if isinstance(table, list):
        return [converted_by_suffix(inner, key=key) for inner in table]
    unit = suffix_unit(key.rpartition(".")[2])
    if unit is None or not isinstance(table, str):
        return table
    try:
        value, written = number_and_unit(table)
        return in_unit(value, written, unit)
    except InputError as error:
        raise InputError(error.problem, key=key, value=table, remedy=error.remedy) from None
