"""The robots of the gallery: limits hold, links keep their distance, targets within reach are reached."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.robot import Robot
from tests.pictures import blank_pictures
from tests.tools import need_compiler

GALLERY = Path(__file__).parents[2] / "notebooks" / "gallery"


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Run an example; return its variables."""
    need_compiler()
    monkeypatch.setenv("MPLBACKEND", "agg")
    blank_pictures(monkeypatch)
    monkeypatch.chdir(folder)
    return runpy.run_path(str(GALLERY / f"{name}.py"))


def check_joints(robot: Robot, path: NDArray[np.float64], dt: float, acceleration: float, first: int = 0) -> None:
    """Position, speed and acceleration of the joints from place `first` of q on, for a robot at rest at the start."""
    places = [place for place in robot.coordinates if place.single and place.q >= first]
    ends = np.array([robot.range_of(place) for place in places])
    most = np.array([robot.speed_of(place, {}) for place in places])
    q = path[:, [place.q for place in places]]
    speeds = np.diff(q, axis=0, prepend=q[:1]) / dt
    assert (q >= ends[:, 0] - 1e-12).all() and (q <= ends[:, 1] + 1e-12).all()
    assert (abs(speeds) <= most + 1e-9).all()
    assert abs(np.diff(speeds, axis=0)).max() <= acceleration * dt + 1e-9


def test_panda_reach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("panda_reach", tmp_path, monkeypatch)
    check_joints(ran["arm"], np.array(ran["q"]), ran["DT"], ran["ACCELERATION"])
    assert ran["error"] < 0.01 and 9.9 < ran["runs"]["with barriers"].min() < 15.0
    assert ran["runs"]["without barriers"].min() < 0.0, "the barriers must be needed"


def test_two_arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("two_arms", tmp_path, monkeypatch)
    arms, q = ran["arms"], np.array(ran["q"])
    check_joints(arms, q, ran["DT"], ran["ACCELERATION"])
    assert 19.9 < min(ran["gaps"]) < 20.1 and max(ran["slip"]) < 1.0
    for end, goal in zip(ran["shown"][1:3], (ran["lifted"], ran["tilted"]), strict=True):
        assert np.linalg.norm((arms.pose("right6", q[end]) - goal)[:3, 3]) < 1e-5


def test_bluerov2_arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("bluerov2_arm", tmp_path, monkeypatch)
    unknown, known = (np.array(ran["paths"][f"thrust limits {word}"]) for word in ("unknown", "known"))
    assert known[:, 2].max() <= 1.0 + 1e-12 < unknown[:, 2].max()
    assert known[:, 0].max() < 1.5 < 50.0 < unknown[:, 0].max()
    assert known[:, 1].max() > 100.0 and known[-1].max() < 0.1


def test_humanoid_reach(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = run("humanoid_reach", tmp_path, monkeypatch)
    body, q, centres = ran["body"], np.array(ran["q"]), np.array(ran["centres"])
    check_joints(body, q, ran["DT"], ran["ACCELERATION"], first=7)
    assert (centres >= np.array(ran["LOW"]) - 2e-4).all() and (centres <= np.array(ran["HIGH"]) + 2e-4).all()
    feet = ca.Function("feet", [body.q], [body.frame(f"{side}_foot").position for side in ("left", "right")])
    for here, there in zip(feet.map(len(q))(q.T), feet(q[0]), strict=True):
        assert abs(np.array(here) - np.array(there)).max() < 2e-4
    errors = [ran["errors"][k * 250 - 1] for k in (1, 2, 3)]
    assert max(errors[:2]) < 1.0 < errors[2] < 300.0
