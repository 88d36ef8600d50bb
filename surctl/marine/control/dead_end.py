"""Detection of dead ends: after too long without progress, the law reports a dead end and holds the position.

Progress is either of two events: the robot's projection on the path moves further than before, or the box around all
positions since the last such event grows. A robot that moves back and forth between the arms of a U-shaped obstacle
causes neither event. The law counts the time without progress. The count pauses while a moving obstacle is near, at the
end of the path, and while the law stops because it does not know what is ahead (the output `stopped` reports this).
After the time `patience` without progress, the law sets the status `TRAPPED` permanently: the robot holds its position
and still avoids moving obstacles. If other depths are allowed, the robot tries these depths first (`control.layers`).

With a search limit (`sensing.Equipment.search_limit`, in seconds), a search of new places ends too, if the projection
on the path moves no further for this time. The time also counts while the law stops before unknown space.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from surctl.ir import Port
from surctl.marine.control.layers import layers_next
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.guidance import Contact

__all__ = ["DEAD_END_PORTS", "SEARCH_PORT", "dead_end_next", "standing"]

NEW = 0.1  # [m] smallest distance that counts as progress: several times the position uncertainty
NEAR = 1.5  # [m] clearance of a moving contact below which the robot waits for it
MOVES = 0.05  # [m/s] speed above which a contact counts as moving
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
    """Return the desired motion; after a dead end and during a change of depth, the robot holds its position.

    Args:
        desired: the motion along the path.
        x: state with `DEAD_END_PORTS`, and with `LAYER_PORTS` if other depths are allowed.
        eta: (4, 1) pose in {E}.
        p: parameters; the function uses `cruise`.
    """
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
        desired: the desired motion of this step.
        contacts: known obstacles that may move.
        x: state of the law.
        eta: (4, 1) pose in {E}.
        stopped: 1 while the law stops because it does not know what is ahead.
        p: parameters `patience` (0: never report a dead end) and `waypoints`; if other depths are allowed, also the
            parameters of `layers.aimed_depth`.
        nu: (4, 1) velocity in {B}; required if other depths are allowed.
        column: (2, 1) free water above and below the hull [m]; None: only the path's depth is allowed.
        dt: control period [s].
        limit: time without progress along the path [s] after which the law gives up; the next value of `SEARCH_PORT` is
            then returned too. None: no limit.
    """
    here = ca.vertcat(eta[0], eta[0], eta[1], eta[1])
    signs = ca.DM([-1, 1, -1, 1])
    grown = signs * (here - x["searched"])
    reached = x["progress"] + desired.x_e
    further = reached > x["furthest"] + NEW
    new = ca.logic_or(further, ca.mmax(grown) > NEW)
    near = ca.SX(0)
    for contact in contacts:
        moves = ca.sumsqr(contact.velocity) > MOVES**2
        near = ca.logic_or(near, ca.logic_and(moves, contact.clearance < NEAR))
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
    return layers_next(after, x, eta, nu, column, p, reached=reached, ended=ended)
