"""The least-distance adapter against an oracle that tries every set of active rows."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.priority import BACKENDS, Level, Row, build_problem, nsb_sweep, solve, solve_least_distance
from surctl.priority.backends import KernelSolution, project, row_space
from tests.oracles.priority_draws import draw_levels, unit

N = 4

each = pytest.mark.parametrize("backend", ["daqp", "osqp"])


def oracle(target, A, upper):
    """min ‖x − target‖ with A x ≤ upper, by enumeration; None when empty."""
    best, where = np.inf, None
    for k in range(min(len(A), N) + 1):
        for active in map(list, itertools.combinations(range(len(A)), k)):
            B = A[active]
            if k and np.linalg.matrix_rank(B) < k:
                continue
            x = target + np.linalg.pinv(B) @ (upper[active] - B @ target) if k else target
            if (A @ x <= upper + 1e-9).all() and np.linalg.norm(x - target) < best:
                best, where = np.linalg.norm(x - target), x
    return where


@each
def test_it_equals_enumeration(backend):
    rng = np.random.default_rng(1)
    empty = 0
    for _ in range(30):
        m = int(rng.integers(1, 7))
        A, upper, target = (
            np.array([unit(rng) for _ in range(m)]),
            rng.normal(size=m) * 0.7,
            rng.normal(size=N),
        )
        if m > 1 and rng.random() < 0.3:
            A[1] = -A[0]
        if m > 2 and rng.random() < 0.3:
            A[2], upper[2] = A[0], upper[0]
        got, want = (
            solve_least_distance(target, A=A, lower=np.full(m, -np.inf), upper=upper, backend=backend),
            oracle(target, A, upper),
        )
        if want is None:
            empty += 1
            assert got.x is None
            continue
        assert got.status == "optimal"
        assert np.abs(got.x - want).max() < 1e-8
        assert np.abs(got.x - target + A.T @ got.multipliers).max() < 1e-7
        assert (got.multipliers >= -1e-9).all()
    assert empty > 0


@each
@settings(max_examples=20, deadline=None)  # the first use of a backend imports it
@given(st.integers(0, 2**32 - 1))
def test_the_qp_is_the_last_projection_of_nsb_when_rows_are_loose(backend, seed):
    made = draw_levels(np.random.default_rng(seed), conditioned=True)
    first, w_2 = made[0], nsb_sweep(made[1:], start=np.zeros(N))
    reachable = first.J @ row_space(first.J).particular(first.x)
    got = solve_least_distance(
        w_2,
        A=np.eye(N),
        lower=np.full(N, -1e6),  # w_2 grows to 1e3 with nearly parallel levels
        upper=np.full(N, 1e6),
        A_eq=first.J,
        b_eq=reachable,
        backend=backend,
    )
    assert np.abs(got.x - project(w_2, first.J, x=first.x)).max() < 1e-8 * (1 + np.abs(w_2).max())


@each
def test_equalities_that_disagree_are_infeasible_and_doubled_ones_are_not(backend):
    row = np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0]])
    box = {"A": np.eye(N), "lower": np.full(N, -1.0), "upper": np.full(N, 1.0), "backend": backend}
    assert solve_least_distance(np.ones(N), A_eq=row, b_eq=np.array([0.1, 0.2]), **box).status == "infeasible"
    doubled = solve_least_distance(np.ones(N), A_eq=row, b_eq=np.array([0.1, 0.1]), **box)
    assert np.allclose(doubled.x, [0.1, 1, 1, 1], atol=1e-9)
    outside = solve_least_distance(np.ones(N), A_eq=row, b_eq=np.array([2.0, 2.0]), **box)
    assert outside.status == "infeasible"


@each
def test_multipliers_are_those_of_the_rows_as_given(backend):
    rng, bound = np.random.default_rng(6), 0
    for _ in range(20):
        A = np.array([unit(rng) * 10.0 ** rng.uniform(-1, 1) for _ in range(3)])
        upper, target, row = 0.1 * np.linalg.norm(A, axis=1), 2 * rng.normal(size=N), rng.normal(size=(1, N))
        got = solve_least_distance(
            target, A=A, lower=np.full(3, -np.inf), upper=upper, A_eq=row, b_eq=np.zeros(1), backend=backend
        )
        force = got.x - target + A.T @ got.multipliers  # what is left is the equality's own
        assert np.linalg.norm(force - row[0] * (row[0] @ force) / (row[0] @ row[0])) < 1e-7
        bound += np.any(got.multipliers > 0)
    assert bound > 5


@each
def test_a_fixed_velocity_and_absent_bounds(backend):
    lower, upper = np.array([0.3, -np.inf, -np.inf, 0.0]), np.array([0.3, np.inf, -0.5, np.inf])
    got = solve_least_distance(np.zeros(N), A=np.eye(N), lower=lower, upper=upper, backend=backend)
    assert np.allclose(got.x, [0.3, 0, -0.5, 0], atol=1e-9)
    assert got.multipliers[0] < 0 < got.multipliers[2]


def test_an_answer_that_does_not_hold_is_not_passed_on():
    from surctl.priority.backends import KernelSolution, _checked

    G, low, high = np.eye(2), np.array([0.5, -1.0]), np.array([1.0, 1.0])
    close = np.full(2, 1e-9)
    lie = KernelSolution(np.array([0.4, np.nan]), np.array([np.nan, 0.0]), 1, "optimal")
    assert _checked(lie, G, low, high, tolerance=close).status == "failed"
    rough = KernelSolution(np.array([0.5 - 1e-6, 1e-6]), np.array([-0.5, 0.0]), 1, "optimal")
    assert np.abs(_checked(rough, G, low, high, tolerance=close).y - [0.5, 0.0]).max() < 1e-15


@each
def test_crossed_bounds_and_a_nan_are_no_answer(backend, capfd):
    G, low, high = np.eye(2), np.array([0.5, -1.0]), np.array([0.4, 1.0])
    assert solve_least_distance(np.ones(2), A=G, lower=low, upper=high, backend=backend).x is None
    for rows in ((G * np.nan, low, high + 1.0), (G, low, high * np.nan)):
        got = solve_least_distance(np.ones(2), A=rows[0], lower=rows[1], upper=rows[2], backend=backend)
        assert got.status == "failed" and got.x is None
    free = {"A": G, "lower": np.full(2, -np.inf), "upper": np.full(2, np.inf), "backend": backend}
    assert solve_least_distance(np.array([1.0, np.nan]), **free).status == "failed"
    assert capfd.readouterr() == ("", "")


def test_the_backends_come_in_order():
    assert list(BACKENDS)[:2] == ["daqp", "osqp"]
    assert "clarabel" in list(BACKENDS)[2:]


def test_an_unknown_backend_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'daqp'"):
        solve_least_distance(np.zeros(1), A=np.eye(1), lower=-np.ones(1), upper=np.ones(1), backend="dakp")


@each
def test_nothing_is_printed(backend, capfd):
    box = {"A": np.eye(N), "lower": np.full(N, -1.0), "upper": np.full(N, 1.0), "backend": backend}
    solve_least_distance(np.zeros(N), **box)
    solve_least_distance(np.full(N, 3.0), **box)
    assert capfd.readouterr() == ("", "")


def test_a_solver_of_qpsolvers_referees():
    assert "clarabel" in BACKENDS  # an interior-point method, unlike the two native ones
    rng = np.random.default_rng(3)
    for _ in range(40):
        A, upper, target = rng.normal(size=(6, N)), rng.uniform(0.1, 1.0, 6), 2 * rng.normal(size=N)
        rows = {"A": A, "lower": np.full(6, -3.0), "upper": upper}
        native = solve_least_distance(target, **rows, backend="daqp")
        referee = solve_least_distance(target, **rows, backend="clarabel")
        assert native.status == referee.status == "optimal"
        assert np.abs(native.x - referee.x).max() < 1e-6  # what its default tolerances give


@pytest.mark.parametrize("backend", ["daqp", "osqp"])
def test_rows_that_contradict_each_other_have_no_answer_for_a_far_target_either(backend):
    across = np.array([[0.6, 0.8, 0.0, 0.0], [-0.6, -0.8, 0.0, 0.0]])
    A = np.vstack([np.eye(4), across])
    lower, upper = np.append(-np.ones(4), [1e-4, 0.0]), np.append(np.ones(4), [2.0, 2.0])
    for size in (1.0, 1e6, 1e8, 1e10, 1e12):
        answer = solve_least_distance(np.full(4, size), A=A, lower=lower, upper=upper, backend=backend)
        assert answer.x is None, (size, answer.status)


def test_a_kernel_that_gives_up_or_lies_is_never_called_optimal():
    """Right for the box alone; with the wall it stops at a point that is wrong, and says what it likes."""
    rows = [Row(f"box{i}", "actuator", np.eye(2)[i], -1.0, 1.0) for i in range(2)]
    rows += [Row("wall", "barrier", np.array([0.6, 0.8]), -np.inf, 0.5)]
    problem = build_problem([Level("goal", np.array([[1.0, 0.1]]), np.array([0.9]))], rows)
    for status in ("optimal", "unfinished", "infeasible", "failed"):

        def gives_up(G, lower, upper, status=status):
            if len(G) <= 2:
                return BACKENDS["daqp"](G, lower, upper)
            y = np.zeros(G.shape[1]) if status in ("optimal", "unfinished") else None
            return KernelSolution(y, np.zeros(len(G)), 9, status)

        for mode in ("filter", "projected", "lexicographic"):
            want, got = (solve(problem, mode=mode, backend=backend) for backend in ("daqp", gives_up))
            assert not got.relaxed  # it keeps the rows all the same
            assert got.status == "unconfirmed" or np.abs(got.v - want.v).max() < 1e-9
            if mode == "filter":
                assert got.status == "unconfirmed" and want.status == "optimal"
                assert got.fallback == 3 and "a better v may exist" in got.explain()


def test_a_search_that_did_not_end_is_not_called_optimal(monkeypatch):
    rows = [Row("box", "actuator", np.array([1.0, 0.0]), -1.0, 1.0)]
    problem = build_problem([Level("goal", np.eye(2), np.array([3.0, 0.5]))], rows)
    assert solve(problem, backend="daqp").status == "limited"
    monkeypatch.setattr("surctl.priority.reference._CAP", 1)
    assert solve(problem, backend="daqp").status == "unconfirmed"
