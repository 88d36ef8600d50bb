"""A face beside the robot: found from echoes of its nearest point, and believed to go on where nothing answers."""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Layout, tabulated
from surctl.marine.control.perception import FACE_PORTS, Firing, face_after, with_face, within_beam

HULL, BLIND, DT, DEEP = 0.27, 0.2, 0.05, 0.03
HALF = math.radians(37.5)
STATE = Layout(FACE_PORTS)
NOTHING = 4.5  # [m] reading without an echo
LEANS = math.radians(20)  # of the face's normal, from x of {E}


@cache
def step():
    """Face and foot after one firing of one sensor."""
    x, place, firing = STATE.symbols("x"), ca.SX.sym("place", 2), ca.SX.sym("firing", 9)
    one = Firing(firing[:2], firing[2:4], within_beam(HALF), firing[4], firing[5], firing[6], firing[7], firing[8])
    face, foot = face_after(x[1], tabulated([one]), place, dt=DT, blind=BLIND, hull=ca.SX(HULL), deep=ca.SX(DEEP))
    return ca.Function("step", [x[0], place, firing], [STATE.join(face), foot])


class Passing:
    """A robot that passes a face at `gap` [m] beside the hull with one sensor turned `aside` [rad] from the normal."""

    def __init__(self, gap: float, *, aside: float = 0.2, bend: float = 0.0):
        self.state, self.gap, self.aside, self.bend = STATE.pack(), gap, aside, bend
        self.normal = np.array([math.cos(LEANS), math.sin(LEANS)])
        self.tangent = np.array([-self.normal[1], self.normal[0]])

    def at(self, along: float, reading: float | None = None, *, gap: float | None = None) -> np.ndarray:
        """Foot (3,) after a firing `along` [m] the face; the reading that the face gives, or another one [m]."""
        gap = self.gap if gap is None else gap
        place = along * self.tangent - (HULL + gap) * self.normal
        axis = np.array([math.cos(LEANS + self.aside), math.sin(LEANS + self.aside)])
        apex = place + HULL * axis
        range_ = -float(apex @ self.normal) + self.bend * float(apex @ self.tangent) ** 2
        reading = max(range_, BLIND) if reading is None else reading
        blind, echo = reading <= BLIND, reading < NOTHING
        self.state, foot = step()(self.state, place, [*apex, *axis, 1, reading, reading, echo, blind])
        return np.asarray(foot).ravel()

    def nearest(self, gap: float) -> np.ndarray:
        """Offset (2,) from the robot to the point behind the face's nearest point."""
        return np.asarray((HULL + gap + DEEP) * self.normal)


def measured() -> Passing:
    """A robot that has passed 0.7 m of a face outside the blind range."""
    robot = Passing(0.25)
    assert all(robot.at(along)[2] == 1e6 for along in np.arange(0.0, 0.7, 0.01))  # the sonars measure it there
    return robot


def test_a_face_goes_on_within_the_blind_range():
    robot = measured()
    for along in np.arange(0.7, 2.0, 0.01):  # every reading is the same: the least
        foot = robot.at(along, gap=0.15)
    assert foot[:2] == pytest.approx(robot.nearest(0.15), abs=1e-6)
    assert foot[2] == pytest.approx(float(foot[:2] @ foot[:2]))


def test_too_few_echoes_are_no_face():
    robot = Passing(0.25)
    for along in np.arange(0.0, 0.3, 0.01):
        robot.at(along)
    assert robot.at(0.3, gap=0.15)[2] == 1e6


def test_silence_where_the_face_would_answer_ends_it():
    robot = measured()
    assert robot.at(0.7, NOTHING, gap=0.15)[2] == 1e6
    assert robot.at(0.71, gap=0.15)[2] == 1e6  # one echo does not bring it back


def test_silent_it_goes_on_for_a_fifth_of_a_metre_and_three_seconds():
    robot = measured()
    robot.at(0.7, gap=0.15)
    robot.aside = 1.0  # the sensor looks away: the face would not answer
    assert robot.at(0.8, NOTHING, gap=0.15)[2] < 1.0
    assert robot.at(1.0, NOTHING, gap=0.15)[2] == 1e6
    assert robot.at(0.8, NOTHING, gap=0.15)[2] < 1.0
    for _ in range(int(3 / DT)):
        foot = robot.at(0.7, NOTHING, gap=0.15)
    assert foot[2] == 1e6


def test_echoes_that_lie_on_no_plane_are_no_face():
    robot = Passing(0.25, bend=1.0)
    for along in np.arange(-0.4, 0.4, 0.01):
        robot.at(along)
    assert robot.at(0.4, gap=0.15)[2] == 1e6


def test_a_face_replaces_only_farther_marks_in_its_direction():
    marks = np.tile([0.0, 0.0, 1e6], (16, 1))
    marks[0], marks[1] = [0.4, 0.0, 0.16], [0.3, 0.1, 0.1]
    near, far = ca.DM([0.35, 0.02, 0.35**2]), ca.DM([0.5, 0.0, 0.25])
    closer, same = (np.asarray(ca.evalf(with_face(ca.SX(ca.DM(marks)), ca.SX(foot)))) for foot in (near, far))
    assert closer[0] == pytest.approx([0.35, 0.02, 0.35**2]) and np.array_equal(closer[1:], marks[1:])
    assert np.array_equal(same, marks)
