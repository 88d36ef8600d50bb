"""Arguments and results of a user's functions by port names, and mistakes in them, such as `math.sin`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from surctl.errors import InputError, nearest
from surctl.ir import Layout, Port
from surctl.ir.c99 import identifier
from surctl.own_code import remedy_of

Parts: TypeAlias = Mapping[str, ca.SX]
EMPTY = Layout(())
_FLOAT = "__float__"


def checked_layout(layout: object, *, key: str) -> Layout:
    """Return the layout after a check that each port (named part) has a C identifier, a positive size and a unit."""
    if isinstance(layout, Port):
        raise InputError("is one port", key=key, remedy="write Layout((port,))")
    if not isinstance(layout, Layout):
        raise InputError(f"is a {type(layout).__name__}", key=key, remedy="give a surctl.ir.Layout of ports")
    for port in layout:
        identifier(port.name)
        if not port.unit.strip():
            raise InputError("has no unit", key=f"{key}.{port.name}", remedy='name it in SI, "1" if it has none')
        if port.size < 1:
            raise InputError("has no entries", key=f"{key}.{port.name}", remedy="leave the port out")
    return layout


def called(function: Callable[..., Any], *arguments: object, key: str) -> Any:
    """Return the result of a user's function for symbolic arguments."""
    if not callable(function):
        raise InputError(f"is of type {type(function).__name__}", key=key, remedy="give a function")
    try:
        return symbolic(function, *arguments)
    except InputError as error:
        raise InputError(error.problem, key=f"{key}: {error.key}", value=error.value, remedy=error.remedy) from error
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        problem = f"fails on CasADi symbols ({type(error).__name__}: {text})"
        raise InputError(problem, key=key, remedy=remedy_of(error)) from error


def symbolic(function: Callable[..., Any], *arguments: object) -> Any:
    """Return the result of a function; a call of float() on a symbolic expression raises TypeError.

    `math.sin` and other functions for numbers call float(), which is NaN for an expression without this check.
    """
    number = ca.SX.__float__

    def checked(value: ca.SX) -> float:
        if not value.is_constant():
            raise TypeError("a CasADi expression has no number")
        return float(number(value))

    setattr(ca.SX, _FLOAT, checked)
    try:
        return function(*arguments)
    finally:
        setattr(ca.SX, _FLOAT, number)


def joined(layout: Layout, returned: object, *, key: str) -> ca.SX:
    """Return the flat vector (n, 1) of a layout from named expressions, or from one flat vector."""
    if isinstance(returned, Mapping):
        unknown = [name for name in returned if name not in layout]
        if unknown:
            raise InputError(
                "is returned, but is not the name of a port", key=f"{key}.{unknown[0]}",
                remedy=nearest(str(unknown[0]), [port.name for port in layout]),
            )  # fmt: skip
        missing = [port.name for port in layout if port.name not in returned]
        if missing:
            raise InputError("is not returned", key=f"{key}.{missing[0]}", remedy="return every port of the layout")
        parts = {name: expression(value, key=f"{key}.{name}") for name, value in returned.items()}
        try:
            return layout.join(parts)
        except InputError as error:
            raise InputError(error.problem, key=f"{key}.{error.key}", remedy="return the shape of the port") from None
    flat = expression(returned, key=key)
    if flat.numel() != layout.size:
        names = ", ".join(port.name for port in layout)
        raise InputError(
            f"returns {flat.numel()} numbers, expected {layout.size}", key=key, remedy=f"return a dict of {names}"
        )
    return ca.reshape(flat, -1, 1)


def entry_labels(layout: Layout, prefix: str = "") -> list[str]:
    """Return a label for each entry of a vector: the name of its part (port), with [i] if the part has several entries.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import entry_labels
        >>> entry_labels(Layout((Port("speed", (1,), "m/s", ""), Port("force", (2,), "N", ""))))
        ['speed', 'force[0]', 'force[1]']
    """
    return [f"{prefix}{p.name}{f'[{k}]' if p.size > 1 else ''}" for p in layout for k in range(p.size)]


def entry_units(layout: Layout) -> list[str]:
    """Return the unit of each entry of a vector.

    The unit of a part (port) is one unit, or a list with one unit for each entry, such as "m, m, rad".

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import entry_units
        >>> entry_units(Layout((Port("pose", (3,), "m, m, rad", ""), Port("force", (2,), "N", ""))))
        ['m', 'm', 'rad', 'N', 'N']
    """
    units: list[str] = []
    for port in layout:
        each = [unit.strip() for unit in port.unit.split(",")]
        units += each if len(each) == port.size else [port.unit] * port.size
    return units


def not_finite(parts: Iterable[tuple[str, Layout, ArrayLike]]) -> str:
    """Return kind and label of the first entry that is not finite, such as "command force[1]"; "" if there is none.

    Args:
        parts: kind, layout and values (n,) of vectors.
    """
    for kind, layout, values in parts:
        lost = np.flatnonzero(~np.isfinite(values))
        if lost.size:
            return f"{kind} {entry_labels(layout)[lost[0]]}"
    return ""


def expression(value: Any, *, key: str) -> ca.SX:
    """Return a value of a user's function as a dense SX; a list is a column of its items."""
    try:
        return ca.densify(ca.SX(value))
    except (NotImplementedError, RuntimeError, TypeError):
        if isinstance(value, list | tuple):
            return ca.vertcat(*(expression(item, key=key) for item in value))
        raise InputError(
            f"is of type {type(value).__name__}", key=key, remedy="return CasADi SX expressions or numbers"
        ) from None
