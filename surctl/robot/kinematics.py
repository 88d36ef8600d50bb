"""Kinematics of a robot from its URDF: configuration, frames, Jacobians and centre of mass."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_known
from surctl.ir import Port
from surctl.robot.urdf import Joint, Urdf
from surctl.units import as_numbers

# Rotations as matrices, quaternions (x, y, z, w) and rotation vectors, in CasADi


def about(axis: NDArray[np.float64], angle: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) of a rotation by `angle` [rad] about the unit vector `axis` (Rodrigues)."""
    x, y, z = (float(entry) for entry in axis)
    cross = ca.sparsify(ca.DM([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return ca.SX.eye(3) + ca.sin(angle) * cross + (1.0 - ca.cos(angle)) * (cross @ cross)


def rotation_of(quaternion: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) of a quaternion (x, y, z, w) of any length but 0."""
    x, y, z, w = ca.vertsplit(quaternion)
    s = 2.0 / ca.sumsqr(quaternion)
    return ca.vertcat(
        ca.horzcat(1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
        ca.horzcat(s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
        ca.horzcat(s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
    )


def _quaternion_rate(quaternion: ca.SX) -> ca.SX:
    """Return the matrix (4, 3) that maps the angular velocity in the turning frame to the rate of its quaternion."""
    x, y, z, w = ca.vertsplit(quaternion)
    return 0.5 * ca.vertcat(ca.horzcat(w, -z, y), ca.horzcat(z, w, -x), ca.horzcat(-y, x, w), ca.horzcat(-x, -y, -z))


def _quaternion_of(R: ca.SX) -> ca.SX:
    """Return the unit quaternion (x, y, z, w), w ≥ 0, of a rotation matrix (Shepperd 1978)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, yz, zx = R[0, 1] + R[1, 0], R[1, 2] + R[2, 1], R[0, 2] + R[2, 0]
    # each is the quaternion times four of its entries, of which the largest is far from 0
    rows = [
        ca.vertcat(1.0 + 2.0 * R[0, 0] - trace, xy, zx, x),
        ca.vertcat(xy, 1.0 + 2.0 * R[1, 1] - trace, yz, y),
        ca.vertcat(zx, yz, 1.0 + 2.0 * R[2, 2] - trace, z),
        ca.vertcat(x, y, z, 1.0 + trace),
    ]
    best, largest = rows[3], rows[3][3]
    for k in range(3):
        better = rows[k][k] > largest
        best, largest = ca.if_else(better, rows[k], best), ca.fmax(largest, rows[k][k])
    best = best / ca.norm_2(best)
    return ca.if_else(best[3] < 0.0, -best, best)


def rotation_vector(R: ca.SX) -> ca.SX:
    """Return angle · axis (3,) [rad] of a rotation matrix, with an angle in [0, π]."""
    quaternion = _quaternion_of(R)
    half = ca.norm_2(quaternion[:3])
    small = half < 1e-9
    # both branches are finite; for small angles the quotient is 2 to rounding
    return quaternion[:3] * ca.if_else(small, 2.0, 2.0 * ca.atan2(half, quaternion[3]) / ca.if_else(small, 1.0, half))


Array: TypeAlias = NDArray[np.float64]
Base: TypeAlias = Literal["fixed", "planar", "floating"]

_SIZES = {"revolute": (1, 1), "continuous": (1, 1), "prismatic": (1, 1), "planar": (3, 3), "floating": (7, 6)}
_WORLD = "world"
_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class Coordinate:
    """The place of a joint in the configuration q and in the velocity v.

    Attributes:
        joint: the joint.
        q, v: index of its first entry in q and in v.
    """

    joint: Joint
    q: int
    v: int

    @property
    def single(self) -> bool:
        """Return whether the joint has one position and one speed."""
        return self.joint.type not in ("planar", "floating")


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame that moves with the robot, as expressions of the configuration q.

    Attributes:
        rotation: (3, 3), from the frame to the world. position: (3, 1), in the world [m].
        jacobian: (6, nv), maps v to the linear velocity of the frame's origin and the angular velocity, both in the
            axes of the world [m/s, rad/s].
    """

    rotation: ca.SX
    position: ca.SX
    jacobian: ca.SX


@dataclass(frozen=True, eq=False)
class _Motion:
    """What one entry of v moves: angular velocity, linear velocity at the point `at`; all (3, 1) in the world."""

    v: int
    joint: str
    angular: ca.SX
    linear: ca.SX
    at: ca.SX

    def velocity(self, point: ca.SX) -> ca.SX:
        return self.linear + ca.cross(self.angular, point - self.at)


class Kinematics:
    """Kinematics of a robot as CasADi expressions of the configuration q, and as numbers.

    The configuration q contains, in the order of the joints, one position [rad or m] of each revolute, continuous or
    prismatic joint; x, y [m] and angle [rad] of a planar joint; and position x, y, z [m] and quaternion x, y, z, w of
    a floating joint. The velocity v contains one speed of each joint with one position; the linear velocity (x, y) and
    the angular velocity of a planar joint; and the linear and the angular velocity (3 and 3) of a floating joint. The
    velocities of planar and floating joints are in the frame of their child link. Fixed joints, locked joints and
    joints that mimic others have no entry. The world is the frame of the root link, or of the joint below a base.

    Attributes:
        urdf: the file.
        coordinates: the moving joints with their places in q and v.
        q: SX (nq, 1), the configuration. v: SX (nv, 1), the commanded velocity of the last control period.
        dt: SX, the control period [s]. `StackController` gives v and dt their values.
    """

    def __init__(self, urdf: Urdf, *, lock: Mapping[str, float], base: Base = "fixed") -> None:
        self.urdf = urdf
        joints = list(urdf.joints)
        if base != "fixed":
            check_known(base, get_args(Base), key="base")
            if _WORLD in urdf.links or any(joint.name == "base" for joint in joints):
                raise InputError(
                    "is the name of a link or joint", key=_WORLD, remedy="rename it, or model the base in the file"
                )
            joints.insert(0, Joint("base", base, _WORLD, urdf.root, np.eye(3), _ORIGIN, np.array([0.0, 0.0, 1.0])))
        self._locked = dict(lock)
        self.coordinates, q, v = _coordinates(joints, self._locked)
        self._by_joint = {coordinate.joint.name: coordinate for coordinate in self.coordinates}
        self._joints = {joint.name: joint for joint in joints}
        self.q, self.v, self.dt = ca.SX.sym("q", q), ca.SX.sym("v", v), ca.SX.sym("dt")
        self._rotations = {joints[0].parent if base != "fixed" else urdf.root: ca.SX.eye(3)}
        self._positions = {link: ca.SX.zeros(3) for link in self._rotations}
        self._functions: dict[str, ca.Function] = {}
        self._parents: dict[str, Joint] = {}
        self._motions: dict[str, tuple[_Motion, ...]] = {}
        for joint in joints:
            self._parents[joint.child] = joint
            self._place(joint)

    @property
    def nq(self) -> int:
        """Return the number of entries of q."""
        return int(self.q.numel())

    @property
    def nv(self) -> int:
        """Return the number of entries of v."""
        return int(self.v.numel())

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the joints that move, in the order of q."""
        return tuple(self._by_joint)

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of all joints, from the root outwards."""
        return tuple(self._joints)

    @property
    def links(self) -> tuple[str, ...]:
        """Return the names of the links, from the root outwards."""
        return tuple(self._rotations)

    def position_of(self, joint: str) -> tuple[float, str | None, float]:
        """Return multiplier, joint and offset of a joint's position: multiplier · q of the joint + offset.

        The joint is None if the position is the offset alone (a fixed or locked joint, or one that mimics such a one).
        """
        factor, offset, at = 1.0, 0.0, self._joints[joint]
        while at.name not in self._locked and at.mimic is not None:
            offset += factor * at.mimic.offset
            factor *= at.mimic.multiplier
            at = self._joints[at.mimic.joint]
        if at.name in self._by_joint:
            return factor, at.name, offset
        return 0.0, None, offset + factor * self._locked.get(at.name, 0.0)

    def coordinate(self, joint: str) -> Coordinate:
        """Return the place of a joint in q and v; raise InputError if the joint does not move by itself."""
        check_known(joint, self.names, "is not a joint that moves", key="joint")
        return self._by_joint[joint]

    @cached_property
    def rate_map(self) -> ca.SX:
        """Return S(q) (nq, nv) of q̇ = S(q) v; the identity if every joint has one position."""
        S = ca.SX(self.nq, self.nv)
        for place in self.coordinates:
            i, j = place.q, place.v
            if place.single:
                S[i, j] = 1.0
            elif place.joint.type == "planar":
                c, s = ca.cos(self.q[i + 2]), ca.sin(self.q[i + 2])
                S[i : i + 2, j : j + 2] = ca.vertcat(ca.horzcat(c, -s), ca.horzcat(s, c))
                S[i + 2, j + 2] = 1.0
            else:
                quaternion = self.q[i + 3 : i + 7]
                S[i : i + 3, j : j + 3] = rotation_of(quaternion)
                S[i + 3 : i + 7, j + 3 : j + 6] = _quaternion_rate(quaternion)
        return S

    def frame(self, link: str) -> Frame:
        """Return the frame of a link as expressions of q; raise InputError for an unknown link."""
        check_known(link, self.links, "is not the name of a link", key="frame")
        position = self._positions[link]
        return Frame(self._rotations[link], position, self.jacobian_at(link, position))

    def jacobian_at(self, link: str, point: ca.SX, *, besides: str | None = None) -> ca.SX:
        """Return the Jacobian (6, nv) of the point (3, 1) of the world that moves with a link; see `Frame`.

        If the link `besides` is given, joints that move both links are left out.
        """
        J = ca.SX(6, self.nv)
        shared = {motion.joint for motion in self._motions[besides]} if besides is not None else set()
        for motion in self._motions[link]:
            if motion.joint not in shared:
                J[:3, motion.v] += motion.velocity(point)
                J[3:, motion.v] += motion.angular
        return J

    def body(self, link: str) -> str:
        """Return the first link of the rigid body that contains a link: the child of the joint that moves it."""
        at = link
        while at in self._parents and self.position_of(self._parents[at].name)[1] is None:
            at = self._parents[at].parent
        return at

    def parent(self, link: str) -> str | None:
        """Return the parent of a link; None for the root."""
        return self._parents[link].parent if link in self._parents else None

    @cached_property
    def centre_of_mass(self) -> tuple[ca.SX, ca.SX]:
        """Return the centre of mass (3, 1) [m] and its Jacobian (3, nv); raise InputError if no link has a mass."""
        masses = {name: link.mass for name, link in self.urdf.links.items()}
        total = sum(masses.values())
        if total <= 0.0:
            raise InputError("has no link with a mass", file=self.urdf.path, key="robot", remedy="add <inertial>")
        position, J = ca.SX.zeros(3), ca.SX(3, self.nv)
        for name, mass in masses.items():
            if mass > 0.0:
                at = self._positions[name] + self._rotations[name] @ _sparse(self.urdf.links[name].centre)
                position += mass / total * at
                J += mass / total * self.jacobian_at(name, at)[:3, :]
        return position, J

    def neutral(self) -> Array:
        """Return the configuration (nq,) with every position 0, or the limit next to 0, and upright floating joints."""
        q = np.zeros(self.nq)
        for place in self.coordinates:
            if place.joint.type == "floating":
                q[place.q + 6] = 1.0
            elif place.single:
                lower, upper = self.range_of(place)
                q[place.q] = min(max(0.0, lower), upper)
        return q

    def sample(self, draws: np.random.Generator) -> Array:
        """Return a configuration (nq,) with random positions of the joints with one position, within ±π."""
        q = self.neutral()
        for place in self.coordinates:
            if place.single:
                q[place.q] = draws.uniform(*np.clip(self.range_of(place), -math.pi, math.pi))
        return q

    def range_of(self, place: Coordinate) -> tuple[float, float]:
        """Return the position limits of a joint and of the joints that mimic it; ±inf for an absent limit."""
        lower, upper = -math.inf, math.inf
        for joint, factor, offset in self._followers(place):
            low = -math.inf if joint.lower is None else joint.lower
            high = math.inf if joint.upper is None else joint.upper
            ends = sorted(((low - offset) / factor, (high - offset) / factor))
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
        if lower > upper:
            problem = "allow no position together with those of the joints that mimic it"
            raise InputError(
                problem, file=self.urdf.path, key=f"joint {place.joint.name}: limits", value=[lower, upper]
            )
        return lower, upper

    def speed_of(self, place: Coordinate, own: Mapping[str, float]) -> float | None:
        """Return the largest speed of a joint, with that of the joints that mimic it; None if no file states it.

        own: largest speeds by joint, which take the place of those in the file.
        """
        speeds = [
            None if (speed := own.get(joint.name, joint.velocity)) is None else speed / abs(factor)
            for joint, factor, _ in self._followers(place)
        ]
        return None if speeds[0] is None else min(speed for speed in speeds if speed is not None)

    def layout(self) -> tuple[Port, Port]:
        """Return the ports q and v with the unit of each entry; the default of q is the neutral configuration."""
        units: tuple[list[str], list[str]] = ([], [])
        for place in self.coordinates:
            kind = place.joint.type
            q, v = {
                "prismatic": ("m", "m/s"),
                "planar": ("m, m, rad", "m/s, m/s, rad/s"),
                "floating": ("m, m, m, 1, 1, 1, 1", "m/s, m/s, m/s, rad/s, rad/s, rad/s"),
            }.get(kind, ("rad", "rad/s"))
            units[0].append(q)
            units[1].append(v)
        start = self.neutral()
        return (
            Port("q", (self.nq,), ", ".join(units[0]), "configuration", start),  # type: ignore[arg-type]
            Port("v", (self.nv,), ", ".join(units[1]), "velocity"),
        )

    def pose(self, link: str, q: ArrayLike) -> Array:
        """Return the pose of a link at configuration q as a homogeneous matrix (4, 4); lengths in m."""
        rotation, position, _ = self._numbers(link, q)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, position[:, 0]
        return pose

    def jacobian(self, link: str, q: ArrayLike) -> Array:
        """Return the Jacobian (6, nv) of a link at configuration q; see `Frame`."""
        return self._numbers(link, q)[2]

    def integrate(self, q: ArrayLike, v: ArrayLike, dt: float) -> Array:
        """Return the configuration (nq,) after the velocity v (nv,) has been applied for the time dt [s].

        Planar and floating joints move along the exponential of their velocity, so a quaternion keeps its length.
        """
        before, speed = as_numbers(q, key="q", size=self.nq), as_numbers(v, key="v", size=self.nv)
        after = before.copy()
        for place in self.coordinates:
            i, j = place.q, place.v
            if place.single:
                after[i] += dt * speed[j]
                continue
            size = _SIZES[place.joint.type]
            after[i : i + size[0]] = _moved(before[i : i + size[0]], dt * speed[j : j + size[1]])
        return after

    def _numbers(self, link: str, q: ArrayLike) -> tuple[Array, Array, Array]:
        if link not in self._functions:
            frame = self.frame(link)
            results = [ca.densify(part) for part in (frame.rotation, frame.position, frame.jacobian)]
            self._functions[link] = ca.Function("frame", [self.q], results)
        rotation, position, jacobian = self._functions[link].call([as_numbers(q, key="q", size=self.nq)])
        return np.array(rotation), np.array(position), np.array(jacobian)

    def _followers(self, place: Coordinate) -> Iterator[tuple[Joint, float, float]]:
        """Yield the joint itself, then those that mimic it, with multiplier and offset."""
        yield place.joint, 1.0, 0.0
        for name, joint in self._joints.items():
            factor, followed, offset = self.position_of(name)
            if followed == place.joint.name and name != followed and factor != 0.0:
                yield joint, factor, offset

    def _place(self, joint: Joint) -> None:
        """Compute the frame of a joint's child link, and what moves it."""
        R = self._rotations[joint.parent]
        p = self._positions[joint.parent] + R @ _sparse(joint.position)
        R = R @ ca.SX(_sparse(joint.rotation))
        motions = list(self._motions.get(joint.parent, ()))
        factor, source, offset = self.position_of(joint.name)
        place = None if source is None else self._by_joint[source]
        none = ca.SX.zeros(3)
        if joint.type in ("planar", "floating") and place is not None:
            own = self.q[place.q : place.q + _SIZES[joint.type][0]]
            if joint.type == "planar":
                p, R = p + R[:, :2] @ own[:2], R @ about(joint.axis, own[2])
                turns = [(2, R[:, 2])]
            else:
                p, R = p + R @ own[:3], R @ rotation_of(own[3:])
                turns = [(3 + k, R[:, k]) for k in range(3)]
            slides = [(k, R[:, k]) for k in range(_SIZES[joint.type][1] - len(turns))]
            motions += [_Motion(place.v + k, joint.name, none, along, p) for k, along in slides]
            motions += [_Motion(place.v + k, joint.name, axis, none, p) for k, axis in turns]
        elif joint.type != "fixed" and joint.type not in ("planar", "floating"):
            position = ca.SX(offset) if place is None else factor * self.q[place.q] + offset
            axis = R @ _sparse(joint.axis)
            slides_along = joint.type == "prismatic"
            if place is not None:
                angular, linear = (none, factor * axis) if slides_along else (factor * axis, none)
                motions.append(_Motion(place.v, joint.name, angular, linear, p))
            p, R = (p + axis * position, R) if slides_along else (p, R @ about(joint.axis, position))
        self._rotations[joint.child], self._positions[joint.child] = R, p
        self._motions[joint.child] = tuple(motions)
        self._motions.setdefault(joint.parent, ())


def _coordinates(joints: Sequence[Joint], locked: Mapping[str, float]) -> tuple[tuple[Coordinate, ...], int, int]:
    places, q, v = [], 0, 0
    for joint in joints:
        if joint.type != "fixed" and joint.name not in locked and joint.mimic is None:
            places.append(Coordinate(joint, q, v))
            sizes = _SIZES[joint.type]
            q, v = q + sizes[0], v + sizes[1]
    if not places:
        raise InputError("has no joint that moves", key="robot", remedy="unlock a joint, or give a moving base")
    return tuple(places), q, v


def _sparse(matrix: Array) -> ca.DM:
    return ca.sparsify(ca.DM(matrix))


def _moved(place: Array, step: Array) -> Array:
    """Return x, y, angle or position and quaternion after a motion `step` in the moving frame."""
    from scipy.spatial.transform import RigidTransform, Rotation  # slow to import

    planar = place.size == 3
    position, rotation = (
        ([*place[:2], 0.0], Rotation.from_rotvec([0.0, 0.0, place[2]]))
        if planar
        else (place[:3], Rotation.from_quat(place[3:]))
    )
    turn_and_shift = [0.0, 0.0, step[2], *step[:2], 0.0] if planar else [*step[3:], *step[:3]]
    after = RigidTransform.from_components(position, rotation) * RigidTransform.from_exp_coords(turn_and_shift)
    if planar:
        return np.array([*after.translation[:2], place[2] + step[2]])
    return np.concatenate([after.translation, after.rotation.as_quat()])
