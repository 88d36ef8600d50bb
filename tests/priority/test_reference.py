"""The reference solver with each QP solver, against an oracle that tries every set of active rows."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.priority import Level, Row, build_problem, solve
from tests.oracles.priority_draws import unit

N = 4

each = pytest.mark.parametrize("backend", ["daqp", "osqp", "clarabel"])


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


def nearest(target, A, upper, backend):
    rows = [Row(f"row{i}", "actuator", a, -np.inf, float(end)) for i, (a, end) in enumerate(zip(A, upper, strict=True))]
    return solve(build_problem([Level("go", np.eye(N), target)], rows), mode="filter", backend=backend)


@each
def test_it_equals_enumeration(backend):
    rng, empty = np.random.default_rng(1), 0
    for _ in range(30):
        m = int(rng.integers(1, 7))
        A, upper, target = np.array([unit(rng) for _ in range(m)]), rng.normal(size=m) * 0.7, rng.normal(size=N)
        if m > 1 and rng.random() < 0.3:
            A[1] = -A[0]
        if m > 2 and rng.random() < 0.3:
            A[2], upper[2] = A[0], upper[0]
        got, want = nearest(target, A, upper, backend), oracle(target, A, upper)
        if want is None:
            empty += 1
            assert got.status == "clamped"
            continue
        assert got.status == "optimal"
        assert np.abs(got.v - want).max() < 1e-8
        assert all(multiplier >= -1e-9 for _, multiplier in got.binding)
    assert empty > 0


@each
def test_a_fixed_velocity_and_absent_bounds(backend):
    ends = [(0.3, 0.3), (-np.inf, np.inf), (-np.inf, -0.5), (0.0, np.inf)]
    rows = [Row(f"row{i}", "actuator", np.eye(N)[i], *pair) for i, pair in enumerate(ends)]
    got = solve(build_problem([Level("go", np.eye(N), np.zeros(N))], rows), mode="filter", backend=backend)
    assert np.allclose(got.v, [0.3, 0, -0.5, 0], atol=1e-9)
    multipliers = dict(got.binding)
    assert multipliers["row0"] < 0 < multipliers["row2"]


@each
def test_nothing_is_printed(backend, capfd):
    for size in (0.0, 3.0):
        assert nearest(np.full(N, size), np.eye(N), np.ones(N), backend).status == "optimal"
    assert capfd.readouterr() == ("", "")


def test_a_solver_that_stops_early_or_finds_nothing_is_never_called_optimal(monkeypatch):
    """With the wall it returns a point that is wrong, or none; the result keeps the limits all the same."""
    rows = [Row(f"box{i}", "actuator", np.eye(2)[i], -1.0, 1.0) for i in range(2)]
    rows += [Row("wall", "barrier", np.array([0.6, 0.8]), -np.inf, 0.5)]
    problem = build_problem([Level("goal", np.array([[1.0, 0.1]]), np.array([0.9]))], rows)
    for mode in ("filter", "projected", "lexicographic"):
        want = solve(problem, mode=mode, backend="daqp")
        for x in (np.zeros(2), None):
            result = SimpleNamespace(x=x, z=np.zeros(5))
            monkeypatch.setattr("qpsolvers.solve_problem", lambda *_, result=result, **__: result)
            got = solve(problem, mode=mode, backend="daqp")
            monkeypatch.undo()
            assert np.abs(got.v).max() <= 1.0
            if np.abs(got.v - want.v).max() > 1e-9:
                assert got.status in ("unconfirmed", "clamped")


def test_an_unknown_backend_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'daqp'"):
        nearest(np.zeros(N), np.eye(N), np.ones(N), "dakp")
