"""Set-based tasks as rows and as levels, limits on rates, units, and stacks that hold both kinds of task."""

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.tasks import (
    RateLimit,
    SetTask,
    Stack,
    Task,
    ThrustLimit,
    VelocityBox,
    clearance_task,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)
from tests.tasks.numbers import function, rows_at

ETA = ca.SX.sym("eta", 4)


def slab_at(task, eta):
    lower, upper = task.slab()
    return (np.array(function(part, ETA)(eta)).reshape(-1) for part in (lower, upper))


def test_the_slab_is_the_gain_times_the_way_to_each_bound():
    task = SetTask(
        name="keep",
        eta=ETA,
        sigma=ETA[:2],
        lower=[-1, -math.inf],
        upper=2.0,
        rate=[0.1, 0],
        gain=[0.5, 2],
        kinematics="vehicle",
    )
    lower, upper = slab_at(task, [0.4, 3.0, 0, 0])
    assert np.allclose(lower, [0.1 + 0.5 * -1.4, -math.inf])
    assert np.allclose(upper, [0.1 + 0.5 * 1.6, 2 * -1.0])
    rows = rows_at(task, [ETA], [[0.4, 3.0, 0, 0.3]])
    assert [(r.name, r.kind) for r in rows] == [("keep.set0", "set"), ("keep.set1", "set")]
    assert np.allclose([r.lower for r in rows], lower)
    assert np.allclose([r.upper for r in rows], upper)
    assert np.allclose([r.a for r in rows], np.array(function(task.jacobian(), ETA)([0.4, 3.0, 0, 0.3])))


def test_a_velocity_inside_the_slab_keeps_the_set():
    """σ̇ at either bound of the slab, in steps with gain·dt ≤ 1: σ comes in from outside, and never leaves."""
    z, dt, gain = ETA[2], 0.1, 2.0
    task = SetTask(name="band", eta=ETA, sigma=z, lower=-0.5, upper=-0.1, gain=gain, kinematics="vehicle")
    rng = np.random.default_rng(0)
    for start in (-2.0, -0.3, 1.0):
        at = start
        for k in range(100):
            (lower,), (upper,) = slab_at(task, [0, 0, at, 0])
            at += dt * rng.choice([lower, upper])
            assert k < 60 or -0.5 - 1e-4 <= at <= -0.1 + 1e-4
            assert not -0.5 <= start <= -0.1 or -0.5 - 1e-12 <= at <= -0.1 + 1e-12


@given(st.floats(-3.1, 3.1), st.floats(0.01, 3.0), st.floats(-20, 20), st.integers(-3, 3))
def test_an_angle_is_kept_in_its_arc_by_the_short_way(middle, half, psi, turns):
    task = SetTask(
        name="look",
        eta=ETA,
        sigma=ETA[3],
        lower=middle - half,
        upper=middle + half,
        angular=True,
        unit="rad",
        kinematics="vehicle",
    )
    (lower,), (upper,) = slab_at(task, [0, 0, 0, psi])
    away = math.remainder(middle - psi, 2 * math.pi)
    assert upper - lower == pytest.approx(2 * half)
    if abs(abs(away) - math.pi) > 1e-6:
        assert (lower + upper) / 2 == pytest.approx(away, abs=1e-9)
        assert np.allclose(list(slab_at(task, [0, 0, 0, psi + 2 * math.pi * turns])), [[lower], [upper]], atol=1e-9)


def test_the_slab_moves_without_jumps():
    """Along a path through both bounds, v nearest to a wish inside the slab is Lipschitz: no switch, no chatter."""
    task = SetTask(name="band", eta=ETA, sigma=ETA[2], lower=-0.5, upper=-0.1, gain=1.0, kinematics="vehicle")
    lower, upper = (function(part, ETA) for part in task.slab())
    at = np.linspace(-1, 0.5, 3001)
    v = np.array([np.clip(0.05, float(lower([0, 0, z, 0])), float(upper([0, 0, z, 0]))) for z in at])
    assert np.abs(np.diff(v) / np.diff(at)).max() <= 1 + 1e-9


def test_split_gives_the_same_rows():
    task = SetTask(
        name="keep",
        eta=ETA,
        sigma=ETA[:2],
        lower=[-1, -2],
        upper=[2.0, 3.0],
        rate=0.1,
        gain=[0.5, 2],
        kinematics="vehicle",
    )
    eta = [0.4, 3.0, 0, 0.7]
    whole = rows_at(task, [ETA], [eta])
    parts = [rows_at(part, [ETA], [eta])[0] for part in task.split()]
    assert [p.name for p in task.split()] == ["keep0", "keep1"]
    for a, b in zip(whole, parts, strict=True):
        assert (a.lower, a.upper, list(a.a)) == (b.lower, b.upper, list(b.a))
    one = task.split()[0]
    assert one.split()[0] is one


def test_a_stack_holds_both_kinds():
    band = SetTask(name="band", eta=ETA, sigma=ETA[2], lower=-0.5, upper=-0.1, kinematics="vehicle")
    go = position_task(ETA, [1.0, 2.0])
    stack = Stack((band, go))
    assert stack.names == ("band", "position")
    (J, lower, upper), (_, at_least, at_most) = stack.slabs()
    assert J.shape == (1, 4)
    assert lower.shape == upper.shape == (1, 1)
    pose = [0, 0, -0.2, 0.4]
    assert [float(function(part, ETA)(pose)) for part in (lower, upper)] == pytest.approx([-0.3, 0.1])
    assert ca.is_equal(at_least, at_most)
    values = [np.array(function(part, ETA)([0, 0, -0.3, 0.4])) for part in (at_least, go.reference())]
    assert np.array_equal(*values)
    with pytest.raises(InputError, match="task band: is set-based"):
        stack.levels()
    assert len(Stack((go,)).levels()) == 1
    with pytest.raises(InputError, match="'band': names both task 1 and task 2"):
        Stack((band, depth_task(ETA, 0.0, name="band")))


def test_rate_limit():
    rows = rows_at(RateLimit(depth_task(ETA, -0.15), 0.05, kind="actuator"), [ETA], [[0, 0, 0, 1.0]])
    assert [(r.name, r.kind, r.lower, r.upper) for r in rows] == [("depth.rate", "actuator", -0.05, 0.05)]
    task = position_task(ETA, [1.0, 2.0])
    rows = rows_at(RateLimit(task, [0.1, 0.2]), [ETA], [[0, 0, 0, 1.0]])
    assert [(r.name, r.kind, r.upper) for r in rows] == [("position.rate0", "set", 0.1), ("position.rate1", "set", 0.2)]
    assert np.allclose([r.a for r in rows], np.array(function(task.jacobian(), ETA)([0, 0, 0, 1.0])))
    symbol = ca.SX.sym("fastest")
    rows = rows_at(RateLimit(task, symbol), [ETA, symbol], [[0, 0, 0, 1.0], 0.3])
    assert [r.upper for r in rows] == [0.3, 0.3]


def test_units():
    tasks = [
        position_task(ETA, [1.0, 2.0]),
        depth_task(ETA, 0.0),
        velocity_task(ETA, [0.0, 0.1]),
        clearance_task(ETA, [1.0, 2.0], margin=0.1),
        distance_task(ETA, [1.0, 2.0], distance=0.1),
    ]
    assert {t.unit for t in tasks} == {"m"}
    assert heading_task(ETA, 0.0).unit == line_of_sight_task(ETA, [1.0, 2.0]).unit == "rad"
    assert Task(name="own", eta=ETA, sigma=ETA[0], kinematics="vehicle").unit == ""
    with pytest.raises(InputError, match="task own: unit"):
        Task(name="own", eta=ETA, sigma=ETA[0], unit=3, kinematics="vehicle")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"lower": 1.0, "upper": 0.0}, "task keep: row 0 = [1.0, 0.0]: allows no value"),
        ({"lower": [0, 3]}, "task keep: row 1"),
        ({"lower": math.nan}, "task keep: lower = nan: is not a number"),
        ({"lower": math.inf, "upper": math.inf}, "allows no value"),
        ({"lower": [1.0, 2.0, 3.0]}, "task keep: lower = [1.0, 2.0, 3.0]: has the wrong shape; give 1 or 2 entries"),
        ({"upper": "far"}, "task keep: upper"),
        ({"angular": True, "lower": -4, "upper": 4}, "is not an arc"),
        ({"angular": True, "lower": -math.inf}, "is not an arc"),
        ({"name": "two words"}, "two words"),
        ({"gain": 0.0}, "task keep: gain"),
        ({"rate": math.inf}, "task keep: rate"),
        ({"sigma": ca.SX.sym("other", 2)}, "does not depend on eta"),
    ],
)
def test_bad_sets_are_refused_by_name(change, says):
    good = {"name": "keep", "eta": ETA, "kinematics": "vehicle", "sigma": ETA[:2], "lower": -1.0, "upper": 2.0}
    with pytest.raises(InputError) as caught:
        SetTask(**(good | change))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("limit", "kind", "says"),
    [(-1.0, "set", "depth.rate: limit = -1.0"), ([1, 2, 3], "set", "depth.rate: limit"), (1.0, "sets", "depth.rate")],
)
def test_bad_rate_limits_are_refused_by_name(limit, kind, says):
    with pytest.raises(InputError) as caught:
        RateLimit(depth_task(ETA, 0.0), limit, kind=kind)
    assert says in str(caught.value)


@pytest.mark.parametrize("sigma", [None, "x", ca.MX.sym("x")])
@pytest.mark.parametrize(("kind", "bounds"), [(Task, {}), (SetTask, {"lower": 0.0, "upper": 1.0})])
def test_what_is_no_expression_is_refused_by_name(kind, bounds, sigma):
    with pytest.raises(InputError, match="task odd: sigma"):
        kind(name="odd", eta=ETA, sigma=sigma, kinematics="vehicle", **bounds)


@pytest.mark.parametrize("mass", [None, "heavy", [[1, 2], [3]]])
def test_a_mass_that_is_no_number_is_refused_by_name(mass):
    with pytest.raises(InputError, match="limit thrust: mass"):
        ThrustLimit([0] * 4, mass, load=[0] * 4, lower=[-1] * 4, upper=[1] * 4, dt=0.1)


def test_a_kind_that_is_no_text_is_refused_by_name():
    with pytest.raises(InputError, match="limit velocity = 3"):
        VelocityBox([-1] * 4, [1] * 4, kind=3)
