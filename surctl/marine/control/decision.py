"""What a law decides: tasks by priority, barriers, next state; turning to scan; obstacle points without a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import casadi as ca

from surctl.ir import Port
from surctl.marine.control.reference import DesiredMotion
from surctl.marine.control.steering import Steering
from surctl.marine.control.stopping import Barrier, Movers
from surctl.marine.guidance import AvoidanceForm, Contact
from surctl.marine.guidance.contacts import disc_contacts, point_contact, wall_contacts
from surctl.marine.sensing import SensorFilter, SonarArray
from surctl.marine.sensing.mapping.contacts import ContactMemory, expected_range, sonar_contacts
from surctl.tasks import HalfPlane, Task, depth_task, heading_task

# Perception of a law without a map; obstacle points are known obstacles, unexplained sonar echoes, and walls


_ARRAY = SonarArray()
_FILTER = SensorFilter(array=_ARRAY)


def perception_ports(dt: float, *, sonar: bool = True) -> tuple[Port, ...]:
    """Return the state entries of the sonar filters for control period `dt` [s]; empty for a law without sonars."""
    if not sonar:
        return ()
    return (*_FILTER.ports("sonar_"), *ContactMemory(dt=dt).ports("sonar_"))


@dataclass(frozen=True)
class Perception:
    """The obstacle points around the robot, and the next state of the sonar filters.

    Attributes:
        known: obstacles known from the base station.
        echoes: one obstacle point per sonar; empty without sonars. Its clearance is `FAR` if there is no echo, or if a
            wall or a known obstacle explains the echo.
        walls: the site's four walls.
        ranges: filtered ranges (4, 1) [m]; the maximum range without sonars.
        state: next values of the state entries by name.
    """

    known: list[Contact]
    echoes: list[Contact]
    walls: list[Contact]
    ranges: ca.SX
    state: dict[str, ca.SX]

    @property
    def all(self) -> list[Contact]:
        """Return all obstacle points in one list."""
        return [*self.known, *self.echoes, *self.walls]


def perceive(x: Mapping[str, ca.SX], u: Mapping[str, ca.SX], p: Mapping[str, ca.SX], *, dt: float) -> Perception:
    """Filter the sonar ranges, remove echoes that walls or known obstacles explain, and return all obstacle points.

    State `x` (see `perception_ports`), inputs `u` and parameters `p` are by name. Without input `contacts` no obstacle
    is known; without input `samples` the law has no sonars.
    """
    position, hull, rows = u["eta"][:2], p["hull"], u.get("contacts", ca.SX.zeros(0, 6))
    known = disc_contacts(position, hull, rows)
    walls = wall_contacts(position, hull, p["walls"])
    if "samples" not in u:
        return Perception(known, [], walls, ca.SX.ones(_ARRAY.size) * _ARRAY.maximum, {})
    psi = u["eta"][3]
    heading = ca.vertcat(ca.cos(psi), ca.sin(psi))
    gains = {"sonar_lambda1": p["lambda1"], "sonar_relaxation": p["lms_step"], "sonar_beta_max": p["beta_max"]}
    filtered = _FILTER.update(x, u["samples"], fresh=u["fresh"], gains=gains, prefix="sonar_")
    expected = [
        expected_range(
            position,
            heading,
            walls=p["walls"],
            discs=rows[:, :3],
            valid=rows[:, 5],
            azimuth=azimuth,
            hull_radius=hull,
            half_angle=_ARRAY.half_angle,
            maximum=_ARRAY.maximum,
        )
        for azimuth in _ARRAY.azimuths
    ]
    contacts = sonar_contacts(
        _ARRAY, filtered.range_hat, position=position, heading=heading, hull_radius=hull, expected=ca.vertcat(*expected)
    )
    memory, standing = ContactMemory(dt=dt).update(x, contacts, fresh=u["fresh"] * filtered.healthy, prefix="sonar_")
    echoes = [point_contact(position, hull, standing.points[i, :].T, standing.valid[i]) for i in range(_ARRAY.size)]
    return Perception(known, echoes, walls, filtered.range_hat, {**filtered.state, **memory})


DECISION_PORTS = (
    Port("side", (1,), "1", "latched passing side: 0 none, +1 obstacle on the right, -1 on the left", gap="anew"),
    Port(
        "blocker",
        (2,),
        "m",
        "x, y in {E} of the contact that blocked the desired velocity in the last step",
        gap="anew",
    ),
    Port("last_velocity", (2,), "m/s", "horizontal velocity commanded in the last step, in {E}", gap="anew"),
)


class TaskLevel(NamedTuple):
    """A task of one priority: J ν should equal `reference` (k, 1) [unit]; J is (k, 4), and ν is the velocity (4, 1)."""

    name: str
    J: ca.SX
    reference: ca.SX
    unit: str

    @staticmethod
    def of(task: Task) -> TaskLevel:
        """Return the task as a priority level."""
        return TaskLevel(task.name, task.jacobian(), task.reference(), task.rate_unit)


@dataclass(frozen=True)
class Decision:
    """The priority problem and the next state that a law decides on.

    Attributes:
        levels: tasks, highest priority first; a task with zero Jacobian and zero reference has no effect.
        rows: barriers as linear inequalities on the velocity ν, for the priority modes with inequalities.
        velocity: commanded horizontal velocity (2, 1) in {E} [m/s].
        avoiding: 1 while an obstacle changes the desired velocity.
        degraded: 1 if no course satisfies the speed bounds of all obstacles.
        state: next values of the state entries by name; an entry that is not named does not change.
        stopped: 1 while the robot stops, or nearly stops, because it does not know what is ahead.
    """

    levels: Sequence[TaskLevel | Task]
    rows: Sequence[HalfPlane] = ()
    velocity: ca.SX = field(default_factory=lambda: ca.SX.zeros(2))
    avoiding: ca.SX = field(default_factory=lambda: ca.SX(0))
    degraded: ca.SX = field(default_factory=lambda: ca.SX(0))
    state: Mapping[str, ca.SX] = field(default_factory=dict)
    stopped: ca.SX = field(default_factory=lambda: ca.SX(0))

    def task_levels(self) -> list[TaskLevel]:
        """Return the levels, with each `Task` replaced by its Jacobian and reference."""
        return [level if isinstance(level, TaskLevel) else TaskLevel.of(level) for level in self.levels]


class Scan(NamedTuple):
    """The inputs, except obstacle points, of a law with a sonar map; see `ports.scan_inputs`."""

    unknown: ca.SX
    sonars: ca.SX
    placed: ca.SX
    echoed: ca.SX


class Situation(NamedTuple):
    """Symbolic inputs of a law's decision: desired motion, obstacle points, state, pose, velocity, gains and mission.

    `form`, `dt`, `barrier` and `movers` are arguments of `build_law` (`form` is the argument `avoidance`). `scan` is
    None for a law without sonars. `moving` is True if obstacles may move. `steering` is the result of
    `LawSource.steering`.
    """

    form: AvoidanceForm
    desired: DesiredMotion
    perceived: Perception
    x: Mapping[str, ca.SX]
    eta: ca.SX
    nu: ca.SX
    p: Mapping[str, ca.SX]
    dt: float
    scan: Scan | None
    moving: bool = True
    barrier: Barrier = "simple"
    movers: Movers = "predict"
    steering: Steering | None = None


def lower_levels(
    eta: ca.SX, desired: DesiredMotion, p: Mapping[str, ca.SX], scan: Scan | None = None, side: ca.SX | None = None
) -> tuple[TaskLevel, TaskLevel]:
    """Return the tasks with lower priority than the velocity task: depth, then heading.

    With a sonar map, the robot turns continuously instead of holding a heading. The yaw rate is the gain `spin`, or
    less if the yaw thrusters cannot sustain this rate; it is 0 until a sonar answers, because turning without any echo
    scans nothing. While the robot does not know its position, its commanded depth
    rate is 0.

    The robot turns to the left while it passes an obstacle on its right (`side` 1), and to the right while it passes
    one on its left: each beam then sweeps past the obstacle from back to front. In the other sense, the end of a smooth
    obstacle, which answers near its normal only, passes unheard through the gap between two beams.
    """
    depth = TaskLevel.of(depth_task(eta, p["depth"], gain=p["k2"]))
    if scan is None:
        return depth, TaskLevel.of(heading_task(eta, desired.heading, gain=p["k_psi"]))
    turning = ca.if_else(scan.echoed, ca.fmin(ca.fmax(p["spin_limit"], -p["spin"]), p["spin"]), 0)
    if side is not None:
        turning = ca.if_else(side == 0, turning, side * ca.fabs(turning))
    depth = depth._replace(reference=ca.if_else(scan.placed, depth.reference, 0))
    return depth, TaskLevel("scan", ca.SX([[0, 0, 0, 1]]), turning, "rad/s")


def weakest_acceleration(p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the least horizontal acceleration at full thrust [m/s²]: the smaller thrust limit over the larger mass."""
    return ca.fmin(p["thrust_limit"][0], p["thrust_limit"][1]) / ca.fmax(p["mass"][0], p["mass"][1])
