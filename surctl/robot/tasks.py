"""Tasks of a robot: frames, centre of mass, posture and the direction in which a frame looks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Port
from surctl.robot.kinematics import Kinematics
from surctl.robot.rotation import quaternion_of, rotation_of, rotation_vector
from surctl.tasks import Task
from surctl.units import is_number

__all__ = ["FrameTask", "Input", "RobotTask", "com_task", "frame_task", "look_at_task", "posture_task"]

Array: TypeAlias = NDArray[np.float64]

_MATRIX = ca.SX.sym("R", 3, 3)
_QUATERNION = ca.Function("quaternion", [_MATRIX], [quaternion_of(_MATRIX)])
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


def frame_task(
    robot: Kinematics,
    frame: str,
    *,
    target: str,
    gain: float = 1.0,
    max_speed: float | None = None,
    max_rate: float | None = None,
    relative_to: str | None = None,
) -> FrameTask:
    """Return tasks for position and orientation of a link; see `Robot.frame_task`."""
    name = _checked_name(target)
    moving = robot.frame(frame)
    position, rotation, J = moving.position, moving.rotation, moving.jacobian
    default = robot.pose(frame, robot.neutral())
    if relative_to is not None:
        other = robot.frame(relative_to)
        R, apart = other.rotation, position - other.position
        # seen in the other frame, whose rotation moves the frame too
        linear = J[:3, :] - other.jacobian[:3, :] + _cross(apart) @ other.jacobian[3:, :]
        J = ca.vertcat(R.T @ linear, R.T @ (J[3:, :] - other.jacobian[3:, :]))
        position, rotation = R.T @ apart, R.T @ rotation
        default = np.linalg.inv(robot.pose(relative_to, robot.neutral())) @ default
    where = "the world" if relative_to is None else relative_to
    goal = _vector(name, 7, "m, m, m, 1, 1, 1, 1", f"pose in {where}: position, quaternion x y z w", flat_pose(default))
    rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
    speed = _capped(f"{name}_max_speed", max_speed, "m/s", "largest speed of the frame")
    turn = _capped(f"{name}_max_rate", max_rate, "rad/s", "largest angular velocity of the frame")
    error = rotation_vector(rotation_of(goal.symbol[3:]) @ rotation.T)
    parts = {
        "position": (position - goal.symbol[:3], J[:3, :], "m", (goal, rate), speed),
        "orientation": (-error, J[3:, :], "rad", (goal, rate), turn),
    }
    return FrameTask(lambda part: _task(robot, f"{name}_{part}", *parts[part]))


def com_task(robot: Kinematics, target: str, *, gain: float = 1.0, max_speed: float | None = None) -> RobotTask:
    """Return a task for the centre of mass; see `Robot.com_task`."""
    name = _checked_name(target)
    position, J = robot.centre_of_mass
    start = ca.Function("com", [robot.q], [position])(robot.neutral())
    goal = _vector(name, 3, "m", "centre of mass in the world", np.array(start).reshape(-1))
    speed = _capped(f"{name}_max_speed", max_speed, "m/s", "largest speed of the centre of mass")
    rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
    return _task(robot, name, position - goal.symbol, J, "m", (goal, rate), speed, suffix="_position")


def posture_task(
    robot: Kinematics, name: str, target: ArrayLike | Mapping[str, float] | None = None, *, gain: float = 1.0
) -> RobotTask:
    """Return a task for the positions of the joints; see `Robot.posture_task`."""
    places = [place for place in robot.coordinates if place.single]
    rows, columns = [place.q for place in places], [place.v for place in places]
    default = robot.neutral()
    if isinstance(target, Mapping):
        for joint, position in target.items():
            default[robot.coordinate(joint).q] = robot.checked([position], 1, f"{name}: {joint}")[0]
    elif target is not None:
        default = robot.checked(target, robot.nq, name)
    units = ", ".join("m" if place.joint.type == "prismatic" else "rad" for place in places)
    port = Port(_checked_name(name), (len(rows),), units, "desired joint positions", default[rows])  # type: ignore[arg-type]
    goal = Input(port, ca.SX.sym(name, len(rows)), tunable=True)
    J = ca.SX.eye(robot.nv)[columns, :]
    rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
    unit = "rad" if "m" not in units.split(", ") else ""
    return _task(robot, name, robot.q[rows] - goal.symbol, J, unit, (goal, rate), None, suffix="_posture")


def look_at_task(
    robot: Kinematics, frame: str, *, target: str, axis: Sequence[float] = (1.0, 0.0, 0.0), gain: float = 1.0
) -> RobotTask:
    """Return a task that turns an axis of a frame towards a point; see `Robot.look_at_task`."""
    name = _checked_name(target)
    moving = robot.frame(frame)
    direction = np.asarray(axis, dtype=float)
    length = float(np.sqrt(direction @ direction)) if direction.shape == (3,) else 0.0
    if not length > 0.0:
        raise InputError("is not a direction", key=f"{name}: axis", value=axis, remedy="give three numbers, not all 0")
    basis = np.linalg.svd(direction[None] / length)[2]  # rows: the axis up to its sign, then two across
    start = robot.pose(frame, robot.neutral())
    ahead = start[:3, 3] + start[:3, :3] @ direction / length
    goal = _vector(name, 3, "m", "point in the world to look at", ahead)
    rate = _number(f"{name}_gain", gain, "1/s", "convergence gain")
    local = moving.rotation.T @ (goal.symbol - moving.position)
    across, along = ca.DM(basis[1:]) @ local, ca.dot(ca.DM(direction / length), local)
    # the angle to the point, in the direction across the axis; the square root is never differentiated at 0
    size = ca.sqrt(ca.sumsqr(across) + 1e-24 * ca.sumsqr(local))
    return RobotTask(
        robot=robot, name=f"{name}_direction", eta=robot.q, sigma=across * ca.atan2(size, along) / size,
        gain=rate.symbol, unit="rad",        kinematics=robot.rate_map, inputs=(goal, rate),
    )  # fmt: skip


def flat_pose(pose: ArrayLike) -> Array:
    """Return position and quaternion (7,): x, y, z [m], then x, y, z, w; from these, or from a matrix (4, 4)."""
    matrix = np.asarray(pose, dtype=float)
    if matrix.shape != (4, 4):
        return matrix.reshape(-1)
    R = matrix[:3, :3]
    if not np.isfinite(matrix).all() or abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
        raise InputError("is not a pose", key="target", value=matrix.tolist(), remedy="give a homogeneous matrix")
    return np.concatenate([matrix[:3, 3], np.array(_QUATERNION(R)).reshape(-1)])


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
    if not is_number(value) or not value > 0.0:
        raise InputError("is not a positive number", key=name, value=value, remedy=f"give {unit}")
    return Input(Port(name, (1,), unit, meaning, float(value)), ca.SX.sym(name), tunable=True)


def _capped(name: str, value: float | None, unit: str, meaning: str) -> Input | None:
    return None if value is None else _number(name, value, unit, meaning)


def _cross(vector: ca.SX) -> ca.SX:
    return ca.skew(vector)
