"""The result of fitting a vehicle to a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.fitted import CONSTANT_FORCE
from surctl.marine.vehicle.parameters import Vehicle
from surctl.marine.vehicle.specs import parameter_spec

__all__ = ["Identified"]


@dataclass(frozen=True, eq=False)
class Identified:
    """The result of fitting a vehicle to a log.

    Attributes:
        vehicle: the vehicle with the fitted values. Parameters that the log does not determine have the values of
            `start`, and the others were fitted again together with them, so that the vehicle is one consistent model.
            The range of an identified parameter is its 95 % interval.
        start: the vehicle whose parameters are the initial values of the fit.
        estimates: for every fitted parameter by name, and for the constant force (X0, Y0, Z0, N0), the estimate and
            half the width of its 95 % interval, with all parameters free. An estimate of drag may be negative.
        identified: names of the parameters whose 95 % interval is sufficiently narrow, without those held.
        held: names of the parameters that have the value of `start` in `vehicle`; a constant force that `start` does
            not have is 0.
        drifting: names of the constant forces that change in the log; `vehicle` has their mean.
        zeroed: names of the drag parameters that are 0 in `vehicle` because their estimates are negative.
        directions: the combinations of parameters that the log does not determine, one text each.
        noise: standard deviation of the residuals, by column of the log.
        notes: what is wrong with the model or the log.
        sections: number of parts of the log that were fitted, each with its own initial state.
    """

    vehicle: Vehicle
    start: Vehicle
    estimates: Mapping[str, tuple[float, float]]
    identified: tuple[str, ...]
    held: tuple[str, ...]
    drifting: tuple[str, ...]
    zeroed: tuple[str, ...]
    directions: tuple[str, ...]
    noise: Mapping[str, float]
    notes: tuple[str, ...]
    sections: int

    @property
    def constant_force(self) -> NDArray[np.float64]:
        """Constant force (4,) on the vehicle along its axes [N] and constant yaw moment [N m]."""
        return np.array([self.fitted_value(k) for k in CONSTANT_FORCE])

    @property
    def refusal(self) -> str:
        """Why the fit has no physical meaning, with the remedy; empty if it has one."""
        below = [
            f"{key} = {value:.3g} ± {half:.2g} {spec.unit}"
            for key, (value, half) in self.estimates.items()
            if (spec := parameter_spec(key)) is not None and not spec.signed and value + half < 0
        ]
        remedy = "check the signs and scales of thrust and motion"
        return f"the log contradicts the model: {', '.join(below)} would be below 0; {remedy}" if below else ""

    def fitted_value(self, name: str) -> float:
        """Return the value of a parameter in the vehicle; 0 for a constant force that it does not have."""
        return self.vehicle[name] if name in self.vehicle.parameters else 0.0

    def start_value(self, name: str) -> float:
        """Return the value of a parameter in `start`; 0 for a constant force that it does not have."""
        return self.start[name] if name in self.start.parameters else 0.0

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        spec = parameter_spec(name)
        return spec.unit if spec is not None else ""
