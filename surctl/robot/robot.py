"""A robot from its URDF file: tasks for frames, posture, centre of mass and view, limits, locked joints."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_known, check_number, mistakes_in
from surctl.ir import Port
from surctl.robot import limits
from surctl.robot.kinematics import Base, Kinematics, rotation_of, rotation_vector
from surctl.robot.urdf import read_urdf
from surctl.tasks import Task
from surctl.units import as_numbers

# Tasks of a robot: frames, centre of mass, posture and the direction in which a frame looks


Array: TypeAlias = NDArray[np.float64]

_NAME = re.compile(r"[a-z_][a-z0-9_]*", re.ASCII)


@dataclass(frozen=True, eq=False)
class Input:
    """A number or vector that a task gets at run time.

    Attributes:
        port: name, size, unit and default value.
        symbol: SX (size, 1) that stands for it in the expressions of the task.
        tunable: True for a gain with a nominal value; False for a target.
    """

    port: Port
    symbol: ca.SX
    tunable: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotTask(Task):
    """A task of a robot with the inputs that it needs.

    Attributes:
        robot: the robot.
        geometric: SX (k, nv), the Jacobian where it is not the derivative of σ: for an orientation, σ is the rotation
            vector to the target, and the rows are those of the angular velocity.
        inputs: targets and gains.
    """

    robot: Kinematics
    geometric: ca.SX | None = None
    inputs: tuple[Input, ...] = field(default=(), repr=False)

    def jacobian(self) -> ca.SX:
        """Return the Jacobian (k, nv)."""
        return super().jacobian() if self.geometric is None else ca.densify(self.geometric)


@dataclass(frozen=True, eq=False)
class FrameTask:
    """Tasks that move a frame to a target pose.

    Attributes:
        build: function that returns the task with the name "position" or "orientation".
    """

    build: Callable[[str], RobotTask] = field(repr=False)

    @cached_property
    def position(self) -> RobotTask:
        """Return the task for the position of the frame [m]."""
        return self.build("position")

    @cached_property
    def orientation(self) -> RobotTask:
        """Return the task for the orientation of the frame; its error is the rotation vector to the target [rad]."""
        return self.build("orientation")


def flat_pose(pose: ArrayLike) -> Array:
    """Return position and quaternion (7,): x, y, z [m], then x, y, z, w; from these, or from a matrix (4, 4)."""
    from scipy.spatial.transform import Rotation  # slow to import

    matrix = as_numbers(pose, key="target")
    if matrix.shape != (4, 4):
        return matrix.reshape(-1)
    R = matrix[:3, :3]
    if not np.isfinite(matrix).all() or abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
        raise InputError("is not a pose", key="target", value=matrix.tolist(), remedy="give a homogeneous matrix")
    return np.concatenate([matrix[:3, 3], Rotation.from_matrix(R).as_quat(canonical=True)])


def _task(
    robot: Kinematics, name: str, sigma: ca.SX, J: ca.SX, unit: str, inputs: tuple[Input, Input], cap: Input | None,
    *, suffix: str = "",
) -> RobotTask:  # fmt: skip
    gain = inputs[1].symbol
    if cap is not None:
        gain = gain * ca.fmin(1.0, cap.symbol / (gain * ca.sqrt(ca.sumsqr(sigma) + 1e-24)))
    return RobotTask(
        robot=robot, name=name + suffix, eta=robot.q, sigma=sigma, gain=gain, unit=unit,
        kinematics=robot.rate_map, geometric=J, inputs=(*inputs, *([] if cap is None else [cap])),
    )  # fmt: skip


def _checked_name(name: str) -> str:
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        remedy = "use small letters, digits and _"
        raise InputError("is not a name for a target", key="target", value=name, remedy=remedy)
    return name


def _vector(name: str, size: int, unit: str, meaning: str, default: Array) -> Input:
    port = Port(name, (size,), unit, meaning, default)  # type: ignore[arg-type]
    return Input(port, ca.SX.sym(name, size))


def _number(name: str, value: float, unit: str, meaning: str) -> Input:
    check_number(name, value, unit=unit)
    return Input(Port(name, (1,), unit, meaning, float(value)), ca.SX.sym(name), tunable=True)


def _capped(name: str, value: float | None, unit: str, meaning: str) -> Input | None:
    return None if value is None else _number(name, value, unit, meaning)


class Robot(Kinematics):
    """A robot: its kinematics, and tasks and limits for a `StackController`. Build it with `load_urdf`."""

    def frame_task(
        self,
        frame: str,
        *,
        target: str,
        gain: float = 1.0,
        max_speed: float | None = None,
        max_rate: float | None = None,
        relative_to: str | None = None,
    ) -> FrameTask:
        """Return the tasks `.position` and `.orientation`, which move the frame of a link to a target pose.

        Args:
            frame: name of a link.
            target: name of the target pose: x, y, z [m] and quaternion x, y, z, w.
            gain: convergence gain [1/s].
            max_speed, max_rate: largest desired speed [m/s] and angular velocity [rad/s]; None for no such limit.
            relative_to: name of the link in whose frame the target is; None for the world.

        Raises:
            InputError: a link is unknown, the name is not an identifier, or a number is not positive.
        """
        name = _checked_name(target)
        moving = self.frame(frame)
        position, rotation, J = moving.position, moving.rotation, moving.jacobian
        default = self.pose(frame, self.neutral())
        if relative_to is not None:
            other = self.frame(relative_to)
            R, apart = other.rotation, position - other.position
            # seen in the other frame, whose rotation moves the frame too
            linear = J[:3, :] - other.jacobian[:3, :] + ca.skew(apart) @ other.jacobian[3:, :]
            J = ca.vertcat(R.T @ linear, R.T @ (J[3:, :] - other.jacobian[3:, :]))
            position, rotation = R.T @ apart, R.T @ rotation
            default = np.linalg.inv(self.pose(relative_to, self.neutral())) @ default
        where = "the world" if relative_to is None else relative_to
        goal = _vector(
            name, 7, "m, m, m, 1, 1, 1, 1", f"pose in {where}: position, quaternion x y z w", flat_pose(default)
        )
        rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
        speed = _capped(f"{name}_max_speed", max_speed, "m/s", "largest speed of the frame")
        turn = _capped(f"{name}_max_rate", max_rate, "rad/s", "largest angular velocity of the frame")
        error = rotation_vector(rotation_of(goal.symbol[3:]) @ rotation.T)
        parts = {
            "position": (position - goal.symbol[:3], J[:3, :], "m", (goal, rate), speed),
            "orientation": (-error, J[3:, :], "rad", (goal, rate), turn),
        }
        return FrameTask(lambda part: _task(self, f"{name}_{part}", *parts[part]))

    def posture_task(
        self, name: str, target: ArrayLike | Mapping[str, float] | None = None, *, gain: float = 1.0
    ) -> RobotTask:
        """Return a task that moves the joints with one position to a posture.

        Args:
            name: name of the posture, by which `StackController.step` accepts another.
            target: configuration (nq,), or positions [rad or m] by joint; the others, by default all, are those of
                `neutral`.
            gain: convergence gain [1/s].
        """
        places = [place for place in self.coordinates if place.single]
        if not places:
            raise InputError("has no joint with one position", file=self.urdf.path, key=name, remedy="use a frame task")
        rows, columns = [place.q for place in places], [place.v for place in places]
        default = self.neutral()
        if isinstance(target, Mapping):
            for joint, position in target.items():
                default[self.coordinate(joint).q] = as_numbers([position], key=f"{name}: {joint}", size=1)[0]
        elif target is not None:
            default = as_numbers(target, key=name, size=self.nq)
        units = ", ".join("m" if place.joint.type == "prismatic" else "rad" for place in places)
        port = Port(_checked_name(name), (len(rows),), units, "desired joint positions", default[rows])  # type: ignore[arg-type]
        goal = Input(port, ca.SX.sym(name, len(rows)), tunable=True)
        J = ca.SX.eye(self.nv)[columns, :]
        rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
        unit = "rad" if "m" not in units.split(", ") else ""
        return _task(self, name, self.q[rows] - goal.symbol, J, unit, (goal, rate), None, suffix="_posture")

    def com_task(self, target: str, *, gain: float = 1.0, max_speed: float | None = None) -> RobotTask:
        """Return a task that moves the centre of mass to the point `target` (3,) in the world [m].

        Args:
            target: name of the point.
            gain: convergence gain [1/s].
            max_speed: largest desired speed [m/s]; None for no such limit.
        """
        name = _checked_name(target)
        position, J = self.centre_of_mass
        start = ca.Function("com", [self.q], [position])(self.neutral())
        goal = _vector(name, 3, "m", "centre of mass in the world", np.array(start).reshape(-1))
        speed = _capped(f"{name}_max_speed", max_speed, "m/s", "largest speed of the centre of mass")
        rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
        return _task(self, name, position - goal.symbol, J, "m", (goal, rate), speed, suffix="_position")

    def look_at_task(
        self, frame: str, *, target: str, axis: Sequence[float] = (1.0, 0.0, 0.0), gain: float = 1.0
    ) -> RobotTask:
        """Return a task that turns an axis of a frame towards the point `target` (3,) in the world [m].

        σ (2,) is the angle between axis and direction [rad], times the direction across the axis; it is undefined where
        the point is behind the frame.

        Args:
            frame: name of a link. target: name of the point. axis: direction (3,) in the frame.
            gain: convergence gain [1/s].
        """
        name = _checked_name(target)
        moving = self.frame(frame)
        direction = as_numbers(axis, key="axis")
        length = float(np.sqrt(direction @ direction)) if direction.shape == (3,) else 0.0
        if not length > 0.0:
            raise InputError(
                "is not a direction", key=f"{name}: axis", value=axis, remedy="give three numbers, not all 0"
            )
        basis = np.linalg.svd(direction[None] / length)[2]  # rows: the axis up to its sign, then two across
        start = self.pose(frame, self.neutral())
        ahead = start[:3, 3] + start[:3, :3] @ direction / length
        goal = _vector(name, 3, "m", "point in the world to look at", ahead)
        rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
        local = moving.rotation.T @ (goal.symbol - moving.position)
        across, along = ca.DM(basis[1:]) @ local, ca.dot(ca.DM(direction / length), local)
        # the angle to the point, in the direction across the axis; the square root is never differentiated at 0
        size = ca.sqrt(ca.sumsqr(across) + 1e-24 * ca.sumsqr(local))
        return RobotTask(
            robot=self, name=f"{name}_direction", eta=self.q, sigma=across * ca.atan2(size, along) / size,
            gain=rate.symbol, unit="rad",        kinematics=self.rate_map, inputs=(goal, rate),
        )  # fmt: skip

    joint_limits = limits.joint_limits
    self_collision = limits.self_collision


def load_urdf(path: str | Path, *, lock: Sequence[str] | Mapping[str, float] = (), base: Base = "fixed") -> Robot:
    """Return the robot that a URDF file describes.

    Args:
        path: the file.
        lock: joints that do not move: their names, for position 0, or the position [rad or m] of each by name.
        base: what moves the root link: nothing, a planar joint or a floating joint, which comes first in q and v.

    Raises:
        InputError: `read_urdf` finds an error, a joint to be locked is unknown or has several positions, or nothing
            moves.

    Example:
        >>> from pathlib import Path
        >>> from surctl.robot import load_urdf
        >>> links = '<link name="base"/><link name="arm"/>'
        >>> ends = '<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/><origin xyz="0.5 0 0"/>'
        >>> _ = Path("hinge.urdf").write_text(f'<robot>{links}<joint name="j" type="continuous">{ends}</joint></robot>')
        >>> robot = load_urdf("hinge.urdf")
        >>> robot.pose("arm", [0.0])[:3, 3].tolist(), robot.jacobian("arm", [0.0])[:, 0].tolist()
        ([0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    """
    urdf = read_urdf(path)
    known = {joint.name: joint for joint in urdf.joints}
    positions = dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(lock, 0.0)
    for name, position in positions.items():
        check_known(name, known, "no such joint", key="lock", file=path)
        if known[name].type in ("planar", "floating") or not math.isfinite(position):
            remedy = "give one finite position"
            raise InputError("cannot be locked there", file=path, key=f"lock {name}", value=position, remedy=remedy)
    with mistakes_in(path):
        return Robot(urdf, lock=positions, base=base)
