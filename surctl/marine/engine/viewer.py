"""Show a run in MuJoCo's own window while it is simulated."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing
from surctl.marine.engine.library import mujoco_library
from surctl.marine.engine.physics import MujocoPhysics

if TYPE_CHECKING:
    from surctl.marine.sensing import SonarArray
    from surctl.marine.simulation import PhysicsMaker, World
    from surctl.marine.vehicle import Vehicle

__all__ = ["check_screen", "watched"]

Vector = NDArray[np.float64]


def check_screen() -> None:
    """Raise ToolMissing if there is no screen on which a window can open."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ToolMissing("needs a screen", key="--view", remedy="use --film FILE.gif, which needs none")


@dataclass(frozen=True)
class watched:  # noqa: N801  # used as a function
    """The physics of a run in MuJoCo, shown in a window in real time until the window is closed."""

    physics: PhysicsMaker

    def __call__(self, world: World, vehicle: Vehicle, array: SonarArray) -> _Watched:
        """Return the physics of one run."""
        inner = self.physics(world, vehicle, array)
        assert isinstance(inner, MujocoPhysics)
        return _Watched(inner)


class _Watched:
    def __init__(self, physics: MujocoPhysics) -> None:
        import importlib

        mujoco_library()
        viewer: Any = importlib.import_module("mujoco.viewer")
        self._physics = physics
        self._window: Any = viewer.launch_passive(physics.model, physics.data, show_left_ui=False, show_right_ui=False)
        self._next = time.monotonic()

    @property
    def name(self) -> str:
        return self._physics.name

    @property
    def contacts(self) -> Sequence[Any]:
        return self._physics.contacts

    @property
    def state(self) -> Vector:
        return self._physics.state

    @state.setter
    def state(self, value: Vector) -> None:
        self._physics.state = value

    def advance(self, thrust: Vector, at: float, components: Vector | None = None) -> Vector:
        if not self._window.is_running():
            return self._physics.advance(thrust, at, components)
        with self._window.lock():
            state = self._physics.advance(thrust, at, components)
        self._window.sync()
        self._next = max(self._next + 0.025, time.monotonic() - 0.1)
        time.sleep(max(0.0, self._next - time.monotonic()))
        return state

    def clearance(self, bodies: Sequence[Any]) -> tuple[float, float]:
        return self._physics.clearance(bodies)

    def echo(self, sensor: int, bodies: Sequence[Any]) -> float:
        return self._physics.echo(sensor, bodies)
