"""The priority kernel: the same bytes everywhere, inside its arrays for any input, and a status that is true."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import daqp
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import compile_block, replay
from surctl.priority import Level, LevelShape, PriorityProblem, Row, build_problem
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.optimality import is_least
from surctl.priority.settings import Settings
from surctl.priority.shapes import StackShape
from surctl.priority.solver.fallback import CLAMPED, LIMITED, MET, RELAXED, UNCONFIRMED
from tests.priority.test_optimum import drawn
from tests.tools import need_compiler

Array = NDArray[np.float64]
N, ROWS = 5, 8
SHAPE = StackShape(N, (LevelShape(2), LevelShape(1, is_set=True), LevelShape(N)))
BOX = np.concatenate([np.full(N, -1.0), np.full(N, 1.0)])


@cache
def kernel() -> Any:
    return hierarchy(SHAPE, ROWS)


def arrays(problem: PriorityProblem) -> list[Array]:
    """The inputs of the kernel."""
    J = np.vstack([level.J for level in problem.levels])
    low, high = (np.concatenate([getattr(level, end) for level in problem.levels]) for end in ("lower", "high"))
    rows = np.array([[*row.a, row.lower, row.upper, row.kind != "actuator"] for row in problem.rows], dtype=float)
    return [J.reshape(-1), low, high, rows.reshape(-1), BOX]


def solved(problem: PriorityProblem) -> dict[str, Array]:
    names = [name for name, _ in kernel().outputs]
    return dict(zip(names, replay(kernel(), *arrays(problem)), strict=True))


def tight(rng: np.random.Generator, tilt: float) -> PriorityProblem:
    """Walls in pairs that are parallel up to `tilt`, two of them against each other."""
    problem = drawn(rng, 3.0)
    box, walls = problem.rows[:N], problem.rows[N:]
    a = walls[0].a
    near = a + tilt * walls[1].a
    rows = [Row("left", "barrier", a, -np.inf, -0.2), Row("right", "barrier", -near, -np.inf, 0.1)]
    return build_problem(problem.levels, [*box, *rows, Row("also", "barrier", near, -np.inf, -0.2)])


def test_compiled_code_gives_the_bytes_of_the_replay() -> None:
    need_compiler()
    problems = [drawn(np.random.default_rng(k), 3.0) for k in range(4)]
    problems += [tight(np.random.default_rng(k), tilt) for k, tilt in ((4, 1e-2), (5, 1e-9), (6, 0.0))]
    batch = [np.array(each) for each in zip(*map(arrays, problems), strict=True)]
    for ours, theirs in zip(compile_block(kernel())(*batch), replay(kernel(), *batch), strict=True):
        assert ours.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("seed", range(5))
def test_what_is_clear_is_shown_to_be_optimal(seed: int) -> None:
    problem = drawn(np.random.default_rng(seed), 3.0)
    got = solved(problem)
    assert got["status"][0] in (MET, 2.0) and got["count"][0] <= 3 * (N + ROWS)
    assert is_least(got["velocity"], problem, settings=Settings("lexicographic"), target=np.zeros(N), tol=1e-7)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_what_rounding_decides_is_called_unconfirmed(tilt: float) -> None:
    outcomes = []
    for seed in range(4):
        problem = tight(np.random.default_rng(seed), tilt)
        got = solved(problem)
        outcomes.append(got["status"][0])
        settings = Settings("lexicographic")
        least = is_least(got["velocity"], problem, settings=settings, target=np.zeros(N), tol=1e-6)
        assert least or got["status"][0] == UNCONFIRMED
        gap = 0.1 / (1 + np.linalg.norm(problem.rows[N + 1].a))
        assert abs(got["opening"][0] - gap) < 0.02 or got["status"][0] == UNCONFIRMED
    assert tilt in (1e-12, 1e-9, 1e-6) or set(outcomes) == {RELAXED}


def test_multipliers_balance_the_first_level_that_limits_stop() -> None:
    problem = build_problem(
        [Level("go", np.eye(N)[:2], np.array([2.0, 0.4])), *drawn(np.random.default_rng(0), 0.1).levels[1:]],
        drawn(np.random.default_rng(0), 0.1).rows[: N + 3],
    )
    got = solved(problem)
    at = np.abs(got["active"]).astype(int)
    pull = problem.levels[0].J.T @ problem.levels[0].miss(got["velocity"])
    assert got["status"][0] == 2.0 and at[0] == 1  # the box stops the first velocity, and is named first
    np.testing.assert_allclose(got["multipliers"][0], abs(pull[0]), rtol=1e-9)


class Guarded(list[Any]):
    """A list that no negative index reaches from behind."""

    def __getitem__(self, at: Any) -> Any:
        assert at >= 0
        return super().__getitem__(at)

    def __setitem__(self, at: Any, value: Any) -> None:
        assert at >= 0
        super().__setitem__(at, value)


def test_no_input_leads_outside_the_arrays_or_to_a_velocity_outside_the_box() -> None:
    rng = np.random.default_rng(8)
    procedure = kernel()
    hostile = [np.nan, np.inf, -np.inf, 1e200, -1e308, 1e-310, 0.0]
    for case in range(16):
        inputs = arrays(drawn(rng, 3.0) if case % 2 else tight(rng, 10.0 ** rng.integers(-15, 0)))
        which = int(rng.integers(4))
        chosen = rng.random(inputs[which].size) < (0.05 if case % 4 else 0.6)
        inputs[which] = np.where(chosen, rng.choice(hostile, inputs[which].size), inputs[which])
        space: dict[str, Any] = {name: Guarded([np.nan] * size) if size else 0 for name, _, size in procedure.memory}
        space |= {name: Guarded(x.tolist()) for (name, _), x in zip(procedure.inputs, inputs, strict=True)}
        space |= {name: Guarded([np.nan] * size) for name, size in procedure.outputs}
        outputs = procedure.run([x.tolist() for x in inputs], space)
        v, status = np.array(outputs[0]), outputs[4][0]
        assert (np.abs(v) <= 1.0).all() and status in (1.0, 2.0, 3.0, CLAMPED, UNCONFIRMED)
        if np.isnan(np.concatenate(inputs)).any():
            assert status == CLAMPED and not any(outputs[1])


def test_limits_that_leave_no_velocity_clip_it_to_the_box() -> None:
    problem = drawn(np.random.default_rng(1), 3.0)
    rows = [*problem.rows[:-1], Row("away", "actuator", np.eye(N)[0], 2.0, 3.0)]
    got = solved(PriorityProblem(problem.levels, tuple(rows)))
    assert got["status"][0] == CLAMPED and (np.abs(got["velocity"]) <= 1.0).all() and not got["active"].any()


@pytest.mark.parametrize(("damped", "more"), [(False, 8000), (True, 12000)])
def test_a_budget_holds_and_changes_no_other_result(damped: bool, more: int) -> None:
    with pytest.raises(InputError, match="budget = 9: is too small; give") as caught:
        hierarchy(SHAPE, ROWS, damped=damped, budget=9)
    most = int(str(caught.value).split()[-4]) + more
    free, short, seen = hierarchy(SHAPE, ROWS, damped=damped), hierarchy(SHAPE, ROWS, damped=damped, budget=most), set()
    assert short.operations == most
    spent = "\n    s.target[0] = 1.0 * s.spent"
    short = replace(short, source=short.source + spent, bounded=short.bounded + spent)
    for k in range(8):
        inputs = [*arrays(drawn(np.random.default_rng(k), 3.0)), *([np.array([0.1])] if damped else [])]
        outputs, same = replay(short, *inputs), replay(free, *inputs)
        v, rows = outputs[0], inputs[3].reshape(ROWS, -1)
        seen.add(outputs[4][0] == UNCONFIRMED)
        assert 0.0 < outputs[-1][0] <= most
        assert (rows[:, :N] @ v <= rows[:, N + 1] + 1e-9).all() and (abs(v) <= 1.0).all()
        if outputs[4][0] != UNCONFIRMED:
            assert [x.tobytes() for x in outputs[:-1]] == [x.tobytes() for x in same[:-1]]
    assert seen == {True, False}


def damped_cascade(problem: PriorityProblem, c: float) -> Array:
    """One quadratic programme for each damped level, with the rates of the levels above as equalities, by DAQP."""
    n, v = problem.width, np.zeros(problem.width)
    rows = [(row.a, row.lower, row.upper) for row in problem.rows]
    for level in problem.levels:
        x = np.clip(level.J @ v, level.lower, level.high)
        outside = level.is_goal or (abs(x - level.J @ v) > 1e-10).any()
        if outside:
            weight = c * np.linalg.norm(x) + 1e-6
            H, f = 2.0 * (level.J.T @ level.J + weight * np.eye(n)), -2.0 * level.J.T @ x
            A, low, high = (np.array(part) for part in zip(*rows, strict=True))
            equal = np.where(low == high, 5, 0).astype(np.intc)
            v, _, flag, _ = daqp.solve(H, f, A, np.minimum(high, 1e30), np.maximum(low, -1e30), equal, primal_tol=1e-10)
            assert flag == 1
        rate = level.J @ v
        low, high = (rate, rate) if level.is_goal else (np.fmin(rate, level.lower), np.fmax(rate, level.high))
        rows += list(zip(level.J, low, high, strict=True))
    return np.asarray(v)


def test_damped_levels_are_those_of_one_programme_after_another() -> None:
    procedure, seen = hierarchy(SHAPE, ROWS, damped=True), set()
    for k, c in [*((k, 0.1) for k in range(25)), *((k, 1.0) for k in range(120, 146))]:
        problem = drawn(np.random.default_rng(k), 3.0)
        out = dict(zip([name for name, _ in procedure.outputs], replay(procedure, *arrays(problem), [c]), strict=True))
        seen.add(int(out["status"][0]))
        assert out["velocity"] == pytest.approx(damped_cascade(problem, c), abs=2e-6)
    assert seen == {MET, LIMITED}
