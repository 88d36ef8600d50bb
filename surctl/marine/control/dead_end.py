"""Dead ends: time without progress (`patience`, `search_limit_s`), other depths (`depths_m`), status TRAPPED.

Progress is either of two events: the robot's projection on the path moves further than before, or the box around all
positions since the last such event grows. A robot that moves back and forth between the arms of a U-shaped obstacle
causes neither event. The law counts the time without progress. The count pauses while a moving obstacle is near, at the
end of the path, and while the law stops because it does not know what is ahead (the output `stopped` reports this).
After the time `patience` without progress, the law sets the status `TRAPPED` permanently: the robot holds its position
and still avoids moving obstacles. If other depths are allowed, the robot tries these depths first.

With a search limit (`sensing.Equipment.search_limit`, in seconds), a search of new places ends too, if the projection
on the path moves no further for this time. The time also counts while the law stops before unknown space.

The paper allows a robot to pass an obstacle "by changing the depth and/or moving horizontally". The robot first tries
horizontal escapes. In a dead end, the robot changes its depth by one layer, i.e. by one hull diameter plus a margin.
The robot stops, moves up or down in place, deletes its sonar map of the old depth, and searches for a path again. The
robot tries all layers that it can reach above, the nearest first, then the layers below. After the last layer the robot
gives up. The robot returns to the path's depth in the same way as soon as two conditions hold: along its path, it is
beyond the dead end by at least one hull diameter plus a margin, and the water between it and the path's depth is free.

The horizontal sonars do not measure the water above or below. During a change of depth, the robot holds its horizontal
position. It moves only through water that its echo sounders measure as free (input `column`), at a speed from which it
can stop within that water. A change of depth is safe if the sounders detect everything above or below the hull, and if
the mission allows the new depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from surctl.ir import Layout, Port, Program, fold, lower, tabulated
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.guidance import Contact
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import allowed_closing_speed

AT = 0.03  # [m] distance from a layer's depth below which the robot has reached it
SLACK = 0.015  # [m] tolerance for missing free water: the precision of depth and sounders
FAST = 0.05  # [m/s] horizontal speed above which the robot stops before it changes its depth
RISES = 0.01  # [m/s] vertical speed above which a change of depth makes progress
ANEW, STANDS, MOVES, RETURNS = -1.0, 0.0, 1.0, 2.0

LAYER_PORTS = (
    Port("layer", (1,), "1", "number of the depth layer: 0 at the path's depth, positive above, negative below"),
    Port(
        "changing",
        (1,),
        "1",
        "1 while the robot changes to its layer, 2 while it returns to the path's depth, -1 when it has arrived",
    ),
    Port("beyond", (1,), "m", "arc length on the path after which the robot may return to the path's depth"),
)


def _goal(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> ca.SX:
    layer = ca.if_else(x["changing"] > 1.5, 0, x["layer"])
    return p["depth"] + layer * _pitch(p)


def _pitch(p: Mapping[str, ca.SX]) -> ca.SX:
    # [m], between adjacent layers
    return 2 * p["hull"] + p["margin"]


def _fast(eta: ca.SX, nu: ca.SX) -> ca.SX:
    return ca.sumsqr(planar_rotation(eta[3]) @ nu[:2]) > FAST**2


def aimed_depth(
    x: Mapping[str, ca.SX], eta: ca.SX, nu: ca.SX, column: ca.SX, p: Mapping[str, ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return z of the present layer (during a change of depth, of the next layer), and z for the depth task [m].

    The z for the depth task is limited such that, with the depth gain `k2`, the robot can always stop in the free water
    above and below the hull, `column` (2, 1) [m].
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
    """Return an instruction list that computes the number `anew` from the decision's state.

    `anew` is 1 in the step after the robot has reached another depth; in this step the map is cleared.
    """
    x, by_name = state.symbols("x")
    return lower(ca.Function("forgetting", [x], [by_name["changing"] < ANEW / 2], ["x"], ["anew"]))


def _layers_next(
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
    """Return the next values of the state entries `DEAD_END_PORTS` and `LAYER_PORTS`.

    `dead_end` has the next values of `DEAD_END_PORTS` that would hold if the depth could not change; `trapped` means a
    dead end at the present layer. `reached` is the arc length of the robot's projection on its path [m], and `ended` is
    1 at the end of the path.
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
    following = ca.if_else(abandoned, -back / _pitch(p), following)  # the present depth, as a number of layers
    state = ca.if_else(ca.logic_or(further, failed), MOVES, ca.fmax(changing, STANDS))
    state = ca.if_else(home, RETURNS, state)
    state = ca.if_else(abandoned, STANDS, ca.if_else(there, ANEW, state))
    starts = ca.logic_or(ca.logic_or(further, home), ca.logic_and(moves, _fast(eta, nu)))
    here = ca.vertcat(eta[0], eta[0], eta[1], eta[1])
    searched = ca.if_else(starts, here, ca.if_else(moves, x["searched"], dead_end["searched"]))
    rises = ca.logic_and(moves, ca.fabs(nu[2]) > RISES)
    anew = ca.logic_or(ca.logic_or(further, home), ca.logic_or(ca.logic_or(there, rises), failed))
    fresh = ca.logic_and(anew, ca.logic_not(abandoned))
    counts = {name: ca.if_else(fresh, 0, dead_end[name]) for name in ("stalled", "searching") if name in dead_end}
    return {
        "furthest": dead_end["furthest"],
        "searched": ca.if_else(was, x["searched"], searched),
        **counts,
        "trapped": ca.logic_or(was, abandoned),
        "layer": ca.if_else(was, layer, following),
        "changing": ca.if_else(was, STANDS, state),
        "beyond": ca.if_else(
            ca.logic_and(further, ca.fabs(layer) < 0.5), dead_end["furthest"] + _pitch(p), x["beyond"]
        ),
    }


NEW = 0.1  # [m] smallest distance that counts as progress: several times the position uncertainty
NEAR = 1.5  # [m] clearance of a moving contact below which the robot waits for it
MOVING_SPEED = 0.05  # [m/s] speed above which a contact counts as moving
ARRIVED = 0.2  # [m] distance to the end of the path below which no further progress is expected
HOLD = 0.5  # [1/s] gain with which the robot holds its position

DEAD_END_PORTS = (
    Port("furthest", (1,), "m", "largest arc length that the robot has reached on its path", -100.0),
    Port("searched", (4,), "m", "x_min, x_max, y_min, y_max of the positions since then, or the place to hold"),
    Port("stalled", (1,), "s", "time without progress"),
    Port("trapped", (1,), "1", "1 after the law gave up in a dead end"),
)

SEARCH_PORT = Port("searching", (1,), "s", "time without progress along the path, for a law with a search limit")


def standing(desired: DesiredMotion, x: Mapping[str, ca.SX], eta: ca.SX, p: Mapping[str, ca.SX]) -> DesiredMotion:
    """Return the desired motion; after a dead end and during a change of depth, the robot holds its position."""
    offset = ca.vertcat(x["searched"][0], x["searched"][2]) - eta[:2]
    distance = ca.sqrt(ca.sumsqr(offset))
    holding = offset * ca.fmin(HOLD, p["cruise"] / ca.fmax(distance, 1e-3))
    stands = ca.fmax(x["trapped"], x["changing"]) if "changing" in x else x["trapped"]
    return replace(desired, velocity=ca.if_else(stands > 0.5, holding, desired.velocity))


def dead_end_next(
    desired: DesiredMotion,
    contacts: Sequence[Contact],
    x: Mapping[str, ca.SX],
    eta: ca.SX,
    stopped: ca.SX,
    p: Mapping[str, ca.SX],
    nu: ca.SX | None = None,
    column: ca.SX | None = None,
    *,
    dt: float,
    limit: float | None = None,
) -> dict[str, ca.SX]:
    """Return the next values of the state entries `DEAD_END_PORTS`, and of `LAYER_PORTS` if depths may change.

    Args:
        contacts: known obstacles that may move.
        stopped: 1 while the law stops because it does not know what is ahead.
        p: parameters `patience` (0: never report a dead end) and `waypoints`, and for `aimed_depth`.
        nu, column: needed if other depths are allowed: (4, 1) velocity in {B}, and (2, 1) free water above and below
            the hull [m].
        limit: time without progress along the path [s] after which the law gives up, and the next value of
            `SEARCH_PORT` is returned too; None: no limit.
    """
    here = ca.vertcat(eta[0], eta[0], eta[1], eta[1])
    signs = ca.DM([-1, 1, -1, 1])
    grown = signs * (here - x["searched"])
    reached = x["progress"] + desired.x_e
    further = reached > x["furthest"] + NEW
    new = ca.logic_or(further, ca.mmax(grown) > NEW)

    def nears(near: ca.SX, row: ca.SX) -> ca.SX:
        contact = Contact.of(row)
        moves = ca.sumsqr(contact.velocity) > MOVING_SPEED**2
        return ca.logic_or(near, ca.logic_and(moves, contact.clearance < NEAR))

    near = fold("nears", nears, ca.SX(0), tabulated((contact.row for contact in contacts), 6))
    left = ca.sumsqr(p["waypoints"][-1, :].T - eta[:2])
    ended = left < ARRIVED**2
    waits = ca.logic_or(ca.logic_or(near, stopped), ended)
    stalled = ca.if_else(new, 0, x["stalled"] + ca.if_else(waits, 0, dt))
    was = x["trapped"] > 0.5
    now = ca.logic_or(was, ca.logic_and(p["patience"] > 0, stalled >= p["patience"]))
    searching = None
    if limit is not None:
        searching = ca.if_else(further, 0, x["searching"] + ca.if_else(ca.logic_or(near, ended), 0, dt))
        now = ca.logic_or(now, searching >= limit)
    # the box grows in steps of `NEW`, so that slow motion counts as progress but a drift of the estimate does not
    box = ca.if_else(grown > NEW, here, x["searched"])
    box = ca.if_else(further, here, box)
    box = ca.if_else(ca.logic_and(now, ca.logic_not(was)), here, ca.if_else(was, x["searched"], box))
    after = {
        "furthest": ca.if_else(further, reached, x["furthest"]),
        "searched": box,
        "stalled": stalled,
        "trapped": now,
        **({} if searching is None else {SEARCH_PORT.name: searching}),
    }
    if column is None or nu is None:
        return after
    return _layers_next(after, x, eta, nu, column, p, reached=reached, ended=ended)
