"""Closed-loop poles over any one knob: a root locus in whatever a sweep can change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.vehicle import Vehicle
from surctl.verification.linear_table import LINEAR_PARAMETERS, cascades_by_order, read_points

__all__ = ["Locus", "sweep_locus"]

_HALVED = 8  # times that a step between two values is halved at most


@dataclass(frozen=True, eq=False)
class Locus:
    """Poles over the values of a knob.

    Attributes:
        parameter: its name.
        values: (n,) ascending or descending, in the knob's unit.
        poles: (n, k) complex [rad/s]; a column is one pole, followed from value to value.
    """

    parameter: str
    values: NDArray[np.float64]
    poles: NDArray[np.complex128]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """(n,): whether every pole lies in the open left half-plane."""
        stable: NDArray[np.bool_] = np.all(self.poles.real < -1e-9, axis=1)
        return stable


def sweep_locus(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    parameter: str,
    values: ArrayLike,
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    smooth: float = np.inf,
    about: Mapping[str, float] = MappingProxyType({}),
) -> Locus:
    """Poles of the cascade over one knob.

    From one value to the next the poles are paired so that the sum of the distances they go is least.

    Args:
        vehicle: the plant.
        gains: all gains, as `loop_margins`.
        parameter: one of `LINEAR_PARAMETERS`.
        values: (n,), n ≥ 2, in order.
        cruise: U [m/s], unless it is the knob.
        dt: control period [s].
        model: what the controller believes; default the vehicle itself.
        smooth: share of its modulus that a pole may go from one value to the next. Where one goes further, as where
            two part, values are put in between, down to 2⁻⁸ of a step.
        about: other knobs that stay at a value; those that move no pole are passed over.

    Raises:
        InputError: a knob without influence on any pole, values out of order or bounds, a cruise that the vehicle
            cannot hold, or values that change the number of poles (0 and others of k_i or thrust_lag).

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> locus = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> locus.poles.shape, locus.poles.real.max(axis=1).round(2).tolist()
        ((5, 24), [-0.22, -0.22, -0.22, -0.22, 0.12])
    """
    if parameter not in LINEAR_PARAMETERS:
        raise InputError("moves no pole", key="locus", value=parameter, remedy=nearest(parameter, LINEAR_PARAMETERS))
    swept = np.atleast_1d(np.asarray(values, dtype=float))
    if swept.ndim != 1 or len(swept) < 2 or not (np.all(np.diff(swept) > 0) or np.all(np.diff(swept) < 0)):
        raise InputError("needs at least two values in order", key=parameter, remedy="write a range, in order")

    def followed(values: NDArray[np.float64]) -> NDArray[np.complex128]:
        points = read_points(vehicle, {**about, parameter: values}, base=gains, cruise=cruise, dt=dt, model=model)
        if not points.feasible.all():
            at = float(values[np.argmin(points.feasible)])
            raise InputError("needs more thrust than the vehicle has", key=parameter, value=at, remedy="cruise slower")
        groups = list(cascades_by_order(points))
        if len(groups) > 1:
            raise InputError("changes the number of poles at 0", key=parameter, remedy="begin above 0")
        return _paired(points.cascade(groups[0]).poles)

    poles = followed(swept)
    for _ in range(_HALVED):
        sizes = np.abs(poles)
        far = np.abs(np.diff(poles, axis=0)) > smooth * np.maximum(sizes[1:], sizes[:-1])
        rough = np.flatnonzero(far.any(axis=1))
        if len(rough) == 0:
            break
        swept = np.insert(swept, rough + 1, (swept[rough] + swept[rough + 1]) / 2)
        poles = followed(swept)
    return Locus(parameter, swept, poles)


def _paired(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Every row in the order of the one before it."""
    from scipy.optimize import linear_sum_assignment

    for before, after in pairwise(poles):
        _, order = linear_sum_assignment(np.abs(before[:, None] - after[None]))
        after[:] = after[order]
    return poles
