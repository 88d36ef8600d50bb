"""How surfaces answer a sonar: kinds of reflectors, the surfaces of a scene, and the probability of a weak echo.

A smooth face is a mirror for ultrasound: it answers only near its normal. A wavelength of 7 mm (200 kHz in water) finds
a face smooth if its roughness stays below λ/8, about 1 mm (Rayleigh's criterion), as for glass, tiles and liners.
Where two smooth walls meet, the corner returns the sound to its source (Kuc and Siegel 1987; Leonard and
Durrant-Whyte 1992). A convex edge and a cylinder spread the sound, so that their echo falls as r^(-3/2); a face's echo
falls as 1/r. A rough face scatters into all directions; Lambert's rule holds down to grazing angles of about 20°.

A weak echo is detected with the probability P = 1/(1 + (r/R)⁶ (1 + x²)⁴). Here r is the range, x is the tangent of the
angle from the beam's axis divided by that of half the opening angle, and R is the range at which an echo on the axis is
detected in half of the firings. P is the logistic function of the echo's level in dB above the threshold, with a spread
of 3.9 dB: the amplitude falls as r^(-3/2), and by half from the axis to the edge of the beam.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, pi
from types import MappingProxyType

import casadi as ca

__all__ = ["REFLECTORS", "Reflector", "Surfaces", "detection_odds"]

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

    Example:
        >>> from surctl.marine.sensing import REFLECTORS, Reflector
        >>> list(REFLECTORS)
        ['ideal', 'webots', 'specular', 'specular-edges', 'diffuse', 'silent']
        >>> Reflector(incidence_limit=0.2).faced(curved=True)  # cosine
        0.9800665778412416
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
        distance: range [m].
        cosine: cosine of the angle between the beam's axis and the direction of the echo.
        half_range: range [m] on the axis at which P = 1/2, for a cylinder with a radius of 0.1 m or for an edge.
        tangent: tangent of half the opening angle of the beam.
        radius: radius of the cylinder [m]; None for an edge.

    Example:
        >>> from math import cos, radians, tan
        >>> from surctl.marine.sensing import detection_odds
        >>> half = radians(37.5)
        >>> beam = {"half_range": 0.6, "tangent": tan(half)}
        >>> [round(1 / detection_odds(0.6, cos(angle), **beam), 3) for angle in (0.0, half)]  # on the axis, at the edge
        [0.5, 0.059]
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
