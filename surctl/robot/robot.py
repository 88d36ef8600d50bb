"""A robot from its URDF file, with the tasks and limits that a `StackController` takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from surctl.errors import InputError, nearest
from surctl.robot import limits, tasks
from surctl.robot.kinematics import Base, Kinematics
from surctl.robot.limits import JointLimits, SelfCollision
from surctl.robot.shapes import Capsule
from surctl.robot.tasks import FrameTask, RobotTask
from surctl.robot.urdf import read_urdf

__all__ = ["Robot", "load_urdf"]


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
        return tasks.frame_task(
            self, frame, target=target, gain=gain, max_speed=max_speed, max_rate=max_rate, relative_to=relative_to
        )

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
        return tasks.posture_task(self, name, target, gain=gain)

    def com_task(self, target: str, *, gain: float = 1.0, max_speed: float | None = None) -> RobotTask:
        """Return a task that moves the centre of mass to the point `target` (3,) in the world [m].

        Args:
            target: name of the point.
            gain: convergence gain [1/s].
            max_speed: largest desired speed [m/s]; None for no such limit.
        """
        return tasks.com_task(self, target, gain=gain, max_speed=max_speed)

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
        return tasks.look_at_task(self, frame, target=target, axis=axis, gain=gain)

    def joint_limits(
        self,
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
        return limits.joint_limits(self, acceleration=acceleration, velocity=velocity)

    def self_collision(
        self,
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
            InputError: a link has a collision mesh and no shape is given, a name is unknown, or no pair is left.
        """
        return limits.self_collision(self, srdf, margin=margin, gain=gain, shapes=shapes)


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
        if name not in known:
            raise InputError("no such joint", file=path, key="lock", value=name, remedy=nearest(str(name), known))
        if known[name].type in ("planar", "floating") or not math.isfinite(position):
            remedy = "give one finite position"
            raise InputError("cannot be locked there", file=path, key=f"lock {name}", value=position, remedy=remedy)
    try:
        return Robot(urdf, lock=positions, base=base)
    except InputError as error:
        raise error.inside(path) from None
