"""The fallback stages of the safe step: active rows, multipliers, and what is relaxed."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from surctl.ir.native import runnable
from surctl.priority import safe_step

runner = cache(lambda n, p, m: runnable(safe_step(n, p, m)))
STAGES = ("met", "limited", "relaxed", "clamped", "bounded", "unconfirmed")


def least_distance(
    target: Any, *, A: Any, lower: Any, upper: Any, J: Any = None, x: Any = (0.0,), soft: Any = None, box: Any = None
) -> Any:
    """The result of the safe step; active rows as "row 0", …, with multipliers of the rows as written."""
    normals, n = np.array(A, dtype=float), len(target)
    rows = np.column_stack([normals, lower, upper, np.ones(len(normals)) if soft is None else soft])
    limits = np.array([[-np.inf] * n, [np.inf] * n] if box is None else box, dtype=float)
    task = np.zeros((1, n)) if J is None else np.array(J)
    v, active, multipliers, opening, status, _ = runner(n, len(task), len(rows))(
        np.array(target), task.reshape(-1), np.array(x), rows.reshape(-1), limits.reshape(-1)
    )
    binding = tuple(
        (f"row {int(abs(k)) - 1}", float(np.sign(k) * u / np.linalg.norm(normals[int(abs(k)) - 1])))
        for k, u in zip(active, multipliers, strict=True)
        if k != 0.0
    )
    return SimpleNamespace(v=v, stage=STAGES[int(status[0]) - 1], opening=float(opening[0]), binding=binding)


BOX: dict[str, Any] = {"A": np.eye(2), "lower": [-1.0, -1.0], "upper": [1.0, 1.0]}


def test_names_and_multipliers_are_those_of_the_rows_as_given() -> None:
    got = least_distance([3.0, 0.0], A=[[2.0, 0.0], [0.0, 1.0]], lower=[-9, -9], upper=[2.0, 9])
    assert got.stage == "met"
    np.testing.assert_allclose(got.v, [1.0, 0.0], atol=1e-15)
    ((name, multiplier),) = got.binding
    assert name == "row 0" and multiplier == pytest.approx(1.0)  # 2·1 = 3 − 1
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
    sharp = {"A": [[1.0, 0.0], [-1.0, 1e-9], [0.0, 1.0]], "lower": [-np.inf] * 2 + [-1.0], "upper": [0.0, -1.0, 1.0]}
    got = least_distance([0.0, 0.0], **sharp, soft=[1, 1, 0])
    assert got.stage in ("relaxed", "unconfirmed") and np.abs(got.v).max() < 2.0
