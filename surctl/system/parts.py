"""Arguments and results of a user's functions by port names, mistakes in them (`math.sin`), undefined operations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from surctl.errors import InputError, nearest
from surctl.ir import Block, Layout, Port, Program, lower, replay
from surctl.ir.c99 import identifier
from surctl.own_code import remedy_of

Parts: TypeAlias = Mapping[str, ca.SX]
EMPTY = Layout(())
_FLOAT = "__float__"
_UNDEFINED_WITHIN = 1e-12  # of an operand from the point at which an operation has no derivative
_LARGEST = 1e294  # a run ends as "not finite" if the sum of its numbers is above 1e300
_DIVERGED = 1e100  # an operand above it is of a loop that diverges, and no mistake of the operation


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

    A number above `_LARGEST` counts as infinite.

    Args:
        parts: kind, layout and values (n,) of vectors.
    """
    for kind, layout, values in parts:
        lost = np.flatnonzero(~(np.abs(values) <= _LARGEST))  # NaN compares as false
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


# The operation from which a result of a function has no finite value or derivative


def undefined_operation(
    of: str, function: ca.Function | Block, arguments: Sequence[ArrayLike], known: Mapping[int, Layout], *,
    slope: bool = False,
) -> str:  # fmt: skip
    """Return the end of a message: ", because of 2/0 of the plant (mass = 0)"; empty if no such operation is found.

    Args:
        of: what the function describes.
        arguments: its arguments, flat.
        known: layouts of the arguments that a user sets, by number; they are named if nothing else decides.
        slope: find the first operation without a finite derivative instead.
    """
    try:
        program = lower(function) if isinstance(function, ca.Function) else function
    except InputError:  # an operation that the instruction list does not support
        return ""
    if not isinstance(program, Program):  # it contains loops
        return ""
    steps, results = program.instructions, [k for refs in program.output_refs for k in refs]
    operands = [() if step.op in ("const", "input") else step.args for step in steps]
    every = Program(program.name, program.inputs, (("all", len(steps)),), steps, (tuple(range(len(steps))),))
    values = replay(every, *(np.array(one, dtype=float).reshape(-1) for one in arguments))[0]
    if slope:
        at = next((k for k, own in enumerate(operands) if _singular(steps[k].op, values[list(own)].tolist())), 0)
    else:  # back from a result to the operation whose operands are finite
        at = next((k for k in results if not np.isfinite(values[k])), 0)
        while lost := [k for k in operands[at] if not np.isfinite(values[k])]:
            at = lost[0]
    own = values[list(operands[at])].tolist()
    if not own or max(map(abs, own)) > _DIVERGED:
        return ""
    decisive, names = {operands[at][-1]}, list[str]()
    for k in range(at, -1, -1):
        if k in decisive and steps[k].op == "input":
            argument, entry = steps[k].args
            labels = entry_labels(known.get(argument, EMPTY))
            names.append(f"{labels[entry]} = {values[k] + 0.0:g}" if labels else "")
        elif k in decisive:
            decisive.update(operands[k])
    shown, op = [f"{round(value, 9) + 0.0:g}" for value in own], steps[at].op
    text = {"inv": "1/{}", "div": "{}/{}"}.get(op, op + "(" + ", ".join(["{}"] * len(shown)) + ")").format(*shown)
    numbers = f" ({', '.join(names)})" if names and all(names) else ""
    return f", because of {text} of the {of}{numbers}"


def _singular(op: str, operands: list[float]) -> bool:
    match op, operands:
        case "sqrt" | "log", [value]:
            return value < _UNDEFINED_WITHIN
        case "acos", [value]:
            return abs(value) > 1 - _UNDEFINED_WITHIN
        case "atan2", [y, x]:
            return abs(y) < _UNDEFINED_WITHIN and abs(x) < _UNDEFINED_WITHIN
        case ("inv", [value]) | ("div", [_, value]):
            return abs(value) < _UNDEFINED_WITHIN
    return False
