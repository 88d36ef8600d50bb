"""The symbolic filters against a plain-Python rewriting, and the claims of E5, E6, E19."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.marine.sensing import SensorFilter, SonarArray
from surctl.marine.sensing.ranging.filters import gate, lms_step, weighted_average
from surctl.marine.world import Wall
from tests.oracles.echoes import fire

ARRAY = SonarArray()
ALLOWED = {
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_INV, ca.OP_SQ, ca.OP_TWICE, ca.OP_SQRT),
    *(ca.OP_FABS, ca.OP_FLOOR, ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND),
    *(ca.OP_OR, ca.OP_NOT, ca.OP_IF_ELSE_ZERO, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT),
}


def compiled(filter_, prefix=""):
    """The filter as a Function of flat vectors: (state, samples, fresh, gains) → (state, range, healthy)."""
    states, gain_layout = Layout(filter_.ports(prefix)), Layout(filter_.gain_ports(prefix))
    x, parts = states.symbols("x")
    p, gains = gain_layout.symbols("p")
    samples, fresh = ca.SX.sym("samples", 4, 5), ca.SX.sym("fresh", 4)
    out = filter_.update(parts, samples, fresh=fresh, gains=gains, prefix=prefix)
    function = ca.Function("f", [x, samples, fresh, p], [states.join(out.state), out.range_hat, out.healthy])
    return function, states, gain_layout


def plain_update(old, samples, gains, filter_):
    """One sensor that fired, rewritten from the paper's formulas in plain Python."""
    d = sum((j + 1) * s for j, s in enumerate(samples)) / 15.0
    window = list(old["window"])
    mean = sum(window) / len(window)
    s2 = sum(v * v for v in window) / len(window) - mean**2
    spread = max(math.sqrt(max(s2, 0.0)), ARRAY.maximum / 255)
    accepted = abs(d - window[0]) < gains["lambda1"] * spread
    x_n = d if accepted else mean
    X, theta = np.array(old["history"]), np.array(old["theta"])
    residual = x_n - float(theta @ X)
    errors = [abs(residual), *old["errors"][:-1]]
    N = len(errors)
    e = sum((1 - i / N) * errors[i] for i in range(N)) / N
    mean_error = float(old["mean_error"])
    after = theta
    if e >= mean_error:
        beta = min(max(gains["beta_max"], 0.0), 0.5) * min(1.0, e / max(mean_error, 1e-9))
        two_mu = 2.0 if filter_.step == "printed" else min(max(gains["relaxation"], 0.0), 1.0)
        after = theta + two_mu / float(X @ X) * residual * X + beta * (theta - np.array(old["theta_prev"]))
    if accepted and abs(x_n - X[0]) > filter_.jump:
        uniform = np.full(len(X), 1 / len(X))
        return {
            "window": [d, *window[:-1]],
            "history": [x_n] * len(X),
            "theta": uniform,
            "theta_prev": uniform,
            "errors": list(old["errors"]),
            "mean_error": mean_error,
            "refused": 0.0,
        }
    refused = 0.0 if accepted or gains["lambda1"] <= 0 else min(float(old["refused"]) + 1, filter_.refusals)
    return {
        "window": [d, *window[:-1]],
        "history": [x_n, *X[:-1]],
        "theta": after,
        "theta_prev": theta,
        "errors": errors,
        "mean_error": mean_error + (e - mean_error) / N,
        "refused": refused,
    }


@pytest.mark.parametrize("step", ["corrected", "printed"])
@pytest.mark.parametrize("lambda1", [0.0, 1.0, 3.0])
def test_update_equals_a_plain_rewriting(step, lambda1):
    filter_ = SensorFilter(step=step)
    f, states, gain_layout = compiled(filter_, "sonar_")
    rng = np.random.default_rng(3)
    gains = {"lambda1": lambda1, "relaxation": 0.7, "beta_max": 0.3}
    p = gain_layout.pack({f"sonar_{k}": v for k, v in gains.items()})
    names = [port.name.removeprefix("sonar_") for port in filter_.ports("sonar_")]
    seen = set()
    x = states.pack()
    truth = np.array([1.0, 2.0, 0.3, 4.5])
    for k in range(60):
        if k % 15 == 14:
            truth = rng.uniform(0.2, 4.5, 4)
        samples = np.clip(truth[:, None] + rng.normal(0, 0.02, (4, 5)), 0.2, 4.5)
        fresh = (rng.random(4) < 0.6).astype(float)
        before = {k: v.copy() for k, v in states.unpack(x).items()}
        x, ranges, healthy = (np.array(o).ravel() for o in f(x, samples, fresh, p))
        after = states.unpack(x)
        for i in range(4):
            old = {name: before[f"sonar_{name}"][i] for name in names}
            new = plain_update(old, samples[i], gains, filter_) if fresh[i] else old
            seen.add((bool(fresh[i]), bool(np.any(new["theta"] != old["theta"])), bool(new["refused"] > 0)))
            for name in names:
                got, want = after[f"sonar_{name}"][i], np.array(new[name])
                # the printed rule never settles: its weights grow, so the tolerance is relative
                assert np.all(np.abs(got - want) <= 1e-12 * np.maximum(1.0, np.abs(want))), (k, i, name)
                if not fresh[i]:
                    assert np.array_equal(got, want)
            want = min(new["history"][0], float(np.dot(new["theta"], new["history"])))
            assert ranges[i] == pytest.approx(min(max(want, 0.2), 4.5), abs=1e-12)
            assert bool(healthy[i]) == (new["refused"] < 3)
    assert {s[:2] for s in seen} >= {(True, True), (True, False), (False, False)}
    assert (lambda1 == 0.0) or any(s[2] for s in seen)


def test_average_weighs_the_newest_most():
    f = ca.Function("f", [s := ca.SX.sym("s", 5)], [weighted_average(s)])
    assert float(f([2, 2, 2, 2, 2])) == pytest.approx(2.0)
    assert float(f([0, 0, 0, 0, 15])) == pytest.approx(5.0)
    assert float(f([15, 0, 0, 0, 0])) == pytest.approx(1.0)


def gate_function():
    w, v, lam = ca.SX.sym("w", 8), ca.SX.sym("v"), ca.SX.sym("l")
    return ca.Function("g", [w, v, lam], list(gate(w, v, lambda1=lam, resolution=ARRAY.resolution)))


def test_gate_floor_keeps_a_constant_signal_open():
    g = gate_function()
    step = ARRAY.resolution
    value, accepted, _ = g([1.0] * 8, 1.0 + 0.9 * step, 1.0)
    assert (float(value), float(accepted)) == (pytest.approx(1.0 + 0.9 * step), 1.0)
    value, accepted, _ = g([1.0] * 8, 1.0 + 1.1 * step, 1.0)
    assert (float(value), float(accepted)) == (pytest.approx(1.0), 0.0)


def test_gate_with_lambda_zero_is_the_running_mean():
    window = np.linspace(1.0, 1.7, 8)
    value, accepted, _ = gate_function()(window, window[0], 0.0)
    assert (float(value), float(accepted)) == (pytest.approx(window.mean()), 0.0)


def test_gate_refuses_a_spike_once_and_takes_a_jump_at_the_second_reading():
    g = gate_function()
    value, accepted, window = g([3.0] * 8, 1.0, 3.0)
    assert (float(value), float(accepted)) == (pytest.approx(3.0), 0.0)
    value, accepted, _ = g(window, 1.01, 3.0)
    assert (float(value), float(accepted)) == (pytest.approx(1.01), 1.0)


def lms_function(step, N=1):
    theta, prev, X = (ca.SX.sym(n, 4) for n in ("theta", "prev", "X"))
    x_n, mean, rho, beta = (ca.SX.sym(n) for n in ("x_n", "mean", "rho", "beta"))
    errors = ca.SX.sym("errors", N)
    out = lms_step(theta, prev, X=X, x_n=x_n, errors=errors, mean_error=mean, relaxation=rho, beta_max=beta, step=step)
    return ca.Function("lms", [theta, prev, X, x_n, errors, mean, rho, beta], [out.theta, out.residual])


@pytest.mark.parametrize(("step", "factor"), [("printed", -1.0), ("corrected", 0.0)])
def test_residual_after_the_update_e5(step, factor):
    rng = np.random.default_rng(0)
    lms = lms_function(step)
    for _ in range(100):
        theta, X, x_n = rng.normal(size=4), rng.uniform(0.2, 4.5, 4), rng.uniform(0.2, 4.5)
        after, residual = lms(theta, theta, X, x_n, 0.0, 0.0, 1.0, 0.0)
        assert x_n - float(np.array(after).ravel() @ X) == pytest.approx(factor * float(residual), abs=1e-12)


def test_relaxation_is_held_below_the_optimum():
    lms = lms_function("corrected")
    args = (np.full(4, 0.3), np.full(4, 0.3), [1.0, 1.1, 1.2, 1.3], 1.0, 0.0, 0.0)
    assert np.array_equal(np.array(lms(*args, 5.0, 0.0)[0]), np.array(lms(*args, 1.0, 0.0)[0]))


def test_no_update_below_the_historic_mean():
    lms = lms_function("corrected")
    theta = np.full(4, 0.3)
    X = [1.0, 1.0, 1.0, 1.0]
    still = lms(theta, np.zeros(4), X, 1.0, 0.0, 10.0, 1.0, 0.5)[0]
    moved = lms(theta, np.zeros(4), X, 1.0, 0.0, 0.0, 1.0, 0.5)[0]
    assert np.array_equal(np.array(still).ravel(), theta)
    assert np.abs(np.array(moved).ravel() - theta).max() > 0.01


@pytest.mark.parametrize(("step", "limit"), [("corrected", 1e-6), ("printed", None)])
def test_only_the_corrected_step_converges(step, limit):
    lms = lms_function(step)
    theta = np.array([1.0, 0.5, -0.2, 0.4])
    residuals = []
    for _ in range(60):
        after, residual = lms(theta, theta, [1.0] * 4, 1.0, 0.0, 0.0, 0.5, 0.0)
        theta = np.array(after).ravel()
        residuals.append(abs(float(residual)))
    if limit is None:
        assert residuals[-1] == pytest.approx(residuals[0], rel=1e-9)
    else:
        assert residuals[-1] < limit


def test_unknown_step_is_named():
    with pytest.raises(InputError, match="did you mean 'corrected'"):
        SensorFilter(step="corected")  # type: ignore[arg-type]


def test_every_operation_can_be_exported():
    f, _, _ = compiled(SensorFilter())
    operations = {f.instruction_id(k) for k in range(f.n_instructions())}
    assert operations <= ALLOWED
    assert f.n_instructions() < 4000


def run(distance, *, seed=0, cycles=80, step="corrected"):
    """Ranges and health of the front sensor over a run; `distance(t)` is the true range."""
    filter_ = SensorFilter(step=step)
    f, states, gains = compiled(filter_)
    rng = np.random.default_rng(seed)
    x, rows = states.pack(), []
    for k in range(cycles):
        true = distance(k * ARRAY.cycle)
        wall = Wall((ARRAY.hull_radius + true, 0.0), (-1.0, 0.0))
        samples = np.tile(
            fire(ARRAY, 0, position=(0, 0), heading=0.0, shapes=(wall,), noise=rng.standard_normal(5)), (4, 1)
        )
        x, ranges, healthy = f(x, samples, np.ones(4), gains.pack())
        rows.append((true, float(ranges[0]), float(healthy[0])))
    return np.array(rows).T


def test_a_still_target_is_measured_within_two_centimetres():
    errors = []
    for seed in range(6):
        true, seen, healthy = run(lambda t: 1.5, seed=seed)
        assert healthy[5:].all()
        errors.append((seen - true)[20:])
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def test_an_approach_at_full_speed_is_followed():
    errors = []
    for seed in range(6):
        true, seen, healthy = run(lambda t: 4.0 - 0.22 * t, seed=seed, cycles=150)
        assert healthy[5:].all()
        errors.append((seen - true)[20:])
    assert np.sqrt(np.mean(np.square(errors))) < 0.03
    assert np.max(errors) < 0.06


def test_nothing_is_believed_before_the_first_accepted_value():
    f, states, gains = compiled(SensorFilter())
    _, ranges, healthy = f(states.pack(), np.full((4, 5), 4.5), np.zeros(4), gains.pack())
    assert np.all(np.array(healthy) == 0) and np.all(np.array(ranges) == 4.5)
    _, _, healthy = f(states.pack(), np.full((4, 5), 4.5), [1, 0, 0, 0], gains.pack())
    assert np.array(healthy).ravel().tolist() == [1, 0, 0, 0]


def test_incoherent_readings_make_a_sensor_unhealthy():
    f, states, gains = compiled(SensorFilter())
    x = states.pack()
    # jumps that grow faster than the spread they cause
    for value in (4.5, 4.5, 2.0, 4.4, 0.3, 4.5):
        x, _, healthy = f(x, np.full((4, 5), value), np.ones(4), gains.pack({"lambda1": 0.5}))
    assert not np.array(healthy).any()


def test_an_object_that_appears_is_not_preceded_by_a_phantom():
    f, states, gain_layout = compiled(SensorFilter(), "sonar_")
    p = gain_layout.pack()
    x = states.pack()
    heard = []
    for k in range(24):
        distance = 4.5 if k < 12 else 1.0
        x, ranges, _ = (np.array(o).ravel() for o in f(x, np.full((4, 5), distance), np.ones(4), p))
        heard.append(ranges[0])
    assert min(heard) >= 0.95
    assert heard[13] == pytest.approx(1.0, abs=1e-9)  # one firing late, no more
