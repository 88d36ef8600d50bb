"""How fast the guarded law lets itself come nearer: two barriers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias, get_args

import casadi as ca

from surctl.guidance import allowed_closing_speed
from surctl.guidance.braking_symbols import BrakeSymbols, closing_bound

__all__ = ["BARRIERS", "BARRIER_NAMES", "BRAKE", "MOVERS", "Barrier", "Movers", "Stop"]

Barrier = Literal["simple", "inertia"]
BARRIER_NAMES: tuple[Barrier, ...] = get_args(Barrier)

Movers = Literal["predict", "barrier"]
MOVERS: tuple[Movers, ...] = get_args(Movers)

BRAKE = 4.0
"""Times the excess speed that is taken off the command: the velocity loop alone is too slow."""

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
