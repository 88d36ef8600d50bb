"""Poses and Jacobians of drawn robots against products of homogeneous matrices and differences."""

from __future__ import annotations

import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.robot import Robot, load_urdf
from tests.robot.robots import ARM, joint, link, written

Array = NDArray[np.float64]
KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating", "mimic", "locked")


def _turn(axis: Array, angle: float) -> Array:
    """A rotation by the power series of its generator, which shares nothing with Rodrigues' formula."""
    x, y, z = angle * axis
    step = np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0, 0, 0, 0]])
    whole = term = np.eye(4)
    for k in range(1, 40):
        term = term @ step / k
        whole = whole + term
    return whole


def _shift(offset: Array) -> Array:
    T = np.eye(4)
    T[:3, 3] = offset
    return T


def _motion(kind: str, axis: Array, own: Array) -> Array:
    if kind == "planar":
        return _shift(np.append(own[:2], 0.0)) @ _turn(np.array([0.0, 0.0, 1.0]), own[2])
    if kind == "floating":
        angle = 2.0 * math.acos(max(-1.0, min(1.0, own[6])))
        return _shift(own[:3]) @ _turn(own[3:6] / max(1e-300, math.sqrt(own[3:6] @ own[3:6])), angle)
    return _shift(axis * own[0]) if kind == "prismatic" else _turn(axis, own[0])


def _drawn(seed: int, size: int, folder: Path) -> tuple[Robot, Array, dict[str, Array]]:
    """A drawn tree, a configuration, and the pose of each link."""
    draws = np.random.default_rng(seed)
    kinds = ["revolute", *draws.choice(KINDS, size - 1)]
    parts, poses, positions, lock, q = [link("l0")], {"l0": np.eye(4)}, {}, {}, []
    for k, kind in enumerate(kinds, 1):
        parent, name = f"l{draws.integers(k)}", f"j{k}"
        xyz, rpy, axis = draws.normal(size=3), draws.uniform(-math.pi, math.pi, 3), draws.normal(size=3)
        axis = np.array([0.0, 0.0, 1.0]) if kind == "planar" else axis
        more, written_kind = "", kind
        own = draws.normal(size={"planar": 3, "floating": 7}.get(kind, 1))
        if kind == "floating":
            own[3:] /= math.sqrt(own[3:] @ own[3:])
        if kind == "locked":
            lock[name], written_kind = float(own[0]), "revolute"
        elif kind == "mimic":
            source = str(draws.choice(list(positions)))
            factor, offset = map(float, draws.normal(size=2))
            more = f'<mimic joint="{source}" multiplier="{factor!r}" offset="{offset!r}"/>'
            own, written_kind = factor * positions[source] + offset, str(draws.choice(["revolute", "prismatic"]))
        elif kind == "fixed":
            own = np.zeros(1)
        if kind in ("revolute", "continuous", "prismatic", "mimic", "locked"):
            positions[name] = own
        parts += [link(f"l{k}"), joint(name, parent, f"l{k}", written_kind, xyz=xyz, rpy=rpy, axis=axis, more=more)]
        unit = axis / math.sqrt(axis @ axis)
        frame = _shift(xyz) @ _turn(np.eye(3)[2], rpy[2]) @ _turn(np.eye(3)[1], rpy[1]) @ _turn(np.eye(3)[0], rpy[0])
        poses[f"l{k}"] = poses[parent] @ frame @ _motion(written_kind, unit, own)
    robot = load_urdf(written(folder, *parts), lock=lock)
    free = [f"j{k}" for k, kind in enumerate(kinds, 1) if kind not in ("mimic", "locked", "fixed")]
    assert sorted(robot.names) == sorted(free)
    for place in robot.coordinates:
        pose = np.linalg.inv(_frame_of(robot, place.joint.name, poses)) @ poses[place.joint.child]
        q.append(_coordinates(place.joint.type, place.joint.axis, pose, positions.get(place.joint.name)))
    return robot, np.concatenate(q), poses


def _frame_of(robot: Robot, name: str, poses: dict[str, Array]) -> Array:
    own = next(joint for joint in robot.urdf.joints if joint.name == name)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = own.rotation, own.position
    return poses[own.parent] @ T


def _coordinates(kind: str, axis: Array, pose: Array, position: Array | None) -> Array:
    if position is not None:
        return position
    if kind == "planar":
        return np.array([*pose[:2, 3], math.atan2(pose[1, 0], pose[0, 0])])
    # the eigenvector of this matrix with the largest eigenvalue is the quaternion (Bar-Itzhack 2000)
    R = pose[:3, :3]
    K = np.zeros((4, 4))
    K[:3, :3] = R + R.T - np.eye(3) * np.trace(R)
    K[3, :3] = K[:3, 3] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[3, 3] = np.trace(R)
    return np.concatenate([pose[:3, 3], np.linalg.eigh(K)[1][:, -1]])


@settings(max_examples=12, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 9))
def test_drawn_robots_equal_products_of_matrices_and_differences(
    seed: int, size: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    robot, q, poses = _drawn(seed, size, tmp_path_factory.mktemp("robot"))
    scale, h = 1.0 + max(abs(pose).max() for pose in poses.values()), 1e-6
    for name in robot.links:
        assert abs(robot.pose(name, q) - poses[name]).max() < 1e-11 * scale
    name = robot.links[-1]
    J, R = robot.jacobian(name, q), robot.pose(name, q)[:3, :3]
    for j, direction in enumerate(np.eye(robot.nv)):
        ahead, behind = (robot.pose(name, robot.integrate(q, direction, by)) for by in (h, -h))
        slope = (ahead - behind) / (2.0 * h)
        W = slope[:3, :3] @ R.T
        column = np.array([*slope[:3, 3], W[2, 1], W[0, 2], W[1, 0]])
        assert abs(J[:, j] - column).max() < 1e-8 * scale**2


def test_the_rate_of_the_configuration_is_that_of_its_integration(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM), base="floating")
    draws = np.random.default_rng(1)
    q, v, h = robot.neutral(), draws.normal(size=robot.nv), 1e-6
    q = robot.integrate(q, draws.normal(size=robot.nv), 1.0)
    rate = np.array(ca.Function("rate", [robot.q], [ca.densify(robot.rate_map)])(q)) @ v
    assert abs((robot.integrate(q, v, h) - robot.integrate(q, v, -h)) / (2.0 * h) - rate).max() < 1e-9


def test_the_centre_of_mass_is_the_mean_of_the_links(tmp_path: Path) -> None:
    robot = load_urdf(written(tmp_path, *ARM))
    q = np.array([0.3, -0.7, 1.1])
    position, J = (np.array(ca.Function("com", [robot.q], [ca.densify(part)])(q)) for part in robot.centre_of_mass)
    centres = [robot.pose(name, q) @ [0.05 if name == "base" else 0.25, 0, 0, 1] for name in robot.links]
    assert abs(position[:, 0] - np.mean(centres, axis=0)[:3]).max() < 1e-15
    steps = [np.array(ca.Function("com", [robot.q], [robot.centre_of_mass[0]])(q + d)) for d in 1e-6 * np.eye(3)]
    assert abs((np.hstack(steps) - position) / 1e-6 - J).max() < 1e-6
    with pytest.raises(InputError, match="has no link with a mass"):
        _ = load_urdf(written(tmp_path, link("a"), link("b"), joint("j", "a", "b"))).centre_of_mass
