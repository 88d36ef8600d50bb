"""Dead ends: where the robot gets on neither along its path nor into new water, it says so and stands.

Getting on is one of two things: the projection on the path comes further than ever, or the box around all places since
then grows. A search that goes to and fro between the arms of a U does neither. The time without both is counted, but
not while something that moves is near, at the path's end, or while the law halts for want of knowledge, which it
reports by itself; after `patience` the robot is trapped, for good: it stays where it is, and still gives way to what
moves. Where other depths are allowed they are tried before (`control.layers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from surctl.control.layers import layers_next
from surctl.control.reference import DesiredMotion
from surctl.guidance import Contact
from surctl.ir import Port

__all__ = ["DEAD_END_PORTS", "dead_end_next", "standing"]

NEW = 0.1  # [m] by which the robot must get on; several times what its position is uncertain by
NEAR = 1.5  # [m] clearance within which something that moves is waited for
MOVES = 0.05  # [m/s] from which it does
ARRIVED = 0.2  # [m] from the path's end within which there is nowhere to get on to
HOLD = 0.5  # [1/s] gain with which the place is kept

DEAD_END_PORTS = (
    Port("furthest", (1,), "m", "arc length of the path that was reached at most", -100.0),
    Port("searched", (4,), "m", "x_min, x_max, y_min, y_max of the places since then; once trapped, the place to keep"),
    Port("stalled", (1,), "s", "time without getting on"),
    Port("trapped", (1,), "1", "1 from when the law gave up"),
)


def standing(desired: DesiredMotion, x: Mapping[str, ca.SX], eta: ca.SX, p: Mapping[str, ca.SX]) -> DesiredMotion:
    """The wish, or to stay where the robot gave up, or where it changes its depth.

    Args:
        wish: what it would do.
        x: state, `TRAP_PORTS` among it, and `LAYER_PORTS` where other depths are allowed.
        eta: (4, 1) pose in {E}.
        p: `cruise`.
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
) -> dict[str, ca.SX]:
    """`TRAP_PORTS` one control period later, and `LAYER_PORTS` where other depths are allowed.

    Args:
        wish: of this step.
        contacts: known ones that may move.
        x: state.
        eta: (4, 1) pose in {E}.
        halted: 1 while the law stands for want of knowledge.
        p: `patience`, 0 for never, and `waypoints`; for other depths what `layers.aimed_depth` needs.
        nu: (4, 1) velocity in {B}, for other depths.
        column: (2, 1) free water above and below the hull [m]; None: the path's depth alone.
        dt: control period [s].
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
    # in steps, so that a slow drift of the estimate is no progress, and a slow robot's is
    box = ca.if_else(grown > NEW, here, x["searched"])
    box = ca.if_else(further, here, box)
    box = ca.if_else(ca.logic_and(now, ca.logic_not(was)), here, ca.if_else(was, x["searched"], box))
    after = {
        "furthest": ca.if_else(further, reached, x["furthest"]),
        "searched": box,
        "stalled": stalled,
        "trapped": now,
    }
    if column is None or nu is None:
        return after
    return layers_next(after, x, eta, nu, column, p, reached=reached, ended=ended)
