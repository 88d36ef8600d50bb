"""Buoyancy of a spherical hull whose top is above the water."""

from __future__ import annotations

from math import pi

__all__ = ["GRAVITY", "WATER", "floating_depth", "missing_buoyancy"]

GRAVITY = 9.81
"""Acceleration of gravity [m/s²]."""

WATER = 1000.0
"""Density of the water [kg/m³]."""


def missing_buoyancy(radius: float, z: float) -> float:
    """Return the weight [N] of the water that the part of a spherical hull above the surface does not displace.

    Args:
        radius: radius of the hull [m].
        z: z of its centre [m]; the surface is at 0.

    Example:
        >>> from surctl.marine.vehicle import missing_buoyancy
        >>> round(missing_buoyancy(0.27, -0.15), 1), missing_buoyancy(0.27, -0.3)
        (102.1, 0.0)
    """
    height = min(max(z + radius, 0.0), 2 * radius)
    return WATER * GRAVITY * pi * height * height * (3 * radius - height) / 3


def floating_depth(radius: float, force: float) -> float:
    """Return z [m] at which the missing buoyancy of a spherical hull equals a force ≥ 0 [N], which holds it there.

    Example:
        >>> from surctl.marine.vehicle import floating_depth
        >>> round(floating_depth(0.27, 5.0), 3)  # a neutral sphere that keeps its water, and 5 N upwards
        -0.245
    """
    low, high = -radius, radius
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if missing_buoyancy(radius, middle) < force else (low, middle)
    return low
