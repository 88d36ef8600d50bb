"""Upright solids of finite height: a planar shape between two depths, and its exact distance to a point in space.

z is up, as everywhere: a depth below the surface is negative. A prism is the product of a planar set and an interval,
so that the square of its distance is the sum of their squares; a sphere is clear of it by that distance less its
radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, isinf, isnan

from surctl.errors import InputError
from surctl.world.shapes import Shape

__all__ = ["WHOLE", "Heights", "Prism"]


@dataclass(frozen=True)
class Heights:
    """From which z to which z something reaches [m]; infinite: beyond floor or surface.

    Attributes:
        bottom, top: z of its ends, bottom < top.
    """

    bottom: float = -inf
    top: float = inf

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        if isnan(self.bottom) or isnan(self.top) or self.bottom >= self.top:
            raise InputError(
                f"is not below the top, {self.top:g}",
                key="bottom",
                value=self.bottom,
                remedy="z is up: write z of both ends, negative below the surface, the lower one as bottom",
            )

    @property
    def whole(self) -> bool:
        """Whether it reaches through the whole water column."""
        return isinf(self.bottom) and isinf(self.top)

    def gap(self, z: float) -> float:
        """Signed vertical distance [m] from z to the interval, negative inside."""
        return max(self.bottom - z, z - self.top)

    def crosses(self, z: float, distance: float) -> bool:
        """Whether anything of it lies less than `reach` [m] above or below z."""
        return self.gap(z) < distance

    def shares(self, other: Heights) -> bool:
        """Whether the two have any depth in common."""
        return self.bottom < other.top and other.bottom < self.top


WHOLE = Heights()
"""The whole water column."""


@dataclass(frozen=True)
class Prism:
    """An upright solid: `base` at every depth of `heights`."""

    base: Shape
    heights: Heights = WHOLE

    def distance(self, x: float, y: float, z: float) -> float:
        """Signed distance [m] of a point in {E} to the surface; inside, minus that to the nearest face."""
        across = self.base.foot(x, y)[0]
        if self.heights.whole:
            return across
        along = self.heights.gap(z)
        if across <= 0.0 or along <= 0.0:
            return max(across, along)
        return hypot(across, along)
