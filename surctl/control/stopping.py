"""How fast the guarded law lets itself come nearer, two barriers by name, and how it brakes when it is faster."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import casadi as ca

from surctl.guidance import allowed_closing_speed
from surctl.guidance.braking_symbols import BrakeSymbols, closing_bound
from surctl.ir import fold, tabulated

__all__ = ["BARRIERS", "BARRIER_NAMES", "BRAKE", "HARD", "MOVERS", "Barrier", "Bounds", "Movers", "Stop", "braked"]

Barrier = Literal["simple", "inertia"]
BARRIER_NAMES: tuple[Barrier, ...] = get_args(Barrier)

Movers = Literal["predict", "barrier"]
MOVERS: tuple[Movers, ...] = get_args(Movers)

BRAKE = 4.0
"""Times the excess speed that is taken off the command: the velocity loop alone is too slow."""

HARD = 0.02
"""[m/s] over a bound, at which the whole thrust is for braking."""

Bounds: TypeAlias = Sequence[tuple[ca.SX, ca.SX]]
"""(unit normal (2, 1) in {E}, largest speed along it [m/s])."""

Stop: TypeAlias = Callable[[ca.SX, ca.SX], ca.SX]
"""(clearance less the margin [m], v_o·n of the contact, negative as it comes nearer [m/s]) → largest n·v [m/s]."""


def _simple(p: Mapping[str, ca.SX], dt: float) -> Stop:
    """s²/(2a) + s t, of a contact that stands; what approaches is given its way in the time t as further stand-off."""
    least = p["brake"] * ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1])
    deceleration, reaction = least / ca.fmax(p["mass"][0], p["mass"][1]), p["reaction"]

    def stop(distance: ca.SX, closing: ca.SX) -> ca.SX:
        distance = distance - reaction * ca.fmax(-closing, 0)
        return allowed_closing_speed(distance, deceleration=deceleration, reaction=reaction) + closing

    return stop


def _inertia(p: Mapping[str, ca.SX], dt: float) -> Stop:
    """The closed form of `guidance.braking`, at the worst of the vehicle's ranges."""
    least = p["brake"] * ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1])
    lightest, heaviest, most, lag, linear, quadratic = ca.vertsplit(p["stopping"])
    brakes = BrakeSymbols(lightest, heaviest, least, most, lag, linear, quadratic, ca.SX(dt))

    def stop(distance: ca.SX, closing: ca.SX) -> ca.SX:
        # what goes away is followed: it is not assumed to stop at once
        return closing_bound(brakes, distance, obstacle=ca.fmax(-closing, 0)) + ca.fmax(closing, 0)

    return stop


BARRIERS: Mapping[Barrier, Callable[[Mapping[str, ca.SX], float], Stop]] = MappingProxyType(
    {"simple": _simple, "inertia": _inertia}
)
"""Name → the bound, of the law's parameters and its period [s]."""


def braked(velocity: ca.SX, now: ca.SX, bounds: Bounds, *, calm: ca.SX | float = 1.0) -> ca.SX:
    """More than the velocity loop alone would brake, where the robot is faster than a bound.

    Thrust is clipped axis by axis: what is asked for sideways at the same time takes from the force against the bound,
    up to half of it and more. So the faster the robot is the less is asked for sideways than what it does already, and
    of that no more than another bound allows.

    Args:
        velocity: wanted (2, 1) in {E} [m/s].
        now: over ground (2, 1) in {E} [m/s].
        bounds: on the speed.
        calm: 0 where it must evade what moves: then it brakes, and asks for the rest all the same.
    """
    excess, normal = _worst(now, bounds)
    straight = now + ca.dot(velocity - now, normal) * normal
    beyond, other = _worst(straight, bounds)
    velocity += calm * ca.fmin(excess / HARD, 1) * (straight - beyond * other - velocity)
    return velocity - BRAKE * excess * normal


def _worst(velocity: ca.SX, bounds: Bounds) -> tuple[ca.SX, ca.SX]:
    """By how much a velocity exceeds a bound at most [m/s], and that bound's normal; 0 and the zero vector if none."""

    def further(excess: ca.SX, normal: ca.SX, row: ca.SX) -> list[ca.SX]:
        over = ca.dot(velocity, row[:2]) - row[2]
        return [ca.fmax(excess, over), ca.if_else(over > excess, row[:2], normal)]

    excess, normal = fold("overspeed", further, [ca.SX(0), ca.SX.zeros(2)], tabulated(bounds, 3))
    return excess, normal
