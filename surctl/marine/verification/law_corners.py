"""The sampled loop of any law at the corners of the uncertainty of its plant; the law keeps the nominal model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from surctl.marine.control import Gains, Law
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.law_loop import LawLoop, law_loop
from surctl.marine.verification.linear.corners import corners
from surctl.marine.verification.operating_point import OperatingPoint
from surctl.verification.sampled_loop import worst_loop

__all__ = ["LawCorners", "law_corners"]


@dataclass(frozen=True, eq=False)
class LawCorners:
    """The loop of a law for the nominal plant and for the worst corner of its uncertainty.

    Attributes:
        nominal: the loop with the nominal plant.
        worst: the loop with the least disk margin, or an unstable one.
        corner: the parameters of the worst corner, as text.
        at: the vehicle of that corner.
        text: description of all corners.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        unable: number of corners at which the thrust cannot hold the cruise speed; they are left out.
    """

    nominal: LawLoop
    worst: LawLoop
    corner: str
    at: Vehicle
    text: str
    slowest_per_s: float
    unable: int = 0

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every corner."""
        return self.nominal.stable and self.worst.stable

    @property
    def disk(self) -> float:
        """The disk margin at the worst corner; 0 if one is unstable."""
        return self.worst.disk

    def lines(self) -> list[str]:
        """Return lines of text: the nominal loop, then the worst corner."""
        left = f"; at {self.unable} of them the thrust cannot hold the speed" if self.unable else ""
        word = f"disk margin {self.disk:.2f}" if self.worst.stable else "UNSTABLE"
        return [*self.nominal.lines(), f"  worst of {self.text}{left}: {word} at {self.corner}"]

    def to_dict(self) -> dict[str, Any]:
        """Return the analysis as plain data for JSON."""
        worst = {**self.worst.to_dict(), "corner": self.corner, "of": self.text}
        return {**self.nominal.to_dict(), "worst": worst}


def law_corners(
    law: Law,
    vehicle: Vehicle,
    gains: Gains,
    *,
    cruise: float,
    uncertainty: float | None = None,
    at: OperatingPoint | None = None,
) -> LawCorners:
    """Return the loop of a law about a straight cruise for the nominal plant and the worst corner of its parameters.

    With `at`, every loop is linearised about that steady motion.

    The corners are those of the ranges in the vehicle file. If the file states none, all masses are off by ±5 % and all
    drag coefficients by ±20 %; with `uncertainty`, both by this share.

    Args:
        law, vehicle, gains, cruise, at: as for `law_loop`.
        uncertainty: relative uncertainty, 0 ≤ uncertainty < 1, or None.

    Raises:
        InputError: the law uses sonars, or the nominal vehicle cannot cruise at that speed.

    Example:
        >>> from surctl.marine.control import build_law
        >>> from surctl.marine.tuning import derived_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import law_corners
        >>> boat = load_vehicle("otter")
        >>> result = law_corners(build_law("steered"), boat, derived_gains(boat, cruise=0.77), cruise=0.77)
        >>> result.stable, round(result.nominal.disk, 2), result.corner
        (True, 0.66, 'mass +5%, drag -20%')
    """
    nominal = law_loop(law, vehicle, gains, cruise=cruise, at=at)
    tried = corners(vehicle, uncertainty)
    loop_of = partial(law_loop, law, gains=gains, cruise=cruise, model=vehicle, at=at)
    plants = ((tried.label(plant), partial(loop_of, plant)) for plant in tried.vehicles[1:])
    worst = worst_loop(nominal, "the nominal vehicle", plants)
    # a corner without a loop is one at which the thrust cannot hold the speed
    plant = next((p for p in tried.vehicles[1:] if tried.label(p) == worst.corner), vehicle)
    return LawCorners(nominal, worst.loop, worst.corner, plant, tried.text, worst.slowest_per_s, len(worst.lost))
