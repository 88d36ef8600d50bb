"""The face beside the robot: a plane through the echoes of a smooth surface, which goes on where it is silent.

A smooth face answers only near its normal, so a robot that moves along a face hears only the part beside it. The map
has no marks of the part ahead, and no range at all within the sonars' blind range. The nearest point of the face is the
foot of the perpendicular from the sensor. Two echoes with the ranges r1, r2 from the apexes A1, A2 therefore determine
the face's unit normal n by n·(A2 − A1) = r1 − r2 (range-only mapping; see Leonard and Durrant-Whyte 1992, "Directed
sonar sensing for mobile robot navigation"). A third echo between the two must fit the plane: the echoes of an edge and
of a thin cylinder do not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from typing import NamedTuple

import casadi as ca

from surctl.ir import Port, each

__all__ = ["FACE_PORTS", "Face", "Firing", "face_after", "with_face"]

_NEVER = 1e5  # [s] age of a face that was never measured
_NEAR = 0.6  # [m] longest range of an echo from which a face is determined
_APART = 0.25  # [m] least distance between two echoes
_TOGETHER = 0.8  # [m] distance beyond which two echoes count as those of different objects
_FLAT = 0.025  # [m] largest error of the middle echo
_SAME = 0.03  # [m] largest difference of an echo from the face that it confirms
_GONE = 0.15  # [m] distance beyond the face from which a reading shows that the face has ended
_TURNS = 0.2  # share by which an estimate turns a face that is already known
_ALIKE = 0.9  # least cosine of the angle between an estimate and the known face, for them to be the same
_INSIDE = 0.05  # [rad] the foot of the perpendicular must lie this far inside the beam
_LASTS = 10.0  # [s] time without a confirmation after which the face is dropped
_CLOSE = 3.0  # [s] time since an echo from within the blind range after which the map alone counts
_GOES_ON = 0.2  # [m] distance by which the face goes on beyond the last place at which it was confirmed
_FAR = 1e6  # [m²] no face; as in the map

FACE_PORTS = (
    Port(
        "face_echoes",
        (2, 3),
        "m",
        "two earlier echoes, the later one first: x, y of the apex in {E}, range; range 0: none",
    ),
    Port(
        "face_plane", (5,), "1, m", "normal x, y in {E}, distance from the origin of {E}, x, y of the last confirmation"
    ),
    Port("face_age", (2,), "s", "time since the face was confirmed, and since it was within the blind range", _NEVER),
)
"""State of the face beside the robot."""


class Firing(NamedTuple):
    """One firing: apex and axis (2, 1) of the beam in {E}, half its opening angle [rad], and what was measured.

    Attributes:
        arrived: 1 if the firing is new and credible.
        reading: range [m].
        longest: range [m] up to which the last firings agree that nothing answered.
        echo: 1 if no wall, no floor and no known obstacle explains the echo.
        blind: 1 if the echo came from within the blind range.
    """

    apex: ca.SX
    axis: ca.SX
    half: float
    arrived: ca.SX
    reading: ca.SX
    longest: ca.SX
    echo: ca.SX
    blind: ca.SX


@dataclass(frozen=True)
class Face:
    """The state after a period, and the foot of the perpendicular: offset x, y from the robot [m], squared distance."""

    state: Mapping[str, ca.SX]
    foot: ca.SX


def face_after(
    x: Mapping[str, ca.SX],
    firings: Sequence[Firing],
    position: ca.SX,
    *,
    dt: float,
    blind: float,
    hull: ca.SX,
    deep: ca.SX,
) -> Face:
    """Return the face beside the robot after the firings of one control period.

    Args:
        x: state by name, see `FACE_PORTS`.
        firings: the firings of all sensors.
        position: the robot's place (2, 1) in {E} [m].
        dt: control period [s].
        blind: longest range that a sensor cannot measure [m].
        hull: radius of the hull [m].
        deep: distance [m] by which the point in `foot` lies behind the face, as the centre of a marked cell does.
    """
    late, early = x["face_echoes"][0, :].T, x["face_echoes"][1, :].T
    plane, age, close = x["face_plane"], x["face_age"][0] + dt, x["face_age"][1] + dt
    nearest, now, axis, half = ca.SX(_NEAR), ca.SX.zeros(3), ca.SX([1, 0]), ca.SX(1)
    for one in firings:
        measured = ca.logic_and(ca.logic_and(one.arrived, one.echo), ca.logic_not(one.blind))
        take = ca.logic_and(measured, one.reading < nearest)
        nearest = ca.if_else(take, one.reading, nearest)
        now = ca.if_else(take, ca.vertcat(one.apex, one.reading), now)
        axis, half = ca.if_else(take, one.axis, axis), ca.if_else(take, cos(one.half - _INSIDE), half)
    there = now[2] > 0
    # a plane through the present echo and the earlier one
    base = now[:2] - early[:2]
    apart = ca.sqrt(ca.sumsqr(base))
    along = base / ca.fmax(apart, 1e-6)
    cosine = (early[2] - now[2]) / ca.fmax(apart, 1e-6)
    sine = ca.sqrt(ca.fmax(1 - cosine * cosine, 0))
    side = ca.vertcat(-along[1], along[0])
    side = ca.if_else(ca.dot(side, axis) < 0, -side, side)
    normal = cosine * along + sine * side
    distance = ca.dot(normal, now[:2]) + now[2]
    same = ca.logic_and(age < _LASTS, ca.dot(normal, plane[:2]) > _ALIKE)
    same = ca.logic_and(same, ca.fabs(plane[2] - ca.dot(plane[:2], now[:2]) - now[2]) < _SAME)
    middle = ca.fabs(distance - ca.dot(normal, late[:2]) - late[2])
    fits = ca.logic_and(ca.logic_and(there, early[2] > 0), ca.logic_and(apart > _APART, apart < _TOGETHER))
    fits = ca.logic_and(fits, ca.logic_and(ca.fabs(cosine) < 1, ca.dot(normal, axis) > half))
    step = ca.sqrt(ca.sumsqr(now[:2] - late[:2]))
    fits = ca.logic_and(fits, ca.logic_and(step > 0.1, middle < _FLAT))
    turned = plane[:2] + _TURNS * (normal - plane[:2])
    normal = ca.if_else(same, turned / ca.fmax(ca.sqrt(ca.sumsqr(turned)), 0.5), normal)
    plane = ca.if_else(fits, ca.vertcat(normal, ca.dot(normal, now[:2]) + now[2], now[:2]), plane)
    age = ca.if_else(fits, 0, age)
    for one in firings:
        ahead = plane[2] - ca.dot(plane[:2], one.apex)
        faces = ca.logic_and(one.arrived, ca.dot(plane[:2], one.axis) > cos(one.half - _INSIDE))
        agrees = ca.if_else(one.blind, ahead < blind + _SAME, ca.fabs(one.reading - ahead) < _SAME)
        agrees = ca.logic_and(ca.logic_and(faces, age < _LASTS), agrees)
        gone = ca.logic_and(faces, one.longest > ca.fmax(ahead, blind) + _GONE)
        age = ca.if_else(agrees, 0, ca.if_else(gone, _NEVER, age))
        close = ca.if_else(ca.logic_and(agrees, one.blind), 0, close)
        plane = ca.if_else(agrees, ca.vertcat(plane[:3], one.apex), plane)
    # the later of the two echoes moves on
    lost = ca.logic_or(late[2] <= 0, step > _TOGETHER)
    moves = ca.logic_and(there, ca.logic_or(lost, step >= _APART))
    echoes = ca.vertcat(
        ca.if_else(moves, now, late).T, ca.if_else(moves, ca.if_else(lost, ca.DM.zeros(3), late), early).T
    )
    away = plane[2] - ca.dot(plane[:2], position)
    further = ca.fabs(ca.dot(ca.vertcat(-plane[1], plane[0]), position - plane[3:]))
    holds = ca.logic_and(
        ca.logic_and(ca.logic_and(age < _LASTS, close < _CLOSE), further < _GOES_ON),
        ca.logic_and(away > 0, away < hull + blind),
    )
    away += deep
    foot = ca.if_else(holds, ca.vertcat(away * plane[:2], away * away), ca.DM([0, 0, _FAR]))
    state = {"face_echoes": echoes, "face_plane": plane, "face_age": ca.fmin(ca.vertcat(age, close), _NEVER)}
    return Face(state, foot)


def with_face(marks: ca.SX, foot: ca.SX) -> ca.SX:
    """Return the nearest marks of the map (sectors, 3), with the face's foot (3, 1) in its sector if it is nearer."""
    sectors = marks.shape[0]
    middles = [2 * pi * k / sectors for k in range(sectors)]

    def nearer(mark: ca.SX, middle: ca.SX) -> tuple[ca.SX]:
        inside = ca.dot(foot[:2], middle) > cos(pi / sectors) * ca.sqrt(foot[2])
        return (ca.if_else(ca.logic_and(foot[2] < mark[2], inside), foot, mark),)

    (table,) = each("with_face", nearer, marks, ca.SX([[cos(a), sin(a)] for a in middles]))
    return table
