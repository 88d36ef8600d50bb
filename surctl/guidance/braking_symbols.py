"""The closed-form barrier in symbols, as `braking` has it in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

__all__ = ["BrakeSymbols", "closing_bound", "range_symbol", "stopping_symbol"]

_LEAST_LEFT = 0.02  # share of F_b that counts as left before what is too fast to be braked for: it asks for a retreat


@dataclass(frozen=True, eq=False)
class BrakeSymbols:
    """`Brakes` without push and current, and the period of `Watch`, as scalars.

    Attributes:
        lightest, heaviest: [kg], > 0.
        least, most: F_b > 0 and F⁺ [N].
        lag: τ [s].
        linear, quadratic: largest drag [N s/m, N s²/m²].
        period: T > 0 [s].
    """

    lightest: ca.SX
    heaviest: ca.SX
    least: ca.SX
    most: ca.SX
    lag: ca.SX
    linear: ca.SX
    quadratic: ca.SX
    period: ca.SX

    def left(self, obstacle: ca.SX) -> ca.SX:
        """F' [N], at least 2 % of F_b."""
        return ca.fmax(self.least - self._drag(obstacle), _LEAST_LEFT * self.least)

    def acceleration(self, obstacle: ca.SX) -> ca.SX:
        """a⁺ [m/s²]."""
        return (self.most + self._drag(obstacle)) / self.lightest

    def _drag(self, speed: ca.SX) -> ca.SX:
        return self.linear * speed + self.quadratic * speed * speed


def stopping_symbol(brakes: BrakeSymbols, speed: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """`stopping_distance` from the largest thrust [m], where F' is at least 2 % of F_b."""
    closing, swing, longest = ca.fmax(speed + obstacle, 0), brakes.lag * (brakes.most + brakes.least), ca.SX(0)
    for m in (brakes.lightest, brakes.heaviest):
        longest = ca.fmax(longest, m * (closing + swing / m) ** 2 / (2 * brakes.left(obstacle)))
    return longest


def range_symbol(brakes: BrakeSymbols, speed: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """`range_needed` for a range that is neither old nor wrong [m]."""
    gain, period = brakes.acceleration(obstacle), brakes.period
    distance = stopping_symbol(brakes, speed + gain * period, obstacle=obstacle)
    return (speed + obstacle) * period + gain * period * period / 2 + distance


def closing_bound(brakes: BrakeSymbols, distance: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """`allowed_speed` [m/s] for a range that is neither old nor wrong, any sign.

    Args:
        brakes: what stops.
        distance: clearance less what it may be wrong by [m].
        obstacle: v_o ≥ 0 [m/s].
    """
    gain, period, roots = brakes.acceleration(obstacle), brakes.period, []
    swing = brakes.lag * (brakes.most + brakes.least)
    for m in (brakes.lightest, brakes.heaviest):
        k, lost = m / (2 * brakes.left(obstacle)), swing / m
        remaining = distance + gain * period * period / 2 - k * lost * lost
        slope = period + 2 * k * lost
        roots.append(2 * remaining / (slope + ca.sqrt(slope * slope + 4 * k * ca.fmax(remaining, 0))))
    return ca.fmin(*roots) - obstacle - gain * period
