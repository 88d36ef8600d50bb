"""The echo model in CasADi symbols: the distance to the nearest reflecting point, and the samples of a firing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos

import casadi as ca

from surctl.errors import InputError
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.solids import Cone, Solid, turned


@dataclass(frozen=True, eq=False)
class Beam:
    """The beam of a sensor: its apex (2, 1) in {E} [m], the cones that the hull does not block, and its axis (2, 1)."""

    apex: ca.SX
    cones: tuple[Cone, ...]
    axis: ca.SX

    def holds(self, ray: ca.SX) -> ca.SX:
        """Return whether a unit vector (2, 1) lies in one of the cones."""
        inside = ca.SX(0)
        for cone in self.cones:
            inside = ca.logic_or(inside, cone.holds(ray))
        return inside


def beam_of(
    array: SonarArray,
    sensors: Sequence[int],
    turn: ca.SX | int,
    *,
    position: ca.SX,
    heading: ca.SX,
    hull_radius: ca.SX | float | None = None,
) -> Beam:
    """Return the beam of the firing sensor: number `turn` of `sensors`, the indices of those that may fire.

    Args:
        position, heading: (2, 1) centre of the robot in {E} [m], and ψ [rad].
        hull_radius: used for an array without `mounts` [m]; a symbol if the loop is compiled for any vehicle; None: the
            array's.
    """
    if not sensors or not all(0 <= i < array.size for i in sensors):
        raise InputError("no such sensor", key="sensors", value=sensors, remedy=f"give some of 0 to {array.size - 1}")
    angle = heading + _picked(turn, [array.azimuths[i] for i in sensors])
    axis = ca.vertcat(ca.cos(angle), ca.sin(angle))
    if array.mounts is None:
        apex = position + (array.hull_radius if hull_radius is None else hull_radius) * axis
    else:
        mount = ca.vertcat(*(_picked(turn, [array.mounts[i][k] for i in sensors]) for k in (0, 1)))
        c, s = ca.cos(heading), ca.sin(heading)
        apex = position + ca.vertcat(c * mount[0] - s * mount[1], s * mount[0] + c * mount[1])
    cones = [array.cones[i] for i in sensors]
    parts = []
    for k in range(max(len(own) for own in cones)):
        offsets, halves = zip(*(own[min(k, len(own) - 1)] for own in cones), strict=True)
        offset = _picked(turn, offsets)
        turned_axis = axis if isinstance(offset, float) and offset == 0.0 else turned(axis, offset)
        parts.append(Cone(turned_axis, _picked(turn, halves)))
    return Beam(apex, tuple(parts), axis)


def echo_range(array: SonarArray, beam: Beam, solids: Sequence[Solid]) -> ca.SX:
    """Return the distance [m] from the apex to the nearest reflecting point, at most 2·maximum."""
    nothing = 2.0 * array.maximum
    nearest = ca.SX(nothing)
    if array.incidence_limit is None:
        for solid in solids:
            for cone in beam.cones:
                candidate = solid.nearest_in_cone(beam.apex, cone, nothing=nothing)
                nearest = ca.fmin(nearest, ca.if_else(solid.present, candidate, nothing))
        return nearest
    looks, inside = looks_of(beam, solids)
    faced = cos(array.incidence_limit)
    for ray, looked in looks:
        distance, cosine = ca.SX(nothing), ca.SX(0)
        for solid in solids:
            far, facing = solid.hit(beam.apex, ray, nothing=nothing)
            first = ca.logic_and(solid.present, far < distance)
            distance, cosine = ca.if_else(first, far, distance), ca.if_else(first, facing, cosine)
        nearest = ca.fmin(nearest, ca.if_else(ca.logic_and(looked, cosine >= faced), distance, nothing))
    return ca.if_else(inside, 0.0, nearest)


def looks_of(beam: Beam, solids: Sequence[Solid]) -> tuple[list[tuple[ca.SX, ca.SX]], ca.SX]:
    """Return unit vectors to where the nearest echo may lie, each with 1 if in the beam; and 1 if inside a solid."""
    looks, inside = [(edge, ca.SX(1)) for cone in beam.cones for edge in cone.edges], ca.SX(0)
    for solid in solids:
        inside = ca.logic_or(inside, ca.logic_and(solid.present, solid.holds(beam.apex)))
        looks += [(ray, beam.holds(ray)) for ray in solid.outlook(beam.apex)]
    return looks, inside


def echo_samples(array: SonarArray, distance: ca.SX, *, noise: ca.SX) -> ca.SX:
    """Return the samples (samples, 1) [m] of a firing whose echo comes from `distance` [m], in order of time.

    Each sample is scale · distance + bias + noise, limited to [lowest, maximum] and rounded to the nearest conversion
    step (for example, the minimum of 0.2 m gives the nearest code, 0.194 m). Without an echo within the maximum, every
    sample is the maximum. `noise` are standard normal numbers.
    """
    reading = array.scale * distance + array.bias + array.noise_sd * noise
    reading = ca.fmin(ca.fmax(reading, array.lowest), array.maximum)
    top = float(array.top_code)
    codes = ca.floor(reading * top / array.maximum + 0.5)
    return ca.if_else(distance > array.maximum, array.maximum, codes * array.maximum / top)


def _picked(turn: ca.SX | int, values: Sequence[float]) -> ca.SX | float:
    # a plain number if all values are equal
    if all(value == values[0] for value in values):
        return values[0]
    chosen = ca.SX(0)
    for k, value in enumerate(values):
        chosen = ca.if_else(turn == k, value, chosen)
    return chosen
