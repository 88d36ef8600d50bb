"""The open cones of a sensor on or outside the hull: the parts of its beam that the robot's hull does not hide."""

from __future__ import annotations

from math import asin, atan2, hypot, pi

__all__ = ["SLIVER", "inside_hull", "open_cones"]

SLIVER = 1e-6  # rad; an opening narrower than twice this value is ignored
_ON_HULL = 1e-9  # m; an apex up to this far inside the hull counts as on it


def inside_hull(mount: tuple[float, float], hull_radius: float) -> bool:
    """Return whether an apex (x, y) in {B} [m] lies strictly inside the hull."""
    return hypot(*mount) < hull_radius - _ON_HULL


def open_cones(
    mount: tuple[float, float], azimuth: float, *, half_angle: float, hull_radius: float
) -> tuple[tuple[float, float], ...]:
    """Return the parts of a beam that the hull does not hide, from right to left.

    Each part is given as (offset from the beam's axis, half angle) [rad].

    Seen from an apex at distance ρ from the centre, the hull (a disc of radius R) hides the bearings within asin(R/ρ)
    of the centre's bearing. Seen from an apex on the hull, the hull hides the half-plane behind the apex. No object can
    lie between apex and hull. The result is the whole beam, one part of the beam, two parts (one on each side of the
    hull), or empty.

    Args:
        mount: (2,) apex in {B} [m], not inside the hull.
        azimuth: direction of the beam's axis in {B} [rad].
        half_angle: half the opening angle of the beam [rad], below π/2.
        hull_radius: radius R of the hull [m]; a hull of radius 0 hides nothing.
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
        parts = [(a, b) for a, b in cut if b - a > 2.0 * SLIVER]
    if parts == [(-half_angle, half_angle)]:
        return ((0.0, half_angle),)
    return tuple((0.5 * (a + b), 0.5 * (b - a)) for a, b in parts)
