"""The ultrasonic array (II-B, Table I): geometry, firing order, and the echo model in the simulated world.

The water's surface and the vertical opening of a beam are not modelled: cones are planar at the robot's
depth. What of an obstacle's height a beam meets is said by who asks; in the closed loop, by `simulation.column`.

A firing is one ping: its samples are conversions of one echo (*chosen*: five pings over 4.5 m, one after another,
would take 30 ms in water, longer than ΔT).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import cos, isfinite, pi, sin

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.sensing.array_checks import check_array
from surctl.sensing.mounting import open_cones
from surctl.sensing.sound import Medium, speed_of_sound
from surctl.world import Shape, Vector2, nearest_echo

__all__ = ["SonarArray", "fire", "heard", "true_range"]


@dataclass(frozen=True, kw_only=True)
class SonarArray:
    """Sensors on the hull, fired one after another; defaults are the paper's, or *chosen* where it is silent.

    Attributes:
        azimuths: (n,) directions of the beams' axes in {B} [rad], counter-clockwise from forward (*chosen*).
        mounts: (n, 2) apexes in {B} [m], not inside the hull; None: on the hull, each at its azimuth. Directions in
            which the hull stands before an apex are no part of its beam, see `cones`.
        hull_radius: [m] of the hull, a disc about the robot's centre.
        beam_angle: full opening angle [rad], below π (*chosen* 75°).
        incidence_limit: largest angle [rad] between a surface's outward normal and the way back at which it
            reflects, in (0, π/2) (Webots' default for its sonars is 22.5°); None: everything reflects.
        minimum: blind range [m]; anything closer reads it (*chosen*).
        blind_time: time after a ping in which no echo is heard [s], in place of `minimum`: the blind range is then
            half of it times the speed of sound.
        maximum: longest range [m] that is waited for; also what a sensor without an echo reads.
        medium, temperature: what the sound travels in, and its temperature [°C]; they give its speed.
        calibrated_for: speed of sound [m/s] that the converter assumes; None: the true one. Readings are true ranges
            times `scale`, the assumed speed over the true one.
        firing_period: ΔT between two firings [s]; the echo from the maximum must be back within it.
        cycle_limit: longest cycle [s]; II-B: "the cycle time is set to be less than 0.1 s".
        order: the sensors in firing order, each once.
        bits: of the conversion; a step is `resolution` (E4).
        noise_sd: standard deviation of one sample [m].
        bias: of every sample [m] (Table II, water).
        samples: a firing, conversions of one echo.
        cones: of each sensor, the parts of its beam that the hull leaves open, one or two: (offset from the axis,
            half angle) [rad]; follows from the others.
    """

    azimuths: tuple[float, ...] = (0.0, pi / 2, pi, -pi / 2)
    mounts: tuple[tuple[float, float], ...] | None = None
    hull_radius: float = 0.27
    beam_angle: float = 75.0 * pi / 180.0
    incidence_limit: float | None = None
    minimum: float = 0.2
    blind_time: float | None = None
    maximum: float = 4.5
    medium: Medium = "water"
    temperature: float = 20.0
    calibrated_for: float | None = None
    firing_period: float = 0.025
    cycle_limit: float = 0.1
    order: tuple[int, ...] = (0, 1, 2, 3)
    bits: int = 8
    noise_sd: float = 0.015
    bias: float = 0.0011
    samples: int = 5
    cones: tuple[tuple[tuple[float, float], ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        object.__setattr__(self, "azimuths", tuple(float(a) for a in self.azimuths))
        object.__setattr__(self, "order", tuple(int(i) for i in self.order))
        if self.mounts is not None:
            object.__setattr__(self, "mounts", tuple(tuple(float(v) for v in mount) for mount in self.mounts))
        check_array(self)
        object.__setattr__(self, "cones", tuple(self._cones(i) for i in range(self.size)))

    @property
    def size(self) -> int:
        """Number of sensors n."""
        return len(self.azimuths)

    @property
    def half_angle(self) -> float:
        """Half the beam's opening angle [rad]."""
        return 0.5 * self.beam_angle

    @property
    def cycle(self) -> float:
        """T = n·ΔT [s], after which a sensor fires again."""
        return self.size * self.firing_period

    @property
    def speed(self) -> float:
        """True speed of sound [m/s]."""
        return speed_of_sound(self.temperature, self.medium)

    @property
    def scale(self) -> float:
        """Reading over true range: what the converter assumes of the speed of sound, over what it is."""
        return 1.0 if self.calibrated_for is None else self.calibrated_for / self.speed

    @property
    def blind(self) -> float:
        """Blind range [m], true."""
        return self.minimum if self.blind_time is None else 0.5 * self.speed * self.blind_time

    @property
    def lowest(self) -> float:
        """Lowest reading [m], before its conversion to codes: that of an echo from the blind range or closer."""
        return self.blind * self.scale

    @property
    def echo_time(self) -> float:
        """Time [s] until the echo from the maximum is back."""
        return 2.0 * self.maximum / self.speed

    @property
    def top_code(self) -> int:
        """Largest code of the conversion, 2^bits − 1."""
        return (1 << self.bits) - 1

    @property
    def resolution(self) -> float:
        """One conversion step [m]: maximum / (2^bits − 1), 17.65 mm (E4); the full code is the maximum."""
        return self.maximum / self.top_code

    def sensor_at(self, tick: int) -> int:
        """The sensor that fires at time tick·ΔT."""
        return self.order[tick % self.size]

    def apex(self, sensor: int, *, position: Vector2, heading: float) -> tuple[float, float, float]:
        """Apex (x, y) [m] and axis [rad] of a sensor's cone in {E}; `position` (2,) [m], heading ψ [rad]."""
        if not 0 <= sensor < self.size:
            raise InputError("no such sensor", key="sensor", value=sensor, remedy=f"give 0 to {self.size - 1}")
        axis = heading + self.azimuths[sensor]
        if self.mounts is not None:
            (x, y), c, s = self.mounts[sensor], cos(heading), sin(heading)
            return float(position[0]) + c * x - s * y, float(position[1]) + s * x + c * y, axis
        return (
            float(position[0]) + self.hull_radius * cos(axis),
            float(position[1]) + self.hull_radius * sin(axis),
            axis,
        )

    def _cones(self, sensor: int) -> tuple[tuple[float, float], ...]:
        if self.mounts is None:  # on the hull, looking straight out: a beam below π passes it
            return ((0.0, self.half_angle),)
        cones = open_cones(
            self.mounts[sensor], self.azimuths[sensor], half_angle=self.half_angle, hull_radius=self.hull_radius
        )
        if not cones:
            raise InputError(
                f"sensor {sensor} looks into the hull",
                key="array.mounts, azimuths",
                value=(self.mounts[sensor], self.azimuths[sensor]),
                remedy="turn its azimuth outward, or mount it elsewhere",
            )
        return cones


def true_range(array: SonarArray, sensor: int, *, position: Vector2, heading: float, shapes: Iterable[Shape]) -> float:
    """Distance from the sensor's apex to the nearest reflecting point within its open cones [m]; inf when none.

    Args:
        array: the array.
        sensor: index into its azimuths.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all that reflects, where it is now.

    Raises:
        InputError: no such sensor, or position or heading not finite.

    Example:
        >>> from surctl.sensing import SonarArray, true_range
        >>> from surctl.world import Disc
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
    """The raw samples of one firing, (samples,) [m]: `heard` of the `true_range`.

    Args:
        array: the array.
        sensor: index into its azimuths.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all that reflects, where it is now.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: as `true_range`, or noise of another shape.

    Example:
        >>> import numpy as np
        >>> from surctl.sensing import NoiseStream, SonarArray, fire
        >>> from surctl.world import Disc
        >>> noise, pipe = NoiseStream(0).normals(6)[:5], Disc((3.0, 1.0), 0.2)
        >>> fire(SonarArray(), 0, position=(1.0, 1.0), heading=0.0, shapes=[pipe], noise=noise).round(3).tolist()
        [1.518, 1.553, 1.535, 1.518, 1.5]
    """
    return heard(array, true_range(array, sensor, position=position, heading=heading, shapes=shapes), noise=noise)


def heard(array: SonarArray, distance: float, *, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """The raw samples of a firing whose echo comes from `distance`, (samples,) [m], in the order they are taken.

    Each is scale · distance + bias + noise, held to [lowest, maximum], then rounded to the nearest conversion step
    (so the minimum of 0.2 m comes out as its nearest code, 0.194 m). Without an echo within the maximum every
    sample is the maximum.

    Args:
        array: the array.
        distance: true range [m]; inf when there is no echo.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: noise of another shape.

    Example:
        >>> import numpy as np
        >>> from surctl.sensing import SonarArray, heard
        >>> [heard(SonarArray(), distance, noise=np.zeros(5))[0].round(3).tolist() for distance in (0.05, 1.53, np.inf)]
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
