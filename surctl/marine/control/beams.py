"""The sonars in the law's model: beams past the hull, floor and walls, expected ranges, firings that change the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial, reduce
from itertools import groupby
from math import radians, sin
from typing import NamedTuple, TypeVar

import casadi as ca

from surctl.ir import each, fold, tabulated
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.sensing.mapping.contacts import expected_range
from surctl.marine.sensing.mapping.firing import READING
from surctl.marine.sensing.sonar.solids import turned
from surctl.marine.vehicle import planar_rotation

SILENT = 0.1
"""A reading less than this distance [m] below the maximum range counts as no echo."""

_TOLERANCE = 0.10
"""Distance [m] below an expected range from which an echo counts as that of the known object."""

SURE, POSSIBLE = radians(3.0), radians(27.0)
"""Angles of incidence up to which a smooth wall surely answers, and beyond which it surely does not.

The limits in use lie between them, with room for the error of the heading: 5 degrees for a smooth wall (reflector
`specular`), and 22.5 degrees in the simulator of the paper (`webots`)."""


class StepState(NamedTuple):
    """Pose, velocity and known moving obstacles in one control step, as symbolic expressions."""

    eta: ca.SX
    nu: ca.SX
    uncertainty: ca.SX
    placed: ca.SX
    movers: ca.SX

    @property
    def heading(self) -> ca.SX:
        """Return the heading as a unit vector (2, 1), with cosine and sine of ψ."""
        return ca.vertcat(ca.cos(self.eta[3]), ca.sin(self.eta[3]))


def beams(array: SonarArray, around: StepState, hull: ca.SX) -> tuple[list[ca.SX], list[ca.SX], list[float]]:
    """Return axis, apex and half angle of each sonar's beam, without the part of the beam that the hull blocks."""
    axes, apexes, halves = [], [], []
    for i, azimuth in enumerate(array.azimuths):
        offset, half = array.cones[i][0]
        axes.append(turned(around.heading, azimuth + offset))
        if array.mounts is None:
            away = hull * turned(around.heading, azimuth)
        else:
            away = planar_rotation(around.eta[3]) @ ca.DM(list(array.mounts[i]))
        apexes.append(around.eta[:2] + away)
        halves.append(half)
    return axes, apexes, halves


class Expected(NamedTuple):
    """The ranges [m] that each sonar should measure, each (n, 1).

    Attributes:
        walls: nearest point of the walls in the beam, which answers if every surface reflects.
        things: nearest point of the known moving obstacles.
        sure: nearest point of the walls that surely answers; a longer reading is a fault.
        possible: nearest point of the walls that may answer because the beam meets the wall near its normal.
    """

    walls: ca.SX
    things: ca.SX
    sure: ca.SX
    possible: ca.SX

    def where(self, placed: ca.SX, nothing: float) -> Expected:
        """Return a copy in which the walls give the range `nothing` [m] unless `placed` is 1."""
        walls, sure, possible = (ca.if_else(placed, one, nothing) for one in (self.walls, self.sure, self.possible))
        return Expected(walls, self.things, sure, possible)

    def unexplained(self, reading: ca.SX) -> ca.SX:
        """Return whether no wall and no known obstacle explains an echo at the range `reading` [m]."""
        nearer: ca.SX = reading < ca.fmin(self.possible, self.things) - _TOLERANCE
        # the nearest point of the walls may answer too, if a wall is less smooth than assumed
        off = ca.fabs(reading - self.walls)
        return ca.logic_and(nearer, off > _TOLERANCE)


def expected(array: SonarArray, around: StepState, apexes: Sequence[ca.SX], p: Mapping[str, ca.SX]) -> Expected:
    """Return the range [m] that each sonar should measure, for echoes of the walls and of moving obstacles."""
    far = ca.SX([-1e3, 1e3, -1e3, 1e3])
    none = ca.SX(0, 3), ca.SX(0, 1)
    discs = (around.movers[:, :3], around.movers[:, 5])
    scenes: list[tuple[ca.SX, tuple[ca.SX, ca.SX], float | None]] = [(p["walls"], none, None), (far, discs, None)]
    scenes += [(p["walls"], none, angle) for angle in (SURE, POSSIBLE)]

    def ranges(half: float, axis: ca.SX, apex: ca.SX) -> tuple[ca.SX]:
        beam = {"azimuth": 0.0, "hull_radius": 0.0, "half_angle": half, "maximum": array.maximum}
        distances = [
            expected_range(apex, axis, walls=site, discs=round_ones, valid=valid, incidence=angle, **beam)
            for site, (round_ones, valid), angle in scenes
        ]
        return (ca.vertcat(*distances),)

    axes = [turned(around.heading, a + cones[0][0]) for a, cones in zip(array.azimuths, array.cones, strict=True)]
    halves = [cones[0][1] for cones in array.cones]
    tables: list[ca.SX] = []
    for half, same in groupby(zip(halves, axes, apexes, strict=True), key=lambda beam: beam[0]):
        beams_alike = list(same)
        table = each(
            "beam_ranges",
            partial(ranges, half),
            tabulated([axis] for _, axis, _ in beams_alike),
            tabulated([apex] for _, _, apex in beams_alike),
        )[0]
        tables.append(table)
    every = ca.vertcat(*tables)
    return Expected(*(every[:, k] for k in range(4)))


def corrected(array: SonarArray, samples: ca.SX) -> ca.SX:
    """Return the range samples, corrected for known bias and scale; samples without an echo are returned unchanged."""
    if array.scale == 1.0 and array.bias == 0.0:
        return samples
    top = array.maximum - 0.5 * array.resolution
    least = array.lowest - array.resolution

    def one(row: ca.SX) -> tuple[ca.SX]:
        echo = ca.logic_and(row < top, row > least)
        return (ca.if_else(echo, (row - array.bias) / array.scale, row),)

    return each("corrected", one, samples)[0]


Height = TypeVar("Height", float, ca.SX)


def floor_range(equipment: Equipment, z: Height) -> Height | None:
    """Return the range [m] from which a law takes echoes for those of the assumed floor; None if it assumes none.

    At this range the steepest direction of a beam meets the floor; `z` is the height of the robot [m], below 0 in the
    water.
    """
    depth = equipment.floor
    return None if depth is None else (z + depth) / sin(equipment.array.steepest(-1)) - _TOLERANCE


def honest(array: SonarArray, every: ca.SX, samples: ca.SX, reading: ca.SX, reliable: ca.SX, changing: ca.SX) -> ca.SX:
    """Return whether the firing (one measurement) of a sonar may change the map.

    A firing may not change the map in these cases: the sensor is stuck or late; its reading is below its shortest range
    or beyond a wall; or its samples equal those of another sensor. If only the readings of a sensor jump, its firings
    may change the map, because it takes three successive readings to clear a cell.

    Args:
        every: samples of all sensors, a row for each.
        samples: samples of this sensor; `reading` is their range [m].
        reliable: whether the readings are neither late nor beyond a wall.
        changing: whether the samples are not those of too many firings before.
    """
    least = array.lowest / array.scale
    fine = ca.logic_and(ca.logic_and(reading >= least - 1.5 * array.resolution, reliable), changing)
    informative = ca.logic_and(reading > least + array.resolution, reading < array.maximum - SILENT)

    def alike(count: ca.SX, other: ca.SX) -> ca.SX:
        return count + ca.logic_not(ca.sumsqr(other - samples) > 0)

    equal = fold("alike", alike, ca.SX(0), every)  # the sensor's own samples too
    return ca.logic_and(fine, ca.logic_or(equal < 1.5, ca.logic_not(informative)))


def least_of(values: ca.SX) -> ca.SX:
    """Return the least entry of a column or a row."""
    return reduce(ca.fmin, (values[k] for k in range(values.numel())))


def slotted(firings: ca.SX, slots: int) -> ca.SX:
    """Return `slots` rows `READING` as a column: one firing in each, or one that changes no map cell.

    `firings` is a table: each row says first whether the firing is new, and then contains its row `READING`.
    """
    size = sum(k for _, k, _ in READING)
    empty = ca.vertcat(ca.SX.zeros(size - 2), -1, 0)

    def entered(*values: ca.SX) -> list[ca.SX]:
        *listed, count, row = values
        fresh, firing = row[0], row[1:]
        after = [ca.if_else(ca.logic_and(fresh, count == s), firing, old) for s, old in enumerate(listed)]
        return [*after, count + fresh]

    *listed, _ = fold("slotted", entered, [*[empty] * slots, ca.SX(0)], firings)
    return ca.vertcat(*listed)
