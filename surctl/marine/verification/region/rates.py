"""How far the level of a region is below the least one at which V decays too slowly, or a thrust saturates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from surctl.lyapunov.dynamics import exact
from surctl.lyapunov.falsified import least_where
from surctl.marine.verification.region.nominal import uncertain_cruise
from surctl.verification.formula import number


class LevelRatios(NamedTuple):
    """Certified level divided by the least level where V̇ > −a V was found, and by the level of thrust saturation."""

    falsifier: float
    thrust: float

    @property
    def sentence(self) -> str:
        """Return a sentence that states both ratios."""
        return (
            f"certified level: {self.falsifier:.0%} of the smallest level with a counterexample, {self.thrust:.0%} of "
            "the level at which thrust saturates" + (", so no thrust limit acts in it" if self.thrust < 1 else "")
        )


def level_ratios(document: Mapping[str, Any]) -> LevelRatios:
    """Return the ratios of the region V ≤ 1 of a certificate without lag, held commands and disturbances.

    The search can miss counterexamples, so the true ratio of the certified level to the smallest level with a
    counterexample may be larger.
    """
    d, function, loads = uncertain_cruise(document)
    rise = d.change(function) + exact(document["claim"]["motion"]["rate_per_s"]) * function
    saturated = min(least_where(d, function, load - number(1)) for load in loads)
    # inside the certified region, level 1, there is no counterexample
    return LevelRatios(1 / least_where(d, function, rise, floor=1.0), 1 / saturated)
