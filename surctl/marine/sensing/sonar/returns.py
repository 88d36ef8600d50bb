"""Built-in reflectors: angles at which a surface answers, certain and weak echoes, and the chance of a weak one.

Several surfaces in a beam answer the same ping, and the module measures the first echo that it detects. So the measured
range is the minimum over the returns that are detected. `certain_range_symbols` gives the nearest return that is always
detected. `weak_range_symbols` gives the nearest of the other returns, if detected in this firing: edges and cylinders,
which are detected with a probability, and corners of the site.

Upright surfaces are met in the horizontal plane of the sensor: for a beam with pitch 0 this is exact, because the
nearest point of an upright surface in a circular cone about a horizontal axis lies in that plane. The water surface and
the floor answer where the beam is steepest, if no upright surface stands before this point. If one does, the echo is
sought past the rims of the upright surfaces; a beam that meets the level surface above a silent oblique face, between
two rims, can answer a little earlier than the model says.

A smooth face is a mirror for ultrasound: it answers only near its normal. A wavelength of 7 mm (200 kHz in water) finds
a face smooth if its roughness stays below λ/8, about 1 mm (Rayleigh's criterion), as for glass, tiles and liners.
Where two smooth walls meet, the corner returns the sound to its source (Kuc and Siegel 1987; Leonard and
Durrant-Whyte 1992). A convex edge and a cylinder spread the sound, so that their echo falls as r^(-3/2); a face's echo
falls as 1/r. A rough face scatters into all directions; Lambert's rule holds down to grazing angles of about 20°.

A weak echo is detected with the probability P = 1/(1 + (r/R)⁶ (1 + x²)⁴). Here r is the range, x is the tangent of the
angle from the beam's axis divided by that of half the opening angle, and R is the range at which an echo on the axis is
detected in half of the firings. P is the logistic function of the echo's level in dB above the threshold, with a spread
of 3.9 dB: the amplitude falls as r^(-3/2), and by half from the axis to the edge of the beam.

The random numbers that decide on weak echoes depend only on the run's seed, the instant, the sensor and the echo. They
are counter-based: no state passes from one number to the next, so their order and the number of threads do not matter.
A number comes from the cipher MiMC (Albrecht, Grassi, Rechberger, Roy and Tiessen 2016): rounds of adding a key and a
constant and of taking the cube modulo a prime p. The cube is a permutation because p − 1 is not divisible by 3. With p
below 2^26, all products are exact in double precision, so Python, CasADi and C give the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin, sqrt, tan
from types import MappingProxyType
from typing import Any
from zlib import crc32

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.echo import Beam, looks_of
from surctl.marine.sensing.sonar.solids import Solid, SolidBox, SolidDisc, SolidWalls
from surctl.noise import noise_states

_RADIUS = 0.1  # [m] radius of the cylinder that `cylinder_range` refers to
_SILENT = 2.0  # a cosine that no face reaches


@dataclass(frozen=True)
class Reflector:
    """How one kind of surface answers a sonar.

    Attributes:
        incidence_limit: largest angle of incidence [rad] at which a face answers; 0: a face is silent; None: a face
            answers at any incidence.
        edge_range: range [m] at which a vertical edge on the beam's axis is detected in half of the firings; 0: an
            edge is silent, except as the end of a face that answers.
        cylinder_range: range [m] at which a cylinder with a radius of 0.1 m on the axis is detected in half of the
            firings; it grows with the cube root of the radius. None: a cylinder answers as a face does.
        corners: whether a corner between two such walls answers from any direction.
    """

    incidence_limit: float | None = None
    edge_range: float = 0.0
    cylinder_range: float | None = None
    corners: bool = False

    def faced(self, *, curved: bool) -> float:
        """Return the least cosine of incidence at which a face, or a `curved` surface, answers with certainty."""
        if self.incidence_limit == 0.0 or (curved and self.cylinder_range is not None):
            return _SILENT
        return -1.0 if self.incidence_limit is None else cos(self.incidence_limit)

    def silent(self, *, curved: bool) -> bool:
        """Return whether no part of a face with its edges, or of a `curved` surface, ever answers."""
        if curved and self.cylinder_range is not None:
            return self.cylinder_range == 0
        return self.incidence_limit == 0 and (curved or self.edge_range == 0)

    @property
    def weak(self) -> bool:
        """Whether some parts of such a surface answer with a probability."""
        return self.edge_range > 0 or bool(self.cylinder_range)


_SPECULAR = 5.0 * pi / 180.0
_CYLINDER, _EDGE = 3.2, 0.6

REFLECTORS: Mapping[str, Reflector] = MappingProxyType(
    {
        "ideal": Reflector(),
        "webots": Reflector(pi / 8),
        "specular": Reflector(_SPECULAR, cylinder_range=_CYLINDER, corners=True),
        "specular-edges": Reflector(_SPECULAR, edge_range=_EDGE, cylinder_range=_CYLINDER, corners=True),
        "diffuse": Reflector(70.0 * pi / 180.0),
        "silent": Reflector(0.0),
    }
)
"""Kinds of reflectors by name.

`ideal` answers at any incidence. `webots` answers within 22.5°, the default of Webots for sonar sensors. `specular` is
smooth: a face answers within 5° (chosen: for the unevenness of tiles and liners), and edges are silent.
`specular-edges` is smooth with edges that answer weakly. `diffuse` is rough and answers up to 70° (Lambert's rule).
`silent` never answers, but hides what is behind it. The ranges of 0.6 m for an edge and 3.2 m for a cylinder follow
from 12 dB between the echo of a face at 4.5 m and the threshold (chosen): at 1 m, the echo of an edge is 31 dB below
that of a face, and that of a cylinder with a radius of 0.1 m is 10 dB below."""


@dataclass(frozen=True)
class Surfaces:
    """The reflectors of a scene.

    Attributes:
        obstacles: reflector of each obstacle of the scenario, in its order.
        walls: (4,) reflectors of the walls x = 0, x = length, y = 0, y = width.
        surface, floor: reflectors of the water surface and of the floor.
        depth: depth of the water [m].
    """

    obstacles: tuple[Reflector, ...]
    walls: tuple[Reflector, ...]
    surface: Reflector
    floor: Reflector
    depth: float

    @property
    def weak(self) -> bool:
        """Whether some obstacle answers with a probability."""
        return any(reflector.weak for reflector in self.obstacles)

    @property
    def corners(self) -> tuple[tuple[int, int], ...]:
        """The corners of the site that answer, as pairs of indices of their walls."""
        return tuple((i, j) for i in (0, 1) for j in (2, 3) if self.walls[i].corners and self.walls[j].corners)


def detection_odds(
    distance: float | ca.SX,
    cosine: float | ca.SX,
    *,
    half_range: float,
    tangent: float,
    radius: float | ca.SX | None = None,
) -> float | ca.SX:
    """Return 1/P for a weak echo with the detection probability P; it is detected if u/P < 1 for a uniform number u.

    Args:
        distance, cosine: range [m], and cosine of the angle from the beam's axis.
        half_range: range [m] on the axis at which P = 1/2, for a cylinder with a radius of 0.1 m or for an edge.
        tangent: tangent of half the opening angle of the beam.
        radius: radius of the cylinder [m]; None for an edge.
    """
    ratio = distance * (1.0 / half_range)
    square = ratio * ratio
    fall = square * square * square
    if radius is not None:
        thin = _RADIUS / radius
        fall = fall * (thin * thin)
    aside = (1.0 / (cosine * cosine) - 1.0) * (1.0 / (tangent * tangent)) + 1.0
    wide = aside * aside
    return 1.0 + fall * (wide * wide)


_NAMES = 1 << 20

_BESIDE = 1e-3  # least cosine of a bearing from the axis
_LEVEL = 1e-6
"""Least sine of the elevation of a ray that meets water surface or floor."""


def level_range(array: SonarArray, reflector: Reflector, *, side: int, gap: float) -> float | None:
    """Return the range [m] of the return of the water surface (`side` 1) or floor (−1) that is `gap` [m] away.

    The result is None if it does not answer in the beam.
    """
    rise, _ = rim(array, 1.0, side=side)
    return gap / rise if rise >= max(reflector.faced(curved=False), _LEVEL) else None


def rim(array: SonarArray, cosine: Any, *, side: int) -> tuple[Any, Any]:
    """Return sine and cosine of the elevation at which the beam is steepest, upwards (`side` 1) or downwards (−1).

    `cosine` is that of the bearing from the beam's axis. Elevations count in the direction of `side`.
    """
    pitch = side * array.elevation
    up, half = sin(pitch), cos(0.5 * array.beam_angle)
    symbolic = isinstance(cosine, ca.SX)
    larger, either = (ca.fmax, ca.if_else) if symbolic else (max, lambda holds, yes, no: yes if holds else no)
    along = larger(cosine, _BESIDE) * cos(pitch)
    size = along * along + up * up
    inside = size - half * half  # below 0 beside the beam
    root = (ca.sqrt if symbolic else sqrt)(larger(inside, 0.0))
    level = (along * half - up * root) / size
    rise = either(level < 0, 1.0, (up * half + along * root) / size)  # the beam contains the vertical
    return either(inside < 0, 0.0, rise), larger(level, 0.0)


def echo_number(name: str) -> int:
    """Return the number of the first weak echo of an obstacle, from its name.

    So an obstacle has the same random numbers whatever other obstacles the scenario has.
    """
    return 4 * (crc32(name.encode()) % _NAMES)  # a box has four edges


_TOUCHES = 1e-9  # [m] a shape that is nearer than a point by less than this does not hide it
_LEAST = 1e-30


def certain_range_symbols(
    array: SonarArray,
    beam: Beam,
    bodies: Sequence[tuple[Solid, Reflector]],
    walls: SolidWalls,
    *,
    z: ca.SX,
    surfaces: Surfaces,
) -> ca.SX:
    """Return the distance [m] to the nearest return that is detected with certainty, at most 2·maximum."""
    nothing = 2.0 * array.maximum
    solids: list[Solid] = [*(solid for solid, _ in bodies), walls]
    faced = [ca.SX(reflector.faced(curved=isinstance(solid, SolidDisc))) for solid, reflector in bodies]
    sides = tuple(reflector.faced(curved=False) for reflector in surfaces.walls)

    def first(ray: ca.SX) -> tuple[ca.SX, ca.SX]:
        # distance, and by how much the cosine exceeds the least one
        distance, margin = ca.SX(nothing), ca.SX(-1)
        for solid, least in zip(solids, [*faced, None], strict=True):
            far, facing = solid.hit(beam.apex, ray, nothing=nothing)
            limit = walls.picked(beam.apex, ray, sides) if least is None else least
            nearer = ca.logic_and(solid.present, far < distance)
            distance = ca.if_else(nearer, far, distance)
            margin = ca.if_else(nearer, ca.if_else(facing >= limit, 1.0, -1.0), margin)
        return distance, margin

    looks, inside = looks_of(beam, solids)
    hits = [(ray, looked, *first(ray)) for ray, looked in looks]
    nearest = ca.SX(nothing)
    for _, looked, distance, margin in hits:
        nearest = ca.fmin(nearest, ca.if_else(ca.logic_and(looked, margin > 0), distance, nothing))
    nearest = ca.if_else(inside, 0.0, nearest)
    levels = [(1, surfaces.surface, -z), (-1, surfaces.floor, surfaces.depth + z)]
    levels = [level for level in levels if level_range(array, level[1], side=level[0], gap=1.0) is not None]
    if not levels:
        return nearest
    rays = [(first(beam.axis)[0], 1.0), *((free, ca.dot(ray, beam.axis)) for ray, _, free, _ in hits)]
    for free, cosine in rays:
        for side, reflector, gap in levels:
            rise, level = rim(array, cosine, side=side)
            least = max(reflector.faced(curved=False), _LEVEL)
            shown = ca.logic_and(rise >= least, free * rise > ca.fmax(gap, 0.0) * level)
            nearest = ca.fmin(nearest, ca.if_else(shown, ca.fmax(gap, 0.0) / ca.fmax(rise, _LEVEL), nothing))
    return nearest


def weak_range_symbols(
    array: SonarArray,
    beam: Beam,
    bodies: Sequence[tuple[ca.SX, Solid, Reflector]],
    walls: SolidWalls,
    *,
    surfaces: Surfaces,
    uniform: Callable[[ca.SX], ca.SX],
) -> ca.SX:
    """Return the distance [m] to the nearest detected edge, cylinder or corner of the site, at most 2·maximum.

    `bodies` are the obstacles with the numbers of their first echoes (`echo_number`).
    """
    nothing, tangent = 2.0 * array.maximum, tan(array.half_angle)
    solids = [solid for _, solid, _ in bodies]
    nearest = ca.SX(nothing)
    for i, j in surfaces.corners:
        distance, ray = _in_view(solids, beam.apex, ca.vertcat(walls.walls[i], walls.walls[j]), nothing)
        nearest = ca.fmin(nearest, ca.if_else(beam.holds(ray), distance, nothing))
    for number, solid, reflector in bodies:
        others = [other for other in solids if other is not solid]
        for k, (point, shown, half_range, radius) in enumerate(_parts(solid, reflector, beam.apex)):
            distance, ray = _in_view(others, beam.apex, point, nothing)
            cosine = ca.fmax(ca.dot(ray, beam.axis), 1e-3)
            odds = detection_odds(distance, cosine, half_range=half_range, tangent=tangent, radius=radius)
            shown = ca.logic_and(ca.logic_and(solid.present, shown), beam.holds(ray))
            detected = ca.logic_and(shown, uniform(number + k) * odds < 1.0)
            nearest = ca.fmin(nearest, ca.if_else(detected, distance, nothing))
    return nearest


_Part = tuple[ca.SX, ca.SX, float, ca.SX | None]


def _parts(solid: Solid, reflector: Reflector, apex: ca.SX) -> list[_Part]:
    # point (2, 1), whether the solid shows it to the apex, range of half the detections, and radius of a cylinder
    if isinstance(solid, SolidBox) and reflector.edge_range > 0:
        return [(point, shown, reflector.edge_range, None) for point, shown in solid.edges(apex)]
    if isinstance(solid, SolidDisc) and reflector.cylinder_range:
        away = apex - solid.centre
        length = ca.fmax(ca.sqrt(ca.sumsqr(away)), _LEAST)
        radius = ca.fmax(solid.radius, _LEAST)
        return [(solid.centre + solid.radius * (away / length), ca.SX(1), reflector.cylinder_range, radius)]
    return []


def _in_view(solids: Sequence[Solid], apex: ca.SX, point: ca.SX, nothing: float) -> tuple[ca.SX, ca.SX]:
    to = point - apex
    distance = ca.sqrt(ca.sumsqr(to))
    ray = to / ca.fmax(distance, _LEAST)
    hidden = ca.SX(0)
    for solid in solids:
        far, _ = solid.hit(apex, ray, nothing=nothing)
        hidden = ca.logic_or(hidden, ca.logic_and(solid.present, far < distance - _TOUCHES))
    return ca.if_else(hidden, nothing, distance), ray


ECHO_KEY = 6
"""Number of values in the key of a run: whole numbers below 2^26."""

_P = 67108859  # 2^26 − 5, the largest prime below 2^26
_ROUNDS = 4  # for each of the three counters: instant, sensor, echo
_CONSTANTS = (14159265, 35897932, 38462643, 38327950, 28841971, 69399375 % _P, 10582097, 49445923, 7816406, 28620899,
              8628034, 82534211 % _P)  # fmt: skip  # digits of π


def echo_keys(seeds: ArrayLike) -> NDArray[np.float64]:
    """Return the key of each seed, (n, `ECHO_KEY`) whole numbers."""
    return np.asarray(noise_states(seeds) % _P, dtype=float)


def firing_block_symbols(key: ca.SX, instant: ca.SX, sensor: ca.SX) -> ca.SX:
    """Return the state of a firing, from which `uniform_symbols` makes the numbers of its echoes.

    `instant` is the number of the firing instant, 0 to 6e7.
    """
    return _mixed_symbols(_mixed_symbols(instant, key, 0) + sensor, key, 1)


def uniform_symbols(key: ca.SX, block: ca.SX, echo: ca.SX | int) -> ca.SX:
    """Return the uniform random number in (0, 1) of echo 0 to 2^22 of the firing with the state `block`."""
    return (_mixed_symbols(block + echo, key, 2) + 0.5) / float(_P)


def _mixed_symbols(x: ca.SX, key: ca.SX, counter: int) -> ca.SX:
    for k in range(counter * _ROUNDS, (counter + 1) * _ROUNDS):
        x = _remainder(x + key[k % ECHO_KEY] + _CONSTANTS[k])
        x = _remainder(_remainder(x * x) * x)
    return x


def _remainder(x: ca.SX) -> ca.SX:
    # exact for whole x below 2^52: the quotient is whole or at least 1/p below the next whole number, and its rounding
    # error is below 2^-27
    return x - ca.floor(x / float(_P)) * float(_P)
