"""Laws `guarded` and `calm`: the nearest velocity from which the robot can brake; waiting, retreat, unknown water.

Its tasks, in order of priority, are the velocity nearest to the desired velocity that no obstacle forbids, the depth,
and the heading. In the priority modes with inequalities, the barriers (speed bounds towards obstacles) are also
inequality constraints of the priority problem. With sonars, the robot turns continuously instead of holding a heading,
and it stops before unknown space.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeAlias

import casadi as ca

from surctl.ir import each, fold, tabulated
from surctl.marine.control.closing import (
    BRAKE,
    BRAKE_AT_START,
    EVADE,
    HARD,
    beside_margin,
    calm_parameters,
    eased,
    pushed,
)
from surctl.marine.control.decision import Decision, Scan, Situation, TaskLevel, lower_levels, weakest_acceleration
from surctl.marine.control.ports import LAUNCHED, SECTORS
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.control.stopping import BARRIERS, Stop, braked
from surctl.marine.guidance import FAR, SAME_CONTACT, Cone, Contact, Sector, inside
from surctl.marine.guidance.contacts import collision_cone
from surctl.marine.guidance.sectors import Bounds, choose_velocity, round_unknown, slowed
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import HalfPlane, velocity_task

_Margin: TypeAlias = Callable[[ca.SX], ca.SX]

_CRAWL = 0.01  # [m/s] commanded speed below which the robot counts as stopped
_GROPING = 0.5  # share of the cruise speed allowed in the direction of an untrusted sonar
_NO_BOUND = 10.0  # [m/s] a speed bound that never binds
_ONE_ENCOUNTER = 1e3  # [m] so large that two blocking contacts always belong to one encounter
_STALLED = 15.0  # [s] without progress, after which slower courses are excluded: creeping would look like progress
_RETURNS = 2.0  # [s] without progress, after which the robot returns and may change the side: see `choose_velocity`
_BACK_OFF = 0.05  # [m/s] largest speed away from a map mark; about half of the marks near the hull are false
_MOVES = 0.05  # [m/s] speed above which a contact counts as moving; for slower contacts the braking distance suffices
_PASSING = 0.1  # [m] clearance beyond the margin with which a moving contact is passed
_HORIZON = 12.0  # [s] prediction time for moving contacts
_BEHIND = 0.7  # cosine above which a contact comes from behind, so that the robot outruns it
_AFTER = 3.0  # [s] time after the robot's arrival up to which moving contacts are predicted
_URGENT = 4.0  # [s] time to a moving contact, below which the robot does not wait for unknown space
_DEEP = 0.01  # [m/s] distance of the velocity inside a collision cone, above which the robot does not wait
_WAITING = 0.5  # share of the chosen speed below which the robot counts as waiting for unknown space
_BESIDE = 0.03  # [m] distance from the path above which a detour around unknown space must not increase it


def guarded_law(s: Situation, calm: float | None = None) -> Decision:
    """Return the decision: of all velocities that no obstacle forbids, the one nearest to the desired velocity.

    The braking distance to each obstacle limits the closing speed. With sonars, the robot turns continuously, and its
    speed is limited so that it can stop before unknown space.

    With `calm`, the control period [s], a law with sonars (not one with true positions) changes its velocity reference
    gradually (`closing.eased`), and only the velocity loop brakes before unknown space. The output `stopped` is
    then judged by the decision before smoothing and braking.
    """
    desired, perceived, x, eta, nu, scan = s.desired, s.perceived, s.x, s.eta, s.nu, s.scan
    p = s.p if calm is None else calm_parameters(s.p)
    stop = BARRIERS[s.barrier](p, s.dt)
    moving = s.moving and s.movers == "predict"
    marks = len(perceived.known) - SECTORS if scan is not None else len(perceived.all)
    movers = min(marks, len(perceived.known)) if moving else 0
    sectors, cones = _movers(perceived.known[:movers], desired, eta, p, stop)
    over_ground = planar_rotation(eta[3]) @ nu[:2]
    away = ca.sumsqr(eta[:2] - p["waypoints"][0, :].T) > LAUNCHED**2
    mark_margin: _Margin | None = None
    if scan is not None and calm is not None:
        mark_margin = partial(beside_margin, course=desired.velocity, now=over_ground, full=ca.logic_not(away), p=p)
    for retreat, contacts, margin in (
        (_NO_BOUND, perceived.all[movers:marks], None),
        (_BACK_OFF, perceived.all[marks : len(perceived.known)], mark_margin),
        (_NO_BOUND, perceived.all[max(marks, len(perceived.known)) :], None),
    ):
        sectors += _standing(contacts, eta, p, stop, retreat=retreat, margin=margin)
    slower = None
    if scan is not None:  # near the start an obstacle may drift undetected: keep the clearance of the full speed there
        slower = ca.logic_and(ca.logic_and(scan.placed, away), x["stalled"] < _STALLED)
    choice = choose_velocity(
        desired.velocity,
        sectors,
        side=x["side"],
        blocker=x["blocker"],
        cruise=p["cruise"],
        cap=p["cap"],
        # the map represents a wall by points, and the blocking point jumps: one encounter lasts until nothing blocks
        same=SAME_CONTACT if scan is None else _ONE_ENCOUNTER,
        cones=cones,
        walls=perceived.walls,
        now=over_ground,
        acceleration=p["brake"] * weakest_acceleration(p),
        slower=slower,
        # with smoothed commands more runs touch (study 33)
        keeps=x["stalled"] < _RETURNS if scan is not None and calm is None else None,
    )
    velocity, stopped, memory = choice.velocity, ca.SX(0), {}
    named = [(f"contact_{k}", sector.normal, sector.bound) for k, sector in enumerate(sectors)]
    if scan is None:
        velocity = braked(velocity, over_ground, sectors)
    else:
        caution = _cautious_bounds(scan, stop, p)
        chased = fold(
            "chased", lambda other, row: ca.logic_or(other, row[2] < 0), ca.SX(0), tabulated(sectors[:marks], 5)
        )
        # while a contact blocks the desired velocity, a detour around unknown space would leave the chosen side
        past = round_unknown(velocity, caution[: scan.unknown.shape[0]], sectors, cones=cones)
        past = ca.if_else(ca.logic_or(choice.blocked, _strays(desired, past, stop)), velocity, past)
        cautious = slowed(past, caution)
        waits = ca.logic_and(ca.logic_not(choice.blocked), ca.sumsqr(cautious) < _WAITING**2 * ca.sumsqr(past))
        cautious = ca.if_else(waits, _back_first(desired, past, caution, sectors), cautious)

        def met(chased: ca.SX, row: ca.SX) -> ca.SX:
            cone = Cone.of(row)
            soon = ca.dot(cone.ahead, cautious) - cone.closing > cone.clearance / _URGENT
            return ca.logic_or(chased, ca.logic_and(soon, inside(cautious, cone) > _DEEP))

        chased = fold("met_soon", met, chased, tabulated(cones, 17))
        velocity = ca.if_else(chased, velocity, cautious)
        blind = ca.sum1(scan.sonars[:, 2]) < 0.5
        lost = ca.logic_or(blind, ca.logic_not(scan.placed))
        decided, firm = velocity, caution
        if calm is not None:
            fastest = ca.if_else(chased, _NO_BOUND, p["ramp"] * weakest_acceleration(p))
            time = ca.if_else(chased, EVADE, p["ease"])
            target = ca.if_else(lost, 0, velocity)
            velocity = eased(target, x["eased"], sectors, time=time, fastest=fastest, dt=calm)
            firm = []
            memory = {"eased": velocity, "pushed": pushed(velocity, x["eased"], x["pushed"], dt=calm)}
        brake = partial(braked, calm=ca.logic_not(chased))
        if calm is not None:
            brake = partial(brake, brake=ca.if_else(away, BRAKE, BRAKE_AT_START), hard=HARD)
        velocity = brake(velocity, over_ground, sectors[:marks])
        rest = [*((sector.normal, sector.bound) for sector in sectors[marks:]), *firm]
        velocity = brake(velocity, over_ground, rest, yields=ca.logic_not(chased))
        # the walls' normals are at right angles, so one projection after the other is exact
        for sector in sectors[-len(perceived.walls) :]:
            velocity -= ca.fmax(ca.dot(velocity, sector.normal) - sector.bound, 0) * sector.normal
        velocity = ca.if_else(lost, 0, velocity)
        slow = velocity if calm is None else decided
        crawling = ca.logic_and(ca.sumsqr(slow) < _CRAWL**2, ca.sumsqr(choice.velocity) > (2 * _CRAWL) ** 2)
        stopped = ca.logic_or(lost, crawling)
        named += [(f"unknown_{k}", normal, bound) for k, (normal, bound) in enumerate(caution)]
    to_body = planar_rotation(eta[3]).T
    rows = [
        HalfPlane(name, ca.horzcat((to_body @ normal).T, 0, 0), bound, kind="barrier") for name, normal, bound in named
    ]
    return Decision(
        [TaskLevel.of(velocity_task(eta, velocity)), *lower_levels(eta, desired, p, scan, choice.side)],
        rows,
        velocity,
        choice.blocked,
        choice.violation > 0.02,
        {"side": choice.side, "blocker": choice.blocker, "last_velocity": velocity, **memory},
        stopped,
    )


def _back_first(desired: DesiredMotion, velocity: ca.SX, caution: Bounds, bounds: Bounds) -> ca.SX:
    """Return a velocity within the speed bounds `caution`; its component back to the path is reduced separately.

    Unknown space ahead need not slow down the component back to the path. The separate reduction changes the course, so
    the speed bounds of the obstacles (`bounds`) are applied again.
    """
    sideways = ca.vertcat(-desired.tangent[1], desired.tangent[0])
    across = ca.dot(sideways, velocity)
    back = slowed(ca.if_else(across * desired.y_e < 0, across, 0) * sideways, caution)
    return slowed(back + slowed(velocity - back, caution, added=back), bounds)


def _strays(desired: DesiredMotion, velocity: ca.SX, stop: Stop) -> ca.SX:
    """Return whether a velocity away from the path is too fast for the robot to stop within `_BESIDE` of the path."""
    across = desired.tangent[0] * velocity[1] - desired.tangent[1] * velocity[0]
    distance = _BESIDE - ca.if_else(across < 0, -desired.y_e, desired.y_e)
    return ca.fabs(across) > ca.fmax(stop(distance, ca.SX(0)), 0)


def _cautious_bounds(scan: Scan, stop: Stop, p: Mapping[str, ca.SX]) -> list[tuple[ca.SX, ca.SX]]:
    # (normal, largest speed along the normal), for unknown space and for untrusted sonars
    def before(row: ca.SX) -> tuple[ca.SX]:
        return (ca.vertcat(row[:2], ca.fmax(stop(ca.fmax(row[2], 0), ca.SX(0)), 0)),)

    (table,) = each("unknown_bound", before, scan.unknown)
    bounds = [(table[k, :2].T, table[k, 2]) for k in range(table.shape[0])]
    for k in range(scan.sonars.shape[0]):
        slow = ca.if_else(scan.sonars[k, 2] > 0.5, _NO_BOUND, _GROPING * p["cruise"])
        bounds.append((scan.sonars[k, 4:6].T, slow))
    return bounds


def _movers(
    contacts: Sequence[Contact], desired: DesiredMotion, eta: ca.SX, p: Mapping[str, ca.SX], stop: Stop
) -> tuple[list[Sector], list[Cone]]:
    """Return, for obstacles that may move, the sectors of blocked courses and the collision cones.

    The robot either avoids the obstacle's collision cone, or limits its closing speed by the braking distance.
    """

    def both(row: ca.SX) -> tuple[ca.SX, ca.SX]:
        contact = Contact.of(row)
        normal, bound, point = _sector(contact, eta, p, stop)
        evaded = _evaded(contact, desired)
        bound = ca.if_else(ca.logic_and(evaded, contact.clearance > p["margin"]), _NO_BOUND, bound)
        return ca.vertcat(normal, bound, point), ca.vertcat(*_cone(contact, evaded, point, eta, p))

    if not contacts:
        return [], []
    sectors, cones = each("mover", both, tabulated(contact.row for contact in contacts))
    count = range(len(contacts))
    return [Sector.of(sectors[k, :].T) for k in count], [Cone.of(cones[k, :].T) for k in count]


def _standing(
    contacts: Sequence[Contact],
    eta: ca.SX,
    p: Mapping[str, ca.SX],
    stop: Stop,
    *,
    retreat: float,
    margin: _Margin | None = None,
) -> list[Sector]:
    """Return, for obstacles at rest, the sectors of courses that the braking distance blocks.

    If an obstacle is closer than the margin, the robot moves away from the obstacle at no more than `retreat` [m/s].
    `margin` is the margin [m] as a function of the unit vector to the obstacle; None: the gain `margin`.
    """

    def one(row: ca.SX) -> tuple[ca.SX]:
        contact = Contact.of(row)
        distance = p["margin"] if margin is None else margin(contact.normal)
        normal, bound, point = _sector(contact, eta, {**p, "margin": distance}, stop)
        return (ca.vertcat(normal, bound if retreat >= _NO_BOUND else ca.fmax(bound, -retreat), point),)

    if not contacts:
        return []
    (table,) = each("contact", one, tabulated(contact.row for contact in contacts))
    return [Sector.of(table[k, :].T) for k in range(len(contacts))]


def _sector(contact: Contact, eta: ca.SX, p: Mapping[str, ca.SX], stop: Stop) -> Sector:
    point = eta[:2] + (contact.clearance + p["hull"]) * contact.normal
    return Sector(contact.normal, stop(contact.clearance - p["margin"], contact.closing), point)


def _evaded(contact: Contact, desired: DesiredMotion) -> ca.SX:
    # the robot evades a moving contact sideways, but outruns a contact that comes from behind
    speed = ca.sqrt(ca.sumsqr(desired.velocity))
    ahead = ca.dot(desired.velocity, contact.normal) > -_BEHIND * speed
    moves = ca.logic_and(ca.sumsqr(contact.velocity) > _MOVES**2, contact.clearance < FAR)
    return ca.logic_and(moves, ahead)


def _cone(contact: Contact, evaded: ca.SX, point: ca.SX, eta: ca.SX, p: Mapping[str, ca.SX]) -> Cone:
    # velocities that meet the contact within the horizon and before the mission's end
    left = ca.sqrt(ca.sumsqr(p["waypoints"][-1, :].T - eta[:2]))
    return collision_cone(
        contact,
        apart=p["margin"] + _PASSING,
        standoff=p["margin"],
        horizon=ca.fmin(_HORIZON, _AFTER + left / p["cruise"]),
        there=evaded,
        point=point,
    )
