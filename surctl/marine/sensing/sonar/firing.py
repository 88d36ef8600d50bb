"""A sonar firing in the simulated world: the echo model in NumPy.

The model omits the water surface and the vertical opening of a beam: cones are planar at the robot's depth. The caller
selects the obstacles that a beam meets at the robot's depth; in the closed loop, `simulation.column` selects these
obstacles.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.world import Shape, Vector2, nearest_echo

__all__ = ["fire", "firing_samples", "true_range"]


def true_range(array: SonarArray, sensor: int, *, position: Vector2, heading: float, shapes: Iterable[Shape]) -> float:
    """Return the distance [m] from a sensor's apex to the nearest reflecting point in its cones; inf if none exists.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.

    Raises:
        InputError: if the sensor does not exist, or the position or heading is not finite.

    Example:
        >>> from surctl.marine.sensing import SonarArray, true_range
        >>> from surctl.marine.world import Disc
        >>> pipe = Disc((3.0, 1.0), 0.2)
        >>> place = {"position": (1.0, 1.0), "heading": 0.0}
        >>> [true_range(SonarArray(), sensor, shapes=[pipe], **place) for sensor in (0, 2)]  # ahead, astern
        [1.53, inf]
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    if not isfinite(x + y):
        raise InputError("position and heading must be finite", key="position", value=(x, y, heading))
    scene, limit = list(shapes), array.incidence_limit
    return min(
        nearest_echo(scene, (x, y), axis + offset, half_angle=half, incidence_limit=limit)
        for offset, half in array.cones[sensor]
    )


def fire(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    shapes: Iterable[Shape],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of one firing in a scene of shapes.

    Args:
        array: the sonar array.
        sensor: index of the sensor.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all reflecting shapes of the scene, at their present positions.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `true_range` raises InputError, or `noise` does not have the shape (samples,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import SonarArray, fire
        >>> from surctl.noise import NoiseStream
        >>> from surctl.marine.world import Disc
        >>> noise, pipe = NoiseStream(0).normals(6)[:5], Disc((3.0, 1.0), 0.2)
        >>> fire(SonarArray(), 0, position=(1.0, 1.0), heading=0.0, shapes=[pipe], noise=noise).round(3).tolist()
        [1.518, 1.553, 1.535, 1.518, 1.5]
    """
    return firing_samples(
        array, true_range(array, sensor, position=position, heading=heading, shapes=shapes), noise=noise
    )


def firing_samples(array: SonarArray, distance: float, *, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the raw samples (samples,) [m] of a firing whose echo comes from `distance`, in order of time.

    Each sample is scale · distance + bias + noise, limited to [lowest, maximum] and rounded to the nearest conversion
    step (for example, the minimum of 0.2 m gives the nearest code, 0.194 m). Without an echo within the maximum, every
    sample is the maximum.

    Args:
        array: the sonar array.
        distance: true range [m]; inf if there is no echo.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: if `noise` does not have the shape (samples,).

    Example:
        >>> import numpy as np
        >>> from surctl.marine.sensing import SonarArray, firing_samples
        >>> array, exact = SonarArray(), np.zeros(5)
        >>> [firing_samples(array, distance, noise=exact)[0].round(3).tolist() for distance in (0.05, 1.53, np.inf)]
        [0.194, 1.535, 4.5]
    """
    if np.shape(noise) != (array.samples,):
        raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({array.samples},)")
    if distance > array.maximum:
        return np.full(array.samples, array.maximum)
    reading = np.clip(array.scale * distance + array.bias + array.noise_sd * noise, array.lowest, array.maximum)
    top = array.top_code
    codes: NDArray[np.float64] = np.floor(reading * top / array.maximum + 0.5)
    return codes * array.maximum / top
