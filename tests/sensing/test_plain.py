"""The numeric twins against the symbolic filters, over random inputs."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.marine.sensing import SensorFilter, SonarArray
from surctl.marine.sensing.ranging.filters import gate, lms_step, weighted_average
from tests.oracles.range_filters import plain_average, plain_filter, plain_gate, plain_lms_step

ARRAY = SonarArray()
DRAWS = 10_000


def columns(function: ca.Function, *inputs: np.ndarray) -> list[np.ndarray]:
    """Outputs of a function mapped over the draws, each (draws, size)."""
    mapped = function.map(len(inputs[0]))
    found = mapped(*(np.reshape(v, (len(v), -1)).T for v in inputs))
    return [np.asarray(part).T for part in (found if isinstance(found, tuple) else (found,))]


def close(got: np.ndarray, want: np.ndarray) -> bool:
    want = want.reshape(got.shape)
    return bool(np.all(np.abs(got - want) <= 1e-12 * np.maximum(1.0, np.abs(want))))


def test_the_average() -> None:
    samples = np.random.default_rng(0).uniform(0.0, 4.5, (DRAWS, 5))
    s = ca.SX.sym("s", 5)
    assert close(plain_average(samples), columns(ca.Function("a", [s], [weighted_average(s)]), samples)[0])


def test_the_gate() -> None:
    rng = np.random.default_rng(1)
    window = rng.uniform(0.2, 4.5, (DRAWS, 1)) + rng.normal(0, 0.02, (DRAWS, 8)) * rng.integers(0, 2, (DRAWS, 1))
    value, lambda1 = window[:, 0] + rng.normal(0, 0.04, DRAWS), rng.integers(0, 4, DRAWS).astype(float)
    w, v, lam = ca.SX.sym("w", 8), ca.SX.sym("v"), ca.SX.sym("l")
    function = ca.Function("g", [w, v, lam], list(gate(w, v, lambda1=lam, resolution=ARRAY.resolution)))
    want = columns(function, window, value, lambda1)
    got = plain_gate(window, value, lambda1=lambda1, resolution=ARRAY.resolution)
    assert all(close(one, other) for one, other in zip(got, want, strict=True))
    assert 0.2 < got[1].mean() < 0.8, "both branches"


@pytest.mark.parametrize("step", ["printed", "corrected"])
def test_the_lms_step(step) -> None:
    rng = np.random.default_rng(2)
    shapes = {"theta": 4, "theta_prev": 4, "X": 4, "x_n": 1, "errors": 8, "mean_error": 1}
    shapes |= {"relaxation": 1, "beta_max": 1}
    drawn = {name: rng.uniform(0.0, 1.3, (DRAWS, size)) for name, size in shapes.items()}
    drawn["x_n"] += 0.5
    symbols = {name: ca.SX.sym(name, size) for name, size in shapes.items()}
    out = lms_step(**symbols, step=step)
    want = columns(ca.Function("l", list(symbols.values()), list(out)), *drawn.values())
    flat = {name: value[:, 0] if value.shape[1] == 1 else value for name, value in drawn.items()}
    got = plain_lms_step(**flat, step=step)
    assert all(close(one, other) for one, other in zip(got, want, strict=True))
    still = np.all(got.theta == flat["theta"], axis=1)
    assert 0.01 < still.mean() < 0.99, "both branches"


@pytest.mark.parametrize(("step", "lambda1"), [("printed", 0.0), ("corrected", 3.0)])
def test_the_whole_filter_over_many_runs(step, lambda1) -> None:
    """50 runs of 60 ticks as a leading axis: 3,000 draws of the filter, four sensors each."""
    filter_, runs = SensorFilter(step=step), 50
    states, gain_layout = Layout(filter_.ports("s_")), Layout(filter_.gain_ports("s_"))
    gains = {"s_lambda1": lambda1, "s_relaxation": 0.7, "s_beta_max": 0.3}
    x, parts = states.symbols("x")
    p, gain_parts = gain_layout.symbols("p")
    samples_sym, fresh_sym = ca.SX.sym("samples", 4, 5), ca.SX.sym("fresh", 4)
    out = filter_.update(parts, samples_sym, fresh=fresh_sym, gains=gain_parts, prefix="s_")
    outputs = [states.join(out.state), out.range_hat, out.healthy]
    function = ca.Function("f", [x, ca.vec(samples_sym.T), fresh_sym, p], outputs)
    rng = np.random.default_rng(3)
    flat = np.tile(states.pack(), (runs, 1))
    truth = rng.uniform(0.2, 4.5, (runs, 4))
    healthy_seen = set()
    for _ in range(60):
        truth = np.where(rng.random((runs, 4)) < 0.05, rng.uniform(0.2, 4.5, (runs, 4)), truth)
        samples = np.clip(truth[..., None] + rng.normal(0, 0.02, (runs, 4, 5)), 0.2, 4.5)
        fresh = (rng.random((runs, 4)) < 0.6).astype(float)
        state = {port.name: flat[:, states.slice(port.name)].reshape(runs, *port.shape) for port in states.ports}
        before = {name: value.copy() for name, value in state.items()}
        got = plain_filter(filter_, state, samples, fresh=fresh, gains=gains, prefix="s_")
        packed = np.tile(gain_layout.pack(gains), (runs, 1))
        want = columns(function, flat, samples, fresh, packed)
        joined = np.concatenate([got.state[port.name].reshape(runs, -1) for port in states.ports], axis=1)
        assert close(joined, want[0]) and close(got.range_hat, want[1]) and close(got.healthy, want[2])
        assert all(np.array_equal(state[name], before[name]) for name in state), "state is not changed in place"
        healthy_seen |= set(np.unique(got.healthy))
        flat = want[0]
    assert 1.0 in healthy_seen


def test_an_unknown_step_is_named() -> None:
    one = np.ones(1)
    with pytest.raises(InputError, match="did you mean 'corrected'"):
        plain_lms_step(
            np.ones(4),
            np.ones(4),
            X=np.ones(4),
            x_n=one[0],
            errors=one,
            mean_error=one[0],
            relaxation=1.0,
            beta_max=0.0,
            step="corected",  # type: ignore[arg-type]
        )
