"""Laws of study 41: `guarded` and a fan of courses by exact positions, with an injected error of the obstacles.

Named `laws.py:guarded` and `laws.py:fan`. The gains `budget`, `wander` and `lag` set what the law believes:

- `budget` [m]: each obstacle is believed nearer than it is, as by a map with this error budget;
- `wander` [m]: amplitude of a slow error of the clearance, of either sign, with another phase for each obstacle;
- `lag` [s]: the believed centre of an obstacle follows the true centre with this time constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, pi, sin

import casadi as ca

from surctl.ir import Port, fold, tabulated
from surctl.marine.control import Decision, GainSpec, LawSource, Situation, TaskLevel
from surctl.marine.control.decision import lower_levels
from surctl.marine.control.registry import LAWS
from surctl.marine.control.stopping import BARRIERS, braked
from surctl.marine.guidance import Contact
from surctl.marine.vehicle import planar_rotation
from surctl.tasks import velocity_task

SLOTS = 4  # obstacles of the static scenarios
PERIOD = 10.0  # s of the slow error; a run among obstacles takes 20 to 60 s
HALF_FAN = 26  # courses on each side of the desired one, 5 degrees apart: up to 130 degrees
KEEPS = 0.4  # weight of the last course beside the desired one
RETREAT = 0.05  # m/s, largest speed away from an obstacle
GAINS = {
    "budget": GainSpec("m", "by which obstacles are believed nearer than they are", default=0.0),
    "wander": GainSpec("m", "amplitude of a slow error of the clearance", default=0.0),
    "lag": GainSpec("s", "time constant of the believed centres", default=0.0),
}
STATE = (
    Port("clock", (1,), "s", "time since the start"),
    Port("believed", (SLOTS, 2), "m", "believed centres of the obstacles in {E}"),
)


def length(vector: ca.SX) -> ca.SX:
    """Return the Euclidean norm of a vector."""
    return ca.sqrt(ca.sumsqr(vector))


def believed(s: Situation) -> tuple[Situation, dict[str, ca.SX]]:
    """Return the situation with the injected error, and the next state of the error."""
    clock, here, hull = s.x["clock"], s.eta[:2], s.p["hull"]
    share = ca.if_else(clock > 0, s.dt / (s.p["lag"] + s.dt), 1)
    known, centres = [], []
    for k, contact in enumerate(s.perceived.known):
        true = here + contact.normal * (contact.clearance + contact.combined_radius)
        before = s.x["believed"][k, :].T
        centre = before + share * (true - before)
        offset = centre - here
        distance = ca.fmax(length(offset), 1e-6)
        wander = s.p["wander"] * ca.sin(2 * pi * (clock / PERIOD + k / SLOTS))
        clearance = distance - contact.combined_radius - s.p["budget"] + wander
        radius = ca.fmax(contact.combined_radius + s.p["budget"] - wander, hull)
        known.append(Contact(offset / distance, clearance, contact.velocity, radius))
        centres.append(centre.T)
    error = {"clock": clock + s.dt, "believed": ca.vertcat(*centres)}
    return s._replace(perceived=replace(s.perceived, known=known)), error


def fan_decision(s: Situation) -> Decision:
    """Return the decision for the best of 53 courses, each at its largest speed from which the robot can brake."""
    stop, now = BARRIERS["simple"](s.p, s.dt), planar_rotation(s.eta[3]) @ s.nu[:2]
    rows = [(c.normal, ca.fmax(stop(c.clearance - s.p["margin"], c.closing), -RETREAT)) for c in s.perceived.all]
    desired = ca.fmax(length(s.desired.velocity), 1e-3)
    ahead, last = s.desired.velocity / desired, s.x["last_velocity"]
    bounds = tabulated(rows, 3)

    def judged(best: ca.SX, most: ca.SX, turn: ca.SX) -> list[ca.SX]:
        course = ca.vertcat(ahead[0] * turn[0] - ahead[1] * turn[1], ahead[1] * turn[0] + ahead[0] * turn[1])

        def free(speed: ca.SX, row: ca.SX) -> ca.SX:
            along = ca.dot(course, row[:2])
            return ca.if_else(along > 1e-3, ca.fmin(speed, ca.fmax(row[2], 0) / ca.fmax(along, 1e-3)), speed)

        speed = fold("free", free, ca.fmin(desired, s.p["cap"]), bounds)
        same = ca.dot(course, last) / ca.fmax(length(last), 0.03)
        value = speed * (turn[0] + KEEPS * same) - 1e-4 * (turn[1] < 0)
        return [ca.if_else(value > most, speed * course, best), ca.fmax(value, most)]

    turns = [2 * pi * k / 72 for k in range(-HALF_FAN, HALF_FAN + 1)]
    start = [ca.SX.zeros(2), ca.SX(0)]
    chosen = fold("fan", judged, start, tabulated([ca.SX([cos(turn), sin(turn)])] for turn in turns))[0]
    velocity = braked(chosen, now, rows, yields=ca.SX(1))
    levels = [TaskLevel.of(velocity_task(s.eta, velocity)), *lower_levels(s.eta, s.desired, s.p, s.scan)]
    avoiding = length(velocity - s.desired.velocity) > 1e-3
    return Decision(levels, (), velocity, avoiding, ca.SX(0), {"last_velocity": chosen})


def _law(name: str, decide: Callable[[Situation], Decision]) -> LawSource:
    def with_error(s: Situation) -> Decision:
        told, error = believed(s)
        decision = decide(told)
        return replace(decision, state={**decision.state, **error})

    return LawSource(name, with_error, gains=GAINS, state=STATE, sensing=("truth",), slots=SLOTS)


def guarded() -> LawSource:
    """Return law `guarded` with the injected error."""
    return _law("guarded_with_error", LAWS["guarded"].decide)


def fan() -> LawSource:
    """Return the fan of courses with the injected error."""
    return _law("fan_with_error", fan_decision)
