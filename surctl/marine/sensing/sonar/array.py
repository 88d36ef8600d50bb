"""The sonar array: mounts, pitch, beams past the hull, ranges, codes, firing times, speed of sound, bad values.

The paper describes the array in section II-B and Table I. A firing is one ping, and all samples of a firing are
conversions of the same echo. This is a design choice: five pings over 4.5 m, one after another, would take 30 ms in
water, longer than the time ΔT between two firings.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import acos, asin, atan2, ceil, cos, degrees, hypot, inf, isfinite, pi, radians, remainder, sin

from surctl.errors import InputError, check_number
from surctl.marine.world import Vector2

_MARCZAK = (1.402385e3, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9)


def speed_of_sound(temperature: float) -> float:
    """Return the speed of sound [m/s] in pure water at a temperature [°C] and atmospheric pressure.

    Marczak 1997, "Water as a standard in the measurements of speed of sound in liquids", J. Acoust. Soc. Am. 102, 2776
    (0 to 95 °C, within 0.02 m/s).
    """
    if not 0.0 <= temperature <= 95.0:
        problem = "lies outside the range of the formula for water"
        raise InputError(problem, key="temperature", value=temperature, remedy="give 0 to 95 °C")
    speed = 0.0
    for factor in reversed(_MARCZAK):
        speed = speed * temperature + factor
    return speed


_SLIVER = 1e-6  # rad; an opening narrower than twice this value is ignored
_ON_HULL = 1e-9  # m; an apex up to this far inside the hull counts as on it


def open_cones(
    mount: tuple[float, float], azimuth: float, *, half_angle: float, hull_radius: float
) -> tuple[tuple[float, float], ...]:
    """Return the parts of a beam that the hull does not hide, from right to left: (offset, half angle) [rad].

    Seen from an apex (2,) in {B} at distance ρ from the centre, the hull (a disc of radius R) hides the bearings within
    asin(R/ρ) of the centre's; from an apex on the hull, the half-plane behind it. No object can lie between apex and
    hull. The result is the whole beam, one part of it, two parts (one on each side of the hull), or empty. A hull of
    radius 0 hides nothing.
    """
    distance = hypot(*mount)
    if hull_radius <= 0.0:
        return ((0.0, half_angle),)
    hidden = asin(min(1.0, hull_radius / distance))
    centre = atan2(-mount[1], -mount[0]) - azimuth
    centre -= 2.0 * pi * round(centre / (2.0 * pi))
    parts = [(-half_angle, half_angle)]
    for turn in (-2.0 * pi, 0.0, 2.0 * pi):
        low, high = centre + turn - hidden, centre + turn + hidden
        cut = [piece for a, b in parts for piece in ((a, min(b, low)), (max(a, high), b))]
        parts = [(a, b) for a, b in cut if b - a > 2.0 * _SLIVER]
    if parts == [(-half_angle, half_angle)]:
        return ((0.0, half_angle),)
    return tuple((0.5 * (a + b), 0.5 * (b - a)) for a, b in parts)


_SLACK = 1e-9  # s
_HIGHEST = radians(19.5)  # [rad] elevation of the steepest direction up to which a rough water surface is silent


@dataclass(frozen=True, kw_only=True)
class SonarArray:
    """Sensors on the hull that fire one after another; a default that the paper does not give is a design choice.

    Attributes:
        azimuths: (n,) directions of the beams' axes in {B} [rad], counter-clockwise from forward (design choice).
        mounts: (n, 2) apexes of the beams in {B} [m], not inside the hull; None: each apex lies on the hull at the
            azimuth of its sensor. The directions that the hull blocks are not part of a beam, see `cones`.
        hull_radius: radius [m] of the hull, a disc about the robot's centre.
        beam_angle: full opening angle [rad] of the beam, a circular cone, below π (75°, a design choice).
        pitch: elevation of the beams' axes [rad], positive towards the water surface, less than half of `beam_angle`
            (a design choice). None: 0, or lower, so that no direction of the beam rises by more than 19.5°: a rough
            water surface, which answers up to 70° off its normal, is silent then. For the default beam: −18°.
        incidence_limit: largest angle [rad] between the outward normal of a surface and the direction to the sensor
            at which the surface reflects, in (0, π/2) (Webots' default for its sonars is 22.5°); None: every surface
            reflects.
        minimum: blind range [m]; the sensor reads `minimum` for every object at a shorter distance (design choice).
        blind_time: time after a ping in which the sensor receives no echo [s]; if given, the blind time replaces
            `minimum`. With `blind_time`, the blind range is half the blind time, multiplied by the speed of sound.
        maximum: longest range [m] that the sensor measures; a sensor without an echo also reads `maximum`.
        temperature: temperature of the water [°C], which determines the speed of sound.
        calibrated_for: speed of sound [m/s] that the converter assumes; None: the true speed. A reading is the true
            range times `scale`, which is the assumed speed divided by the true speed.
        firing_period: time ΔT between two firings [s]; the echo from an object at `maximum` must arrive within ΔT.
        cycle_limit: longest cycle [s]; section II-B of the paper: "the cycle time is set to be less than 0.1 s".
        order: indices of the sensors in firing order, each index exactly once.
        bits: number of bits of the conversion; one conversion step is `resolution` (erratum E4).
        step: length of one conversion step [m] of a module that returns distances, for example 0.01 for whole
            centimetres; `maximum` is a multiple of it. None: the step follows from `bits`.
        noise_sd: standard deviation of the noise of one sample [m].
        bias: constant error of every sample [m] (default from Table II, water).
        samples: number of samples in a firing; all samples of a firing are conversions of one echo.
        cones: for each sensor, the one or two parts of its beam that the hull does not block; each part is given as
            (offset from the axis, half angle) [rad] and computed from the other attributes.
    """

    azimuths: tuple[float, ...] = (0.0, pi / 2, pi, -pi / 2)
    mounts: tuple[tuple[float, float], ...] | None = None
    hull_radius: float = 0.27
    beam_angle: float = 75.0 * pi / 180.0
    pitch: float | None = None
    incidence_limit: float | None = None
    minimum: float = 0.2
    blind_time: float | None = None
    maximum: float = 4.5
    temperature: float = 20.0
    calibrated_for: float | None = None
    firing_period: float = 0.025
    cycle_limit: float = 0.1
    order: tuple[int, ...] = (0, 1, 2, 3)
    bits: int = 8
    noise_sd: float = 0.015
    bias: float = 0.0011
    samples: int = 5
    step: float | None = None
    cones: tuple[tuple[tuple[float, float], ...], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "azimuths", tuple(float(a) for a in self.azimuths))
        object.__setattr__(self, "order", tuple(int(i) for i in self.order))
        if self.mounts is not None:
            object.__setattr__(self, "mounts", tuple(tuple(float(v) for v in mount) for mount in self.mounts))
        _check(self)
        object.__setattr__(self, "cones", tuple(self._cones(i) for i in range(self.size)))

    @property
    def size(self) -> int:
        """Number of sensors n."""
        return len(self.azimuths)

    @property
    def elevation(self) -> float:
        """Elevation [rad] of the beams' axes: `pitch`, or its default."""
        return min(0.0, _HIGHEST - 0.5 * self.beam_angle) if self.pitch is None else self.pitch

    @property
    def half_angle(self) -> float:
        """Half the beam's opening angle in the horizontal plane [rad]; less than half of `beam_angle` with a pitch."""
        if self.elevation == 0.0:
            return 0.5 * self.beam_angle
        return acos(cos(0.5 * self.beam_angle) / cos(self.elevation))

    def steepest(self, side: int) -> float:
        """Return the elevation [rad] of the beam's steepest direction, at most π/2; side 1: upwards, −1: downwards."""
        return min(0.5 * self.beam_angle + side * self.elevation, 0.5 * pi)

    @property
    def cycle(self) -> float:
        """Cycle time T = n·ΔT [s]: the time between two firings of a sensor."""
        return self.size * self.firing_period

    @property
    def speed(self) -> float:
        """True speed of sound [m/s]."""
        return speed_of_sound(self.temperature)

    @property
    def scale(self) -> float:
        """Reading divided by true range, equal to the assumed speed of sound divided by the true speed of sound."""
        return 1.0 if self.calibrated_for is None else self.calibrated_for / self.speed

    @property
    def blind(self) -> float:
        """Blind range as a true distance [m]."""
        return self.minimum if self.blind_time is None else 0.5 * self.speed * self.blind_time

    @property
    def lowest(self) -> float:
        """Lowest reading [m] before the conversion to codes: the reading for an object at the blind range or nearer."""
        return self.blind * self.scale

    @property
    def echo_time(self) -> float:
        """Time [s] from a ping until the echo from the maximum range arrives."""
        return 2.0 * self.maximum / self.speed

    @property
    def top_code(self) -> int:
        """Largest code of the conversion, 2^bits − 1, or the number of steps up to the maximum."""
        return (1 << self.bits) - 1 if self.step is None else round(self.maximum / self.step)

    @property
    def resolution(self) -> float:
        """One conversion step [m]: `step`, else maximum / (2^bits − 1), 17.65 mm (erratum E4)."""
        return self.maximum / self.top_code

    def sensor_at(self, firing: int) -> int:
        """Return the index of the sensor that fires at the time firing·ΔT, for the firing number `firing` = 0, 1, …"""
        return self.order[firing % self.size]

    def apex(self, sensor: int, *, position: Vector2, heading: float) -> tuple[float, float, float]:
        """Return apex x, y [m] and axis [rad] of a sensor's cone in {E}.

        `position` (2,) [m] and `heading` ψ [rad] are those of the robot.
        """
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

    def corner_range(self, incidence: float | None) -> float:
        """Return the distance [m] from the hull at which a corner ahead is first heard; 0: the hull touches it first.

        The corner is a right angle whose edge is silent, and the hull moves straight along its bisector, at the heading
        that hears most. Each face then lies at 45° to the course, and a sensor hears it once the end of the face is
        within `incidence` [rad] (None: any angle) of its normal: with a beam of half angle β on a hull of radius R, at
        R (sin β / sin(45° − incidence) − 1) from the hull. Other courses hear one of the faces earlier.
        """
        if incidence is None or incidence >= pi / 4:
            return self.maximum
        aside = 0.0
        for i, parts in enumerate(self.cones):
            x, y = (self.hull_radius, 0.0) if self.mounts is None else self.mounts[i]
            turned = 0.0 if self.mounts is None else self.azimuths[i] - atan2(y, x)
            for offset, half in parts:
                for side in (-1, 1):
                    angle = abs(remainder(turned + offset + side * half, 2 * pi))
                    aside = max(aside, hypot(x, y) * sin(min(angle, pi / 2)))
        return min(max(aside / sin(pi / 4 - incidence) - self.hull_radius, 0.0), self.maximum)

    def _cones(self, sensor: int) -> tuple[tuple[float, float], ...]:
        if self.mounts is None:  # on the hull and pointing outward: the hull does not hide a beam narrower than π
            return ((0.0, self.half_angle),)
        cones = open_cones(
            self.mounts[sensor], self.azimuths[sensor], half_angle=self.half_angle, hull_radius=self.hull_radius
        )
        if not cones:
            raise InputError(
                f"sensor {sensor} looks into the hull at its azimuth of {degrees(self.azimuths[sensor]):.4g} degrees",
                key="array.mounts",
                value=self.mounts[sensor],
                remedy="turn its azimuth outward, or mount it elsewhere",
            )
        return cones


def _require(array: SonarArray, key: str, holds: bool, problem: str, remedy: str, *, value: object = None) -> None:
    if not holds:
        value = getattr(array, key) if value is None else value
        raise InputError(problem, key=f"array.{key}", value=value, remedy=remedy)


def _check(array: SonarArray) -> None:
    _check_geometry(array)
    _check_mounts(array)
    _check_conversion(array)
    _check_sound(array)
    _check_timing(array)


def _check_geometry(array: SonarArray) -> None:
    finite = array.size > 0 and all(isfinite(a) for a in array.azimuths)
    remedy = "give radians, counter-clockwise from forward"
    _require(array, "azimuths", finite, "must be finite angles, at least one", remedy)
    check_number("array.hull_radius", array.hull_radius, unit="m", zero=True)
    wide = 0 < array.beam_angle < pi
    _require(array, "beam_angle", wide, "must lie between 0 and pi", "give the full angle in radians")
    level = isfinite(array.elevation) and abs(array.elevation) < 0.5 * array.beam_angle
    problem = "must be less than half of the beam angle, so that the beam contains the horizontal plane"
    _require(array, "pitch", level, problem, "give radians, positive upwards, or None for the default")
    limit = array.incidence_limit
    remedy = "give radians, or None if every surface reflects"
    _require(array, "incidence_limit", limit is None or 0 < limit < pi / 2, "must lie between 0 and pi/2", remedy)


def _check_mounts(array: SonarArray) -> None:
    if array.mounts is None:
        return
    points = len(array.mounts) == array.size and all(len(m) == 2 and isfinite(m[0] + m[1]) for m in array.mounts)
    problem = f"must be {array.size} finite points, one for each azimuth"
    _require(array, "mounts", points, problem, "give x, y in {B} in m, or None for sensors on the hull")
    for i, mount in enumerate(array.mounts):
        problem = f"sensor {i} lies inside the hull of radius {array.hull_radius:g} m"
        outside = hypot(*mount) >= array.hull_radius - _ON_HULL
        _require(array, "mounts", outside, problem, "move it out to the hull or beyond", value=mount)


def _check_conversion(array: SonarArray) -> None:
    if not (isfinite(array.maximum) and 0 < array.minimum < array.maximum):
        problem, remedy = "must satisfy 0 < minimum < maximum", "give m, shortest range first"
        value = (array.minimum, array.maximum)
        raise InputError(problem, key="array.minimum, maximum", value=value, remedy=remedy)
    for key, most, usual in (("bits", 24, 8), ("samples", inf, 5)):
        count = getattr(array, key)
        problem = "must be a whole number, at least 1" + (f" and at most {most}" if most < inf else "")
        remedy = f"give for example the {usual} {key} of the paper"
        _require(array, key, isinstance(count, int) and 1 <= count <= most, problem, remedy)
    if array.step is not None:
        divides = isfinite(array.step) and 0 < array.step <= array.maximum
        divides = divides and abs(array.top_code * array.step - array.maximum) <= 1e-9 * array.maximum
        remedy = "give m, for example 0.01 for whole centimetres, and a maximum that is a multiple of it"
        _require(array, "step", divides, f"must divide the maximum of {array.maximum:g} m", remedy)
    check_number("array.noise_sd", array.noise_sd, unit="m", zero=True)
    _require(array, "bias", isfinite(array.bias), "must be finite", "give m")


def _check_sound(array: SonarArray) -> None:
    try:
        speed = array.speed
    except InputError as error:
        raise InputError(error.problem, key=f"array.{error.key}", value=error.value, remedy=error.remedy) from None
    assumed, blind = array.calibrated_for, array.blind_time
    positive = assumed is None or (isfinite(assumed) and assumed > 0)
    _require(array, "calibrated_for", positive, "must be greater than 0", "give m/s, or None for the true speed")
    if blind is not None:
        problem, remedy = (
            "conflicts with minimum, because both set the blind range",
            "give blind_time or minimum, not both",
        )
        _require(array, "blind_time", array.minimum == type(array).minimum, problem, remedy)
        short = isfinite(blind) and 0 < 0.5 * speed * blind < array.maximum
        problem = "must be greater than 0, and its blind range must be less than maximum"
        _require(array, "blind_time", short, problem, f"give less than {2.0 * array.maximum / speed:.3g} s")
    problem = f"is {array.scale:.3g} times the true speed of sound, so that every reading equals the maximum"
    remedy = f"give about {speed:.0f} m/s, or None for the true speed"
    _require(array, "calibrated_for", array.lowest < array.maximum, problem, remedy)


def _check_timing(array: SonarArray) -> None:
    each = sorted(array.order) == list(range(array.size))
    remedy = f"list the numbers 0 to {array.size - 1} in firing order"
    _require(array, "order", each, "must contain every sensor exactly once", remedy)
    check_number("array.firing_period", array.firing_period, unit="s")
    check_number("array.cycle_limit", array.cycle_limit, unit="s")
    fits = array.firing_period / max(1, ceil(array.cycle / array.cycle_limit - _SLACK))
    problem = f"gives a cycle of {array.cycle:g} s, longer than the cycle limit of {array.cycle_limit:g} s"
    remedy = f"give {fits:g} s, or a longer cycle limit"
    _require(array, "firing_period", array.cycle <= array.cycle_limit + _SLACK, problem, remedy)
    echo = f"an echo from it takes {1e3 * array.echo_time:.1f} ms in water"
    problem = f"is too long for the cycle: {echo}, longer than the cycle limit of {array.cycle_limit:g} s"
    remedy = f"give at most {0.5 * array.speed * array.firing_period:.3g} m"
    _require(array, "maximum", array.echo_time <= array.cycle_limit + _SLACK, problem, remedy)
    problem = f"makes firings overlap: {echo}, but the next sensor fires after {1e3 * array.firing_period:g} ms"
    apart = array.echo_time <= array.firing_period + _SLACK
    _require(array, "maximum", apart, problem, f"{remedy}, or a longer firing_period")
