"""Pictures of a run in MuJoCo: frames of films, and MuJoCo's own window (`--view`)."""

from __future__ import annotations

import importlib
import os
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing, check_known
from surctl.files import Closeable
from surctl.marine.engine.fluid import EngineOptions, body_of
from surctl.marine.engine.mjcf import OBSTACLE, mjcf, mujoco_library, no_renderer
from surctl.marine.engine.physics import AWAY, MujocoPhysics, mujoco_physics
from surctl.marine.vehicle.motion_log import quaternion

if TYPE_CHECKING:
    from surctl.marine.sensing import SonarArray
    from surctl.marine.simulation import Body, Scenario, World
    from surctl.marine.vehicle import Vehicle

Picture = NDArray[np.uint8]

CAMERAS = ("above", "side", "nose")
_PATH, _TRACK = (0.95, 0.97, 1.0, 0.9), (0.98, 0.85, 0.25, 0.9)
_ECHO, _SILENT = (1.0, 0.45, 0.30, 0.55), (0.70, 0.90, 1.0, 0.22)


@dataclass(frozen=True, eq=False)
class Moment:
    """What a picture shows.

    Attributes:
        eta: position and heading of the hull (4,) [m, rad].
        tilt: roll and pitch [rad].
        bodies: the obstacles in the water.
        track: positions of the hull until now (n, 3) [m].
        beams: apex x, y [m], axis [rad], half opening angle [rad], length [m] and whether there is an echo, of each
            sonar.
    """

    eta: NDArray[np.float64]
    tilt: tuple[float, float] = (0.0, 0.0)
    bodies: Sequence[Body] = ()
    track: NDArray[np.float64] | None = None
    beams: Sequence[tuple[float, float, float, float, float, bool]] = ()


def check_pictures() -> None:
    """Raise ToolMissing if MuJoCo, or a library that renders without a screen, is not installed."""
    _renderer(mujoco_library().MjModel.from_xml_string("<mujoco/>"), (8, 8)).close()


def _renderer(model: Any, size: tuple[int, int]) -> Any:
    width, height = size
    try:
        return mujoco_library().Renderer(model, height, width)
    except Exception as error:  # MuJoCo and PyOpenGL raise errors of many classes
        raise no_renderer(str(error)) from None


class Scene(Closeable):
    """The scene of a scenario, which can be rendered at `size` (width, height) [pixels]; use it in a `with` statement.

    Raises:
        ToolMissing: MuJoCo, or a library that renders without a screen, is not installed.
    """

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        *,
        options: EngineOptions | None = None,
        size: tuple[int, int] = (640, 360),
    ) -> None:
        self._mujoco: Any = mujoco_library()
        options = options or EngineOptions()
        self._scenario, self._six = scenario, body_of(vehicle, options).options.dof == 6
        self.model = self._mujoco.MjModel.from_xml_string(mjcf(scenario, vehicle, options=options))
        self.data = self._mujoco.MjData(self.model)
        self._mocap = {o.name: int(self.model.body(OBSTACLE + o.name).mocapid[0]) for o in scenario.obstacles}
        self._heights = {name: float(self.data.mocap_pos[k, 2]) for name, k in self._mocap.items()}
        self._renderer = _renderer(self.model, size)
        flags = self._renderer.scene.flags
        kinds = self._mujoco.mjtRndFlag
        flags[kinds.mjRND_SHADOW] = flags[kinds.mjRND_REFLECTION] = 0
        flags[kinds.mjRND_FOG] = 1
        self._look = self._mujoco.MjvOption()
        self._look.geomgroup[3] = 1

    def close(self) -> None:
        """Free the memory of the renderer."""
        self._renderer.close()

    def picture(self, camera: str, moment: Moment) -> Picture:
        """Return a picture (height, width, 3) of a moment, by the camera `above`, `side` or `nose`."""
        check_known(camera, CAMERAS, key="camera")
        place(self.data, moment, self._mocap, self._heights, six=self._six)
        self._mujoco.mj_kinematics(self.model, self.data)
        self._mujoco.mj_camlight(self.model, self.data)
        self._renderer.update_scene(self.data, camera=camera, scene_option=self._look)
        draw(self._mujoco, self._renderer.scene, self._scenario, moment, lines=camera != "nose")
        return np.array(self._renderer.render())


def place(data: Any, moment: Moment, mocap: dict[str, int], heights: dict[str, float], *, six: bool) -> None:
    """Set the positions of the hull and of the obstacles to those of a moment."""
    if six:
        data.qpos[:3], data.qpos[3:] = moment.eta[:3], quaternion(*moment.tilt, float(moment.eta[3]))
    else:
        data.qpos[:] = moment.eta
    there = {body.name: body.shape.center for body in moment.bodies if hasattr(body.shape, "center")}
    for name, k in mocap.items():
        data.mocap_pos[k] = (*there[name], heights[name]) if name in there else AWAY


def draw(mujoco: Any, scene: Any, scenario: Scenario, moment: Moment, *, lines: bool) -> None:
    """Add sonar beams, and with `lines` also path and track, to a scene of MuJoCo."""
    z = float(moment.eta[2])
    points = scenario.path.waypoints
    rises = scenario.path.rises
    heights = np.full(len(points), scenario.depth) if rises is None else scenario.depth + rises
    if lines:
        _line(mujoco, scene, np.column_stack([points, heights]), 0.008, _PATH)
    if lines and moment.track is not None and len(moment.track) > 1:
        apart = max(1, len(moment.track) // 150)
        _line(mujoco, scene, moment.track[::apart], 0.012, _TRACK)
    for x, y, axis, half, length, echo in moment.beams:
        apex, colour = np.array([x, y, z]), _ECHO if echo else _SILENT
        angles = [axis + half * k / 4 for k in range(-4, 5)]
        rim = [apex + length * np.array([cos(angle), sin(angle), 0.0]) for angle in angles]
        for end in (rim[0], rim[-1]):
            _line(mujoco, scene, np.array([apex, end]), 0.006, colour)
        _line(mujoco, scene, np.array(rim), 0.012 if echo else 0.006, colour)


def _line(mujoco: Any, scene: Any, points: Iterable[Any], radius: float, colour: Sequence[float]) -> None:
    rows = [np.asarray(point, dtype=float) for point in points]
    for begin, end in pairwise(rows):
        if scene.ngeom >= scene.maxgeom or np.allclose(begin, end):
            continue
        geom = scene.geoms[scene.ngeom]
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.array(colour, dtype=np.float32))
        mujoco.mjv_connector(geom, kind, radius, begin, end)
        geom.emission = 0.6
        # MuJoCo leaves these as they are in memory, and draws a geom of the model in another light
        geom.objtype, geom.objid, geom.segid = int(mujoco.mjtObj.mjOBJ_UNKNOWN), -1, -1
        geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)
        scene.ngeom += 1


Vector = NDArray[np.float64]


def check_screen() -> None:
    """Raise ToolMissing if there is no screen on which a window can open."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ToolMissing("needs a screen", key="--view", remedy="use --film FILE.gif, which needs none")


@dataclass(frozen=True)
class watched:  # noqa: N801  # used as a function
    """The physics of a run in MuJoCo, shown in a window in real time until the window is closed."""

    physics: mujoco_physics

    def __call__(self, world: World, vehicle: Vehicle, array: SonarArray) -> MujocoPhysics:
        """Return the physics of one run."""
        return _Watched(world, vehicle, array, self.physics.options)


class _Watched(MujocoPhysics):
    def __init__(self, world: World, vehicle: Vehicle, array: SonarArray, options: EngineOptions) -> None:
        super().__init__(world, vehicle, array, options)
        viewer: Any = importlib.import_module("mujoco.viewer")
        self._window: Any = viewer.launch_passive(self.model, self.data, show_left_ui=False, show_right_ui=False)
        self._next = time.monotonic()

    def advance(self, thrust: Vector, at: float, components: Vector | None = None) -> Vector:
        if not self._window.is_running():
            return super().advance(thrust, at, components)
        with self._window.lock():
            state = super().advance(thrust, at, components)
        self._window.sync()
        self._next = max(self._next + 0.025, time.monotonic() - 0.1)
        time.sleep(max(0.0, self._next - time.monotonic()))
        return state
