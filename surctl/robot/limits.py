"""Limits of a robot: joint positions, speeds and accelerations by braking distance, and distances between links."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, check_known, check_number
from surctl.robot.kinematics import Coordinate, Kinematics
from surctl.robot.urdf import Capsule, closest_points, read_xml
from surctl.tasks import LimitRow

Array: TypeAlias = NDArray[np.float64]

_SAMPLES = 100  # configurations


def stopping_speed(distance: ca.SX, acceleration: float, dt: ca.SX) -> ca.SX:
    """Return the largest speed towards a limit that keeps it, if the speed falls by at most acceleration · dt a step.

    The speed is held for each control period dt. For a distance d ≥ 0 [rad or m] it is d/dt up to d = a dt²/2, and
    √(2 a d) − a dt/2 above. Then the position after the period is inside the limit, and a speed that is lower by a dt
    is allowed in the next period. For d < 0 it is minus the speed for −d, so the joint returns.
    """
    # Let D(v) be the distance for which v is returned. For v ≥ 1.5 a dt, D(v − a dt) = D(v) − v dt. For smaller v, put
    # s = v/(a dt): the next speed is allowed because (s − 1.5)² ≥ 0, and the limit is kept because (s − 0.5)² ≥ 0.
    d = ca.fabs(distance)
    braking = ca.sqrt(2.0 * acceleration * d) - 0.5 * acceleration * dt
    speed = ca.if_else(d <= 0.5 * acceleration * dt * dt, d / dt, braking)
    return ca.if_else(distance < 0.0, -speed, speed)


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of position, speed and acceleration of the joints as one box of velocities, which is never empty.

    The velocity of each joint lets it stop before its position limits with its acceleration, and is at most its largest
    speed. If the acceleration limit of a period excludes these (as after a start that is too fast), the acceleration
    limit is kept and the joint brakes.

    Attributes:
        robot: the robot. accelerations: largest acceleration [rad/s² or m/s²] by joint; absent: no such limit.
        velocities: largest speeds [rad/s or m/s] by joint, in place of those of the file.
    """

    robot: Kinematics
    accelerations: Mapping[str, float]
    velocities: Mapping[str, float]

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row for each entry of v that is limited, named joint.NAME."""
        return tuple(self._row(name, *entry) for name, entry in self._entries.items())

    def cause(self, row: str, upper: bool, bound: float, q: Array, v: Array, dt: float) -> str:
        """Return the limit that gives a row its bound, such as "upper acceleration limit 5 rad/s²".

        q (nq,) is the configuration, v (nv,) the velocity of the last control period; "" for a row of other limits. A
        joint that must brake has the limit of acceleration at its other end.
        """
        if row not in self._entries:
            return ""
        robot, (place, at, speed) = self.robot, self._entries[row]
        ends, acceleration = self._ends(place, at, speed), self.accelerations.get(place.joint.name, 0.0)
        values = {"acceleration": (-acceleration, acceleration), "speed": (-speed, speed), "position": (0.0, 0.0)}
        values |= {"position": robot.range_of(place)} if place.single else {}
        sides = [(kind, end) for kind in ends for end in ((False, True) if kind == "acceleration" else (upper,))]
        exact = ca.Function(
            "ends", [robot.q, robot.v, robot.dt], [ca.vertcat(*(ends[kind][end] for kind, end in sides))]
        )
        kind, end = sides[int(np.abs(np.array(exact(q, v, dt))[:, 0] - bound).argmin())]
        unit = robot.layout()[1].unit.split(", ")[at].removesuffix("/s")
        unit += {"acceleration": "/s²", "speed": "/s", "position": ""}[kind]
        return f"{'upper' if end else 'lower'} {kind} limit {values[kind][end]:.6g} {unit}"

    @cached_property
    def _entries(self) -> dict[str, tuple[Coordinate, int, float]]:
        """Return joint, index and largest speed of each entry of v that is limited, by the name of its row."""
        entries, axes = {}, {"planar": ("x", "y", "r"), "floating": ("x", "y", "z", "wx", "wy", "wz")}
        for place in self.robot.coordinates:
            name, own = f"joint.{_identifier(place.joint.name)}", self.velocities.get(place.joint.name)
            speed = self.robot.speed_of(place, self.velocities) if place.single else own
            for k, axis in enumerate(axes.get(place.joint.type, ("",))):
                if speed is not None:
                    entries[f"{name}.{axis}" if axis else name] = (place, place.v + k, speed)
        return entries

    def _ends(self, place: Coordinate, v: int, speed: float) -> dict[str, tuple[ca.SX, ca.SX]]:
        """Return the bounds of an entry of v by limits of acceleration, speed and position, the hardest first."""
        robot, acceleration = self.robot, self.accelerations.get(place.joint.name)
        ends = {}
        if acceleration is not None:
            change = acceleration * robot.dt
            ends["acceleration"] = (robot.v[v] - change, robot.v[v] + change)
        ends["speed"] = (ca.SX(-speed), ca.SX(speed))
        if place.single:
            limits, q = robot.range_of(place), robot.q[place.q]
            speeds = [_allowed(distance, acceleration, robot.dt) for distance in (q - limits[0], limits[1] - q)]
            ends["position"] = (-speeds[0], speeds[1])
        return ends

    def _row(self, name: str, place: Coordinate, v: int, speed: float) -> LimitRow:
        ends = self._ends(place, v, speed)
        lower, upper = ends["speed"]
        if "position" in ends:
            lower, upper = ca.fmax(lower, ends["position"][0]), ca.fmin(upper, ends["position"][1])
        if "acceleration" in ends:
            least, most = ends["acceleration"]
            lower, upper = (ca.fmin(ca.fmax(end, least), most) for end in (lower, upper))
        a = ca.SX.zeros(1, self.robot.nv)
        a[v] = 1.0
        return LimitRow(name, "actuator", a, lower, upper)


def joint_limits(
    robot: Kinematics,
    *,
    acceleration: float | Mapping[str, float] | None = None,
    velocity: float | Mapping[str, float] | None = None,
) -> JointLimits:
    """Return the limits of position, speed and acceleration of the joints.

    A joint may be as fast as it can still stop before its limit, √(2 a d) for the distance d; see `JointLimits`.
    For joints that follow the commanded velocities, all limits hold exactly if they hold at the start.

    Args:
        acceleration: largest acceleration a [rad/s² or m/s²], one for all joints or by joint; None for no limit.
        velocity: largest speeds [rad/s or m/s], in place of those in the file.

    Raises:
        InputError: the file has no limit of a joint, a joint is unknown, or a number is not positive.
    """
    accelerations = _by_joint(robot, acceleration, "acceleration")
    velocities = _by_joint(robot, velocity, "velocity")
    for place in robot.coordinates:
        name, joint = place.joint.name, place.joint
        if not place.single:
            continue
        speed, remedy = robot.speed_of(place, velocities), f'give velocity={{"{name}": …}}, or lock the joint'
        if speed is None:
            raise InputError("has no velocity limit", file=robot.urdf.path, key=f"joint {name}", remedy=remedy)
        if speed == 0.0:
            key = f"joint {name}: velocity"
            raise InputError("never lets the joint move", file=robot.urdf.path, key=key, value=speed, remedy=remedy)
        lacks = [word for word, value in (("lower", joint.lower), ("upper", joint.upper)) if value is None]
        if joint.type in ("revolute", "prismatic") and lacks:
            remedy = "write it into <limit>" + (", or make the joint continuous" * (joint.type == "revolute"))
            raise InputError(f"has no {lacks[0]} limit", file=robot.urdf.path, key=f"joint {name}", remedy=remedy)
        robot.range_of(place)
    return JointLimits(robot, accelerations, velocities)


@dataclass(frozen=True, eq=False)
class SelfCollision:
    """Barriers that keep pairs of links apart: the distance d of two capsules obeys ḋ ≥ −gain · (d − margin).

    In a control period dt, the distance changes by more or less than dt ḋ. What it would fall more at the last velocity
    is subtracted from the right side, so that the distance also obeys the inequality after the period.

    Attributes:
        robot: the robot. pairs: names of two links and a capsule of each.
        margin: least distance of the surfaces [m]. gain: γ of the barrier [1/s].
    """

    robot: Kinematics
    pairs: tuple[tuple[str, Capsule, str, Capsule], ...]
    margin: float
    gain: float

    def distance(self, pair: tuple[str, Capsule, str, Capsule]) -> tuple[ca.SX, ca.SX]:
        """Return the distance of the surfaces of a pair [m], negative if they overlap, and its Jacobian (1, nv)."""
        link, capsule, other, beside = pair
        ends = []
        for name, shape in ((link, capsule), (other, beside)):
            frame = self.robot.frame(name)
            ends += [
                frame.position + frame.rotation @ ca.DM(np.asarray(shape.start)),
                frame.rotation @ ca.DM(shape.axis),
            ]
        lengths = (capsule.length, beside.length)
        first, second = closest_points(ends[0], ends[1], ends[2], ends[3], lengths)
        apart = first - second
        length = ca.sqrt(ca.sumsqr(apart) + 1e-24)
        # joints that move both links change neither; where the points are closest, their motion along the axes does not
        # change the distance, so its derivative is that for points fixed to the links
        J = self.robot.jacobian_at(link, first, besides=other) - self.robot.jacobian_at(other, second, besides=link)
        return length - capsule.radius - beside.radius, ca.densify((apart / length).T @ J[:3, :])

    def rows(self) -> tuple[LimitRow, ...]:
        """Return one limit row for each pair, named self.LINK.LINK."""
        robot, rows, names = self.robot, [], set[str]()
        ahead = robot.q + robot.dt * (robot.rate_map @ robot.v)
        for pair in self.pairs:
            name = base = f"self.{_identifier(pair[0])}.{_identifier(pair[2])}"
            while name in names:
                name = f"{base}.{len(names)}"
            names.add(name)
            distance, J = self.distance(pair)
            curved = ca.substitute(distance, robot.q, ahead) - distance - robot.dt * (J @ robot.v)
            upper = self.gain * (distance - self.margin) + ca.fmin(curved, 0.0) / robot.dt
            rows.append(LimitRow(name, "barrier", -J, ca.SX(-math.inf), upper))
        return tuple(rows)


def self_collision(
    robot: Kinematics,
    srdf: str | Path | None = None,
    *,
    margin: float = 0.0,
    gain: float = 5.0,
    shapes: Mapping[str, Sequence[Capsule]] | None = None,
) -> SelfCollision:
    """Return barriers that keep links apart that are not neighbours.

    Args:
        srdf: SRDF file with pairs of links that need no barrier; None for no such pair.
        margin: least distance [m]. gain: γ in ḋ ≥ −γ (d − margin) for the distance d [1/s].
        shapes: capsules by link, in place of the collision geometry of the URDF file, whose spheres, cylinders and
            boxes count as the smallest capsules around them; their edges may be further apart than the capsules.

    Raises:
        InputError: a link has a collision mesh and no shape is given, a name is unknown, no pair is left, or two links
            are nearer than the margin at every random configuration.
    """
    check_number("margin", margin, unit="m", zero=True)
    check_number("gain", gain, unit="1/s")
    own = dict(shapes or {})
    for link in own:
        robot.frame(link)
    disabled = frozenset() if srdf is None else _read_srdf(robot, srdf)
    capsules = {name: tuple(own.get(name, link.shapes)) for name, link in robot.urdf.links.items()}
    meshes = {name: link.meshes and name not in own for name, link in robot.urdf.links.items()}
    bodies = {name: robot.body(name) for name in robot.urdf.links}
    pairs = []
    for one, other in combinations(robot.urdf.links, 2):
        if frozenset((one, other)) in disabled or _adjacent(robot, bodies[one], bodies[other]):
            continue
        for name, across in ((one, other), (other, one)):
            if meshes[name] and (capsules[across] or meshes[across]):
                remedy = (
                    f'give shapes={{"{name}": [Capsule(…)]}}, [] to ignore the link, or disable its pairs in an SRDF'
                )
                raise InputError("has a collision mesh", file=robot.urdf.path, key=f"link {name}", remedy=remedy)
        pairs += [(one, first, other, second) for first in capsules[one] for second in capsules[other]]
    if not pairs:
        remedy = "add collision geometry, or leave out self_collision"
        raise InputError("has no pair of links to keep apart", file=robot.urdf.path, key="robot", remedy=remedy)
    barriers = SelfCollision(robot, tuple(pairs), float(margin), float(gain))
    _check_apart(barriers)
    return barriers


def _check_apart(barriers: SelfCollision) -> None:
    """Raise InputError if two links are nearer than the margin at every random configuration."""
    robot, draws = barriers.robot, np.random.default_rng(0)
    gaps = [barriers.distance(pair)[0] for pair in barriers.pairs]
    samples = np.array([robot.sample(draws) for _ in range(_SAMPLES)]).T
    most = np.array(ca.Function("gaps", [robot.q], [ca.vertcat(*gaps)]).map(_SAMPLES)(samples)).max(axis=1)
    for (link, _, other, _), gap in zip(barriers.pairs, most, strict=True):
        if gap < barriers.margin:
            problem = f"are less than the margin apart at all {_SAMPLES} random configurations: at most {gap:.3g} m"
            remedy = f'give smaller shapes, or an SRDF with <disable_collisions link1="{link}" link2="{other}"/>'
            raise InputError(problem, file=robot.urdf.path, key=f"links {link}, {other}", remedy=remedy)


def _read_srdf(robot: Kinematics, path: str | Path) -> frozenset[frozenset[str]]:
    """Return the pairs of links whose collision an SRDF file disables.

    Raises:
        InputError: the file cannot be read, or names a link that the robot does not have.
    """
    path, disabled = Path(path), set[frozenset[str]]()
    for element in read_xml(path, "robot").iter("disable_collisions"):
        pair = [element.get("link1", ""), element.get("link2", "")]
        for name in pair:
            check_known(name, robot.urdf.links, "is not the name of a link", key="disable_collisions", file=path)
        disabled.add(frozenset(pair))
    return frozenset(disabled)


def _adjacent(robot: Kinematics, body: str, other: str) -> bool:
    """Return whether two links are one rigid body, or are joined by a joint."""
    parents = [None if (up := robot.parent(name)) is None else robot.body(up) for name in (body, other)]
    return body == other or parents[0] == other or parents[1] == body


def _allowed(distance: ca.SX, acceleration: float | None, dt: ca.SX) -> ca.SX:
    if distance.is_constant():  # no limit
        return ca.SX(math.inf)
    return distance / dt if acceleration is None else stopping_speed(distance, acceleration, dt)


def _by_joint(robot: Kinematics, value: float | Mapping[str, float] | None, key: str) -> dict[str, float]:
    """Return a positive number for each joint named, or one number for all joints with one position."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        value = {place.joint.name: value for place in robot.coordinates if place.single}
    for joint, number in value.items():
        check_known(joint, robot.joints, "no such joint", key=key)
        check_number(f"{key}: {joint}", number, unit="SI units")
    return {joint: float(number) for joint, number in value.items()}


def _identifier(name: str) -> str:
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    return text if text[:1].isalpha() or text[:1] == "_" else f"_{text}"
