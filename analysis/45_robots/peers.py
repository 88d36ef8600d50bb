"""pink and mink on the work of `reach`: the same robot, capsules, targets, gains and limits."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from robots import ACCELERATION, GAIN, MARGIN, RATE, SPEED, Subject
from scipy.spatial.transform import Rotation

__all__ = ["WEIGHTS", "mink_step", "pink_step"]

Array = NDArray[np.float64]
Step = Callable[[Array, Array, list[Array]], tuple[Array, str]]

WEIGHTS = (1.0, 0.01, 1e-4)
"""Costs of position, orientation and posture, which stand for the order of the tasks."""
_DAMPING, _SEEN = 1e-5, 0.3  # of both; distance [m] below which a pair of capsules counts in mink


def pink_step(robot: Subject, dt: float) -> Step:
    """Return a step of pink with DAQP; without its limit of acceleration where it has no solution within all limits."""
    import pink
    import pinocchio as pin
    from pink.barriers import SelfCollisionBarrier
    from pink.limits import AccelerationLimit, ConfigurationLimit, VelocityLimit

    # its parser of URDF files does not read capsules
    model = pin.buildModelFromXML(re.sub("<collision>.*?</collision>", "", robot.path.read_text(encoding="utf-8")))
    shapes = _shapes(robot, model, pin)
    order = [robot.robot.names.index(name) for name in list(model.names)[1:]]  # Pinocchio sorts the branches by name
    configuration = pink.Configuration(
        model, model.createData(), robot.home[order], collision_model=shapes, collision_data=pin.GeometryData(shapes)
    )
    tools = [
        pink.FrameTask(link, position_cost=_cost(k, 0), orientation_cost=_cost(k, 1), gain=GAIN * dt)
        for k, link in enumerate(robot.case.tools)
    ]
    posture = pink.PostureTask(cost=WEIGHTS[2], gain=GAIN * dt)
    posture.set_target(robot.home[order])
    slow = AccelerationLimit(model, np.full(model.nv, ACCELERATION))
    limits = [ConfigurationLimit(model), VelocityLimit(model), slow]
    barriers = [SelfCollisionBarrier(len(shapes.collisionPairs), gain=GAIN, safe_displacement_gain=0.0, d_min=MARGIN)]

    def step(q: Array, before: Array, poses: list[Array]) -> Array:
        configuration.update(q[order])
        slow.set_last_integration(before[order], dt)
        for tool, link, pose in zip(tools, robot.case.tools, poses, strict=True):
            tool.set_target(pin.SE3(_ahead(configuration.get_transform_frame_to_world(link).homogeneous, pose)))
        for kept in (limits, limits[:-1]):
            try:
                found = pink.solve_ik(
                    configuration, [*tools, posture], dt, solver="daqp", limits=kept, barriers=barriers,
                    damping=_DAMPING, safety_break=False,
                )  # fmt: skip
            except pink.exceptions.NoSolutionFound:
                continue
            v = np.zeros(model.nv)
            v[order] = found
            return v, "met" if kept is limits else "no solution"
        return np.zeros(model.nv), "no solution"

    return step


def mink_step(robot: Subject, dt: float) -> Step:
    """Return a step of mink with DAQP; mink has no limit of acceleration."""
    import mink
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(robot.path))
    for geom in range(model.ngeom):
        model.geom_conaffinity[geom] = model.geom_contype[geom] = 1
    configuration = mink.Configuration(model, q=robot.home)
    tools = [
        mink.FrameTask(link, "body", position_cost=_cost(k, 0), orientation_cost=_cost(k, 1), gain=GAIN * dt)
        for k, link in enumerate(robot.case.tools)
    ]
    posture = mink.PostureTask(model, cost=WEIGHTS[2], gain=GAIN * dt)
    posture.set_target(robot.home)
    geoms = {
        link: [g for g in range(model.ngeom) if model.geom_bodyid[g] == model.body(link).id]
        for link in robot.case.capsules
    }
    pairs = [(geoms[one], geoms[other]) for ones, others in robot.case.apart for one in ones for other in others]
    speeds = dict(zip(robot.robot.names, robot.speed, strict=True))
    limits = [
        mink.ConfigurationLimit(model),
        mink.VelocityLimit(model, speeds),
        mink.CollisionAvoidanceLimit(
            model, pairs, gain=GAIN * dt, minimum_distance_from_collisions=MARGIN, collision_detection_distance=_SEEN
        ),
    ]

    def step(q: Array, before: Array, poses: list[Array]) -> Array:
        configuration.update(q)
        for tool, link, pose in zip(tools, robot.case.tools, poses, strict=True):
            here = configuration.get_transform_frame_to_world(link, "body").as_matrix()
            tool.set_target(mink.SE3.from_matrix(_ahead(here, pose)))
        v: Array = mink.solve_ik(configuration, [*tools, posture], dt, solver="daqp", limits=limits, damping=_DAMPING)
        return v, "met"

    return step


def _cost(tool: int, part: int) -> float:
    """Return the cost of position (0) or orientation (1) of a tool; the second tool comes after the first."""
    return WEIGHTS[part] * 0.3**tool


def _ahead(here: Array, target: Array) -> Array:
    """Return the pose on the way to the target at which the desired speeds are at most SPEED and RATE, as in surctl."""
    pose = target.copy()
    apart = target[:3, 3] - here[:3, 3]
    pose[:3, 3] = here[:3, 3] + apart * min(1.0, SPEED / GAIN / max(1e-12, float(np.linalg.norm(apart))))
    turn = Rotation.from_matrix(target[:3, :3] @ here[:3, :3].T).as_rotvec()
    turn *= min(1.0, RATE / GAIN / max(1e-12, float(np.linalg.norm(turn))))
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ here[:3, :3]
    return pose


def _shapes(robot: Subject, model: Any, pin: Any) -> Any:
    """Return the capsules as Pinocchio's geometry."""
    import coal

    geometry, numbers = pin.GeometryModel(), {}
    for pair in robot.barriers.pairs:
        ends = []
        for link, capsule in (pair[:2], pair[2:]):
            if id(capsule) not in numbers:
                frame = model.frames[model.getFrameId(link)]
                along = np.asarray(capsule.axis, dtype=float)
                turn = np.eye(3)
                if capsule.length > 0.0:
                    z = along / capsule.length
                    x = np.linalg.svd(z[None])[2][1]
                    turn = np.column_stack([x, np.cross(z, x), z])
                at = frame.placement * pin.SE3(turn, np.asarray(capsule.start) + along / 2.0)
                shape = coal.Capsule(capsule.radius, capsule.length)
                item = pin.GeometryObject(
                    f"{link}.{len(numbers)}", frame.parentJoint, model.getFrameId(link), at, shape
                )
                numbers[id(capsule)] = geometry.addGeometryObject(item)
            ends.append(numbers[id(capsule)])
        geometry.addCollisionPair(pin.CollisionPair(*ends))
    return geometry
