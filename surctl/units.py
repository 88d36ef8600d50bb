"""Numbers of a user: finite, no text or None; quantities such as "5 cm" in SI units; proved numbers, rounded safely."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from functools import cache
from numbers import Real
from typing import TYPE_CHECKING, Any

from surctl.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from pint import UnitRegistry

__all__ = ["as_numbers", "as_range", "converted_by_suffix", "in_unit", "is_number", "number_and_unit", "towards"]

_SUFFIXES = {
    "_m_per_s": "m/s",
    "_rad_per_s": "rad/s",
    "_n_per_s": "N/s",
    "_deg": "deg",
    "_rad": "rad",
    "_m": "m",
    "_s": "s",
    "_n": "N",
}
"""The unit that each ending of a key in a file stands for; longer endings come first."""

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
_MOST = 40  # characters of a unit; a longer text is rejected before it is parsed
_UNIT = re.compile(r"[A-Za-zµΩ°%][\w\s*/^().°%µ-]*|1(?:\s*/\s*[\w\s*/^().-]+)?")


def is_number(value: object) -> bool:
    """Return whether a value is one finite real number, and no bool.

    Example:
        >>> from surctl.units import is_number
        >>> [is_number(value) for value in (3, 2.5, True, "3", float("nan"))]
        [True, True, False, False, False]
    """
    try:
        return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)
    except OverflowError:  # an integer that no double holds
        return False


def as_numbers(value: object, *, key: str, size: int | None = None) -> NDArray[np.float64]:
    """Return a number, or a list or array of numbers, as an array of the same shape; they need not be finite.

    With `size`, they must be this many finite numbers, and the result is a vector (size,).

    Raises:
        InputError: an entry is no real number (a text, None, a CasADi expression), no double holds an integer, rows
            have different lengths, or the numbers are not `size` finite ones; the message names `key`.

    Example:
        >>> from surctl.units import as_numbers
        >>> as_numbers([[1, 2.5]], key="start"), float(as_numbers(3, key="gain"))
        (array([[1. , 2.5]]), 3.0)
        >>> as_numbers("3", key="gain")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: gain = '3': is not a number or an array of numbers; write digits without quotes
    """
    import numpy as np

    if size is not None:
        vector = as_numbers(value, key=key).reshape(-1)
        if vector.size == size and np.isfinite(vector).all():
            return vector
        raise InputError(f"is not {size} finite numbers", key=key, value=value, remedy=f"give {size} numbers")
    if type(value) is np.ndarray and value.dtype == np.float64:  # in each control step
        return value
    with suppress(TypeError, ValueError, OverflowError, RuntimeError):
        array = np.asarray(value)
        # as objects, NumPy also holds fractions, and integers beyond 64 bits
        if array.dtype.kind in "biuf" or (array.dtype.kind == "O" and all(isinstance(v, Real) for v in array.flat)):
            return array.astype(np.float64, copy=False)
    remedy = "write digits without quotes"
    raise InputError("is not a number or an array of numbers", key=key, value=value, remedy=remedy)


def as_range(ends: Any, *, key: str) -> tuple[float, float]:
    """Return lower and upper bound as floats.

    Raises:
        InputError: they are not two finite numbers, or are reversed; the message names `key`.

    Example:
        >>> from surctl.units import as_range
        >>> as_range((0, 2), key="plant.mass")
        (0.0, 2.0)
        >>> as_range((2, 0), key="plant.mass")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: plant.mass = (2, 0): is not a range; give (low, high), two finite numbers with ...
    """
    try:
        pair = tuple(ends)
    except (TypeError, NotImplementedError):  # not iterable; CasADi raises the latter
        pair = ()
    if len(pair) == 2 and all(map(is_number, pair)) and pair[0] <= pair[1]:
        return float(pair[0]), float(pair[1])
    remedy = "give (low, high), two finite numbers with low <= high"
    raise InputError("is not a range", key=key, value=ends, remedy=remedy)


@cache
def _registry() -> UnitRegistry[Any]:
    import pint  # imported here because it takes half a second and only files in other units need it

    return pint.UnitRegistry()


def number_and_unit(text: str) -> tuple[float, str]:
    """Split a text such as "0.54 m" into its number and its unit, here (0.54, "m"); the unit may be empty.

    Raises:
        InputError: the text does not start with a number.

    Example:
        >>> from surctl.units import number_and_unit
        >>> number_and_unit("0.54 m"), number_and_unit("12 kgf"), number_and_unit("3")
        ((0.54, 'm'), (12.0, 'kgf'), (3.0, ''))
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputError("is not a number with a unit", value=text, remedy='write it like "0.54 m"')
    return float(match.group(1)), match.group(2)


def in_unit(value: float, unit: str, target: str) -> float:
    """Return the value converted to the unit `target`; bit for bit the same number if the two units are equal.

    Angles are treated as plain numbers, as in the law's equations: rad/s and 1/s are the same unit. But an angle is no
    share (unit 1).

    Raises:
        InputError: the unit is unknown or has another dimension, or the value is not finite.

    Example:
        >>> from surctl.units import in_unit
        >>> in_unit(54.0, "cm", "m"), round(in_unit(0.5, "kgf", "N"), 4)
        (0.54, 4.9033)
    """
    if unit == target or (target == "1" and not unit.strip()):
        return value
    import pint

    if not math.isfinite(value):
        raise InputError("is not a finite number", value=value, remedy=f"give a number in {target}")
    remedy = f'give it in {target}, for instance "{value:g} {target}"'
    if not unit.strip():
        raise InputError("has no unit", value=value, remedy=remedy)
    if len(unit) > _MOST or not _UNIT.fullmatch(unit):
        raise InputError("is not a unit", value=unit, remedy=remedy)
    try:
        # one factor for a decimal prefix, so that 15 cm is exactly the number 0.15
        quantity = _registry().Quantity(1.0, unit)
        factor, root = float(quantity.to(target).magnitude), str(quantity.to_root_units().units)
    except pint.DimensionalityError:
        raise InputError("wrong unit", value=unit, remedy=remedy) from None
    except Exception:  # the unit parser may raise any exception; each one means that the text is not a unit
        raise InputError("is not a unit", value=unit, remedy=remedy) from None
    if target == "1" and root == "radian":
        raise InputError("is an angle, not a share", value=unit, remedy='give a number such as 0.05, or "5 %"')
    inverse = round(1.0 / factor) if factor else 0
    if factor < 1 and inverse and math.isclose(1.0 / inverse, factor, rel_tol=1e-15):
        return value / inverse
    return value * factor


def _suffix_unit(key: str) -> str | None:
    """Return the unit that the ending of a key stands for (`depth_m` → m), or None if it has no such ending."""
    return next((unit for ending, unit in _SUFFIXES.items() if key.endswith(ending)), None)


def converted_by_suffix(table: Any, *, key: str = "") -> Any:
    """Return a table in which every text like "15 cm" under a key like `depth_m` is a number in the key's unit.

    Raises:
        InputError: such a text is not a number with a unit of the right dimension; the message names the key.

    Example:
        >>> from surctl.units import converted_by_suffix
        >>> converted_by_suffix({"depth_m": "-15 cm", "cruise_m_per_s": "20 cm/s", "name": "pool"})
        {'depth_m': -0.15, 'cruise_m_per_s': 0.2, 'name': 'pool'}
    """
    if isinstance(table, dict):
        return {name: converted_by_suffix(inner, key=f"{key}.{name}" if key else name) for name, inner in table.items()}
    if isinstance(table, list):
        return [converted_by_suffix(inner, key=key) for inner in table]
    unit = _suffix_unit(key.rpartition(".")[2])
    if unit is None or not isinstance(table, str):
        return table
    try:
        value, written = number_and_unit(table)
        return in_unit(value, written, unit)
    except InputError as error:
        raise InputError(error.problem, key=key, value=table, remedy=error.remedy) from None


def towards(value: float, *, up: bool) -> str:
    """Return a number with three digits, rounded up or down: what is proved of a bound holds for the text, too.

    Example:
        >>> from surctl.units import towards
        >>> towards(0.3849, up=False), towards(0.11531, up=True)
        ('0.384', '0.116')
    """
    number = Decimal(repr(float(value)))
    step = Decimal(1).scaleb(number.adjusted() - 2)
    return f"{float(number.quantize(step, ROUND_CEILING if up else ROUND_FLOOR)):.3g}"
