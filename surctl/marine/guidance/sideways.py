"""Braking of a vehicle that also moves sideways, which `surctl.marine.guidance.braking` counts as a force."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

from surctl.marine.guidance.braking import Brakes

__all__ = ["beside", "sideways_force"]


def sideways_force(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> float:
    """Return the largest additional drag force towards an obstacle [N] at a sideways speed w [m/s], for any heading.

    Drag acts on each axis of the vehicle separately, so the sideways speed increases the drag along n beyond D(v_o).
    For the velocity −v_o n + w t (n towards the obstacle, t perpendicular to n), at any angle between n and the axes,
    and for drag coefficients in their ranges [low, high], the drag along n is at most (high v_o + (high − low) w/2) +
    high v_o² + √2 high v_o w + (2 high − low) w²/(3√3).
    """
    (low, high), (low2, high2) = brakes.linear, brakes.quadratic
    square = (2 * high2 - low2) * sideways**2 / (3 * sqrt(3))
    return (high - low) * sideways / 2 + sqrt(2) * high2 * (obstacle + brakes.current) * sideways + square


def beside(brakes: Brakes, sideways: float, *, obstacle: float = 0.0) -> Brakes:
    """Return the braking data with `sideways_force` added to the disturbance force."""
    return replace(brakes, disturbance=brakes.disturbance + sideways_force(brakes, sideways, obstacle=obstacle))
