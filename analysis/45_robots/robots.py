"""Three robots of the package example-robot-data and a small arm, as URDF files with capsules as collision geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.robot import Robot, SelfCollision, StackController, load_urdf

__all__ = ["CASES", "DAMPING", "QUICK", "Case", "Subject", "folder_of_robots", "subject"]

Array = NDArray[np.float64]
Capsules = dict[str, tuple[tuple[Sequence[float], Sequence[float], float], ...]]

GAIN, SPEED, RATE, ACCELERATION, MARGIN, DAMPING = 5.0, 0.3, 1.0, 15.0, 0.01, 0.05
"""Convergence gain [1/s], largest speed [m/s] and angular velocity [rad/s] of a tool, acceleration [rad/s², m/s²],
least gap [m], damping [m s]."""


@dataclass(frozen=True)
class Case:
    """A robot, and what is asked of it.

    Attributes:
        name: name of the robot. file: path of its URDF file in example-robot-data; "" for the arm of this study.
        joints: the joints that move; all others are fixed. tools: links that have targets.
        home: positions of the joints [rad or m], where a run starts.
        capsules: ends and radius [m] of capsules by link. apart: pairs of groups of links whose links keep a distance.
        vehicle: whether two sliding joints and a turning joint move the root link.
    """

    name: str
    file: str
    joints: tuple[str, ...]
    tools: tuple[str, ...]
    home: tuple[float, ...]
    capsules: Capsules
    apart: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]
    vehicle: bool = False


_SIDES = ("right", "left")
_BAXTER = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
_HANDS = {side: (f"{side}_upper_forearm", f"{side}_wrist") for side in _SIDES}
QUICK = Case(
    "arm", "", ("joint1", "joint2"), ("link2",), (0.3, 1.2),
    {"link0": (((0, 0, 0), (-0.1, 0, 0), 0.1),), "link2": (((0.1, 0, 0), (0.4, 0, 0), 0.05),)},
    ((("link0",), ("link2",)),),
)  # fmt: skip
CASES = (
    Case(
        "Panda", "panda_description/urdf/panda.urdf", tuple(f"panda_joint{k}" for k in range(1, 8)),
        ("panda_hand_tcp",), (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
        {
            "panda_link0": (((-0.09, 0, 0.06), (-0.06, 0, 0.06), 0.06),),
            "panda_link1": (((0, 0, -0.333), (0, 0, -0.05), 0.06),),
            "panda_link2": (((0, 0, -0.06), (0, 0, 0.06), 0.06),),
            "panda_link5": (((0, 0, -0.31), (0, 0, -0.21), 0.06),),
            "panda_link7": (((0, 0, -0.06), (0, 0, 0.08), 0.04),),
            "panda_hand": (((0, -0.05, 0.04), (0, 0.05, 0.04), 0.04), ((0, 0, 0.04), (0, 0, 0.1), 0.03)),
        },
        ((("panda_link0", "panda_link1", "panda_link2"), ("panda_link5", "panda_link7", "panda_hand")),),
    ),
    Case(
        "Baxter, two arms", "baxter_description/urdf/baxter.urdf",
        tuple(f"{side}_{joint}" for side in _SIDES for joint in _BAXTER), ("right_gripper", "left_gripper"),
        (0.0, -0.55, 0.0, 1.1, 0.0, 0.9, 0.0) * 2,
        {
            "torso": (((-0.03, 0, 0), (-0.03, 0, 0.5), 0.16), ((0.08, 0, 0.75), (0.08, 0, 0.75), 0.18)),
            **{f"{side}_upper_elbow": (((0, 0, 0), (0.069, 0, 0.262), 0.06),) for side in _SIDES},
            **{f"{side}_upper_forearm": (((0, 0, 0), (0.01, 0, 0.271), 0.06),) for side in _SIDES},
            **{f"{side}_wrist": (((0, 0, 0), (0, 0, 0.2), 0.05),) for side in _SIDES},
        },
        (
            (_HANDS["right"], ("torso", "left_upper_elbow", *_HANDS["left"])),
            (_HANDS["left"], ("torso", "right_upper_elbow")),
        ),
    ),
    Case(
        "TIAGo, vehicle with arm", "tiago_description/robots/tiago_no_hand.urdf",
        ("base_x", "base_y", "base_angle", "torso_lift_joint", *(f"arm_{k}_joint" for k in range(1, 8))),
        ("arm_tool_link",), (0.0, 0.0, 0.0, 0.15, 0.8, -0.5, -1.0, 1.5, 0.0, 0.3, 0.0),
        {
            "base_link": (((0, 0, 0.05), (0, 0, 0.12), 0.27),),
            "torso_fixed_link": (((-0.06, 0, -0.5), (-0.06, 0, 0.5), 0.16),),
            "torso_lift_link": (((0.12, 0, 0.05), (0.12, 0, 0.15), 0.15),),
            "arm_4_link": (((0, 0, 0), (-0.162, 0.02, 0.027), 0.06),),
            "arm_5_link": (((0, 0, 0), (0, 0, 0.15), 0.05),),
            "arm_7_link": (((0, 0, 0), (0, 0, 0.05), 0.05),),
        },
        ((("base_link", "torso_fixed_link", "torso_lift_link"), ("arm_4_link", "arm_5_link", "arm_7_link")),),
        vehicle=True,
    ),
)  # fmt: skip
_ARM = (
    '<robot name="arm"><link name="link0"/><link name="link1"/><link name="link2"/>'
    '<joint name="joint1" type="revolute"><parent link="link0"/><child link="link1"/><axis xyz="0 0 1"/>'
    '<limit lower="-2.5" upper="2.5" velocity="2"/></joint>'
    '<joint name="joint2" type="revolute"><parent link="link1"/><child link="link2"/><axis xyz="0 0 1"/>'
    '<origin xyz="0.5 0 0"/><limit lower="-2.9" upper="2.9" velocity="2"/></joint></robot>'
)
_BASE = (  # joint, type, axis, lower, upper, velocity
    ("base_x", "prismatic", "1 0 0", -0.5, 0.5, 0.5),
    ("base_y", "prismatic", "0 1 0", -0.5, 0.5, 0.5),
    ("base_angle", "revolute", "0 0 1", -1.5, 1.5, 1.0),
)


def folder_of_robots() -> Path:
    """Return the folder of the URDF files in the package example-robot-data."""
    import pinocchio

    return Path(pinocchio.__file__).parents[4] / "share" / "example-robot-data" / "robots"


@dataclass(frozen=True, eq=False)
class Subject:
    """A robot with its tasks and limits.

    Attributes:
        case: the case. path: its URDF file. robot: the robot. home: where a run starts (nq,).
        lower, upper, speed: limits of position and speed (nq,). barriers: the pairs of capsules.
        places: CasADi function of q: position of each tool (3, t). gaps: function of q: distances of all pairs.
        gaps_by: function of q: their Jacobian. places_by: function of q: Jacobian (3 t, nv) of the positions.
    """

    case: Case
    path: Path
    robot: Robot
    home: Array
    lower: Array
    upper: Array
    speed: Array
    barriers: SelfCollision
    places: ca.Function
    places_by: ca.Function
    gaps: ca.Function
    gaps_by: ca.Function

    def controller(self, dt: float, damping: float = DAMPING) -> StackController:
        """Return the controller: positions of the tools, then their orientations, then the posture."""
        robot, plane = self.robot, self.case is QUICK
        tools = [
            robot.frame_task(link, target=f"tool{k}", gain=GAIN, max_speed=SPEED, max_rate=RATE)
            for k, link in enumerate(self.case.tools)
        ]
        tasks = [tool.position for tool in tools] + [tool.orientation for tool in tools if not plane]
        limits = [robot.joint_limits(acceleration=ACCELERATION), self.barriers]
        return StackController(
            [*tasks, robot.posture_task("home", self.home, gain=GAIN)], limits=limits, dt=dt, damping=damping
        )


def subject(case: Case, folder: Path) -> Subject:
    """Write the URDF file of a case, and return the robot with its limits."""
    path = _written(case, folder)
    robot = load_urdf(path)
    names = [place.joint.name for place in robot.coordinates]
    home = np.zeros(robot.nq)
    home[[names.index(name) for name in case.joints]] = case.home
    ends = np.array([robot.range_of(place) for place in robot.coordinates])
    speed = np.array([robot.speed_of(place, {}) for place in robot.coordinates])
    barriers = robot.self_collision(_srdf(case, folder), margin=MARGIN)
    distances = [barriers.distance(pair) for pair in barriers.pairs]
    frames = [robot.frame(link) for link in case.tools]
    q = [robot.q]
    return Subject(
        case, path, robot, home, ends[:, 0], ends[:, 1], speed, barriers,
        ca.Function("places", q, [ca.horzcat(*(frame.position for frame in frames))]),
        ca.Function("places_by", q, [ca.densify(ca.vertcat(*(frame.jacobian[:3, :] for frame in frames)))]),
        ca.Function("gaps", q, [ca.vertcat(*(distance for distance, _ in distances))]),
        ca.Function("gaps_by", q, [ca.densify(ca.vertcat(*(J for _, J in distances)))]),
    )  # fmt: skip


def _written(case: Case, folder: Path) -> Path:
    """Write the URDF file with the joints and the collision geometry of a case, for surctl, Pinocchio and MuJoCo."""
    tree = ElementTree.ElementTree(ElementTree.fromstring(_ARM))
    if case.file:
        tree = ElementTree.parse(folder_of_robots() / case.file)
    root = tree.getroot()
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if joint.get("name") not in case.joints:
            joint.set("type", "fixed")
    if case.vehicle:
        children = {joint.find("child").get("link") for joint in root.findall("joint")}  # type: ignore[union-attr]
        below = next(link.get("name") for link in root.findall("link") if link.get("name") not in children)
        links = ("ground", "base_1", "base_2", below)
        for k, (name, kind, axis, lower, upper, velocity) in enumerate(_BASE):
            root.append(
                ElementTree.fromstring(
                    f'<joint name="{name}" type="{kind}"><parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
                    f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="1"/>'
                    "</joint>"
                )
            )
            root.append(ElementTree.Element("link", name=str(links[k])))
    for link in root.findall("link"):
        for part in list(link):
            link.remove(part)
        inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        link.append(ElementTree.fromstring(f'<inertial><mass value="1"/>{inertia}</inertial>'))
        for start, end, radius in case.capsules.get(str(link.get("name")), ()):
            link.append(_capsule(np.array(start, dtype=float), np.array(end, dtype=float), radius))
    compiler = '<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco>'
    root.insert(0, ElementTree.fromstring(compiler))
    path = folder / f"{case.tools[0]}.urdf"
    tree.write(path)
    return path


def _capsule(start: Array, end: Array, radius: float) -> ElementTree.Element:
    middle, along = (start + end) / 2.0, end - start
    length = float(np.sqrt(along @ along))
    shape, pitch, yaw = f'<sphere radius="{radius}"/>', 0.0, 0.0
    if length > 0.0:
        shape = f'<capsule radius="{radius}" length="{length!r}"/>'
        pitch, yaw = float(np.arctan2(np.hypot(along[0], along[1]), along[2])), float(np.arctan2(along[1], along[0]))
    origin = f'<origin xyz="{middle[0]} {middle[1]} {middle[2]}" rpy="0 {pitch!r} {yaw!r}"/>'
    return ElementTree.fromstring(f"<collision>{origin}<geometry>{shape}</geometry></collision>")


def _srdf(case: Case, folder: Path) -> Path:
    """Write the SRDF file that disables all pairs of links with capsules but those of the case."""
    kept = {frozenset((one, other)) for ones, others in case.apart for one in ones for other in others}
    pairs = [pair for pair in combinations(case.capsules, 2) if frozenset(pair) not in kept]
    lines = [f'<disable_collisions link1="{one}" link2="{other}"/>' for one, other in pairs]
    path = folder / f"{case.tools[0]}.srdf"
    path.write_text(f"<robot>{''.join(lines)}</robot>", encoding="utf-8")
    return path
