"""Poses and Jacobians of links by Pinocchio, in the coordinates of `surctl.robot`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio
from numpy.typing import NDArray

from surctl.robot import Robot

__all__ = ["poses"]

Array = NDArray[np.float64]


def poses(robot: Robot, path: Path, configurations: Array) -> Iterator[tuple[Array, Array]]:
    """Yield position and rotation (L, 12) and Jacobians (L, 6, nv) of all links for each configuration (n, nq)."""
    floating = robot.coordinates[0].joint.name == "base"
    arguments = [pinocchio.JointModelFreeFlyer()] if floating else []
    model = pinocchio.buildModelFromUrdf(str(path), *arguments)
    data = model.createData()
    frames = [model.getFrameId(name, pinocchio.FrameType.BODY) for name in robot.links if name != "world"]
    chosen, M = _mapping(robot, model)
    for q in configurations:
        pinocchio.computeJointJacobians(model, data, _configuration(model, q, chosen))
        pinocchio.updateFramePlacements(model, data)
        places = [np.append(data.oMf[f].translation, data.oMf[f].rotation.reshape(-1)) for f in frames]
        aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        yield np.array(places), np.array([pinocchio.getFrameJacobian(model, data, f, aligned) @ M for f in frames])


def _mapping(robot: Robot, model: pinocchio.Model) -> tuple[list[tuple[int, slice, float, slice, float]], Array]:
    """Return how Pinocchio's configuration follows from q, and its velocity (nv of Pinocchio, nv) from v."""
    M, chosen = np.zeros((model.nv, robot.nv)), []
    for index in range(1, model.njoints):
        joint = model.joints[index]
        name = "base" if model.names[index] == "root_joint" else model.names[index]
        factor, source, offset = robot.position_of(name)
        at = slice(0, 0)
        if source is not None:
            place = robot.coordinate(source)
            at = slice(place.q, place.q + (1 if place.single else joint.nq))
            M[joint.idx_v : joint.idx_v + joint.nv, place.v : place.v + joint.nv] = factor * np.eye(joint.nv)
        chosen.append((joint.nv, slice(joint.idx_q, joint.idx_q + joint.nq), factor, at, offset))
    return chosen, M


def _configuration(model: pinocchio.Model, q: Array, chosen: list[tuple[int, slice, float, slice, float]]) -> Array:
    whole = np.zeros(model.nq)
    for speeds, to, factor, at, offset in chosen:
        own = q[at] * factor + offset if at.stop > at.start else np.array([offset])
        # Pinocchio stores a joint without limits as cosine and sine, and a planar one as x, y, cosine and sine
        if speeds in (1, 3) and to.stop - to.start > speeds:
            own = np.concatenate([own[:-1], [np.cos(own[-1]), np.sin(own[-1])]])
        whole[to] = own
    return whole
