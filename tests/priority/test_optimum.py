"""A velocity is optimal, or the status says that it may not be; limits that cross follow one rule."""

from __future__ import annotations

import json
from functools import cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.ir import replay
from surctl.priority import (
    AssembledStep,
    Assembly,
    Level,
    PriorityProblem,
    PriorityStep,
    Row,
    assemble,
    build_problem,
    solve,
)
from surctl.priority.compiled.step import level_shapes
from surctl.priority.optimality import LOSS, is_least
from surctl.priority.settings import Mode, Settings
from surctl.priority.solver.dual_step import OPTIMAL, Space
from surctl.priority.solver.kernel import search
from surctl.tasks import AccelerationLimit, Limit, Stack, Task, VelocityBox
from tests.oracles.stored_problems import stored_problem
from tests.priority.blocks import in_blocks
from tests.tools import need_compiler

ARM, DOUBTFUL, UNSEEN = (
    json.loads((Path(__file__).parent / f"{name}.json").read_text(encoding="utf-8"))
    for name in ("stretched_arm", "doubtful_rank", "unseen_interval")
)
Array = NDArray[np.float64]
reference = partial(solve, backend="daqp")  # a step would be compiled for each shape


def shown(problem: PriorityProblem, v: Array, target: Array, mode: Mode = "lexicographic") -> bool:
    """Whether the check that shares no code with the solvers calls v optimal."""
    return is_least(v, problem, settings=Settings(mode), target=target, tol=LOSS)


def drawn(rng: np.random.Generator, size: float, n: int = 5) -> PriorityProblem:
    """Well-conditioned levels, one of them set-based, with references of this size; a box and three walls."""

    def unit(k: int) -> Array:
        A = rng.normal(size=(k, n))
        return np.asarray(A / np.linalg.norm(A, axis=1, keepdims=True))

    levels = [Level("a", unit(2), size * rng.normal(size=2)), Level("b", unit(1), np.array([0.1]), np.array([0.4]))]
    levels.append(Level("c", np.eye(n), 2 * rng.normal(size=n)))
    rows = [Row(f"box{i}", "actuator", np.eye(n)[i], -1.0, 1.0) for i in range(n)]
    rows += [Row(f"wall{i}", "barrier", a, -np.inf, 0.3 * abs(rng.normal())) for i, a in enumerate(unit(3))]
    return build_problem(levels, rows)


def test_a_stretched_arm_far_from_its_optimum_is_not_called_optimal() -> None:
    problem, v, better = stored_problem(ARM), np.array(ARM["v_worse"]), np.array(ARM["v_better"])
    second = problem.levels[1]
    assert second.residual(v) > 1.3 * second.residual(better)
    assert not shown(problem, v, np.zeros(7))


@pytest.mark.parametrize("kept", [DOUBTFUL, UNSEEN], ids=["doubtful rank", "unseen interval"])
def test_what_is_not_shown_is_not_called_met(kept: dict[str, Any]) -> None:
    """A limit stops a direction of singular value 0.8e-10·|J|; the iterations end before the level of an interval."""
    need_compiler()
    problem = stored_problem(kept)
    step = PriorityStep("lexicographic", n=problem.width, levels=level_shapes(problem), rows=len(problem.rows))
    step.load(problem)
    step.solve()
    assert step.stage == "unconfirmed"


@pytest.mark.parametrize("seed", range(6))
def test_what_is_optimal_is_confirmed_and_what_is_moved_is_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = drawn(rng, 3.0)
    got = reference(problem, mode="lexicographic")
    assert got.status in ("optimal", "limited") and shown(problem, got.v, got.target)
    inside = np.zeros(problem.width)  # every limit allows 0
    for share in (1e-5, 0.3):
        moved = got.v + share * (inside - got.v)
        assert not shown(problem, moved, got.target)
    assert not shown(problem, 1.001 * got.v, got.target)  # outside the limits
    easy = drawn(rng, 0.1)
    near, strict = (reference(easy, mode=mode) for mode in ("projected", "lexicographic"))
    assert shown(easy, near.v, near.target, "projected")
    assert not shown(easy, strict.v, near.target, "projected")  # level 1 is met, but v is not the nearest


def test_an_opening_that_is_not_the_smallest_is_not_confirmed() -> None:
    low, high = (
        Row(name, "barrier", np.array([s, 0.0]), -np.inf, -0.1) for name, s in (("left", 1.0), ("right", -1.0))
    )
    problem = build_problem([Level("go", np.array([[0.0, 1.0]]), np.array([0.2]))], [low, high])
    for aside, good in ((0.0, True), (0.1, False)):  # the walls are relaxed by 0.1 and 0.2
        assert shown(problem, np.array([aside, 0.2]), np.zeros(2)) == good


def test_a_saturated_search_in_20_unknowns_ends() -> None:
    d, m = 20, 64
    rng = np.random.default_rng(1)
    A = np.vstack([np.eye(d), rng.normal(size=(m - d, d))])
    A /= np.linalg.norm(A, axis=1, keepdims=True)
    value = A @ (3 * rng.normal(size=d))
    rows = np.column_stack([A, np.where(rng.random(m) < 0.5, value - 0.05, -np.inf), value + 0.05, np.zeros(m)])
    table = in_blocks(rows[:, :-1])
    point, numbers, weights, status, count = replay(search(Space(d), m), table, np.zeros(d), [0.0])
    at = np.abs(numbers).astype(int) - 1
    used = at >= 0
    assert status == OPTIMAL and count > 40
    pull = (np.sign(numbers) * weights)[used] @ A[at[used]]
    assert (weights >= 0).all() and np.abs(point[:d] + pull).max() < 1e-10
    assert np.maximum(A @ point[:d] - rows[:, d + 1], rows[:, d] - A @ point[:d]).max() < 1e-10


Q, NU = ca.SX.sym("q", 2), ca.SX.sym("nu", 2)
DAMPED = (ca.fmax(-1, 50 * (-1 - Q)), ca.fmin(1, 50 * (1 - Q)))


@cache
def crossing(kind: str) -> tuple[Assembly, AssembledStep]:
    box = VelocityBox(*DAMPED) if kind != "apart" else VelocityBox([-1, -1], [1, 1])
    more: dict[str, list[Limit]] = {
        "one": [],
        "acceleration": [AccelerationLimit(NU, [2, 2], dt=0.1)],
        "apart": [VelocityBox(50 * (-1 - Q), 50 * (1 - Q), name="damper")],
    }
    task = Task(name="tool", eta=Q, sigma=Q[0] + 0.5 * Q[1], target=0.5)
    assembly = assemble(Stack((task,)), [box, *more[kind]], inputs={"q": Q, "nu": NU})
    return assembly, assembly.step()


@pytest.mark.parametrize("kind", ["one", "acceleration", "apart"])
@settings(max_examples=30, deadline=None)
@given(q=st.lists(st.floats(-1.3, 1.3), min_size=2, max_size=2), nu=st.lists(st.floats(-1, 1), min_size=2, max_size=2))
def test_limits_that_cross_never_exceed_the_harder_one(kind: str, q: list[float], nu: list[float]) -> None:
    need_compiler()
    assembly, step = crossing(kind)
    step.inputs["q"][:], step.inputs["nu"][:] = q, nu
    step.solve()
    problem = assembly.problem({"q": q, "nu": nu})
    want = reference(problem)
    assert np.abs(step.v).max() <= 1.0 and np.abs(step.v - want.v).max() < 1e-9
    outside = np.abs(q) > 1.02 + 1e-9  # beyond, the damper asks for more than the velocity limit
    assert (step.v[outside] == -np.sign(q)[outside]).all()
    names = {row.name for row, by in zip(assembly.limits, step.moved, strict=True) if by > 0}
    assert names == set(problem.moved) <= set(want.relaxed)
    assert bool(outside.any()) <= bool(names)
    if names:
        assert step.stage == want.status == "relaxed"
        assert all(f"`{name}`" in want.explain() for name in names)


def test_the_earlier_of_two_actuator_limits_is_harder_and_the_other_is_named() -> None:
    go, axis = Level("go", np.eye(2), np.array([0.5, 0.2])), np.array([1.0, 0.0])
    fast, slow = Row("box", "actuator", axis, -1.0, 0.1), Row("rate", "actuator", -2.0 * axis, -0.8, -0.6)
    for rows, v, moved in (((fast, slow), 0.1, {"rate": 0.4}), ((slow, fast), 0.3, {"box": 0.2})):
        problem = build_problem([go], rows)
        got = solve(problem, mode="lexicographic")
        np.testing.assert_allclose(got.v, [v, 0.2], atol=1e-12)
        assert dict(problem.moved) == pytest.approx(moved) == dict(got.relaxed) and got.status == "relaxed"
