"""Bounds on the closing speed (`--barrier simple`, `inertia`; `--movers`), and braking harder above a bound."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import casadi as ca

from surctl.ir import fold, tabulated
from surctl.marine.guidance.braking import BrakeSymbols, closing_bound
from surctl.marine.guidance.sectors import Bounds, slowed
from surctl.tasks import allowed_closing_speed

Barrier = Literal["simple", "inertia"]
BARRIER_NAMES: tuple[Barrier, ...] = get_args(Barrier)

Movers = Literal["predict", "barrier"]
MOVERS: tuple[Movers, ...] = get_args(Movers)

BRAKE = 4.0
"""The speed command is reduced by this multiple of the excess speed; the velocity loop alone brakes too slowly."""

HARD = 0.02
"""Excess over a speed bound [m/s] at which all thrust is used for braking."""

_FIRST = 10.0  # [m/s] larger than any excess: bounds that the robot violates by closing in come before retreats

Stop: TypeAlias = Callable[[ca.SX, ca.SX], ca.SX]
"""Function of clearance minus margin [m] and obstacle speed v_o·n [m/s] (negative if approaching): largest n·v."""


def _simple(p: Mapping[str, ca.SX], dt: float) -> Stop:
    """Return the bound on the closing speed s by the braking distance s²/(2a) + s t to an obstacle at rest.

    a is the deceleration. The distance that an approaching obstacle travels in the reaction time t is subtracted from
    the clearance.
    """
    least = p["brake"] * ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1])
    deceleration, reaction = least / ca.fmax(p["mass"][0], p["mass"][1]), p["reaction"]

    def stop(distance: ca.SX, closing: ca.SX) -> ca.SX:
        distance = distance - reaction * ca.fmax(-closing, 0)
        return allowed_closing_speed(distance, deceleration=deceleration, reaction=reaction) + closing

    return stop


def _inertia(p: Mapping[str, ca.SX], dt: float) -> Stop:
    # closed form of `guidance.braking`, for the worst case of the parameter ranges
    least = p["brake"] * ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1])
    lightest, heaviest, most, lag, linear, quadratic = ca.vertsplit(p["stopping"])
    brakes = BrakeSymbols(lightest, heaviest, least, most, lag, linear, quadratic, ca.SX(dt))

    def stop(distance: ca.SX, closing: ca.SX) -> ca.SX:
        # the robot may follow a receding contact, and the bound does not assume that the contact stops at once
        return closing_bound(brakes, distance, obstacle=ca.fmax(-closing, 0)) + ca.fmax(closing, 0)

    return stop


BARRIERS: Mapping[Barrier, Callable[[Mapping[str, ca.SX], float], Stop]] = MappingProxyType(
    {"simple": _simple, "inertia": _inertia}
)
"""For each barrier by name, a function from the law's parameters and control period [s] to its speed bound."""


def braked(
    velocity: ca.SX,
    now: ca.SX,
    bounds: Bounds,
    *,
    calm: ca.SX | float = 1.0,
    brake: ca.SX | float = BRAKE,
    hard: float = HARD,
    yields: ca.SX | None = None,
) -> ca.SX:
    """Return a velocity command that brakes harder than the velocity loop alone, if the robot exceeds a speed bound.

    The thrust limit acts on each axis separately, so a simultaneous sideways command can halve the braking force.
    Therefore, the more the robot exceeds the bound, the closer the commanded sideways velocity is to the present
    sideways velocity, as far as the other bounds allow.

    Args:
        velocity, now: desired velocity, and velocity over ground (2, 1) in {E} [m/s].
        calm: 0 while the robot must evade a moving obstacle, so that braking does not change the sideways command;
            otherwise 1.
        brake, hard: see `BRAKE` and `HARD`.
        yields: 1 if a retreat (a negative bound) yields to the other bounds: the robot brakes first for what it closes
            in on, and no retreat from one contact leads towards another one faster than this one's bound.
    """
    excess, normal = _worst(now, bounds) if yields is None else _first(now, bounds, yields)
    straight = now + ca.dot(velocity - now, normal) * normal
    beyond, other = _worst(straight, bounds)
    velocity += calm * ca.fmin(excess / hard, 1) * (straight - beyond * other - velocity)
    velocity -= brake * excess * normal
    if yields is None:
        return velocity

    def within(velocity: ca.SX, row: ca.SX) -> ca.SX:
        return velocity - yields * ca.fmax(ca.dot(velocity, row[:2]) - ca.fmax(row[2], 0), 0) * row[:2]

    velocity = fold("within", within, velocity, tabulated(bounds, 3))
    # one bound after another: where they oppose each other, the result may still violate an earlier one
    return ca.if_else(yields, slowed(velocity, bounds), velocity)


def _worst(velocity: ca.SX, bounds: Bounds) -> tuple[ca.SX, ca.SX]:
    # [m/s] and the normal of the bound; zeros if no bound is exceeded
    def further(excess: ca.SX, normal: ca.SX, row: ca.SX) -> list[ca.SX]:
        over = ca.dot(velocity, row[:2]) - row[2]
        return [ca.fmax(excess, over), ca.if_else(over > excess, row[:2], normal)]

    excess, normal = fold("overspeed", further, [ca.SX(0), ca.SX.zeros(2)], tabulated(bounds, 3))
    return excess, normal


def _first(velocity: ca.SX, bounds: Bounds, yields: ca.SX) -> tuple[ca.SX, ca.SX]:
    # as `_worst`, but retreats come last if they yield
    def further(rank: ca.SX, excess: ca.SX, normal: ca.SX, row: ca.SX) -> list[ca.SX]:
        closing = ca.dot(velocity, row[:2])
        over = closing - row[2]
        ranked = over + ca.if_else(ca.logic_and(yields, closing > ca.fmax(row[2], 0)), _FIRST, 0)
        more = ranked > rank
        return [ca.fmax(rank, ranked), ca.if_else(more, over, excess), ca.if_else(more, row[:2], normal)]

    _, excess, normal = fold("first_bound", further, [ca.SX(0), ca.SX(0), ca.SX.zeros(2)], tabulated(bounds, 3))
    return excess, normal
