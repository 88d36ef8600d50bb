"""The Python face of the ladder: names, multipliers, and mistakes that are told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import surctl.priority.solver.safe_point as module
from surctl.errors import InputError, ToolMissing
from surctl.ir import SlowerEngine
from surctl.priority import build_problem, least_distance, solve
from surctl.priority.draws import draw_problem
from surctl.priority.problem import Row

BOX: dict[str, Any] = {"A": np.eye(2), "lower": [-1.0, -1.0], "upper": [1.0, 1.0]}


def test_names_and_multipliers_are_those_of_the_rows_as_given() -> None:
    got = least_distance(
        [3.0, 0.0], A=[[2.0, 0.0], [0.0, 1.0]], lower=[-9, -9], upper=[2.0, 9], names=("east", "north")
    )
    assert got.stage == "met"
    np.testing.assert_allclose(got.v, [1.0, 0.0], atol=1e-15)
    ((name, multiplier),) = got.binding
    assert name == "east" and multiplier == pytest.approx(1.0)  # 2·1 = 3 − 1
    got = least_distance([-3.0, 0.0], **BOX)
    assert got.binding == (("row 0", pytest.approx(-2.0)),)


@pytest.mark.parametrize("n", [2, 3])
def test_multipliers_of_several_rows_make_up_what_the_target_is_moved_by(n: int) -> None:
    """target − v = Aᵀλ with λ ≥ 0 of rows at their bounds is what makes v the nearest point."""
    rng = np.random.default_rng(n)
    for _ in range(8):
        A, v, wanted = rng.normal(size=(n + 2, n)), rng.normal(size=n), rng.uniform(0.5, 2.0, n)
        upper = A @ v + np.append(np.zeros(n), [0.5, 1.0])  # the last two are loose
        got = least_distance(v + A[:n].T @ wanted, A=A, lower=np.full(n + 2, -np.inf), upper=upper)
        np.testing.assert_allclose(got.v, v, atol=1e-9)
        found = dict(got.binding)
        assert [found[f"row {k}"] for k in range(n)] == pytest.approx(wanted.tolist(), rel=1e-7)
        assert len(found) == n


def test_the_ladder_from_python() -> None:
    task: dict[str, Any] = {"J": [[1.0, 0.0]], "x": [0.5]}
    assert least_distance([0.0, 0.3], **BOX, **task).stage == "met"
    limited = least_distance([0.0, 0.3], **BOX, J=[[1.0, 0.0]], x=[5.0])
    assert limited.stage == "limited"
    np.testing.assert_allclose(limited.v, [1.0, 0.3], atol=1e-9)
    wall = {"A": [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]], "lower": [-1, -1, 2.0], "upper": [1, 1, np.inf]}
    relaxed = least_distance([0.0, 0.3], **wall, soft=[0, 0, 1])
    assert relaxed.stage == "relaxed" and relaxed.opening == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(relaxed.v, [1.0, 0.3], atol=1e-8)
    clamped = least_distance([7.0, 0.3], **wall, soft=[0, 0, 0], box=([-1, -1], [1, 1]))
    assert clamped.stage == "clamped" and clamped.binding == ()
    np.testing.assert_allclose(clamped.v, [1.0, 0.3])


def test_of_equal_rows_the_first_binds_and_nearly_equal_ones_do_not_send_v_away() -> None:
    twice = {"A": [[0.0, 1.0], [1.0, 0.0], [1.0, 0.0]], "lower": [-9.0] * 3, "upper": [9.0, 1.0, 1.0]}
    assert [name for name, _ in least_distance([3.0, 0.0], **twice).binding] == ["row 1"]
    # these two meet a million kilometres away: that is no answer for a robot
    sharp = {"A": [[1.0, 0.0], [-1.0, 1e-9]], "lower": [-np.inf] * 2, "upper": [0.0, -1.0]}
    got = least_distance([0.0, 0.0], **sharp)
    assert got.stage == "relaxed" and np.abs(got.v).max() < 2.0


def test_no_rows_and_many_rows() -> None:
    nothing = np.zeros((0, 3))
    assert least_distance([1.0, 2.0, 3.0], A=nothing, lower=[], upper=[]).v.tolist() == [1.0, 2.0, 3.0]
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    got = least_distance([5.0, 0.0], A=ring, lower=np.full(100, -np.inf), upper=np.ones(100))
    np.testing.assert_allclose(got.v, [1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"target": [np.nan, 0.0]}, r"target\[0\].*not finite"),
        ({"A": [[1.0, 0.0], [np.inf, 0.0]]}, r"A\[1\].*not finite"),
        ({"upper": [1.0, np.nan]}, r"limit b = .*no NaN"),
        ({"upper": [1.0, -2.0]}, "limit b = .*exclude every velocity"),
        ({"A": np.eye(3)}, "A: has shape"),
        ({"J": [[1.0, 0.0]], "x": [1.0, 2.0]}, "x: has shape"),
        ({"J": [[np.nan, 0.0]], "x": [1.0]}, r"J\[0\].*not finite"),
        ({"x": [1.0]}, "requires J"),
        ({"names": ("a",)}, "names: has 1 entries"),
        ({"box": ([1, 1], [0, 2])}, r"box\[0\]"),
        ({"target": "north"}, "not an array"),
    ],
)
def test_mistakes_are_told(change: dict[str, Any], told: str) -> None:
    given: dict[str, Any] = {"target": [0.0, 0.0], **BOX, "names": ("a", "b"), **change}
    with pytest.raises(InputError, match=told):
        least_distance(given.pop("target"), **given)


def test_without_a_compiler_the_numbers_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    want = least_distance([3.0, 0.4], **BOX)

    def missing(*_: object, **__: object) -> None:
        raise ToolMissing("no C compiler found")

    monkeypatch.setattr("surctl.ir.native.compile_block", missing)
    module.step_runner.cache_clear()
    try:
        with pytest.warns(SlowerEngine, match="no C compiler found"):
            got = least_distance([3.0, 0.4], **BOX)
    finally:
        module.step_runner.cache_clear()
    assert got.v.tobytes() == want.v.tobytes() and got.binding == want.binding


def test_the_backend_own_solves_whole_ticks_as_daqp_does() -> None:
    rng = np.random.default_rng(11)
    for _ in range(12):
        problem = draw_problem(rng)
        own, other = solve(problem, backend="own"), solve(problem, backend="daqp")
        assert own.status == other.status
        # rungs 2 and 3 go through an iteration that ends at 1e-7 or so
        tolerance = 1e-9 if own.fallback == 1 else 1e-6
        assert np.abs(own.v - other.v).max() <= tolerance * (1 + np.abs(other.v).max())
        assert own.is_optimal(problem)


def test_a_row_that_does_nothing_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    problem = draw_problem(rng)
    wider = build_problem(problem.levels, [*problem.rows, Row("idle", "barrier", np.ones(4), -np.inf, 1e6)])
    a, b = solve(problem, backend="own"), solve(wider, backend="own")
    np.testing.assert_allclose(a.v, b.v, atol=1e-12)
