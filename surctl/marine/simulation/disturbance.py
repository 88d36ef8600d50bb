"""Disturbances of a scenario: waves, slow drift force, current, and thrust errors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from surctl.files import Strict
from surctl.marine.simulation.obstacle import NotNegative, Positive

__all__ = ["Disturbance"]

Share = Annotated[float, Field(ge=0, lt=1)]


class Disturbance(Strict):
    """Disturbances: waves, slow drift force, constant current, and thrust errors.

    Waves and slow drift are sinusoidal forces in the earth frame {E}; the seed determines their directions and phases.

    For a command τ, an axis with the thrust limit τ_max delivers the thrust (1 + g)·τ + b·τ_max, clipped to ±τ_max. The
    gain error g and the bias b are drawn once per run, uniformly within ±`thrust_error` and ±`thrust_bias`.
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
        """Whether any disturbance depends on the random seed."""
        return any((self.wave_force_n, self.drift_force_n, self.thrust_error, self.thrust_bias))
