"""The guarded law: the path's wish, bent around every contact by the braking barrier, then depth, then heading.

The same barriers stand as rows for the priority modes that take inequalities. With sonars it turns, in place of a
heading, and stops before what it knows nothing of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from surctl.control.decision import Decision, Scan, TaskLevel, lower_levels, weakest_acceleration
from surctl.control.echoes import Perception
from surctl.control.ports import SECTORS
from surctl.control.reference import DesiredMotion
from surctl.control.stopping import Bounds, Stop, braked
from surctl.guidance import (
    FAR,
    SAME_CONTACT,
    Cone,
    Contact,
    Sector,
    choose_velocity,
    collision_cone,
    inside,
    round_unknown,
    slowed,
)
from surctl.ir import each, fold, tabulated
from surctl.tasks import HalfPlane, velocity_task
from surctl.vehicle import planar_rotation

__all__ = ["guarded_law"]

_CRAWL = 0.01  # [m/s] below which it stands
_GROPING = 0.5  # of the cruise speed: most towards where a sonar is not to be believed
_NO_BOUND = 10.0  # [m/s]
_ONE_ENCOUNTER = 1e3  # [m]
_LAUNCHED = 0.3  # [m] from the start within which what stood in the sonars' blind range was perhaps never ranged
_STALLED = 15.0  # [s] without getting on; then no slower course: creeping about a dead end would look like getting on
_BACK_OFF = 0.05  # [m/s] with which the robot backs off from a mark; half of what is marked near the hull is not there
_MOVES = 0.05  # [m/s] from which something moves: slower things are kept off by their braking distance
_PASSING = 0.1  # [m] beyond the margin, at which something that moves is passed
_HORIZON = 12.0  # [s] ahead for which it is
_BEHIND = 0.7  # cosine from which something comes from behind: it is outrun
_AFTER = 3.0  # [s] after the arrival for which it is
_URGENT = 4.0  # [s] before it is met
_DEEP = 0.01  # [m/s] in a cone at which the robot goes on where it would wait to look
_WAITING = 0.5  # share of its speed below which it waits for what is unknown
_BESIDE = 0.03  # [m] off the path from which a way past the unknown must not lead further off


def guarded_law(
    desired: DesiredMotion,
    perceived: Perception,
    x: Mapping[str, ca.SX],
    eta: ca.SX,
    nu: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    stop: Stop,
    scan: Scan | None = None,
    moving: bool = True,
) -> Decision:
    """Path wish on the free course nearest to it; every contact bounds the closing speed by its braking distance.

    With sonars it turns all the time, and goes only where it can stop before the first place it knows nothing of.
    """
    marks = len(perceived.known) - SECTORS if scan is not None else len(perceived.all)
    movers = min(marks, len(perceived.known)) if moving else 0
    sectors, cones = _movers(perceived.known[:movers], desired, eta, p, stop)
    for retreat, contacts in (
        (_NO_BOUND, perceived.all[movers:marks]),
        (_BACK_OFF, perceived.all[marks : len(perceived.known)]),
        (_NO_BOUND, perceived.all[max(marks, len(perceived.known)) :]),
    ):
        sectors += _standing(contacts, eta, p, stop, retreat=retreat)
    over_ground = planar_rotation(eta[3]) @ nu[:2]
    slower = None
    if scan is not None:  # what drifts beside the start unheard is passed with the room that the whole speed asks for
        away = ca.sumsqr(eta[:2] - p["waypoints"][0, :].T) > _LAUNCHED**2
        slower = ca.logic_and(ca.logic_and(scan.placed, away), x["stalled"] < _STALLED)
    choice = choose_velocity(
        desired.velocity,
        sectors,
        side=x["side"],
        blocker=x["blocker"],
        cruise=p["cruise"],
        cap=p["cap"],
        # of a wall the map knows points, so the blocker jumps: one encounter lasts as long as the wish is blocked
        same=SAME_CONTACT if scan is None else _ONE_ENCOUNTER,
        cones=cones,
        walls=perceived.walls,
        now=over_ground,
        acceleration=p["brake"] * weakest_acceleration(p),
        slower=slower,
    )
    velocity, stopped = choice.velocity, ca.SX(0)
    bounds = [(sector.normal, sector.bound) for sector in sectors]
    named = [(f"contact_{k}", *bound) for k, bound in enumerate(bounds)]
    if scan is None:
        velocity = braked(velocity, over_ground, bounds)
    else:
        caution = _cautious_bounds(scan, stop, p)
        chased = fold(
            "chased", lambda other, row: ca.logic_or(other, row[2] < 0), ca.SX(0), tabulated(sectors[:marks], 5)
        )
        # beside what blocks the wish, a way past the unknown would leave the side that is latched
        past = round_unknown(velocity, caution[: scan.unknown.shape[0]], sectors, cones=cones)
        past = ca.if_else(ca.logic_or(choice.blocked, _strays(desired, past, stop)), velocity, past)
        cautious = slowed(past, caution)
        waits = ca.logic_and(ca.logic_not(choice.blocked), ca.sumsqr(cautious) < _WAITING**2 * ca.sumsqr(past))
        cautious = ca.if_else(waits, _back_first(desired, past, caution, bounds), cautious)

        def met(chased: ca.SX, row: ca.SX) -> ca.SX:
            cone = Cone.of(row)
            soon = ca.dot(cone.ahead, cautious) - cone.closing > cone.clearance / _URGENT
            return ca.logic_or(chased, ca.logic_and(soon, inside(cautious, cone) > _DEEP))

        chased = fold("met_soon", met, chased, tabulated(cones, 17))
        velocity = ca.if_else(chased, velocity, cautious)
        blind = ca.sum1(scan.sonars[:, 2]) < 0.5
        calm = ca.logic_not(chased)
        velocity = braked(velocity, over_ground, bounds[:marks], calm=calm)
        velocity = braked(velocity, over_ground, [*bounds[marks:], *caution], calm=calm)
        for sector in sectors[
            -len(perceived.walls) :
        ]:  # whose normals are at right angles: one after the other is exact
            velocity -= ca.fmax(ca.dot(velocity, sector.normal) - sector.bound, 0) * sector.normal
        lost = ca.logic_or(blind, ca.logic_not(scan.placed))
        velocity = ca.if_else(lost, 0, velocity)
        crawling = ca.logic_and(ca.sumsqr(velocity) < _CRAWL**2, ca.sumsqr(choice.velocity) > (2 * _CRAWL) ** 2)
        stopped = ca.logic_or(lost, crawling)
        named += [(f"unknown_{k}", normal, bound) for k, (normal, bound) in enumerate(caution)]
    to_body = planar_rotation(eta[3]).T
    rows = [
        HalfPlane(name, ca.horzcat((to_body @ normal).T, 0, 0), bound, kind="barrier") for name, normal, bound in named
    ]
    return Decision(
        [TaskLevel.of(velocity_task(eta, velocity)), *lower_levels(eta, desired, p, scan)],
        rows,
        velocity,
        choice.blocked,
        choice.violation > 0.02,
        {"side": choice.side, "blocker": choice.blocker, "last_velocity": velocity},
        stopped,
    )


def _back_first(desired: DesiredMotion, velocity: ca.SX, caution: Bounds, bounds: Bounds) -> ca.SX:
    """As slow as caution asks, but what leads back to the path last: that need not wait for what is unknown ahead.

    The course turns by that, and keeps the other bounds once more.
    """
    sideways = ca.vertcat(-desired.tangent[1], desired.tangent[0])
    across = ca.dot(sideways, velocity)
    back = slowed(ca.if_else(across * desired.y_e < 0, across, 0) * sideways, caution)
    ahead = slowed(velocity - back, [(n, ca.fmax(bound - ca.dot(n, back), 0)) for n, bound in caution])
    return slowed(back + ahead, [(n, ca.fmax(bound, 0)) for n, bound in bounds])


def _strays(desired: DesiredMotion, velocity: ca.SX, stop: Stop) -> ca.SX:
    """Whether a velocity leads off the path, where the robot already is beside it or could not stop before it is."""
    across = desired.tangent[0] * velocity[1] - desired.tangent[1] * velocity[0]
    distance = _BESIDE - ca.if_else(across < 0, -desired.y_e, desired.y_e)
    return ca.fabs(across) > ca.fmax(stop(distance, ca.SX(0)), 0)


def _cautious_bounds(scan: Scan, stop: Stop, p: Mapping[str, ca.SX]) -> list[tuple[ca.SX, ca.SX]]:
    """(normal, largest speed along it): stop before what is unknown, slow where a sonar is not to be trusted."""

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
    """What may move: evaded by its cone, or kept off by its braking distance."""

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
    contacts: Sequence[Contact], eta: ca.SX, p: Mapping[str, ca.SX], stop: Stop, *, retreat: float
) -> list[Sector]:
    """What stands: kept off by its braking distance; from too near the robot backs off with `retreat` [m/s] at most."""

    def one(row: ca.SX) -> tuple[ca.SX]:
        normal, bound, point = _sector(Contact.of(row), eta, p, stop)
        return (ca.vertcat(normal, bound if retreat >= _NO_BOUND else ca.fmax(bound, -retreat), point),)

    if not contacts:
        return []
    (table,) = each("contact", one, tabulated(contact.row for contact in contacts))
    return [Sector.of(table[k, :].T) for k in range(len(contacts))]


def _sector(contact: Contact, eta: ca.SX, p: Mapping[str, ca.SX], stop: Stop) -> Sector:
    point = eta[:2] + (contact.clearance + p["hull"]) * contact.normal
    return Sector(contact.normal, stop(contact.clearance - p["margin"], contact.closing), point)


def _evaded(contact: Contact, desired: DesiredMotion) -> ca.SX:
    """Whether a contact moves and does not come from behind: then it is evaded sideways, else outrun."""
    speed = ca.sqrt(ca.sumsqr(desired.velocity))
    ahead = ca.dot(desired.velocity, contact.normal) > -_BEHIND * speed
    moves = ca.logic_and(ca.sumsqr(contact.velocity) > _MOVES**2, contact.clearance < FAR)
    return ca.logic_and(moves, ahead)


def _cone(contact: Contact, evaded: ca.SX, point: ca.SX, eta: ca.SX, p: Mapping[str, ca.SX]) -> Cone:
    """Velocities that meet the contact before the mission is over, or soon."""
    left = ca.sqrt(ca.sumsqr(p["waypoints"][-1, :].T - eta[:2]))
    return collision_cone(
        contact,
        apart=p["margin"] + _PASSING,
        standoff=p["margin"],
        horizon=ca.fmin(_HORIZON, _AFTER + left / p["cruise"]),
        there=evaded,
        point=point,
    )
