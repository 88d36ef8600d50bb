"""The ultrasonic array (II-B, Table I): geometry, firing order, and the echo model in the simulated world.

The water's surface and the vertical opening of a beam are not modelled: cones are planar at the robot's
depth.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, inf, isfinite, pi, sin

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.world import Shape, Vector2

__all__ = ["SonarArray", "fire", "true_range"]

CYCLE_LIMIT = 0.1  # s, II-B: "the cycle time is set to be less than 0.1 s"


@dataclass(frozen=True, kw_only=True)
class SonarArray:
    """Sensors on the hull, fired one after another; defaults are the paper's, or *chosen* where it is silent.

    Attributes:
        azimuths: (n,) mounting angles in {B} [rad], counter-clockwise from forward (*chosen*).
        hull_radius: [m] from the robot's centre to each apex; a beam starts at the hull and so never sees it.
        beam_angle: full opening angle [rad], below π (*chosen* 75°).
        minimum: shortest range [m]; anything closer reads it (*chosen*).
        maximum: longest range [m]; also what a sensor without an echo reads.
        firing_period: ΔT between two firings [s].
        order: the sensors in firing order, each once.
        bits: of the conversion; a step is `resolution` (E4).
        noise_sd: standard deviation of one sample [m].
        bias: of every sample [m] (Table II, water).
        samples: a firing.
    """

    azimuths: tuple[float, ...] = (0.0, pi / 2, pi, -pi / 2)
    hull_radius: float = 0.27
    beam_angle: float = 75.0 * pi / 180.0
    minimum: float = 0.2
    maximum: float = 4.5
    firing_period: float = 0.025
    order: tuple[int, ...] = (0, 1, 2, 3)
    bits: int = 8
    noise_sd: float = 0.015
    bias: float = 0.0011
    samples: int = 5

    def __post_init__(self) -> None:
        """Check the values; InputError names the wrong one."""
        object.__setattr__(self, "azimuths", tuple(float(a) for a in self.azimuths))
        object.__setattr__(self, "order", tuple(int(i) for i in self.order))
        _check_geometry(self)
        _check_timing(self)
        _check_conversion(self)

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
        return (
            float(position[0]) + self.hull_radius * cos(axis),
            float(position[1]) + self.hull_radius * sin(axis),
            axis,
        )


def true_range(array: SonarArray, sensor: int, *, position: Vector2, heading: float, shapes: Iterable[Shape]) -> float:
    """Distance from the sensor's apex to the nearest reflecting point within its cone [m]; inf when none.

    Args:
        array: the array.
        sensor: index into its azimuths.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all that reflects, where it is now.

    Raises:
        InputError: no such sensor, or position or heading not finite.
    """
    x, y, axis = array.apex(sensor, position=position, heading=heading)
    if not isfinite(x + y):
        raise InputError("position and heading must be finite", key="position", value=(x, y, heading))
    half = array.half_angle
    return min((shape.nearest_in_cone((x, y), axis, half_angle=half) for shape in shapes), default=inf)


def fire(
    array: SonarArray,
    sensor: int,
    *,
    position: Vector2,
    heading: float,
    shapes: Iterable[Shape],
    noise: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The raw samples of one firing, (samples,) [m], in the order they are taken.

    Each is the true range + bias + noise, held to [minimum, maximum], then rounded to the nearest conversion
    step (so the minimum of 0.2 m comes out as its nearest code, 0.194 m). Without an echo within the maximum
    every sample is the maximum.

    Args:
        array: the array.
        sensor: index into its azimuths.
        position: (2,) centre of the robot in {E} [m].
        heading: ψ [rad].
        shapes: all that reflects, where it is now.
        noise: (samples,) standard normal numbers.

    Raises:
        InputError: as `true_range`, or noise of another shape.
    """
    if np.shape(noise) != (array.samples,):
        raise InputError(f"has shape {np.shape(noise)}", key="noise", remedy=f"give ({array.samples},)")
    distance = true_range(array, sensor, position=position, heading=heading, shapes=shapes)
    if distance > array.maximum:
        return np.full(array.samples, array.maximum)
    heard = np.clip(distance + array.bias + array.noise_sd * noise, array.minimum, array.maximum)
    top = array.top_code
    codes: NDArray[np.float64] = np.floor(heard * top / array.maximum + 0.5)
    return codes * array.maximum / top


def _require(holds: bool, problem: str, *, key: str, value: object, remedy: str) -> None:
    if not holds:
        raise InputError(problem, key=f"array.{key}", value=value, remedy=remedy)


def _check_geometry(array: SonarArray) -> None:
    _require(
        array.size > 0 and all(isfinite(a) for a in array.azimuths),
        "must be finite angles, at least one",
        key="azimuths",
        value=array.azimuths,
        remedy="give radians, counter-clockwise from forward",
    )
    _require(
        isfinite(array.hull_radius) and array.hull_radius >= 0,
        "must be at least 0",
        key="hull_radius",
        value=array.hull_radius,
        remedy="give m",
    )
    _require(
        0 < array.beam_angle < pi,
        "must lie between 0 and pi",
        key="beam_angle",
        value=array.beam_angle,
        remedy="give the full angle in radians",
    )


def _check_timing(array: SonarArray) -> None:
    _require(
        sorted(array.order) == list(range(array.size)),
        "must name every sensor once",
        key="order",
        value=array.order,
        remedy=f"write an order of 0 to {array.size - 1}",
    )
    _require(
        isfinite(array.firing_period) and array.firing_period > 0,
        "must be greater than 0",
        key="firing_period",
        value=array.firing_period,
        remedy="give s",
    )
    _require(
        array.cycle <= CYCLE_LIMIT + 1e-9,
        f"makes a cycle of {array.cycle:g} s, longer than {CYCLE_LIMIT:g} s",
        key="firing_period",
        value=array.firing_period,
        remedy=f"at most {CYCLE_LIMIT / array.size:g} s for {array.size} sensors",
    )


def _check_conversion(array: SonarArray) -> None:
    _require(
        isfinite(array.maximum) and 0 < array.minimum < array.maximum,
        "must hold 0 < minimum < maximum",
        key="minimum, maximum",
        value=(array.minimum, array.maximum),
        remedy="give m, shortest range first",
    )
    whole = isinstance(array.bits, int) and isinstance(array.samples, int)
    _require(
        whole and 1 <= array.bits <= 24 and array.samples >= 1,
        "must be whole numbers, bits 1 to 24, samples at least 1",
        key="bits, samples",
        value=(array.bits, array.samples),
        remedy="the paper has 8 bits, 5 samples",
    )
    _require(
        isfinite(array.noise_sd) and array.noise_sd >= 0 and isfinite(array.bias),
        "must be finite, noise at least 0",
        key="noise_sd, bias",
        value=(array.noise_sd, array.bias),
        remedy="give m",
    )
