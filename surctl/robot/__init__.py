"""Any robot from its URDF: kinematics, tasks, limits, and priority controllers that run in Python and in C."""

from surctl.robot.kinematics import Coordinate, Frame, Kinematics
from surctl.robot.limits import JointLimits, SelfCollision
from surctl.robot.robot import FrameTask, Input, Robot, RobotTask, load_urdf
from surctl.robot.stack_controller import StackController
from surctl.robot.urdf import Capsule, Joint, Link, Mimic, Urdf, read_urdf

__all__ = [
    "Capsule",
    "Coordinate",
    "Frame",
    "FrameTask",
    "Input",
    "Joint",
    "JointLimits",
    "Kinematics",
    "Link",
    "Mimic",
    "Robot",
    "RobotTask",
    "SelfCollision",
    "StackController",
    "Urdf",
    "load_urdf",
    "read_urdf",
]
