"""Escape by depth: from a dead end the robot tries the water above the path's depth, then that below, layer by layer.

The paper lets an obstacle be passed "by changing the depth and/or moving horizontally". Horizontal ways come first:
only where `control.trap` finds a dead end does the robot change its depth, by a hull's diameter and a margin at a time.
It stops, goes up or down in place, forgets what the sonars told of the other depth, and looks for a way again. Above
all layers that it can reach from there come first, nearest first, then those below; after the last one it gives up.
Once it is further along its path than the dead end, by the hull's diameter and a margin, and the water back to the
path's depth is free, it returns in the same way.

Sonars that look ahead say nothing of the water above or below. It moves there only as far as its echo sounders find
it free (`column`), no faster than it can stop short of their end, and keeps to its place meanwhile. So what it rests on
is that the sounders hear all that stands over or under the hull, and that the mission allows that water.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from surctl.guidance import allowed_closing_speed
from surctl.ir import Layout, Port, Program, lower
from surctl.vehicle import planar_rotation

__all__ = ["LAYER_PORTS", "aimed_depth", "forgetting", "layers_next"]

AT = 0.03  # [m] from a layer's depth at which it is there
SLACK = 0.015  # [m] by which the free water may be too short: depth and sounders are not that exact
FAST = 0.05  # [m/s] horizontally, above which it stops before it changes its depth
RISES = 0.01  # [m/s] up or down, above which it gets on with a change of its depth
ANEW, STANDS, MOVES, RETURNS = -1.0, 0.0, 1.0, 2.0

LAYER_PORTS = (
    Port("layer", (1,), "1", "depth it flies at: layers above the path's, negative below; 0 the path's own"),
    Port(
        "changing",
        (1,),
        "1",
        "1 while it changes to that depth in place, 2 while it returns to the path's, -1 once there",
    ),
    Port("beyond", (1,), "m", "arc length past which it may return"),
)


def _goal(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> ca.SX:
    layer = ca.if_else(x["changing"] > 1.5, 0, x["layer"])
    return p["depth"] + layer * _pitch(p)


def _pitch(p: Mapping[str, ca.SX]) -> ca.SX:
    """From one layer to the next [m]."""
    return 2 * p["hull"] + p["margin"]


def _fast(eta: ca.SX, nu: ca.SX) -> ca.SX:
    return ca.sumsqr(planar_rotation(eta[3]) @ nu[:2]) > FAST**2


def aimed_depth(
    x: Mapping[str, ca.SX], eta: ca.SX, nu: ca.SX, column: ca.SX, p: Mapping[str, ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """(z of the layer it flies at or changes to, z that the depth task is given) [m].

    The second is no further away than the robot, at gain `k2`, may go to and still stop in the water that is free.

    Args:
        x: state, `LAYER_PORTS` among it.
        eta, nu: (4, 1) pose in {E} and velocity in {B}.
        column: (2, 1) free water above and below the hull [m].
        p: `depth`, `hull`, `margin`, `k2`, `brake`, `reaction`, thrust and mass.
    """
    goal, z = _goal(x, p), eta[2]
    deceleration = p["brake"] * p["thrust_limit"][2] / p["mass"][2]
    most = [
        allowed_closing_speed(ca.fmax(column[k] - p["margin"], 0), deceleration=deceleration, reaction=p["reaction"])
        / ca.fmax(p["k2"], 1e-6)
        for k in (0, 1)
    ]
    near = z + ca.fmin(ca.fmax(goal - z, -most[1]), most[0])
    moving = ca.if_else(_fast(eta, nu), z, near)
    return goal, ca.if_else(x["changing"] > 0.5, moving, goal)


def forgetting(state: Layout) -> Program:
    """Decision's state → `anew`: 1 in the step after another depth was reached, in which the map starts anew."""
    x, by_name = state.symbols("x")
    return lower(ca.Function("forgetting", [x], [by_name["changing"] < ANEW / 2], ["x"], ["anew"]))


def layers_next(
    dead_end: Mapping[str, ca.SX],
    x: Mapping[str, ca.SX],
    eta: ca.SX,
    nu: ca.SX,
    column: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    reached: ca.SX,
    ended: ca.SX,
) -> dict[str, ca.SX]:
    """`trap.TRAP_PORTS` and `LAYER_PORTS` one control period later.

    Args:
        trap: what `trap_next` has without layers; its `trapped` is a dead end at this layer.
        x: state.
        eta, nu: (4, 1) pose in {E} and velocity in {B}.
        column: (2, 1) free water above and below the hull [m].
        p: as `aimed_depth`.
        reached: arc length of the robot's projection on its path [m].
        ended: 1 at the path's end.
    """
    was, layer, changing = x["trapped"] > 0.5, x["layer"], x["changing"]
    moves, returns = changing > 0.5, changing > 1.5
    dead = ca.logic_and(dead_end["trapped"], ca.logic_not(was))
    rise = _goal(x, p) - eta[2]
    there = ca.logic_and(moves, ca.fabs(rise) <= AT)
    clearance = ca.if_else(rise > 0, column[0], column[1]) - p["margin"] + SLACK
    short = ca.logic_and(ca.logic_and(moves, ca.logic_not(there)), ca.fabs(rise) > clearance)
    failed = ca.logic_and(moves, ca.logic_or(short, ca.logic_and(dead, ca.logic_not(there))))
    unreached = ca.logic_and(failed, ca.logic_not(returns))
    back = p["depth"] - eta[2]
    free = ca.fabs(back) <= ca.if_else(back > 0, column[0], column[1]) - p["margin"] + SLACK
    past = ca.logic_or(reached > x["beyond"], ended)
    away = ca.logic_and(ca.fabs(layer) > 0.5, ca.logic_not(ca.logic_or(moves, was)))
    home = ca.logic_and(away, ca.logic_and(past, free))
    further = ca.logic_and(ca.logic_and(dead, ca.logic_not(moves)), ca.logic_not(home))
    abandoned = ca.logic_and(unreached, layer < 0)

    following = ca.if_else(further, layer + ca.if_else(layer < 0, -1, 1), layer)
    following = ca.if_else(unreached, -1, following)
    following = ca.if_else(ca.logic_and(there, returns), 0, following)
    following = ca.if_else(abandoned, -back / _pitch(p), following)  # of the place it stands at
    state = ca.if_else(ca.logic_or(further, failed), MOVES, ca.fmax(changing, STANDS))
    state = ca.if_else(home, RETURNS, state)
    state = ca.if_else(abandoned, STANDS, ca.if_else(there, ANEW, state))
    starts = ca.logic_or(ca.logic_or(further, home), ca.logic_and(moves, _fast(eta, nu)))
    here = ca.vertcat(eta[0], eta[0], eta[1], eta[1])
    searched = ca.if_else(starts, here, ca.if_else(moves, x["searched"], dead_end["searched"]))
    rises = ca.logic_and(moves, ca.fabs(nu[2]) > RISES)
    anew = ca.logic_or(ca.logic_or(further, home), ca.logic_or(ca.logic_or(there, rises), failed))
    return {
        "furthest": dead_end["furthest"],
        "searched": ca.if_else(was, x["searched"], searched),
        "stalled": ca.if_else(ca.logic_and(anew, ca.logic_not(abandoned)), 0, dead_end["stalled"]),
        "trapped": ca.logic_or(was, abandoned),
        "layer": ca.if_else(was, layer, following),
        "changing": ca.if_else(was, STANDS, state),
        "beyond": ca.if_else(
            ca.logic_and(further, ca.fabs(layer) < 0.5), dead_end["furthest"] + _pitch(p), x["beyond"]
        ),
    }
