"""The result of fitting a vehicle to a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.vehicle.identification.model import CONSTANT_FORCE
from surctl.vehicle.parameters import Vehicle

__all__ = ["Identified", "with_constant_force"]


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of fitting a vehicle to a log.

    Attributes:
        vehicle: the vehicle with the fitted values. Parameters that the log does not determine have the values of
            `start`, and the others were fitted again together with them, so that the vehicle is one consistent model.
            The range of an identified parameter is its 95 % interval.
        start: the vehicle whose parameters are the initial values of the fit.
        constant_force: (4,) constant force on the vehicle along its axes [N] and yaw moment [N m], fitted together with
            `vehicle`; 0 where the log does not determine it.
        estimates: for every fitted parameter by name, and for the constant force (X0, Y0, Z0, N0), the estimate and half
            the width of its 95 % interval, with all parameters free. An estimate of drag may be negative.
        identified: names of the parameters whose 95 % interval is sufficiently narrow.
        held: names of the parameters that have the value of `start` in `vehicle`.
        zeroed: names of the drag parameters that are 0 in `vehicle` because their estimates are negative.
        directions: the combinations of parameters that the log does not determine, one text each.
        noise: standard deviation of the residuals, by column of the log.
        notes: what is wrong with the model or the log.
        sections: number of parts of the log that were fitted, each with its own initial state.
    """

    vehicle: Vehicle
    start: Vehicle
    constant_force: NDArray[np.float64]
    estimates: Mapping[str, tuple[float, float]]
    identified: tuple[str, ...]
    held: tuple[str, ...]
    zeroed: tuple[str, ...]
    directions: tuple[str, ...]
    noise: Mapping[str, float]
    notes: tuple[str, ...]
    sections: int

    def fitted_value(self, name: str) -> float:
        """Return the value of a parameter in the consistent model: of the vehicle, or of the constant force."""
        if name in CONSTANT_FORCE:
            return float(self.constant_force[CONSTANT_FORCE.index(name)])
        return self.vehicle[name]


def with_constant_force(vehicle: Vehicle, force: NDArray[np.float64]) -> Vehicle:
    """Return the vehicle with a constant force (4,) in its file.

    Vehicle files have no entry for a constant force yet, so the vehicle is returned unchanged. When they get one, this
    function is the place that fills it.
    """
    del force
    return vehicle
