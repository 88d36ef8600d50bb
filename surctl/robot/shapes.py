"""Capsules (and spheres) around the links of a robot, and the distance between two of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError

__all__ = ["Capsule", "capsule_around", "closest_points"]

Array: TypeAlias = NDArray[np.float64]

_PARALLEL = 1e-10  # squared sine of the angle below which two axes count as nearly parallel


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of the segment from `start` to `end`; a sphere if both ends are equal.

    Attributes:
        start, end: ends (3,) of the axis in the frame of the link [m].
        radius: radius [m], greater than 0.

    Raises:
        InputError: an end is not three finite numbers, or the radius is not positive.
    """

    start: Array | Sequence[float]
    end: Array | Sequence[float]
    radius: float

    def __post_init__(self) -> None:
        for field in ("start", "end"):
            point = np.asarray(getattr(self, field), dtype=float)
            if point.shape != (3,) or not np.isfinite(point).all():
                raise InputError("is not a point", key=f"capsule.{field}", value=point.tolist(), remedy="give x, y, z")
            object.__setattr__(self, field, point)
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError("is not a radius", key="capsule.radius", value=self.radius, remedy="give metres above 0")

    @property
    def axis(self) -> Array:
        """Return the vector (3,) from start to end [m]."""
        along: Array = np.asarray(self.end) - np.asarray(self.start)
        return along

    @property
    def length(self) -> float:
        """Return the length of the axis [m]."""
        return math.sqrt(float(self.axis @ self.axis))


def capsule_around(kind: str, size: Array, rotation: Array, position: Array) -> Capsule:
    """Return the capsule that contains a shape of a URDF file, in the frame of the link.

    Args:
        kind: "sphere", "cylinder", "capsule" or "box".
        size: radius (1,); radius and length (2,); or the edges (3,) of a box [m].
        rotation, position: frame of the shape in the frame of the link; the axis of a cylinder is z.
    """
    along, radius = np.zeros(3), float(size[0])
    if kind in ("cylinder", "capsule"):
        along[2] = size[1] / 2.0
    elif kind == "box":
        longest = int(np.argmax(size))
        along[longest] = size[longest] / 2.0
        radius = float(np.sqrt((np.delete(size, longest) ** 2).sum())) / 2.0
    return Capsule(position - rotation @ along, position + rotation @ along, radius)


def closest_points(
    start: ca.SX, along: ca.SX, other: ca.SX, beside: ca.SX, lengths: tuple[float, float]
) -> tuple[ca.SX, ca.SX]:
    """Return the closest points (3,) of two segments.

    The solution is that of Ericson (2005), section 5.1.9. For nearly parallel segments, the points are continuous in
    the configuration, and their distance is larger than the least by a negligible amount.

    Args:
        start, along: start (3,) of the first segment and vector (3,) to its end [m].
        other, beside: the same of the second segment.
        lengths: lengths of the segments [m]; 0 for a point.
    """
    a, e = lengths[0] ** 2, lengths[1] ** 2
    between = start - other
    c, f, b = ca.dot(along, between), ca.dot(beside, between), ca.dot(along, beside)
    if a == 0.0 and e == 0.0:
        return start, other
    if a == 0.0:
        return start, other + beside * _share(f / e)
    if e == 0.0:
        return start + along * _share(-c / a), other
    # the second share is the best one for the first, and then the first is the best one for the second
    first = _share((b * f - c * e) / (a * e * (1.0 + _PARALLEL) - b * b))
    second = _share((b * first + f) / e)
    return start + along * _share((b * second - c) / a), other + beside * second


def _share(value: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(value, 0.0), 1.0)
