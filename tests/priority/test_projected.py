"""The projected mode: exact when nothing binds, limited where it must be, and never without an answer."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from surctl.errors import InputError
from surctl.priority import Level, PriorityProblem, Row, build_problem, nsb, solve
from tests.oracles.priority_draws import draw_levels, draw_problem, wide

N = 4
reference = partial(solve, backend="daqp")  # the problems have many shapes, and each would be compiled

both = pytest.mark.parametrize("backend", ["daqp", "osqp"])
E = np.eye(N)


def box(half, **rows):
    made = [Row(f"box.{axis}", "actuator", E[i], -half, half) for i, axis in enumerate("uvwr")]
    return made + [Row(name, *row) for name, row in rows.items()]


def worst_miss(rows, v):
    """Largest violation of the rows as given, each divided by its length."""
    return max(max(r.lower - r.a @ v, r.a @ v - r.upper) / np.linalg.norm(r.a) for r in rows)


@both
@given(st.integers(0, 2**32 - 1))
def test_it_is_nsb_when_nothing_binds(backend, seed):
    problem = wide(draw_levels(np.random.default_rng(seed), conditioned=True))
    got, want = solve(problem, backend=backend), nsb(problem)
    assert np.abs(got.v - want).max() <= 1e-8 * (1 + np.abs(want).max())
    assert (got.binding, got.relaxed, got.status) == ((), {}, "optimal")


@pytest.mark.parametrize(("backend", "count", "certified"), [("daqp", 40, 1.0), ("osqp", 20, 0.9)])
def test_every_tick_has_an_answer_that_stands_without_the_solver(backend, count, certified):
    rng, stands, seen = np.random.default_rng(17), 0, set()
    for _ in range(count):
        problem = draw_problem(rng)
        got = solve(problem, backend=backend)
        assert np.isfinite(got.v).all()
        assert worst_miss([r for r in problem.rows if r.kind == "actuator"], got.v) <= 1e-7
        assert (worst_miss(problem.rows, got.v) <= 1e-7) == (got.relaxed == {})
        assert (got.relaxed == {}) == (got.status in ("optimal", "limited"))
        assert got.explain()
        seen.add(got.status)
        assert got.status != "clamped"  # the actuator rows of these problems agree
        stands += got.is_optimal(problem, 1e-6)
    assert stands >= certified * count
    assert seen == {"optimal", "limited", "relaxed"}


def test_backends_agree_where_rows_are_consistent():
    rng, compared = np.random.default_rng(4), 0
    for _ in range(30):
        problem = draw_problem(rng)
        one, other = (solve(problem, backend=b) for b in ("daqp", "osqp"))
        if one.status == other.status == "optimal":
            compared += 1
            assert np.abs(one.v - other.v).max() < 1e-6
    assert compared > 3


def test_the_first_task_is_served_as_well_as_the_box_allows():
    rng = np.random.default_rng(2)
    for _ in range(40):
        first = Level("first", rng.normal(size=(2, N)), 3 * rng.normal(size=2))
        problem = build_problem([first, Level("second", rng.normal(size=(2, N)), rng.normal(size=2))], box(0.5))
        best = lsq_linear(first.J, first.x, bounds=(-0.5, 0.5), tol=1e-14)
        assert reference(problem).residuals["first"] == pytest.approx(np.sqrt(2 * best.cost), abs=1e-7)


def test_a_limited_first_task_names_the_row_and_leaves_the_rest_alone():
    first, second = Level("surge", E[:1], np.array([1.0])), Level("depth", E[2:3], np.array([0.1]))
    got = reference(build_problem([first, second], box(0.22)))
    assert np.allclose(got.v, [0.22, 0, 0.1, 0], atol=1e-9)
    assert got.status == "limited"
    assert [name for name, _ in got.binding] == ["box.u"]
    assert got.explain() == "Task `surge` gave up 0.78 because `box.u` binds."


def test_a_lower_task_pays_for_a_barrier():
    first, second = Level("depth", E[2:3], np.array([0.1])), Level("surge", E[:1], np.array([0.2]))
    got = reference(build_problem([first, second], box(0.22, wall=("barrier", E[0], -np.inf, 0.05))))
    assert np.allclose(got.v, [0.05, 0, 0.1, 0], atol=1e-9)
    assert got.status == "optimal"
    ((name, multiplier),) = got.binding
    assert (name, multiplier) == ("wall", pytest.approx(0.15, abs=1e-9))
    assert "`surge` gave up 0.15 because `wall` binds" in got.explain()


def test_contradicting_barriers_give_way_by_the_least_and_the_box_does_not():
    level = Level("surge", E[:1], np.array([0.2]))
    rows = box(0.22, ahead=("barrier", E[0], -np.inf, -0.1), behind=("barrier", -2 * E[0], -np.inf, -0.2))
    got = reference(build_problem([level], rows))  # u ≤ −0.1 and u ≥ 0.1: both give 0.1
    assert np.allclose(got.v, 0.0, atol=1e-8)
    assert got.status == "relaxed"
    assert got.relaxed == {"ahead": pytest.approx(0.1, abs=1e-7), "behind": pytest.approx(0.2, abs=1e-7)}
    assert "least violation" in got.explain()
    assert "`ahead` by 0.1" in got.explain()
    outside = reference(build_problem([level], box(0.22, far=("barrier", E[0], 0.5, np.inf))))
    assert outside.v[0] == pytest.approx(0.22, abs=1e-8)
    assert outside.v[0] <= 0.22


@pytest.mark.parametrize("backend", [None, "daqp"])
def test_sets_and_barriers_give_way_together(backend):
    level = Level("surge", E[:1], np.array([0.0]))
    rows = box(1.0, wall=("barrier", E[0], -np.inf, 0.1), wish=("set", 2 * E[0], 0.6, 0.8))
    got = solve(build_problem([level], rows), backend=backend)
    assert got.v[0] == pytest.approx(0.2, abs=1e-8)
    assert dict(got.relaxed) == {"wall": pytest.approx(0.1, abs=1e-7), "wish": pytest.approx(0.2, abs=1e-7)}
    assert got.conflict == ("wall", "wish") and got.status == "relaxed"


def test_a_first_task_that_is_switched_off_or_out_of_reach():
    off = Level("off", np.zeros((1, N)), np.array([3.0]))
    surge = Level("surge", E[:1], np.array([1.0]))
    assert np.allclose(reference(build_problem([off, surge], box(0.2))).v, [0.2, 0, 0, 0], atol=1e-9)
    torn = Level("torn", np.vstack([E[0], E[0]]), np.array([0.1, 0.3]))
    got = reference(build_problem([torn, Level("sway", E[1:2], np.array([9.0]))], box(0.25)))
    assert np.allclose(got.v, [0.2, 0.25, 0, 0], atol=1e-9)
    assert got.status == "optimal"


def test_it_is_continuous_through_the_point_where_the_first_task_becomes_unreachable():
    def v(speed):
        levels_ = [
            Level("a", np.array([[1.0, 1.0, 0, 0]]), np.array([speed])),
            Level("b", E[:2], np.array([0.3, 0.1])),
        ]
        return reference(build_problem(levels_, box(0.22))).v

    path = np.array([v(s) for s in np.linspace(0.40, 0.48, 101)])
    assert np.abs(np.diff(path, axis=0)).max() < 8e-4 * 1.5


def test_is_optimal_refuses_what_is_not():
    rng = np.random.default_rng(8)
    refused = 0
    for _ in range(30):
        problem = draw_problem(rng)
        got = reference(problem)
        moved = replace(got, v=got.v + 1e-3 * rng.normal(size=N))
        refused += not moved.is_optimal(problem, 1e-6)
    assert refused == 30


def test_a_nan_that_slipped_past_the_gate_never_becomes_a_command():
    for mode in ("projected", "nsb"):
        broken = PriorityProblem((Level("t", np.full((2, N), np.nan), np.ones(2)),), tuple(box(0.2)))
        got = reference(broken, mode=mode)
        assert np.array_equal(got.v, np.zeros(N))
        assert got.status == "clamped"
        assert not got.is_optimal(broken)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-200, 1e-12, 1e12, 1e150, 1e300]))
def test_numbers_of_any_size_give_a_finite_answer_inside_the_box(seed, scale):
    rng = np.random.default_rng(seed)
    made = [Level(lv.name, lv.J, lv.x * scale) for lv in draw_levels(rng)]
    problem = build_problem(made, box(0.3))
    for mode in ("projected", "nsb"):
        assert np.isfinite(reference(problem, mode=mode).v).all()
    assert np.abs(reference(problem).v).max() <= 0.3
    tall = build_problem([Level(lv.name, lv.J * scale, lv.x) for lv in made], box(0.3))
    assert np.abs(reference(tall).v).max() <= 0.3


def test_actuator_rows_that_contradict_each_other_still_give_an_answer():
    rows = box(0.2, other=("actuator", E[0] + E[1], 1.0, np.inf))
    got = reference(build_problem([Level("surge", E[:1], np.array([1.0]))], rows))
    assert got.status == "clamped"
    assert np.abs(got.v).max() <= 0.2
    assert got.relaxed["other"] >= 0.6 - 1e-9


def test_mode_nsb_knows_no_rows_and_says_so():
    problem = build_problem([Level("surge", E[:1], np.array([1.0]))], box(0.22))
    got = reference(problem, mode="nsb")
    assert np.allclose(got.v, [1, 0, 0, 0])
    assert got.relaxed == {"box.u": pytest.approx(0.78)}
    assert "ignores limits" in got.explain()
    assert got.is_optimal(problem, 1e-9)


def test_without_rows_it_is_nsb():
    problem = build_problem(draw_levels(np.random.default_rng(0)))
    assert np.allclose(reference(problem).v, nsb(problem), atol=1e-12)
    assert reference(problem).explain() == "No limit binds: v is the null-space-based law."


def test_unknown_mode_and_backend_name_the_nearest():
    problem = build_problem([Level("surge", E[:1], np.array([1.0]))])
    with pytest.raises(InputError, match="did you mean 'projected'"):
        reference(problem, mode="projektd")
    with pytest.raises(InputError, match="did you mean 'osqp'"):
        solve(problem, backend="osqb")
