"""Echoes of sonars in MuJoCo: the nearest hit of many rays within the beam, with the angle of incidence."""

from __future__ import annotations

from math import cos, inf, pi, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.engine.library import mujoco_library
from surctl.marine.engine.options import EngineOptions

if TYPE_CHECKING:
    from surctl.marine.sensing import SonarArray

__all__ = ["Rays", "beam_directions"]

Array = NDArray[np.float64]
_SURFACE_GROUP = 3  # group of the water surface in the model


def beam_directions(half: float, *, count: int, fan: bool = False) -> Array:
    """Return unit vectors (n, 3) that fill a cone about the x axis evenly, with a tenth of them on its rim.

    Args:
        half: half the opening angle [rad].
        count: number of directions.
        fan: whether to fill only the part of the cone in the horizontal plane.

    Example:
        >>> from surctl.marine.engine.rays import beam_directions
        >>> directions = beam_directions(0.5, count=100)
        >>> directions.shape, round(float(directions[:, 0].min()), 4)  # cos 0.5
        ((100, 3), 0.8776)
    """
    if fan:
        angles = np.linspace(-half, half, count)
        return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    rim = max(8, count // 10) if count > 8 else 0
    inner = np.arange(count - rim) + 0.5
    along = 1 - inner / max(count - rim, 1) * (1 - cos(half))
    across, turn = np.sqrt(1 - along**2), pi * (1 + sqrt(5)) * inner  # points of a Fibonacci spiral
    edge = np.linspace(0, 2 * pi, rim, endpoint=False)
    rows = [np.column_stack([along, across * np.cos(turn), across * np.sin(turn)])]
    rows.append(np.column_stack([np.full(rim, cos(half)), sin(half) * np.cos(edge), sin(half) * np.sin(edge)]))
    rows[0][0] = 1, 0, 0
    return np.vstack(rows)


class Rays:
    """The rays of all sonars of an array.

    Args:
        array: the sonars on the hull.
        options: the options of the simulation.
        faced: (k,) least cosine of incidence at which each geom of the model answers, above 1 if it is silent; None:
            all answer as the `incidence_limit` of the array and the options say.
    """

    def __init__(self, array: SonarArray, options: EngineOptions, faced: Array | None = None) -> None:
        self._mujoco, self._options, self._faced = mujoco_library(), options, faced
        self._limit = None if array.incidence_limit is None else cos(array.incidence_limit)
        self._cutoff = array.maximum + 1.0
        fan = options.rays == "fan"
        self._beams: list[tuple[Array, Array]] = []  # apex (3,) and directions (n, 3) in the frame of the hull
        for sensor, azimuth in enumerate(array.azimuths):
            x, y, _ = array.apex(sensor, position=(0.0, 0.0), heading=0.0)
            cones = array.cones[sensor]
            if not fan and array.pitch != 0.0 and cones == ((0.0, array.half_angle),):
                cones = ((0.0, 0.5 * array.beam_angle),)
            rise = np.eye(3) if fan else _about_y(-array.pitch)
            parts = [
                beam_directions(half, count=options.count, fan=fan) @ (_about_z(azimuth + offset) @ rise).T
                for offset, half in cones
            ]
            self._beams.append((np.array([x, y, 0.0]), np.vstack(parts)))
        surface = options.surface_echo or faced is not None
        self._groups = np.array([1, 1, 1, int(surface), 1, 1], dtype=np.uint8)

    def nearest(self, model: Any, data: Any, body: int, sensor: int) -> float:
        """Return the distance [m] of the nearest echo of a sonar of the hull `body`, inf if there is none."""
        distances = self.hits(model, data, body, sensor)[1]
        return float(distances.min(initial=inf))

    def hits(self, model: Any, data: Any, body: int, sensor: int) -> tuple[Array, Array, Array]:
        """Return the apex (3,), the distances (n,) of all rays [m], inf without an echo, and their directions (n, 3).

        Apex and directions are in the earth frame {E}.
        """
        apex, beam = self._beams[sensor]
        rotation = data.xmat[body].reshape(3, 3)
        if self._options.rays == "fan":
            heading = np.arctan2(rotation[1, 0], rotation[0, 0])
            rotation = _about_z(float(heading))
        directions = np.ascontiguousarray(beam @ rotation.T)
        origin = data.xpos[body] + rotation @ apex
        count = len(directions)
        geoms, distances, normals = np.full(count, -1, dtype=np.int32), np.full(count, -1.0), np.zeros(3 * count)
        self._mujoco.mj_multiRay(
            model, data, origin, directions.ravel(), self._groups, 1, body, geoms, distances, normals, count,
            self._cutoff,
        )  # fmt: skip
        audible = distances >= 0
        if self._faced is not None:
            incidence = -np.einsum("ij,ij->i", normals.reshape(-1, 3), directions)
            audible &= incidence >= self._faced[geoms]
            return origin, np.where(audible, distances, inf), directions
        if not self._options.floor:
            audible &= geoms != model.geom("floor").id
        if self._limit is not None:
            incidence = -np.einsum("ij,ij->i", normals.reshape(-1, 3), directions)
            audible &= incidence >= self._limit
        return origin, np.where(audible, distances, inf), directions


def _about_y(angle: float) -> Array:
    return np.array([[cos(angle), 0.0, sin(angle)], [0.0, 1.0, 0.0], [-sin(angle), 0.0, cos(angle)]])


def _about_z(angle: float) -> Array:
    return np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])
