"""The search in loops for many velocities."""

import numpy as np

from surctl.ir import replay
from surctl.priority import LevelShape, priority_step, solve
from surctl.priority.problem import Level, Row, build_problem


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
