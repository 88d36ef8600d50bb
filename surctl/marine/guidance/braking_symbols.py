"""The closed-form barrier of `guidance.braking` as CasADi expressions."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

__all__ = ["BrakeSymbols", "closing_bound", "range_symbol", "stopping_symbol"]

_LEAST_LEFT = 0.02  # lower bound of F' as a share of F_b; for an obstacle too fast for braking it causes a retreat


@dataclass(frozen=True, eq=False)
class BrakeSymbols:
    """The vehicle's braking data, as in `Brakes` but without disturbance and current, as scalar CasADi expressions.

    Attributes:
        lightest, heaviest: least and largest mass [kg], > 0.
        least: guaranteed thrust F_b > 0 [N]; most: largest thrust F⁺ [N].
        lag: time constant τ of the thrust [s].
        linear: largest linear drag coefficient [N s/m]; quadratic: largest quadratic drag coefficient [N s²/m²].
        period: T > 0, time between two braking decisions [s].
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
        """Return the net braking force F' [N], limited to at least 2 % of the guaranteed thrust F_b."""
        return ca.fmax(self.least - self._drag(obstacle), _LEAST_LEFT * self.least)

    def acceleration(self, obstacle: ca.SX) -> ca.SX:
        """Return a⁺ [m/s²], the largest acceleration of the robot towards the obstacle."""
        return (self.most + self._drag(obstacle)) / self.lightest

    def _drag(self, speed: ca.SX) -> ca.SX:
        return self.linear * speed + self.quadratic * speed * speed


def stopping_symbol(brakes: BrakeSymbols, speed: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """Return the stopping distance [m] for the largest present thrust, as `stopping_distance` does.

    The net braking force is limited to at least 2 % of the guaranteed thrust.
    """
    closing, swing, longest = ca.fmax(speed + obstacle, 0), brakes.lag * (brakes.most + brakes.least), ca.SX(0)
    for m in (brakes.lightest, brakes.heaviest):
        longest = ca.fmax(longest, m * (closing + swing / m) ** 2 / (2 * brakes.left(obstacle)))
    return longest


def range_symbol(brakes: BrakeSymbols, speed: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """Return the smallest range [m] at which not braking is safe, as `range_needed`, for exact and timely ranges."""
    gain, period = brakes.acceleration(obstacle), brakes.period
    distance = stopping_symbol(brakes, speed + gain * period, obstacle=obstacle)
    return (speed + obstacle) * period + gain * period * period / 2 + distance


def closing_bound(brakes: BrakeSymbols, distance: ca.SX, *, obstacle: ca.SX) -> ca.SX:
    """Return the largest safe speed towards the obstacle [m/s]; a negative speed requires a retreat.

    The function corresponds to `allowed_speed` for range measurements without delay and error.

    Args:
        brakes: braking data of the vehicle.
        distance: clearance minus its largest error [m].
        obstacle: speed v_o ≥ 0 of the obstacle towards the robot [m/s].
    """
    gain, period, roots = brakes.acceleration(obstacle), brakes.period, []
    swing = brakes.lag * (brakes.most + brakes.least)
    for m in (brakes.lightest, brakes.heaviest):
        k, lost = m / (2 * brakes.left(obstacle)), swing / m
        remaining = distance + gain * period * period / 2 - k * lost * lost
        slope = period + 2 * k * lost
        roots.append(2 * remaining / (slope + ca.sqrt(slope * slope + 4 * k * ca.fmax(remaining, 0))))
    return ca.fmin(*roots) - obstacle - gain * period
