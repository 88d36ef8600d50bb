"""Upright solids, each with the same horizontal section between two depths, and their exact distances to a point.

The z axis points up, so z is negative below the water surface. A prism is the product of a planar set and an interval
of z. So the squared distance of a point to a prism is the sum of the squared distances to the planar set and to the
interval. The clearance of a sphere is the distance of its centre minus its radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, isinf, isnan

from surctl.errors import InputError
from surctl.marine.world.shapes import Shape

__all__ = ["WHOLE", "Heights", "Prism"]


@dataclass(frozen=True)
class Heights:
    """The interval of z [m] that a body occupies; an infinite end lies beyond the floor or the water surface.

    Attributes:
        bottom, top: z of the lower and the upper end [m], bottom < top.
    """

    bottom: float = -inf
    top: float = inf

    def __post_init__(self) -> None:
        """Check the values; raise an InputError that names an invalid value."""
        if isnan(self.bottom) or isnan(self.top) or self.bottom >= self.top:
            raise InputError(
                f"is not below the top, {self.top:g}",
                key="bottom",
                value=self.bottom,
                remedy="z is up: write z of both ends (negative below the surface), with the lower one as bottom",
            )

    @property
    def whole(self) -> bool:
        """Whether the body occupies the whole water column."""
        return isinf(self.bottom) and isinf(self.top)

    def gap(self, z: float) -> float:
        """Return the signed vertical distance [m] from z to the interval, negative if z lies inside the interval."""
        return max(self.bottom - z, z - self.top)

    def crosses(self, z: float, distance: float) -> bool:
        """Return whether any part of the interval lies less than `distance` [m] above or below z."""
        return self.gap(z) < distance

    def shares(self, other: Heights) -> bool:
        """Return whether the intervals of two bodies have a depth in common."""
        return self.bottom < other.top and other.bottom < self.top


WHOLE = Heights()
"""The whole water column."""


@dataclass(frozen=True)
class Prism:
    """An upright solid with the horizontal section `base` at every depth of `heights`."""

    base: Shape
    heights: Heights = WHOLE

    def distance(self, x: float, y: float, z: float) -> float:
        """Return the signed distance [m] of a point in {E} to the prism; negative if the point lies inside."""
        across = self.base.foot(x, y)[0]
        if self.heights.whole:
            return across
        along = self.heights.gap(z)
        if across <= 0.0 or along <= 0.0:
            return max(across, along)
        return hypot(across, along)
