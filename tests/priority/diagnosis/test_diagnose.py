"""Diagnosis of stacks whose answers are known by hand."""

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.priority import Level, build_problem, nsb
from surctl.priority.diagnosis import commutator_norms, diagnose
from surctl.priority.diagnosis.laws import strict_velocities
from surctl.tasks import (
    Stack,
    Task,
    clearance_task,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)

ETA = ca.SX.sym("eta", 4)
POINT, OTHER = ca.SX.sym("point", 2), ca.SX.sym("other", 2)
REGION = ([-2.0, -2.0, -1.0, -3.0], [2.0, 2.0, 0.0, 3.0])
BOTH = [(POINT, -1.0, 1.0), (OTHER, [-1.0, -1.0], [1.0, 1.0])]

DEPTH, HEADING = depth_task(ETA, -0.15), heading_task(ETA, 0.4)
POSITION, VELOCITY = position_task(ETA, [1.0, 2.0]), velocity_task(ETA, [0.1, 0.05])
SPACE = position_task(ETA, [1.0, 2.0, -0.3], name="space")
DISTANCE = distance_task(ETA, POINT, distance=0.5)
SAME = distance_task(ETA, POINT, distance=0.5, name="same")
FAR = distance_task(ETA, OTHER, distance=1.0, name="far")
SIGHT = line_of_sight_task(ETA, POINT)
MIXED = Task(name="mixed", eta=ETA, sigma=ETA[0] + ETA[1] + ETA[3], kinematics="vehicle")


def look(*tasks, region=REGION, parameters=BOTH, **settings):
    return diagnose(Stack(tasks), region, parameters=parameters, **{"samples": 64, **settings})


def at(stack, pose):
    """Jacobians and references at a pose that a diagnosis gave."""
    symbols = ca.vertcat(ETA, POINT, OTHER)
    f = ca.Function("f", [symbols], [part for pair in stack.levels() for part in pair])
    values = [np.array(v) for v in f([*(pose[n] for n in ("x", "y", "z", "psi")), *(pose.get(n, 0.0) for n in OPEN)])]
    return values[::2], [x.ravel() for x in values[1::2]]


OPEN = ("point_0", "point_1", "other_0", "other_1")


def test_selections_of_degrees_of_freedom_are_equal_everywhere_as_expressions():
    found = look(DEPTH, HEADING, POSITION)
    assert (found.equality.verdict, found.equality.where) == ("everywhere", None)
    assert found.equality.largest < 1e-12
    assert {p.kind for p in found.pairs} == {"orthogonal"}
    assert found.singularities == ()
    assert [(lv.rank, lv.gained, lv.met) for lv in found.levels] == [
        (1, 1, "by both laws"),
        (1, 1, "by both laws"),
        (2, 2, "by both laws"),
    ]
    assert "NSB equals strict priority everywhere" in str(found)


def test_a_line_of_sight_and_a_position_differ_and_the_pose_shows_it():
    found = look(SIGHT, POSITION)
    assert (found.equality.verdict, found.equality.task) == ("differs", "position")
    pose = found.equality.where
    # the row (t/d, -1) and the plane of x and y meet at atan d; sin cos is largest at d = 1
    distance = math.hypot(pose["x"] - pose["point_0"], pose["y"] - pose["point_1"])
    assert found.equality.largest == pytest.approx(0.5, abs=1e-9)
    assert distance == pytest.approx(1.0, abs=1e-3)
    jacobians, x = at(Stack((SIGHT, POSITION)), pose)
    assert commutator_norms(jacobians)[1] == pytest.approx(found.equality.largest)
    made = [Level(n, J, b) for n, J, b in zip(("a", "b"), jacobians, x, strict=True)]
    assert np.abs(nsb(build_problem(made)) - strict_velocities(jacobians, x)).max() > 0.01
    assert found.levels[1].met == "by strict priority only"
    assert "NSB differs from strict priority at `position`" in found.explain()


def test_the_angle_of_a_coupled_pair_runs_over_what_geometry_says():
    region = ([1.0, -0.5, -1.0, -3.0], [2.0, 0.5, 0.0, 3.0])  # 1 to 2.06 m from the origin
    found = look(SIGHT, POSITION, region=region, parameters=[(POINT, 0.0, 0.0)], samples=1024)
    (pair,) = found.pairs
    assert pair.kind == "coupled"
    assert pair.smallest == pytest.approx(math.atan(1.0), abs=1e-9)
    assert pair.largest == pytest.approx(math.atan(math.hypot(2.0, 0.5)), abs=2e-2)
    assert (pair.where["x"], pair.where["y"]) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert found.singularities == ()
    assert "`line_of_sight` and `position` are coupled: angle between 45° and" in str(found)


def test_a_distance_lies_inside_a_position_and_commutes_with_it():
    for tasks in ((DISTANCE, POSITION), (POSITION, DISTANCE)):
        found = look(*tasks)
        assert found.equality.verdict == "on all samples"
        (pair,) = found.pairs
        assert pair.kind == "dependent everywhere"
        lower = found.levels[1]
        assert lower.rank - lower.gained == 1 and lower.met == "by neither law" and lower.strict[0] > 0.1


def test_what_only_samples_show_is_not_called_a_proof():
    found = look(DISTANCE, SIGHT)  # orthogonal by n·t = 0, which no simplification sees
    assert found.equality.verdict == "on all samples"
    assert found.equality.largest < 1e-12
    assert found.pairs[0].kind == "orthogonal"
    assert "which is not a proof" in str(found)


def test_a_doubled_task_is_dependent_and_met_only_when_it_agrees():
    found = look(DISTANCE, SAME)
    assert found.pairs[0].kind == "dependent everywhere"
    assert (found.levels[1].gained, found.levels[1].rank, found.levels[1].met) == (0, 1, "by both laws")
    against = look(DISTANCE, distance_task(ETA, POINT, distance=0.7, name="against"))
    assert against.levels[1].met == "by neither law"
    assert against.levels[1].strict[0] == pytest.approx(0.2)
    assert "`against` is met by neither law: strict priority leaves 0.2 (median)" in str(against)


def test_five_rows_in_four_velocities_leave_no_freedom():
    found = look(SPACE, HEADING, FAR)
    assert [lv.gained for lv in found.levels] == [3, 1, 0]
    assert "it shares 1 of 1 directions with the tasks above it" in str(found)


def test_the_clearances_of_the_paper_against_a_velocity():
    one, two = clearance_task(ETA, POINT, margin=0.5, name="one"), clearance_task(ETA, OTHER, margin=0.5, name="two")
    alone = look(one, VELOCITY)
    assert alone.equality.verdict == "on all samples"
    assert alone.levels[1].rank - alone.levels[1].gained == 1
    found = look(one, two, VELOCITY)
    assert (found.equality.verdict, found.equality.task) == ("differs", "two")
    assert found.levels[1].met == "by strict priority only"
    assert found.levels[2].gained == 0 and found.levels[2].met == "by neither law"


def test_two_distances_lose_a_direction_on_the_line_through_their_points():
    near, far = distance_task(ETA, [-1.0, 0.5], distance=0.4), distance_task(ETA, [1.0, 0.5], distance=0.4, name="far")
    region = ([-0.6, -2.0, -1.0, -3.0], [0.6, 2.0, 0.0, 3.0])
    found = look(near, far, region=region, parameters=())
    (singular,) = found.singularities
    assert (singular.task, singular.kind) == ("far", "algorithmic")
    assert singular.value < 1e-8 and singular.also_singular == ()
    assert singular.where["y"] == pytest.approx(0.5, abs=1e-6)
    assert found.pairs[0].kind == "dependent somewhere"
    off = look(near, far, region=([-0.6, 0.8, -1.0, -3.0], [0.6, 2.0, 0.0, 3.0]), parameters=())
    assert off.singularities == () and off.pairs[0].kind == "coupled"


def test_a_task_on_its_own_point_is_told_apart_from_the_conflict_it_causes():
    found = look(SIGHT, POSITION, parameters=[(POINT, [0.3, -0.2], [0.3, -0.2])])
    own, caused = found.singularities
    assert (own.task, own.kind) == ("line_of_sight", "kinematic")
    assert (caused.task, caused.kind, caused.also_singular) == ("position", "algorithmic", ("line_of_sight",))
    for pose in (own.where, caused.where):
        assert (pose["x"], pose["y"]) == pytest.approx((0.3, -0.2), abs=1e-3)
    assert "where `line_of_sight` is singular itself" in str(found)


def test_a_search_comes_as_near_to_a_singular_point_as_the_task_lets_it():
    (singular,) = look(DISTANCE).singularities  # the gradient is of length 1 until 1e-6 m
    pose = singular.where
    assert singular.kind == "kinematic" and singular.value < 1e-5
    assert math.hypot(pose["x"] - pose["point_0"], pose["y"] - pose["point_1"]) < 1e-3


def test_a_task_singular_by_itself_is_not_blamed_on_those_above():
    (singular,) = look(POSITION, SIGHT).singularities
    assert (singular.task, singular.kind) == ("line_of_sight", "kinematic")


def test_a_jacobian_that_loses_rank_is_kinematic_even_below_other_tasks():
    folded = Task(name="folded", eta=ETA, sigma=ca.vertcat(ETA[0] + ETA[1], ETA[0] + ETA[1] ** 2), kinematics="vehicle")
    found = look(DEPTH, folded, parameters=())  # rows (1, 1) and (1, 2y): parallel at y = 0.5
    (singular,) = found.singularities
    assert (singular.task, singular.kind) == ("folded", "kinematic")
    assert singular.where["y"] == pytest.approx(0.5, abs=1e-3)


def test_an_inactive_task_is_not_singular():
    switched = Task(name="switched", eta=ETA, sigma=ca.fmax(ETA[0], 0.0), kinematics="vehicle")
    for above in (POSITION, MIXED):
        assert look(above, switched, parameters=()).singularities == ()
    off = look(POSITION, switched, region=([-2, -2, -1, -3], [-1, 2, 0, 3]), parameters=())
    assert off.pairs[0].kind == "never active together" and off.pairs[0].smallest is None
    assert off.levels[1].rank == 0
    assert "`switched`" in str(off) and "inactive at all samples" in str(off)


def test_a_task_met_at_some_samples_only_is_not_met():
    switched = Task(name="switched", eta=ETA, sigma=ca.fmax(ETA[0], 0.0), target=1.0, kinematics="vehicle")
    (level,) = look(switched, parameters=()).levels
    assert level.met == "by neither law"
    assert level.strict[1] == pytest.approx(1.0)


def test_one_task_is_trivially_equal_and_a_fixed_pose_is_one_sample():
    found = look(HEADING, region=([0, 0, 0, 1.0], [0, 0, 0, 1.0]), parameters=())
    assert (found.samples, found.equality.verdict, found.pairs) == (1, "everywhere", ())
    assert "NSB equals strict priority everywhere." in str(found)


def test_the_same_seed_gives_the_same_diagnosis():
    first, second, other = (look(SIGHT, POSITION, samples=6, seed=seed) for seed in (0, 0, 1))
    assert first == second
    assert first.levels != other.levels


def test_an_arm_is_diagnosed_in_its_own_joints():
    q = ca.SX.sym("q", 2)
    tip = ca.vertcat(ca.cos(q[0]) + ca.cos(q[0] + q[1]), ca.sin(q[0]) + ca.sin(q[0] + q[1]))
    reach = Task(name="reach", eta=q, sigma=tip, target=[0.5, 0.5])
    home = Task(name="home", eta=q, sigma=q, target=[0.0, 0.5])
    found = diagnose(Stack((reach, home)), ([-3.0, -1.0], [3.0, 2.0]), samples=64)
    (stretched,) = found.singularities
    assert (stretched.task, stretched.kind) == ("reach", "kinematic")
    assert stretched.where["q_1"] == pytest.approx(0.0, abs=1e-4)
    assert found.levels[1].gained == 0


@pytest.mark.parametrize(
    ("region", "message"),
    [
        (([0.0] * 3, [1.0] * 4), "eta.*needs finite ranges of 1 or 4 entries"),
        (([0.0, 0, 0, 2.0], [1.0, 1, 1, 1.0]), "eta = .*has no value in its range"),
        (([0.0, math.nan, 0, 0], [1.0] * 4), "eta = .*needs finite ranges"),
        (([0.0] * 4, [1.0, 1, math.inf, 1]), "eta = .*needs finite ranges"),
        (0.0, "region = 0.0: is not .lower, upper."),
        ((["a"] * 4, [1.0] * 4), "has a range that is not numeric"),
    ],
)
def test_a_bad_region_names_the_axis(region, message):
    with pytest.raises(InputError, match=message):
        look(DEPTH, region=region)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ([], "task line_of_sight: contains the symbol point_0, which has no range"),
        ([(POINT[0], 0.0, 1.0)], "task line_of_sight: contains the symbol point_1"),
        ([(POINT, 1.0, 0.0)], "parameter point = .*has no value in its range"),
        ([(POINT, [0.0, math.nan], 1.0)], "parameter point = .*needs finite ranges"),
        ([(POINT, [0.0, 0.0, 0.0], 1.0)], "point = .*needs finite ranges of 1 or 2 entries"),
        ([(POINT, 0.0, 1.0), (POINT[1], 0.0, 1.0)], "has two ranges"),
        ([(POINT, 0.0, 1.0), (ETA, 0.0, 1.0)], "has two ranges"),
        ([(POINT + 1.0, 0.0, 1.0)], "is not an SX symbol"),
        ([(POINT, 1.0)], "is not .symbol, lowest, highest."),
    ],
)
def test_a_bad_parameter_is_named(parameters, message):
    with pytest.raises(InputError, match=message):
        look(SIGHT, parameters=parameters)


def test_bad_numbers_and_tasks_that_are_not_finite_are_refused():
    for bad in (
        {"samples": 0},
        {"samples": 2.5},
        {"starts": 0},
        {"threshold": 0.0},
        {"threshold": math.nan},
        {"threshold": "x"},
        {"seed": -1},
        {"seed": "x"},
        {"seed": None},
    ):
        with pytest.raises(InputError, match=next(iter(bad))):
            look(DEPTH, **bad)
    with pytest.raises(InputError, match=r"task root: is not finite at x = -"):
        look(Task(name="root", eta=ETA, sigma=ca.sqrt(ETA[0]), kinematics="vehicle"), parameters=())
