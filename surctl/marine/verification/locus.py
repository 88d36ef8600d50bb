"""Closed-loop poles as one parameter varies: a root locus over a gain, a vehicle parameter or the cruise speed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.linear_table import LINEAR_PARAMETERS, cascades_by_order, read_points
from surctl.plotted import Plotted

__all__ = ["Locus", "sweep_locus"]

_HALVED = 8  # largest number of times that the step between two values is halved


@dataclass(frozen=True, eq=False)
class Locus(Plotted):
    """A root locus: the closed-loop poles for every value of one parameter; `plot()` draws them.

    Attributes:
        parameter: name of the parameter.
        values: (n,) values of the parameter, ascending or descending, in its unit.
        poles: (n, k) complex poles [rad/s]; a row holds the poles at one value, a column follows one pole over the
            values.
    """

    PLOT = "surctl.marine.report.margin_plots:plot_locus"

    parameter: str
    values: NDArray[np.float64]
    poles: NDArray[np.complex128]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether every pole lies in the open left half-plane, (n,)."""
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
    """Compute the poles of the cascade over the values of one parameter.

    The poles at neighbouring values are paired so that the sum of the distances between paired poles is smallest.

    Args:
        vehicle: the plant.
        gains: all gains, as in `loop_margins`.
        parameter: name of the parameter that varies, from `LINEAR_PARAMETERS`.
        values: (n,) values of the parameter, n ≥ 2, in ascending or descending order.
        cruise: cruise speed U [m/s]; ignored if the cruise speed is the parameter that varies.
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        smooth: largest allowed step of a pole between two neighbouring values, as a share of the pole's modulus. If a
            pole moves further, for example where two poles separate, values are inserted between two given values, down
            to a spacing of 2⁻⁸ of the given spacing.
        about: fixed values of other parameters by name; parameters that move no pole are ignored.

    Raises:
        InputError: the parameter moves no pole, the values are not in order or out of bounds, the vehicle cannot hold
            the cruise speed, or the number of poles changes (because k_i or thrust_lag is 0 for some values and
            positive for others).

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import sweep_locus
        >>> gains = load_gains("default").values
        >>> locus = sweep_locus(load_vehicle("sur400"), gains, "k_psi", [0.2, 0.4, 0.8, 1.6, 3.2], cruise=0.15, dt=0.05)
        >>> locus.poles.shape, locus.poles.real.max(axis=1).round(2).tolist()
        ((5, 24), [-0.22, -0.22, -0.22, -0.22, 0.12])
    """
    if parameter not in LINEAR_PARAMETERS:
        raise InputError("moves no pole", key="locus", value=parameter, remedy=nearest(parameter, LINEAR_PARAMETERS))
    swept = np.atleast_1d(np.asarray(values, dtype=float))
    if swept.ndim != 1 or len(swept) < 2 or not (np.all(np.diff(swept) > 0) or np.all(np.diff(swept) < 0)):
        raise InputError(
            "needs at least two values in order", key=parameter, remedy="give a range, ascending or descending"
        )

    def followed(values: NDArray[np.float64]) -> NDArray[np.complex128]:
        points = read_points(vehicle, {**about, parameter: values}, base=gains, cruise=cruise, dt=dt, model=model)
        if not points.feasible.all():
            at = float(values[np.argmin(points.feasible)])
            raise InputError("needs more thrust than the vehicle has", key=parameter, value=at, remedy="cruise slower")
        groups = list(cascades_by_order(points))
        if len(groups) > 1:
            raise InputError(
                "changes the number of poles where it is 0", key=parameter, remedy="begin the range above 0"
            )
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
    """Reorder the poles in every row of the array so that each pole is in the column of the pole it continues."""
    from scipy.optimize import linear_sum_assignment

    for before, after in pairwise(poles):
        _, order = linear_sum_assignment(np.abs(before[:, None] - after[None]))
        after[:] = after[order]
    return poles
