"""The public checks: what is right passes, and everything that is deliberately wrong is caught and named."""

import math
from functools import partial

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError, SurctlError
from surctl.marine.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters, plant_thrust_limit
from surctl.tasks import (
    AccelerationLimit,
    Barrier,
    HalfPlane,
    LimitRow,
    RateLimit,
    SetTask,
    Task,
    VelocityBox,
    allowed_closing_speed,
    clearance_task,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)
from surctl.testing import CheckFailed, check_task
from tests.oracles.limit_rows import check_limit

ETA = ca.SX.sym("eta", 4)
NU = ca.SX.sym("nu", 4)
ECHO = ca.SX.sym("echo", 2)
GAIN = ca.SX.sym("gain")
STOPPING = partial(allowed_closing_speed, deceleration=GAIN, reaction=0.4)
ON_TOP = [1.3, -0.4, 0.0, 0.3]
POINT = ON_TOP[:2]
DISC = ca.norm_2(ETA[:2] - ca.DM([1.0, 0.5])) - 0.4


def one_line(caught, *parts):
    text = str(caught.value)
    assert "\n" not in text
    for part in parts:
        assert part in text, text


# --- tasks --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda eta: position_task(eta, [1.0, 2.0, -0.5]),
        lambda eta: depth_task(eta, -0.15),
        lambda eta: heading_task(eta, 0.7),
        lambda eta: velocity_task(eta, [0.1, -0.2]),
        lambda eta: clearance_task(eta, POINT, margin=0.4),
        lambda eta: distance_task(eta, POINT, distance=0.5),
        lambda eta: line_of_sight_task(eta, POINT),
        lambda eta: SetTask(
            name="arc", eta=eta, sigma=eta[3], lower=-1.0, upper=2.0, angular=True, kinematics="vehicle"
        ),
        lambda eta: SetTask(name="band", eta=eta, sigma=eta[2], lower=-math.inf, upper=-0.1, kinematics="vehicle"),
    ],
)
def test_tasks_of_the_library_pass(make):
    report = check_task(make, near=[ON_TOP], samples=20)
    assert report.derivative_error < 1e-7
    assert report.samples == 20
    assert report.rank == report.size


def test_ranks_are_reported_with_the_pose_of_the_least():
    report = check_task(lambda eta: distance_task(eta, POINT, distance=0.5), near=[ON_TOP])
    assert (report.rank, report.least_rank) == (1, 0)
    assert report.least_rank_at.startswith("eta = [")
    report = check_task(
        lambda eta: Task(name="twice", eta=eta, sigma=ca.vertcat(eta[2], 2 * eta[2]), kinematics="vehicle")
    )
    assert (report.size, report.rank, report.least_rank) == (2, 1, 1)


def test_symbols_are_drawn_from_their_ranges():
    task = clearance_task(ETA, ECHO, margin=0.4, gain=GAIN)
    assert check_task(task, parameters=[(ECHO, -3, [3, 4]), (GAIN, 0.1, 2)]).rank == 1
    with pytest.raises(InputError, match="task clearance: contains the symbol gain"):
        check_task(task, parameters=[(ECHO, -3, 3)])
    with pytest.raises(InputError, match="parameter echo"):
        check_task(task, parameters=[(ECHO, 3, -3), (GAIN, 0.1, 2)])
    with pytest.raises(InputError, match="parameter echo"):
        check_task(task, parameters=[(ECHO, [1, 2, 3], 3), (GAIN, 0.1, 2)])


class ForgetsTheFrame(Task):
    """∂σ/∂η without J(ψ): right at ψ = 0 only."""

    def jacobian(self):
        return ca.jacobian(self.sigma, self.eta)


class SlightlyOff(Task):
    def jacobian(self):
        return super().jacobian() * (1 + 1e-5)


class TooShort(Task):
    def reference(self):
        return super().reference()[0]


class Unwrapped(Task):
    def error(self):
        return self.target - self.sigma


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda e: ForgetsTheFrame(name="bad", eta=e, sigma=e[:2], kinematics="vehicle"),
            ["row 0 of J is", "sigma changes", "eta = ["],
        ),
        (
            lambda e: SlightlyOff(name="bad", eta=e, sigma=e[:2], kinematics="vehicle"),
            ["of J is ", "but sigma changes at a rate of"],
        ),
        (
            lambda e: TooShort(name="bad", eta=e, sigma=e[:2], kinematics="vehicle"),
            ["reference has shape (1, 1), expected (2, 1)"],
        ),
        (
            lambda e: Task(name="bad", eta=e, sigma=e[3], kinematics="vehicle"),
            ["the reference changes", "full turn", "angular=True?"],
        ),
        (
            lambda e: Unwrapped(name="bad", eta=e, sigma=3 * e[3], angular=True, kinematics="vehicle"),
            ["the angular error", "half a turn"],
        ),
        (
            lambda e: Task(name="bad", eta=e, sigma=ca.sqrt(e[0]), kinematics="vehicle"),
            ["sigma is not finite in row 0"],
        ),
        (
            lambda e: Task(name="bad", eta=e, sigma=e[0], rate=ca.log(e[1]), kinematics="vehicle"),
            ["the reference is not finite in row 0"],
        ),
        (
            lambda e: Task(name="bad", eta=e, sigma=ca.norm_2(e[:2] - ca.DM(POINT)), kinematics="vehicle"),
            ["J is not finite", "1.3, -0.4"],
        ),
        (
            lambda e: SetTask(name="bad", eta=e, sigma=e[2], lower=0.1 * e[0], upper=0.2, kinematics="vehicle"),
            ["the bounds of row 0 cross", "eta = ["],
        ),
    ],
)
def test_wrong_tasks_are_caught_and_named(make, says):
    with pytest.raises(CheckFailed) as caught:
        check_task(make, near=[ON_TOP], samples=150)
    one_line(caught, "task bad: ", *says)
    assert isinstance(caught.value, SurctlError)
    assert isinstance(caught.value, AssertionError)


def test_a_task_that_counts_turns_may_say_so():
    assert check_task(lambda e: Task(name="unwind", eta=e, sigma=e[3], kinematics="vehicle"), full_turn=False).rank == 1


# --- limits -------------------------------------------------------------------------------------------------------

WIDE = [(NU, -0.5, 0.5)]
NUMBERS = PLANT_PARAMETERS.unpack(plant_parameters(load_vehicle("sur540-flooded")))


@pytest.mark.parametrize(
    ("limit", "parameters"),
    [
        (VelocityBox([-1] * 4, [1, 1, 1, math.inf]), []),
        (HalfPlane("wall", ECHO[[0, 1, 0, 1]], 0.3), [(ECHO, -1, 1)]),
        (AccelerationLimit(NU, [0.1] * 4, dt=0.05), WIDE),
        (plant_thrust_limit(NU, NUMBERS, dt=0.05), WIDE),
        (Barrier("disc", ETA, h=DISC, kinematics="vehicle"), [(ETA, -3, 3)]),
        (
            Barrier("disc", ETA, h=DISC, alpha=STOPPING, kinematics="vehicle"),
            [(ETA, -3, 3), (GAIN, 0.01, 1)],
        ),
        (RateLimit(position_task(ETA, [1.0, 2.0]), 0.1), [(ETA, -3, 3)]),
        (
            SetTask(name="band", eta=ETA, sigma=ETA[:2], lower=-1.0, upper=[0.5, math.inf], kinematics="vehicle"),
            [(ETA, -3, 3)],
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_limits_of_the_library_pass(limit, parameters):
    report = check_limit(limit, parameters=parameters, samples=20)
    assert report.names == tuple(row.name for row in limit.rows())
    assert report.narrowest >= 0
    assert report.samples > 20


class Rows:
    """A limit of rows as they are given."""

    def __init__(self, *rows):
        self.given = rows

    def rows(self):
        return self.given


class Renamed:
    def __init__(self):
        self.calls = 0

    def rows(self):
        self.calls += 1
        return (row(f"row{self.calls}"),)


def row(name="mine.u", kind="barrier", a=(1, 0, 0, 0), lower=-math.inf, upper=1.0):
    return LimitRow(name, kind, ca.SX(a).T if isinstance(a, ca.SX) else ca.SX([list(a)]), ca.SX(lower), ca.SX(upper))


# crosses only in a corner of the ranges that no random sample meets: within 0.06 of one point of (−1, 1)²
HIDDEN = ca.sumsqr(ECHO - ca.DM([0.31, -0.62])) - 0.003


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (Rows(), "has no rows"),
        (Rows(row(), row()), "'mine.u': occurs twice"),
        (Rows(row("my row")), "'my row': is not identifiers"),
        (Rows(row("mine.")), "is not identifiers"),
        (Rows(row(kind="soft")), "unknown kind 'soft'; known: actuator, barrier, set"),
        (Rows(row(), row("mine.v", a=(1, 0, 0))), "a has shape (1, 3), expected (1, 4)"),
        (Renamed(), "different row names at every call"),
        (Rows(row(upper=ca.log(ECHO[0]))), "'mine.u': a bound is not a number"),
        (Rows(row(a=ca.vertcat(1 / (ECHO[0] - 1), 0, 0, 0))), "'mine.u': a is not finite: [inf"),
        (Rows(row(), row("mine.v", lower=ECHO[0], upper=ECHO[1])), "'mine.v': allows no velocity"),
        (Rows(row(), row("mine.v", lower=0.0, upper=HIDDEN)), "'mine.v': allows no velocity: lower = 0, upper = -"),
        (Rows(row(a=(0, 0, 0, 0), upper=-0.1)), "requires a row of zeros"),
        (Rows(row(upper=-math.inf)), "allows no velocity"),
        (
            Rows(
                row(kind="actuator", a=(2, 0, 0, 0), upper=0.2),
                row("other", "actuator", a=(0, 1, 0, 0)),
                row("mine.v", "actuator", lower=0.3, upper=0.4),
            ),
            "actuator rows mine.u and mine.v contradict each other: smallest violation 0.1",
        ),
        (
            Rows(
                *VelocityBox([-0.1] * 4, [0.1] * 4).rows(),
                *AccelerationLimit(10 * ECHO[[0, 1, 0, 1]], [0.1] * 4, dt=1).rows(),
            ),
            "contradict each other",
        ),
    ],
)
def test_wrong_limits_are_caught_and_named(limit, says):
    with pytest.raises(CheckFailed) as caught:
        check_limit(limit, parameters=[(ECHO, -1, 1)])
    one_line(caught, says)


def test_the_point_of_a_finding_is_told():
    with pytest.raises(CheckFailed) as caught:
        check_limit(Rows(row(lower=0.0, upper=HIDDEN)), parameters=[(ECHO, -1, 1)])
    x, y = map(float, caught.value.at.removeprefix("echo = [").removesuffix("]").split(","))
    assert (x - 0.31) ** 2 + (y + 0.62) ** 2 < 0.003


def test_a_predicate_is_compared_on_both_sides_of_every_bound():
    limit = AccelerationLimit(NU, [0.1, 0.2, 0.3, 0.4], dt=0.5)

    def within(reach):
        return lambda v, nu: bool((np.abs(v - nu) <= np.array(reach)).all())

    assert check_limit(limit, parameters=WIDE, holds=within([0.05, 0.1, 0.15, 0.2])).compared > 500
    with pytest.raises(CheckFailed) as caught:
        check_limit(limit, parameters=WIDE, holds=within([0.05, 0.1, 0.15, 0.19]))
    one_line(caught, "and all others allow v = [", "but holds() says otherwise, at nu = [")
    with pytest.raises(CheckFailed) as caught:
        check_limit(limit, parameters=WIDE, holds=lambda v, nu: True)
    one_line(caught, "refuses v = [")


PLAIN = Task(name="plain", eta=ETA, sigma=ETA[:2], kinematics="vehicle")
KNOB = ca.SX.sym("knob")


@pytest.mark.parametrize(
    ("check", "says"),
    [
        (lambda: check_task(PLAIN, samples=0), "samples = 0"),
        (lambda: check_task(PLAIN, near=[[0.0, 0.0]]), r"near\[0\]"),
        (lambda: check_task("plain"), "neither a Task nor a SetTask"),
        (lambda: check_task(PLAIN, parameters=[(KNOB, 0.0)]), "lowest, highest"),
        (lambda: check_task(PLAIN, parameters=[(KNOB, "a", "b")]), "parameter knob"),
        (lambda: check_task(PLAIN, parameters=[(KNOB, 0, 1), (KNOB, 0, 1)]), "knob: has two ranges"),
        (lambda: check_limit(VelocityBox([-1] * 4, [1] * 4), samples=0), "samples = 0"),
        (lambda: check_limit(VelocityBox([-1] * 4, [1] * 4), velocity=math.nan), "velocity = nan"),
    ],
)
def test_a_check_of_nothing_is_refused(check, says):
    with pytest.raises(InputError, match=says):
        check()


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (3, "is a int without rows"),
        (Rows(1, 2), "a row that is a int"),
        (Rows(LimitRow("own", "actuator", None, ca.SX(-1), ca.SX(1))), "a is a NoneType, not SX"),
    ],
)
def test_what_is_no_limit_at_all_is_a_finding(limit, says):
    with pytest.raises(CheckFailed, match=says):
        check_limit(limit)
