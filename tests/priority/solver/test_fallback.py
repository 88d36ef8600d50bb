"""The safe tick against problems that are meant to break it, and a referee that trusts no solver."""

from __future__ import annotations

from functools import cache

import casadi as ca
import daqp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from surctl.ir import Real, Routine, compile_block, replay, to_casadi
from surctl.ir.native import Native
from surctl.priority import safe_step
from surctl.priority.solver.dual_step import OPTIMAL, STUCK, Space
from surctl.priority.solver.elimination import FLOAT32, FLOAT64, Precision
from surctl.priority.solver.fallback import CLAMPED, LIMITED, MET, RELAXED, UNCONFIRMED
from surctl.priority.solver.kernel import most_iterations, search
from tests.oracles.distance_trials import FAMILIES, Trials, draw_trials, judge
from tests.priority.blocks import in_blocks
from tests.tools import need_compiler

Array = NDArray[np.float64]
N, P, M = 4, 2, 24


PRECISION: dict[Real, Precision] = {"float64": FLOAT64, "float32": FLOAT32}


@cache
def ladder(real: Real = "float64") -> Routine:
    return safe_step(N, P, M, precision=PRECISION[real])


@cache
def compiled(real: Real = "float64") -> Native:
    need_compiler()
    return compile_block(ladder(real), real=real)


class Flown:
    """A batch of problems and what the compiled ladder says."""

    def __init__(self, trials: Trials) -> None:
        self.trials = trials
        self.outputs = compiled()(*trials.arrays)
        self.v, self.active, self.multipliers, opening, status, count = self.outputs
        self.opening, self.status, self.count = opening[:, 0], status[:, 0], count[:, 0]


SMALL = (2, 1, 8)


@cache
def machine() -> ca.Function:
    return to_casadi(safe_step(*SMALL))


@cache
def small() -> tuple[Trials, list[Array]]:
    """Problems of a small ladder, and what it says."""
    n, p, m = SMALL
    trials = draw_trials(2_000, n=n, p=p, m=m, seed=1)
    return trials, compile_block(safe_step(*SMALL))(*trials.arrays)


@pytest.fixture(scope="module")
def flown() -> Flown:
    return Flown(draw_trials(3_000, n=N, p=P, m=M, seed=1))


def has(trials: Trials, name: str) -> NDArray[np.bool_]:
    return trials.features[:, FAMILIES.index(name)]


def nearest(trials: Trials, k: int, unit: tuple[Array, Array, Array]) -> Array | None:
    """DAQP's point for rung 1, if it finds one that holds."""
    A, lower, upper = unit
    J, x = trials.J[k].reshape(P, N), trials.x[k]
    length = np.linalg.norm(J, axis=1)
    length[length == 0] = 1.0
    rows = np.ascontiguousarray(np.vstack([A[k], J / length[:, None]]))
    low, high = np.append(lower[k], x / length), np.append(upper[k], x / length)
    sense = np.append(np.zeros(M), np.full(P, 5)).astype(np.intc)
    y, _, flag, _ = daqp.solve(
        np.eye(N),
        -trials.target[k],
        rows,
        np.minimum(high, 1e30),
        np.maximum(low, -1e30),
        sense,
        primal_tol=1e-12,
    )
    if flag != 1:
        return None
    holds = max((rows @ y - high).max(), (low - rows @ y).max()) <= 1e-10 * (1 + np.abs(y).max())
    return np.array(y) if holds else None


def test_every_tick_has_a_finite_answer_inside_the_hard_rows(flown: Flown) -> None:
    A, lower, upper, soft = flown.trials.unit()
    assert np.isfinite(np.concatenate(flown.outputs, axis=1)).all()
    value = np.einsum("kij,kj->ki", A, flown.v)
    missed = np.maximum(value - upper, lower - value)
    assert missed[~soft].max() <= 1e-9
    shown = flown.status != UNCONFIRMED
    assert shown.mean() > 0.98 and (np.where(soft, missed, -1).max(axis=1) <= flown.opening + 1e-9).all()
    box = flown.trials.box
    assert ((box[:, :N] <= flown.v) & (flown.v <= box[:, N:])).all()
    assert not (flown.status == CLAMPED).any()
    for rung in (MET, LIMITED, RELAXED):
        assert (flown.status == rung).sum() > 250


def test_met_is_the_nearest_point_by_its_optimality_conditions(flown: Flown) -> None:
    met = (flown.status == MET) & flown.trials.attained(flown.v)
    assert met.sum() > 400
    verdict = judge(flown.trials[met], flown.v[met], flown.active[met], multipliers=flown.multipliers[met])
    assert verdict.worst().max() <= 1e-9
    assert verdict.worst()[~has(flown.trials[met], "parallel")].max() <= 1e-12


def test_the_referee_sees_a_wrong_answer(flown: Flown) -> None:
    met = (flown.status == MET) & flown.trials.attained(flown.v) & (flown.active != 0).any(axis=1)
    met = np.flatnonzero(met & ~has(flown.trials, "far"))[:50]
    trials = flown.trials[met]
    for change in (1e-6, -1e-6):
        moved = judge(trials, flown.v[met] + change, flown.active[met], multipliers=flown.multipliers[met])
        assert (moved.worst() > 1e-8).all()
    forgot = judge(trials, flown.v[met], np.zeros((50, N)), multipliers=np.zeros((50, N)))
    assert (forgot.worst() > 1e-8).all()


def test_daqp_agrees_and_nothing_feasible_is_given_up(flown: Flown) -> None:
    compared, unit = 0, flown.trials.unit()[:3]
    for k in range(500):
        want = nearest(flown.trials, k, unit)
        if want is None or not flown.trials[np.array([k])].attained(want[None])[0]:
            continue
        assert flown.status[k] == MET, k
        gap = np.abs(want - flown.v[k]).max() / (1 + np.abs(flown.trials.target[k]).max())
        assert gap <= 1e-8, k
        compared += 1
    assert compared > 60


def sides(A: Array, lower: Array, upper: Array, opens: Array) -> tuple[Array, Array]:
    """G, h with G (v, t) ≤ h."""
    both = [(np.column_stack([A, -opens]), upper), (np.column_stack([-A, -opens]), -lower)]
    return (
        np.vstack([rows[np.isfinite(b)] for rows, b in both]),
        np.concatenate([b[np.isfinite(b)] for _, b in both]),
    )


TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


def test_limited_is_the_best_that_the_rows_allow(flown: Flown) -> None:
    """‖J v − x‖ exceeds the least one by at most its slope along the best way left, found by a linear programme."""
    A, lower, upper, soft = flown.trials.unit()
    for k in np.flatnonzero(flown.status == LIMITED)[:40]:
        J, x = flown.trials.J[k].reshape(P, N), flown.trials.x[k]
        rest = x - J @ flown.v[k]
        size, scale = np.linalg.norm(rest), np.linalg.norm(J, axis=1).max()
        if size <= 1e-6 * scale:  # rounding turns the slope of so short a rest
            continue
        slope = J.T @ rest / (size * scale)
        G, h = sides(A[k], lower[k], upper[k], 0.0 * soft[k])
        room = np.maximum(h, G[:, :N] @ flown.v[k])
        best = linprog(-slope, G[:, :N], room, bounds=[(None, None)] * N, method="highs-ds", options=TIGHT)
        assert best.status == 4 or slope @ (best.x - flown.v[k]) <= 1e-8, k


def test_relaxed_opens_no_more_than_it_must(flown: Flown) -> None:
    A, lower, upper, soft = flown.trials.unit()
    compared = 0
    for k in np.flatnonzero(flown.status == RELAXED)[:40]:
        G, h = sides(A[k], lower[k], upper[k], soft[k].astype(float))
        bounds = [(None, None)] * N + [(0, None)]
        least = linprog(np.append(np.zeros(N), 1.0), G, h, bounds=bounds, method="highs-ds", options=TIGHT)
        assert least.status in (0, 4)
        if least.status == 0:
            assert abs(flown.opening[k] - least.x[-1]) <= 1e-8, k
            compared += 1
    assert compared > 36


@pytest.mark.parametrize("size", [1.0, 1e10])
@pytest.mark.parametrize("long", [False, True])
def test_contradicting_tasks_of_any_size_open_no_row(size: float, long: bool) -> None:
    need_compiler()
    trials = draw_trials(300, n=N, p=P, m=M, seed=6, mixed=False)
    rows = trials.rows.reshape(300, M, N + 3).copy()
    rows[..., N], rows[..., N + 1] = np.minimum(rows[..., N], -0.01), np.maximum(rows[..., N + 1], 0.01)  # 0 keeps all
    rng = np.random.default_rng(7)
    J = np.repeat(rng.normal(size=(300, 1, N)), P, axis=1) * (size if long else 1.0)
    x = size * rng.normal(size=(300, P))
    status = compiled()(trials.target, J.reshape(300, -1), x, rows.reshape(300, -1), trials.box)[4]
    assert not np.isin(status, (RELAXED, CLAMPED)).any() and (status == LIMITED).mean() > 0.3


def test_the_cap_is_far_away() -> None:
    need_compiler()
    trials, space = draw_trials(4_000, n=N, p=P, m=M, seed=2), Space(N)
    A, lower, upper, _ = trials.unit()
    rows = in_blocks(np.concatenate([A, lower[..., None], upper[..., None]], axis=2))
    goal = np.clip(trials.target, trials.box[:, :N], trials.box[:, N:])
    _, _, _, status, count = compile_block(search(space, M))(rows, goal, np.zeros(1))
    assert set(np.unique(status)) <= {OPTIMAL, STUCK}
    assert count.max() <= 25 < most_iterations(space)


def test_replay_and_casadi_give_the_same_bytes(flown: Flown) -> None:
    some = flown.trials[slice(0, 8)]
    for a, b in zip(replay(ladder(), *some.arrays), flown.outputs, strict=True):
        assert a.tobytes() == b[:8].tobytes()
    trials, outputs = small()
    for k in range(3):
        one = machine()(*(array[k] for array in trials.arrays))
        for a, b in zip(one, outputs, strict=True):
            # + 0.0: CasADi's if_else turns −0 into +0
            assert (np.asarray(a).reshape(-1) + 0.0).tobytes() == (b[k] + 0.0).tobytes()


def test_in_float_it_is_as_safe_and_nearly_as_good(flown: Flown) -> None:
    rounded = [array.astype(np.float32) for array in flown.trials.arrays]
    outputs = compiled("float32")(*rounded)
    assert all(array.dtype == np.float32 for array in outputs)  # the bytes of the replay: test_bounded
    v, status = outputs[0], outputs[4][:, 0]
    assert np.isfinite(np.concatenate(outputs, axis=1)).all() and not (status == CLAMPED).any()
    assert ((rounded[4][:, :N] <= v) & (v <= rounded[4][:, N:])).all()
    A, lower, upper, soft = Trials(*(a.astype(np.float64) for a in rounded), flown.trials.features).unit()
    value = np.einsum("kij,kj->ki", A, v.astype(np.float64))
    assert np.where(soft, -1.0, np.maximum(value - upper, lower - value)).max() <= 1e-4
    assert (status != UNCONFIRMED).mean() > 0.95
    both = (status == MET) & (flown.status == MET)
    gap = np.abs(v - flown.v).max(axis=1) / (1 + np.abs(flown.trials.target).max(axis=1))
    assert both.sum() > 500 and np.quantile(gap[both], 0.9) <= 1e-6


ODD = [np.nan, np.inf, -np.inf, 1e-320, 1e38, 1e-40]
CASES = [("float64", 1e308), ("float64", -1e308), *((real, bad) for real in ("float64", "float32") for bad in ODD)]


@pytest.mark.parametrize(("real", "bad"), CASES)
def test_no_number_anywhere_makes_it_anything_but_finite(bad: float, real: Real) -> None:
    tick = compiled(real)
    good = draw_trials(1, n=N, p=P, m=M, seed=4)
    for which, array in enumerate(good.arrays):
        count = array.shape[1]
        arrays = [np.repeat(a, count, axis=0) for a in good.arrays]
        arrays[which][np.arange(count), np.arange(count)] = bad
        v, *_, status, _ = tick(*arrays)
        assert np.isfinite(v).all()
        if which < 4:  # the box itself is sound
            box = good.box[0].astype(real)
            assert ((box[:N] <= v) & (v <= box[N:])).all()
        if np.isnan(bad) and which < 4:
            soft = which == 3 and np.arange(count) % (N + 3) == N + 2  # what is no number is not soft
            assert (status[:, 0] == CLAMPED)[~np.broadcast_to(soft, count)].all()
