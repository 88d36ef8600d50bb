"""The law (16): printed, as a sweep, and as one symbolic expression."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.priority import Level, build_problem, nsb, nsb_sweep, nsb_symbolic
from surctl.tasks import (
    Stack,
    depth_task,
    distance_task,
    heading_task,
    line_of_sight_task,
    position_task,
    velocity_task,
)
from tests.oracles.priority_draws import draw_levels
from tests.oracles.priority_references import printed_law, svd_cascade

N = 4
seeds = st.integers(0, 2**32 - 1)


def size(made):
    return 1.0 + sum(np.linalg.norm(np.linalg.pinv(lv.J, rcond=1e-10) @ lv.x) for lv in made)


@given(seeds)
def test_nsb_equals_the_sweep_and_the_printed_formula(seed):
    made = draw_levels(np.random.default_rng(seed), most=8, conditioned=True)
    v = nsb(build_problem(made))
    assert np.abs(v - printed_law(made)).max() <= 1e-12 * size(made)
    assert np.abs(v - nsb_sweep(made, start=np.zeros(N))).max() <= 1e-12 * size(made)


def test_noise_in_a_deficient_jacobian_is_not_inverted():
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(60):
        J = rng.normal(size=(3, 1)) @ rng.normal(size=(1, N))  # rank 1, singular values 2 and 3 near 1e-17
        worst = max(worst, np.abs(nsb(build_problem([Level("t", J, J @ np.ones(N))]))).max())
    assert worst < 10


def evaluate(made, *, damping=0.0):
    symbols = [(ca.SX.sym("J", *lv.J.shape), ca.SX.sym("x", lv.x.size)) for lv in made]
    flat = [part for pair in symbols for part in pair]
    f = ca.Function("f", flat, [nsb_symbolic(symbols, damping=damping)])
    return np.array(f(*[part for lv in made for part in (lv.J, lv.x)])).ravel()


@settings(max_examples=25)
@given(seeds)
def test_symbolic_equals_numeric_on_conditioned_levels(seed):
    made = draw_levels(np.random.default_rng(seed), conditioned=True, deficient=False)
    v = nsb(build_problem(made))
    assert np.abs(evaluate(made) - v).max() <= 1e-10 * size(made)


@settings(max_examples=15)
@given(seeds)
def test_symbolic_leaves_out_zero_and_doubled_rows(seed):
    rng = np.random.default_rng(seed)
    made = draw_levels(rng, conditioned=True, deficient=False)
    row = rng.normal(size=N)
    odd = Level("odd", np.vstack([np.zeros(N), row, 0.37 * row]), np.array([5.0, 0.3, 9.0]))  # 9.0 is left out
    with_odd = [*made[:1], odd, *made[1:]]
    plain = [*made[:1], Level("odd", row[None], np.array([0.3])), *made[1:]]
    assert np.abs(evaluate(with_odd) - evaluate(plain)).max() <= 1e-10 * size(plain)
    off = [*made, Level("off", np.zeros((2, N)), np.ones(2))]
    assert np.abs(evaluate(off) - evaluate(made)).max() == 0.0


@settings(max_examples=25)
@given(seeds, st.floats(1e-3, 1.0))
def test_damped_form_is_nsb_with_the_damped_inverse_in_both_places(seed, damping):
    made = draw_levels(np.random.default_rng(seed), most=4)
    v = np.zeros(N)
    for level in reversed(made):
        inverse = level.J.T @ np.linalg.inv(level.J @ level.J.T + damping**2 * np.eye(level.x.size))
        v = inverse @ level.x + (np.eye(N) - inverse @ level.J) @ v
    assert np.abs(evaluate(made, damping=damping) - v).max() <= 1e-7 * (1 + np.abs(v).max())


def at(stack, eta):
    f = ca.Function("f", [stack.eta], [part for pair in stack.levels() for part in pair])
    values = [np.array(v) for v in f(eta)]
    return [Level(n, values[2 * i], values[2 * i + 1].ravel()) for i, n in enumerate(stack.names)]


def test_stacks_whose_projectors_commute_equal_strict_priority_and_others_do_not():
    eta = ca.SX.sym("eta", 4)
    depth, heading, plane = depth_task(eta, -0.15), heading_task(eta, 0.4), velocity_task(eta, [0.1, 0.05])
    # a distance commutes with (x, y), whose rows are orthonormal; a line of sight mixes in yaw and does not
    orthogonal = [
        Stack((depth, heading, plane)),
        Stack((plane, depth, heading)),
        Stack((heading, position_task(eta, [1.0, 2.0]), depth)),
    ]
    orthogonal.append(Stack((distance_task(eta, [3.0, 3.0], distance=0.5), plane, depth)))
    mixed = Stack((line_of_sight_task(eta, [3.0, 3.0]), plane, depth))
    rng, apart = np.random.default_rng(5), 0.0
    for _ in range(15):
        pose = rng.uniform(-2, 2, 4)
        for stack in orthogonal:
            made = at(stack, pose)
            v = nsb(build_problem(made))
            assert np.abs(v - svd_cascade(made)).max() < 1e-12
            if stack is not orthogonal[-1]:
                assert max(np.abs(lv.J @ v - lv.x).max() for lv in made) < 1e-12
        made = at(mixed, pose)
        apart = max(apart, np.abs(nsb(build_problem(made)) - svd_cascade(made)).max())
    assert apart > 0.05


def test_symbolic_refuses_bad_shapes():
    J, x = ca.SX.sym("J", 1, 4), ca.SX.sym("x", 1)
    with pytest.raises(InputError, match="level 2"):
        nsb_symbolic([(J, x), (ca.SX.sym("J", 1, 3), x)])
    with pytest.raises(InputError, match="damping"):
        nsb_symbolic([(J, x)], damping=-1.0)
    with pytest.raises(InputError, match="no level"):
        nsb_symbolic([])
