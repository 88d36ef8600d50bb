"""What pushes the robot, and how far its thrust is off."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from surctl.files import Strict
from surctl.simulation.obstacle import NotNegative, Positive

__all__ = ["Disturbance"]

Share = Annotated[float, Field(ge=0, lt=1)]


class Disturbance(Strict):
    """Waves and a slow drift as seeded sinusoidal forces in {E}, a constant current, and errors of the thrust.

    Every axis delivers (1 + g)·τ + b·τ_max of a command τ, within its limit τ_max, g uniform within ±`thrust_error`
    and b within ±`thrust_bias`, both drawn once a run.
    """

    wave_force_n: NotNegative = 0.0
    wave_period_s: Positive = 3.0
    drift_force_n: NotNegative = 0.0
    drift_period_s: Positive = 40.0
    thrust_error: Share = 0.0
    thrust_bias: Share = 0.0
    current_m_per_s: tuple[float, float] = (0.0, 0.0)

    @property
    def seeded(self) -> bool:
        """Whether anything of it is drawn."""
        return any((self.wave_force_n, self.drift_force_n, self.thrust_error, self.thrust_bias))
