"""The two laws: which tasks, in which order, and what they ask for.

`guarded`: path wish, bent around every contact by the braking barrier (`guidance.sectors`), then depth, then heading;
the same barriers stand as rows for the priority modes that take inequalities.
`paper`: each sensor a sub-task σ_i = l_dm,i in order of urgency, below them the avoidance velocity (20) or the cruise
velocity, then depth and heading (III-B to III-D).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca
import numpy as np

from surctl.control.echoes import Perception
from surctl.control.ports import SECTORS
from surctl.control.reference import Wish
from surctl.control.stopping import Bounds, Stop, braked
from surctl.guidance import (
    FAR,
    SAME_CONTACT,
    AvoidanceForm,
    Cone,
    Contact,
    Sector,
    avoidance_course,
    choose_velocity,
    collision_cone,
    encounter_side,
    inside,
    nearest_in_quadrants,
    round_unknown,
    slowed,
)
from surctl.ir import Port
from surctl.tasks import HalfPlane, Task, depth_task, heading_task, velocity_task
from surctl.vehicle import planar_rotation

__all__ = ["DECISION_PORTS", "Decision", "Scan", "guarded_law", "look_around", "paper_law"]

DECISION_PORTS = (
    Port("side", (1,), "1", "latched passing side: 0 none, +1 obstacle on the right, -1 on the left"),
    Port("blocker", (2,), "m", "what blocked the wish at the last step, x, y in {E}"),
    Port("last_velocity", (2,), "m/s", "horizontal velocity commanded at the last step, in {E}"),
)

_SENSE_RANGE = 1.0  # [m] below which a sensor sub-task may act
_CRAWL = 0.01  # [m/s] below which it stands
_GROPING = 0.5  # of the cruise speed: most towards where a sonar is not to be believed
_NO_BOUND = 10.0  # [m/s]
_ONE_ENCOUNTER = 1e3  # [m]
_LAUNCHED = 0.3  # [m] from the start within which what stood in the sonars' blind range was perhaps never ranged
_STALLED = 15.0  # [s] without getting on; then no slower course: creeping about a dead end would look like getting on
_GIVE_WAY = 0.05  # [m/s] with which the robot backs off from a mark; half of what is marked near the hull is not there
_MOVES = 0.05  # [m/s] from which something moves: slower things are kept off by their braking distance
_PASSING = 0.1  # [m] beyond the margin, at which something that moves is passed
_HORIZON = 12.0  # [s] ahead for which it is
_BEHIND = 0.7  # cosine from which something comes from behind: it is outrun
_AFTER = 3.0  # [s] after the arrival for which it is
_URGENT = 4.0  # [s] before it is met
_DEEP = 0.01  # [m/s] in a cone at which the robot goes on where it would wait to look
_WAITING = 0.5  # share of its speed below which it waits for what is unknown
_BESIDE = 0.03  # [m] off the path from which a way past the unknown must not lead further off
_OVERTAKE = 0.02  # [m/s] by which the avoidance speed exceeds the obstacle's


class Wanted(NamedTuple):
    """A priority level in symbols: J ν should be `reference` (k, 1) [unit]; J (k, 4)."""

    name: str
    J: ca.SX
    reference: ca.SX
    unit: str

    @staticmethod
    def of(task: Task) -> Wanted:
        """What a task asks for."""
        return Wanted(task.name, task.jacobian(), task.reference(), task.rate_unit)


@dataclass(frozen=True)
class Decision:
    """What a law asks the priority solver for.

    Attributes:
        levels: tasks, highest first; a level may be switched off by a zero Jacobian and reference.
        rows: barriers on ν for modes that take inequalities.
        velocity: horizontal velocity asked for (2, 1) in {E} [m/s].
        avoiding: 1 while a contact changes the wish.
        degraded: 1 when no course satisfied every contact.
        state: next state by port name.
        halted: 1 while it stands, or nearly so, because it does not know what is ahead.
    """

    levels: Sequence[Wanted]
    rows: Sequence[HalfPlane]
    velocity: ca.SX
    avoiding: ca.SX
    degraded: ca.SX
    state: dict[str, ca.SX]
    halted: ca.SX = field(default_factory=lambda: ca.SX(0))


class Scan(NamedTuple):
    """What a law that scans is told beside the contacts, as `ports.scan_inputs` has it."""

    unknown: ca.SX
    heard: ca.SX
    placed: ca.SX


def look_around(p: Mapping[str, ca.SX]) -> Wanted:
    """The lowest level of a law with sonars: to turn all the time, with `spin` or as fast as the yaw thrust holds."""
    return Wanted("scan", ca.SX([[0, 0, 0, 1]]), ca.fmin(ca.fmax(p["spin_limit"], -p["spin"]), p["spin"]), "rad/s")


def guarded_law(
    wish: Wish,
    seen: Perception,
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
    marks = len(seen.known) - SECTORS if scan is not None else len(seen.all)
    sectors, cones = [], []
    for k, c in enumerate(seen.all):
        bound = stop(c.clearance - p["margin"], c.closing)
        point = eta[:2] + (c.clearance + p["hull"]) * c.normal
        if marks <= k < len(seen.known):
            bound = ca.fmax(bound, -_GIVE_WAY)
        elif moving and k < len(seen.known):
            evaded = _evaded(c, wish)
            bound = ca.if_else(ca.logic_and(evaded, c.clearance > p["margin"]), _NO_BOUND, bound)
            cones.append(_cone(c, evaded, point, eta, p))
        sectors.append(Sector(c.normal, bound, point))
    over_ground = planar_rotation(eta[3]) @ nu[:2]
    slower = None
    if scan is not None:  # what drifts beside the start unheard is passed with the room that the whole speed asks for
        away = ca.sumsqr(eta[:2] - p["waypoints"][0, :].T) > _LAUNCHED**2
        slower = ca.logic_and(ca.logic_and(scan.placed, away), x["stalled"] < _STALLED)
    choice = choose_velocity(
        wish.velocity,
        sectors,
        side=x["side"],
        blocker=x["blocker"],
        cruise=p["cruise"],
        cap=p["cap"],
        # of a wall the map knows points, so the blocker jumps: one encounter lasts as long as the wish is blocked
        same=SAME_CONTACT if scan is None else _ONE_ENCOUNTER,
        cones=cones,
        walls=seen.walls,
        now=over_ground,
        acceleration=p["brake"] * _acceleration(p),
        slower=slower,
    )
    velocity, halted = choice.velocity, ca.SX(0)
    bounds = [(sector.normal, sector.bound) for sector in sectors]
    named = [(f"contact_{k}", *bound) for k, bound in enumerate(bounds)]
    levels = [Wanted.of(task) for task in lower_tasks(eta, wish, p)]
    if scan is None:
        velocity = braked(velocity, over_ground, bounds)
    else:
        caution = _cautious_bounds(scan, stop, p)
        chased = ca.SX(0)
        for sector in sectors[:marks]:
            chased = ca.logic_or(chased, sector.bound < 0)
        # beside what blocks the wish, a way past the unknown would leave the side that is latched
        past = round_unknown(velocity, caution[: scan.unknown.shape[0]], sectors, cones=cones)
        past = ca.if_else(ca.logic_or(choice.blocked, _strays(wish, past, stop)), velocity, past)
        cautious = slowed(past, caution)
        waits = ca.logic_and(ca.logic_not(choice.blocked), ca.sumsqr(cautious) < _WAITING**2 * ca.sumsqr(past))
        cautious = ca.if_else(waits, _back_first(wish, past, caution, bounds), cautious)
        for cone in cones:
            soon = ca.dot(cone.ahead, cautious) - cone.closing > cone.room / _URGENT
            chased = ca.logic_or(chased, ca.logic_and(soon, inside(cautious, cone) > _DEEP))
        velocity = ca.if_else(chased, velocity, cautious)
        blind = ca.sum1(scan.heard[:, 2]) < 0.5
        calm = ca.logic_not(chased)
        velocity = braked(velocity, over_ground, bounds[:marks], calm=calm)
        velocity = braked(velocity, over_ground, [*bounds[marks:], *caution], calm=calm)
        for sector in sectors[-len(seen.walls) :]:  # whose normals are at right angles: one after the other is exact
            velocity -= ca.fmax(ca.dot(velocity, sector.normal) - sector.bound, 0) * sector.normal
        lost = ca.logic_or(blind, ca.logic_not(scan.placed))
        velocity = ca.if_else(lost, 0, velocity)
        kept = ca.logic_and(ca.sumsqr(velocity) < _CRAWL**2, ca.sumsqr(choice.velocity) > (2 * _CRAWL) ** 2)
        halted = ca.logic_or(lost, kept)
        named += [(f"unknown_{k}", normal, bound) for k, (normal, bound) in enumerate(caution)]
        depth = levels[0]._replace(reference=ca.if_else(scan.placed, levels[0].reference, 0))
        levels = [depth, look_around(p)]
    to_body = planar_rotation(eta[3]).T
    rows = [
        HalfPlane(name, ca.horzcat((to_body @ normal).T, 0, 0), bound, kind="barrier") for name, normal, bound in named
    ]
    return Decision(
        [Wanted.of(velocity_task(eta, velocity)), *levels],
        rows,
        velocity,
        choice.blocked,
        choice.violation > 0.02,
        {"side": choice.side, "blocker": choice.blocker, "last_velocity": velocity},
        halted,
    )


def _back_first(wish: Wish, velocity: ca.SX, caution: Bounds, bounds: Bounds) -> ca.SX:
    """As slow as caution asks, but what leads back to the path last: that need not wait for what is unknown ahead.

    The course turns by that, and keeps the other bounds once more.
    """
    sideways = ca.vertcat(-wish.tangent[1], wish.tangent[0])
    across = ca.dot(sideways, velocity)
    back = slowed(ca.if_else(across * wish.y_e < 0, across, 0) * sideways, caution)
    ahead = slowed(velocity - back, [(n, ca.fmax(bound - ca.dot(n, back), 0)) for n, bound in caution])
    return slowed(back + ahead, [(n, ca.fmax(bound, 0)) for n, bound in bounds])


def _strays(wish: Wish, velocity: ca.SX, stop: Stop) -> ca.SX:
    """Whether a velocity leads off the path, where the robot already is beside it or could not stop before it is."""
    across = wish.tangent[0] * velocity[1] - wish.tangent[1] * velocity[0]
    room = _BESIDE - ca.if_else(across < 0, -wish.y_e, wish.y_e)
    return ca.fabs(across) > ca.fmax(stop(room, ca.SX(0)), 0)


def _cautious_bounds(scan: Scan, stop: Stop, p: Mapping[str, ca.SX]) -> list[tuple[ca.SX, ca.SX]]:
    """(normal, largest speed along it): stop before what is unknown, slow where a sonar is not to be trusted."""
    bounds = []
    for k in range(scan.unknown.shape[0]):
        normal, clearance = scan.unknown[k, :2].T, scan.unknown[k, 2]
        bounds.append((normal, ca.fmax(stop(ca.fmax(clearance, 0), ca.SX(0)), 0)))
    for k in range(scan.heard.shape[0]):
        slow = ca.if_else(scan.heard[k, 2] > 0.5, _NO_BOUND, _GROPING * p["cruise"])
        bounds.append((scan.heard[k, 4:6].T, slow))
    return bounds


def paper_law(
    form: AvoidanceForm,
    wish: Wish,
    seen: Perception,
    x: Mapping[str, ca.SX],
    eta: ca.SX,
    p: Mapping[str, ca.SX],
    *,
    dt: float,
) -> Decision:
    """The printed stack, made definite: sensor sub-tasks by urgency, (20) or cruise, depth, heading."""
    heading = ca.vertcat(ca.cos(eta[3]), ca.sin(eta[3]))
    left = ca.vertcat(-heading[1], heading[0])
    sensed = nearest_in_quadrants(seen.all, [heading, left, -heading, -left])
    closing = [_sub_task_speed(c, p) for c in sensed]
    threat = [
        ca.logic_and(c.clearance - p["margin"] < _SENSE_RANGE, ca.dot(wish.velocity, c.normal) > v)
        for c, v in zip(sensed, closing, strict=True)
    ]
    avoiding = threat[0]
    for other in threat[1:]:
        avoiding = ca.logic_or(avoiding, other)
    velocity, side = _avoidance_velocity(form, wish, _most_urgent(sensed, threat, wish), avoiding, x, p, dt=dt)
    levels = _by_urgency(sensed, closing, velocity, eta, p)
    lower = (velocity_task(eta, velocity), *lower_tasks(eta, wish, p))
    return Decision(
        [*levels, *(Wanted.of(task) for task in lower)],
        [],
        velocity,
        avoiding,
        ca.SX(0),
        {"side": side, "blocker": x["blocker"], "last_velocity": velocity},
    )


def _evaded(contact: Contact, wish: Wish) -> ca.SX:
    """Whether a contact moves and does not come from behind: then it is evaded sideways, else outrun."""
    speed = ca.sqrt(ca.sumsqr(wish.velocity))
    ahead = ca.dot(wish.velocity, contact.normal) > -_BEHIND * speed
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


def lower_tasks(eta: ca.SX, wish: Wish, p: Mapping[str, ca.SX]) -> tuple[Task, Task]:
    return (
        depth_task(eta, p["depth"], gain=p["k2"]),
        heading_task(eta, wish.heading, gain=p["k_psi"]),
    )


def _acceleration(p: Mapping[str, ca.SX]) -> ca.SX:
    """What the horizontal thrust gives at the least [m/s²]."""
    return ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1]) / ca.fmax(p["mass"][0], p["mass"][1])


def _sub_task_speed(contact: Contact, p: Mapping[str, ca.SX]) -> ca.SX:
    """Speed towards the contact that σ̇ = −κ σ asks for [m/s]."""
    return p["kappa"] * (contact.clearance - p["margin"])


def _urgency(contact: Contact, speed: ca.SX) -> ca.SX:
    """Time to contact [s], smallest first; a contact that is not approached is never urgent."""
    rate = ca.fmax(speed - contact.closing, 1e-3)
    return ca.fmax(contact.clearance, 0) / rate


def _most_urgent(sensed: Sequence[Contact], threat: Sequence[ca.SX], wish: Wish) -> Contact:
    best, least = sensed[0], ca.SX(1e6)
    for contact, active in zip(sensed, threat, strict=True):
        time = ca.if_else(active, _urgency(contact, ca.dot(wish.velocity, contact.normal)), 1e6)
        take = time < least
        best = Contact(*(ca.if_else(take, a, b) for a, b in zip(_fields(contact), _fields(best), strict=True)))
        least = ca.fmin(time, least)
    return best


def _fields(contact: Contact) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    return contact.normal, contact.clearance, contact.velocity, contact.reach


def _avoidance_velocity(
    form: AvoidanceForm,
    wish: Wish,
    contact: Contact,
    avoiding: ca.SX,
    x: Mapping[str, ca.SX],
    p: Mapping[str, ca.SX],
    *,
    dt: float,
) -> tuple[ca.SX, ca.SX]:
    """(20) with λ2 latched for the encounter, inside the window (19); and the next λ2."""
    met = encounter_side(wish.velocity - contact.velocity, contact.normal)
    side = ca.if_else(ca.fabs(x["side"]) > 0.5, x["side"], met)
    speed = ca.fmin(p["cap"], ca.fmax(p["cruise"], ca.sqrt(ca.sumsqr(contact.velocity)) + _OVERTAKE))
    course = avoidance_course(
        form,
        ca.atan2(contact.normal[1], contact.normal[0]),
        contact.clearance - p["margin"],
        radius=contact.reach + p["margin"],
        side=side,
        delta=p["delta"],
        k3=p["k3"],
        speed=speed,
        closing=contact.closing,
        kappa=p["kappa"],
        standoff=ca.SX(0),
    )
    velocity = _window(speed, course, x["last_velocity"], contact.reach + p["margin"], p, dt=dt)
    return ca.if_else(avoiding, velocity, wish.velocity), ca.if_else(avoiding, side, 0)


def _window(speed: ca.SX, course: ca.SX, last: ca.SX, radius: ca.SX, p: Mapping[str, ca.SX], *, dt: float) -> ca.SX:
    """The window (19): speed within a·t, course within √(a/R_OB)·t (E17) of the last command."""
    acceleration = _acceleration(p)
    previous = ca.sqrt(ca.sumsqr(last))
    step = acceleration * dt
    allowed = ca.fmin(ca.fmax(speed, previous - step), previous + step)
    turn = course - ca.atan2(last[1], last[0])
    turn = turn - 2 * np.pi * ca.floor((turn + np.pi) / (2 * np.pi))
    widest = ca.sqrt(acceleration / radius) * dt
    # a robot that hardly moves has no course to stay near
    turn = ca.if_else(previous > 0.02, ca.fmin(ca.fmax(turn, -widest), widest), turn)
    course = ca.atan2(last[1], last[0]) + turn
    return allowed * ca.vertcat(ca.cos(course), ca.sin(course))


def _by_urgency(
    sensed: Sequence[Contact], closing: Sequence[ca.SX], lower: ca.SX, eta: ca.SX, p: Mapping[str, ca.SX]
) -> list[Wanted]:
    """Sensor sub-tasks sorted by time to contact (ties: front, left, rear, right); inactive ones are zero rows."""
    to_body = planar_rotation(eta[3]).T
    entries = []
    for contact, wanted in zip(sensed, closing, strict=True):
        near = contact.clearance - p["margin"] < _SENSE_RANGE
        active = ca.logic_and(near, ca.dot(lower, contact.normal) > wanted)
        row = ca.horzcat(-(to_body @ contact.normal).T, 0, 0)
        time = ca.if_else(active, _urgency(contact, ca.dot(lower, contact.normal)), 1e6)
        entries.append([time, ca.if_else(active, row, ca.SX.zeros(1, 4)), ca.if_else(active, -wanted, 0)])
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3), (1, 2)):  # sorting network for four
        swap = entries[j][0] < entries[i][0]
        first = [ca.if_else(swap, b, a) for a, b in zip(entries[i], entries[j], strict=True)]
        second = [ca.if_else(swap, a, b) for a, b in zip(entries[i], entries[j], strict=True)]
        entries[i], entries[j] = first, second
    return [Wanted(f"sensor_{k + 1}", row, reference, "m/s") for k, (_, row, reference) in enumerate(entries)]
