"""Random priority problems for the tests of this room."""

import numpy as np

from surctl.priority import Level, Row, build_problem

N = 4


def levels(rng, most=5, conditioned=False, deficient=True):
    """1 … `most` levels of 1–4 rows; some rank-deficient, with doubled rows, switched off, or selections."""
    made = []
    for i in range(rng.integers(1, most + 1)):
        k = int(rng.integers(1, N + 1))
        J = rng.normal(size=(k, N))
        if conditioned:
            left, _, right = np.linalg.svd(J, full_matrices=False)
            J = left @ np.diag(rng.uniform(0.3, 3.0, k)) @ right
        if deficient:
            kind = rng.random()
            if kind < 0.15 and k > 1:
                J[1] = J[0]
            elif kind < 0.25:
                J = rng.normal(size=(k, 1)) @ rng.normal(size=(1, N))
            elif kind < 0.3:
                J[:] = 0.0
            elif kind < 0.4:
                J = np.eye(N)[rng.permutation(N)[:k]]
        made.append(Level(f"task{i}", J, rng.normal(size=k)))
    return made


def unit(rng):
    a = rng.normal(size=N)
    return a / np.linalg.norm(a)


def constrained(rng):
    """Levels with a box, thrust rows (consistent), and barriers and sets that often contradict them."""
    half = rng.uniform(0.05, 1.0, N)
    rows = [Row(f"box{i}", "actuator", np.eye(N)[i], -half[i], half[i]) for i in range(N)]
    rows += [
        Row(f"thrust{i}", "actuator", unit(rng), -rng.uniform(0.05, 1), rng.uniform(0.05, 1))
        for i in range(rng.integers(0, 4))
    ]
    for i in range(rng.integers(0, 6)):
        a, bound = unit(rng) * 10.0 ** rng.uniform(-1, 1), 0.5 * rng.normal()
        rows.append(Row(f"barrier{i}", "barrier", a, -np.inf, bound))
        if rng.random() < 0.2:
            rows.append(Row(f"double{i}", "barrier", a, -np.inf, bound))
        if rng.random() < 0.1:
            rows.append(Row(f"against{i}", "barrier", -a, -np.inf, -bound + rng.choice([0.0, 0.1, -0.1])))
    if rng.random() < 0.5:
        middle = 0.3 * rng.normal()
        rows.append(Row("set", "set", unit(rng), middle, middle + rng.choice([0.0, 0.2])))
    return build_problem(levels(rng), rows)


def wide(problem, *, span=1e3):
    """The same levels with rows that never bind."""
    rows = [Row(f"box{i}", "actuator", np.eye(N)[i], -span, span) for i in range(N)]
    return build_problem(problem, [*rows, Row("wall", "barrier", np.ones(N), -np.inf, span)])


def with_sets(problem, rng):
    """The same problem with some rows of some levels turned into bounds."""
    made = []
    for level in problem.levels:
        k = level.lower.size
        room = np.where(rng.random(k) < 0.7, rng.choice([0.1, 0.5, 2.0], k), 0.0)
        if rng.random() < 0.65:
            room[:] = 0.0
        lower = np.where((room > 0.0) & (rng.random(k) < 0.2), -np.inf, level.lower)
        made.append(Level(level.name, level.J, lower, level.lower + room))
    return build_problem(made, problem.rows)


def strict(made):
    """Strict (lexicographic) priority: v ← v + (J N)⁺(x − J v), cut off at 1e-10·‖J‖."""
    v, N_A = np.zeros(N), np.eye(N)
    for level in made:
        left, s, right = np.linalg.svd(level.J @ N_A, full_matrices=False)
        keep = s > 1e-10 * np.linalg.norm(level.J, 2)
        v = v + right[keep].T @ ((left[:, keep].T @ (level.x - level.J @ v)) / s[keep])
        N_A = N_A - right[keep].T @ right[keep]
    return v
