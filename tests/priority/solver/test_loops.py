"""The routines in loops for many velocities agree with the unrolled programs for few."""

import casadi as ca
import numpy as np
import pytest

from surctl.ir import replay
from surctl.priority import LevelShape, priority_step, solve
from surctl.priority.compiled.decomposition import attainable, decompose
from surctl.priority.problem import Level, Row, build_problem
from surctl.priority.solver.elimination import FLOAT64, eliminate, elimination, pseudo_inverse, pseudo_inverse_of


@pytest.mark.parametrize("p, n", [(3, 4), (5, 3)])
def test_loops_eliminate_and_decompose_like_the_unrolled_programs(p: int, n: int) -> None:
    J, x = ca.SX.sym("J", p, n), ca.SX.sym("x", p)
    left, parts = eliminate(J), decompose(J)
    full = ca.eq(parts.rank, p)
    attained = [ca.if_else(full, ca.vec(J.T), ca.vec(parts.task().T)), ca.if_else(full, x, parts.turned(x))]
    outputs = [ca.vec(left.lift.T), ca.vec(left.basis.T), left.rank, ca.vec(pseudo_inverse(J).T), *attained]
    unrolled = ca.Function("unrolled", [J, x], outputs)
    loops = (elimination(p, n, FLOAT64), pseudo_inverse_of(p, n, FLOAT64))
    rng = np.random.default_rng(31)
    for case in range(4):
        A, b = rng.normal(size=(p, n)), rng.normal(size=p)
        A[1] = (A[1], 2 * A[0], 0.0, A[1])[case]  # independent, dependent, a row of zeros, all zeros
        A *= case < 3
        found = [part for loop in loops for part in replay(loop, A.ravel())] + replay(attainable(p, n), A.ravel(), b)
        for part, expected in zip(found, unrolled.call([A, b]), strict=True):
            np.testing.assert_allclose(part, np.array(expected).ravel(), atol=1e-13)


def test_a_step_of_six_velocities_equals_solve() -> None:
    n, rank = 6, 4  # two rows of the Jacobian depend on others
    rng = np.random.default_rng(n)
    J, x, normals = rng.normal(size=(n, rank)) @ np.eye(rank, n), rng.normal(size=n), rng.normal(size=(4, n))
    limits = [Row(f"box {i}", "actuator", row, -0.3, 0.3) for i, row in enumerate(np.eye(n))]
    limits += [Row(f"half {i}", "barrier", row, -np.inf, -0.1) for i, row in enumerate(normals)]
    problem = build_problem([Level("task", J, x, None, "m/s")], limits)
    rows = np.array([[*row.a, row.lower, row.upper, row.kind != "actuator"] for row in limits])
    step = priority_step("projected", n=n, levels=(LevelShape(n),), rows=len(rows))
    v, active, *_ = replay(step, J.ravel(), x, x, rows.ravel(), np.repeat([-0.3, 0.3], n))
    np.testing.assert_allclose(v, solve(problem, backend="daqp").v, atol=1e-12)
    assert np.count_nonzero(active) > 2
