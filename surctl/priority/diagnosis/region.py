"""The region of poses and parameters that a diagnosis covers: bounds, samples, and text for a pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.tasks import Stack
from surctl.tasks.task import is_pose

__all__ = ["Bounds", "Parameter", "Pose", "Region", "build_region", "pose_text"]

Array: TypeAlias = NDArray[np.float64]
Bounds: TypeAlias = tuple[Sequence[float] | Array | float, Sequence[float] | Array | float]
"""Lower and upper bounds of the pose."""
Parameter: TypeAlias = tuple[ca.SX, Sequence[float] | Array | float, Sequence[float] | Array | float]
"""A symbol (k, 1) with its lower and upper bounds: k numbers each (or one for all), in the unit of the symbol."""
Pose: TypeAlias = Mapping[str, float]
"""x, y, z [m] in {E}, psi [rad], and every parameter by its name."""

_AXES = ("x", "y", "z", "psi")


@dataclass(frozen=True, eq=False)
class Region:
    """Lower and upper bounds of the pose and of all parameters of a task stack; build it with `build_region`.

    Attributes:
        symbols: SX (d, 1): the entries of the pose eta, then the entries of every parameter that the stack uses.
        names: names of the d variables, for example "x", "psi", "waypoint_0".
        lower, upper: (d,) bounds of the variables [m, m, m, rad, then the unit of each parameter].
    """

    symbols: ca.SX
    names: tuple[str, ...]
    lower: Array
    upper: Array

    @property
    def free(self) -> NDArray[np.intp]:
        """Return the indices (f,) of the free variables, whose lower and upper bounds differ."""
        return np.flatnonzero(self.upper > self.lower)

    def place(self, unit: Array) -> Array:
        """Return the points (N, d) of the region for coordinates (N, f) of the free variables, scaled to 0 … 1."""
        points = np.tile(self.lower, (len(unit), 1))
        points[:, self.free] += np.clip(unit, 0.0, 1.0) * (self.upper - self.lower)[self.free]
        return np.clip(points, self.lower, self.upper)

    def sample(self, samples: int, seed: int) -> Array:
        """Return scrambled Sobol points (2^k, f) in 0 … 1, with 2^k ≥ `samples`; one point if no variable is free."""
        from scipy.stats import qmc

        if self.free.size == 0:
            return np.zeros((1, 0))
        points = qmc.Sobol(self.free.size, seed=seed).random_base2(math.ceil(math.log2(samples)))
        return np.asarray(points, dtype=float)

    def pose(self, point: Array) -> dict[str, float]:
        """Return a point (d,) as a mapping from the names of the variables to their values."""
        return {name: float(value) for name, value in zip(self.names, point, strict=True)}


def build_region(stack: Stack, region: Bounds, parameters: Sequence[Parameter] = ()) -> Region:
    """Check the bounds of the pose, (4,) each [m, m, m, rad], and of the parameters, and return the region.

    Parameters that the stack does not use are dropped.

    Raises:
        InputError: bounds have a wrong size, are not finite, or have lower > upper; a parameter is not a symbol, occurs
            twice, or has a name already in use; or a symbol of the stack has no bounds (the message names its task).
    """
    if not all(is_pose(task.eta, task.mapping) for task in stack.tasks):
        problem = "has a configuration that is not the pose x, y, z, psi of a vehicle, which a diagnosis is about"
        raise InputError(problem, key="stack", remedy="diagnose single problems with solve")
    lower, upper = _corners(region, 4, key="region", names=_AXES)
    symbols, names, low, high = [stack.eta[i] for i in range(4)], list(_AXES), [lower], [upper]
    used = {s.element_hash() for J, x in stack.levels() for s in _symbols(J, x)}
    for parameter in parameters:
        symbol, bounds = _split(parameter)
        entries = _entries(symbol)
        if any(entry.element_hash() == s.element_hash() for entry in entries for s in symbols):
            raise InputError("has two ranges", key=f"parameters: {symbol}", remedy="give each symbol one range")
        lower, upper = _corners(bounds, len(entries), key="parameters", names=[str(e) for e in entries])
        for entry, least, most in zip(entries, lower, upper, strict=True):
            if entry.element_hash() in used:
                symbols.append(entry)
                names.append(_fresh(str(entry), names))
                low.append(np.array([least]))
                high.append(np.array([most]))
    _check_complete(stack, {s.element_hash() for s in symbols})
    return Region(ca.vertcat(*symbols), tuple(names), np.concatenate(low), np.concatenate(high))


def pose_text(pose: Pose) -> str:
    """Return the pose as text, `x = 0.5 m, y = …, psi = 0.3 rad, waypoint_0 = 1`, with four significant digits."""
    units = {"x": " m", "y": " m", "z": " m", "psi": " rad"}
    return ", ".join(f"{name} = {value:.4g}{units.get(name, '')}" for name, value in pose.items())


def _symbols(*expressions: ca.SX) -> list[ca.SX]:
    symbols: list[ca.SX] = ca.symvar(ca.vertcat(*[ca.vec(e) for e in expressions]))
    return symbols


def _check_complete(stack: Stack, known: set[int]) -> None:
    for name, (J, x) in zip(stack.names, stack.levels(), strict=True):
        for symbol in _symbols(J, x):
            if symbol.element_hash() not in known:
                raise InputError(
                    f"uses {symbol}, which has no range",
                    key=f"task {name}",
                    remedy=f"give parameters=[({symbol}, lower, upper)]",
                )


def _split(parameter: Parameter) -> tuple[ca.SX, Bounds]:
    try:
        symbol, lower, upper = parameter
    except (TypeError, ValueError):
        raise InputError(
            "is not a symbol with a range", key="parameters", value=parameter, remedy="give (symbol, lower, upper)"
        ) from None
    return symbol, (lower, upper)


def _entries(symbol: ca.SX) -> list[ca.SX]:
    if not isinstance(symbol, ca.SX) or symbol.numel() == 0 or not symbol.is_valid_input():
        raise InputError("is not an SX symbol", key="parameters", value=symbol, remedy="give (symbol, lower, upper)")
    return [ca.vec(symbol)[i] for i in range(symbol.numel())]


def _fresh(name: str, names: list[str]) -> str:
    if name in names:
        raise InputError("names two variables", key="parameters", value=name, remedy="rename one of the symbols")
    return name


def _corners(bounds: Bounds, size: int, *, key: str, names: Sequence[str]) -> tuple[Array, Array]:
    # for parameters, a single number applies to all entries
    try:
        lower, upper = (np.array(part, dtype=float).reshape(-1) for part in bounds)
    except (TypeError, ValueError):
        raise InputError("is not a box", key=key, value=bounds, remedy="give (lower, upper), numbers each") from None
    spread = key == "parameters"
    corners = [np.repeat(c, size) if spread and c.size == 1 else c for c in (lower, upper)]
    for side, corner in zip(("lower", "upper"), corners, strict=True):
        if corner.size != size:
            raise InputError(
                f"{side} corner has {corner.size} entries",
                key=f"{key}: {', '.join(names)}",
                remedy=f"give {size}",
            )
    for name, least, most in zip(names, *corners, strict=True):
        if not (math.isfinite(least) and math.isfinite(most)):
            raise InputError("is not finite", key=f"{key}: {name}", value=[least, most], remedy="give finite bounds")
        if least > most:
            raise InputError("bounds cross", key=f"{key}: {name}", value=[least, most], remedy="give lower <= upper")
    return corners[0], corners[1]
