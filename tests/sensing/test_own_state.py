"""The own-state filter: its twin, its consistency, latency, gaps, wrong fixes and angles."""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

from surctl.errors import InputError
from surctl.ir import Layout, Port, lower, on_vectors
from surctl.marine.sensing import OwnState, OwnStateFilter
from surctl.marine.sensing.localisation.own_state import LONGEST_AGE, UNKNOWN_SD, OwnEstimate
from tests.oracles.own_state import own_state_step
from tests.oracles.steady_state import steady_sd

DT = 0.05
MODEL = Layout(tuple(Port(name, (4,), "SI", "") for name in ("mass", "linear_drag", "quadratic_drag", "thrust_limit")))
ALLOWED = {
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_INV, ca.OP_SQ, ca.OP_TWICE, ca.OP_SQRT),
    *(ca.OP_FABS, ca.OP_FLOOR, ca.OP_FMIN, ca.OP_FMAX, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND),
    *(ca.OP_OR, ca.OP_NOT, ca.OP_IF_ELSE_ZERO, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_SIN, ca.OP_COS),
}
NAMES = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")
LIMIT = [5.0, 5.0, 5.0, 0.5]
VEHICLE = [[95.0, 95.0, 95.0, 1.5], [2.0, 2.0, 0.0, 0.3], [60.0, 60.0, 90.0, 1.0], LIMIT]
UNEVEN = [[20.0, 26.0, 32.0, 0.6], [13.7, 0.0, 33.0, 0.0], [141.0, 217.0, 190.0, 1.5], LIMIT]
NO_DRAG = [[95.0, 95.0, 95.0, 1.5], [0.0] * 4, [0.0] * 4, LIMIT]
QUIET = {"fix": np.zeros(3), "fix_fresh": 0.0, "yaw": 0.0, "yaw_rate": 0.0, "tau": np.zeros(4)}


def model(vehicle):
    return dict(zip(NAMES, map(np.array, vehicle), strict=True))


def compiled(own, prefix=""):
    """(state, fix, fresh, yaw, rate, tau, model) → (state, eta, nu, position_sd, velocity_sd, age)."""
    layout = Layout(own.ports(prefix))
    x, state = layout.symbols("x")
    m, parts = MODEL.symbols("m")
    given = {name: ca.SX.sym(name, np.size(value)) for name, value in QUIET.items()}
    out = own.update(state, model=parts, prefix=prefix, **given)
    results = [layout.join(out.state), out.eta, out.nu, out.position_sd, out.velocity_sd, out.age]
    return ca.Function("own", [x, *given.values(), m], results), layout


@cache
def running(own, prefix=""):
    """What `compiled` gives, on vectors."""
    function, layout = compiled(own, prefix)
    return on_vectors(function), layout


class Filter:
    """The symbols, which are what ships, with their state; `test_symbols_and_numbers_agree` compares the numbers."""

    def __init__(self, own, vehicle=VEHICLE):
        self.step, self.layout = running(own)
        self.model = MODEL.pack(model(vehicle))
        self.state = {p.name: np.full(p.shape, p.default) for p in own.ports()}

    def __call__(self, **given):
        after, *found = self.step(self.layout.pack(self.state), *{**QUIET, **given}.values(), self.model)
        self.state = self.layout.unpack(after)
        return OwnEstimate(self.state, *found)


@pytest.mark.parametrize(
    ("vehicle", "latency", "lag", "prefix"),
    [(UNEVEN, 0.1, 0.3, "own_"), (VEHICLE, 0.0, 0.0, ""), (UNEVEN, 0.25, 0.3, "")],
)
def test_symbols_and_numbers_agree(vehicle, latency, lag, prefix):
    own = OwnStateFilter(dt=DT, latency=latency, thrust_lag=lag)
    f, layout = running(own, prefix)
    rng, x, truth, seen = np.random.default_rng(5), layout.pack(), model(vehicle), set()
    for k in range(400):
        jump = 2.0 * (k > 300)  # refused, then believed
        wild = (rng.random() < 0.1) * rng.normal(0, 0.5, 3)
        fix, fresh = 1.0 + jump + rng.normal(0, 0.01, 3) + wild, float(rng.random() < 0.4 and not 100 < k < 180)
        yaw, rate, tau = 3.0 + 0.02 * k + rng.normal(0, 0.05), rng.normal(0.4, 0.01), rng.normal(0, 5.0, 4)
        got = f(x, fix, fresh, yaw, rate, tau, MODEL.pack(truth))
        given = {"fix": fix, "fix_fresh": fresh, "yaw": yaw, "yaw_rate": rate, "tau": tau}
        out = own_state_step(own, layout.unpack(x), model=truth, prefix=prefix, **given)
        want = [layout.pack(out.state), out.eta, out.nu, out.position_sd, out.velocity_sd, out.age]
        for a, b in zip(got, want, strict=True):
            assert np.all(np.abs(a - b) <= 1e-12 * np.maximum(1.0, np.abs(b))), k
        before, after = layout.unpack(x), out.state
        if out.age[0] == own.latency:
            seen.add("accepted" if np.any(after[prefix + "disturbance"]) else "taken over")
        elif after[prefix + "refused"][0] > before[prefix + "refused"][0]:
            seen.add("refused")
        x = got[0]
    assert seen == {"accepted", "taken over", "refused"}


def test_the_law_can_carry_it():
    f, _ = compiled(OwnStateFilter(dt=DT))
    assert {f.instruction_id(k) for k in range(f.n_instructions())} <= ALLOWED
    assert len(lower(f).instructions) < 800


def matched(own, seeds, ticks, blind):
    """Truth drawn from the filter's own model: normalised squares of its errors, and what the outputs say of now.

    Without drag the covariance is exact; the yaw is that of the truth.
    """
    phi, noise = own.step
    delayed, place, speed = [], [], []
    for seed in range(seeds):
        rng, filter_ = np.random.default_rng(seed), Filter(own, NO_DRAG)
        x = np.array(
            [rng.normal(0, 3, 3), rng.normal(0, own.velocity_start_sd, 3), rng.normal(0, own.disturbance_sd, 3)]
        )
        left, mean = own.thrust_shares
        past, thrust, psi = [x] * own.late, np.zeros(4), rng.uniform(-3, 3)
        tau = np.zeros(4)
        for k in range(ticks):
            wanted = np.clip(tau, -5.0, 5.0)
            during = wanted + mean * (thrust - wanted)
            thrust = wanted + left * (thrust - wanted)
            push = during[:3] / 95.0
            c, s = math.cos(psi), math.sin(psi)
            push = np.array([c * push[0] - s * push[1], s * push[0] + c * push[1], push[2]])
            if k:
                root = np.linalg.cholesky(noise + (push @ push) * own.model_covariance)
                x = phi @ x + np.outer([0.5 * DT**2, DT, 0.0], push) + root @ rng.standard_normal((3, 3))
                past = [*past, x][-own.late - 1 :]
            fresh = k % 2 == 0 and k >= own.late and not blind[0] <= k < blind[1]
            fix = past[0][0] + rng.normal(0, own.position_sd, 3)
            out = filter_(fix=fix, fix_fresh=float(fresh), yaw=psi, tau=tau)
            tau = np.append(rng.uniform(-6.0, 6.0, 3), 0.0)
        P = np.zeros((3, 3))
        P[np.triu_indices(3)] = out.state["covariance"]
        P = P + np.triu(P, 1).T
        error = np.array([out.state[name] for name in ("position", "velocity", "disturbance")]) - past[0]
        delayed.append(np.sum(error * np.linalg.solve(P, error)))
        c, s = math.cos(out.eta[3]), math.sin(out.eta[3])
        now = np.array([c * out.nu[0] - s * out.nu[1], s * out.nu[0] + c * out.nu[1], out.nu[2]])
        place.append(np.sum((out.eta[:3] - x[0]) ** 2) / out.position_sd[0] ** 2)
        speed.append(np.sum((now - x[1]) ** 2) / out.velocity_sd[0] ** 2)
    return np.sum(delayed), np.sum(place), np.sum(speed)


@pytest.mark.parametrize(("ticks", "blind"), [(12, (0, 0)), (161, (100, 161))])  # settled: study 40
def test_errors_are_as_large_as_the_filter_says(ticks, blind):
    """Normalised errors within chi-square bounds of 99.9 %: soon after the start, settled, 3 s after the last fix."""
    own, seeds = OwnStateFilter(dt=DT, yaw_sd=1e-4, rate_sd=1e-4), 25
    for square, freedom in zip(matched(own, seeds, ticks, blind), (9, 3, 3), strict=True):
        low, high = chi2.ppf([0.0005, 0.9995], freedom * seeds)
        assert low < square < high


def test_the_settled_deviations_are_those_of_the_recursion():
    own = OwnStateFilter(dt=DT)
    filter_ = Filter(own)
    for k in range(1000):
        out = filter_(fix_fresh=float(k % 2 == 0))
        if k % 2 == 0:
            at_fix = out
    assert (at_fix.position_sd[0], at_fix.velocity_sd[0]) == pytest.approx(steady_sd(own, 2), rel=1e-9)
    assert at_fix.position_sd[0] < own.position_sd


def along_a_line(own, *, speed=0.22, ticks=400):
    """Exact late fixes of a robot whose thrust holds its drag: the last estimate, and where it is."""
    filter_, force = Filter(own), 2.0 * speed + 60.0 * speed**2
    for k in range(ticks):
        then = np.array([speed * DT * (k - 2), 0.0, 0.0])
        out = filter_(fix=then, fix_fresh=float(k % 2 == 0 and k >= 2), tau=np.array([force, 0.0, 0.0, 0.0]))
    return out, speed * DT * (ticks - 1)


def test_a_late_fix_is_compared_with_what_was_then():
    out, truth = along_a_line(OwnStateFilter(dt=DT, latency=0.1))
    assert out.eta[0] == pytest.approx(truth, abs=1e-4)
    assert out.nu[0] == pytest.approx(0.22, abs=2e-4)
    naive, truth = along_a_line(OwnStateFilter(dt=DT, latency=0.0))
    assert truth - naive.eta[0] == pytest.approx(0.1 * 0.22, abs=2e-3)


def test_a_gap_widens_the_deviations_and_the_next_fix_then_counts_for_more():
    filter_, gains = Filter(OwnStateFilter(dt=DT)), {}
    for k in range(401):
        filter_(fix_fresh=float(k % 2 == 0))
    settled = dict(filter_.state)
    for seconds in (0.1, 1.0, 3.0):
        filter_.state = dict(settled)
        for _ in range(round(seconds / DT) - 1):
            out = filter_()
        sd, age = out.position_sd[0], out.age[0]
        after = filter_(fix=np.array([0.01, 0.0, 0.0]), fix_fresh=1.0)
        gains[seconds] = sd, age, after.eta[0] / 0.01
        assert after.age[0] == 0.1 and after.position_sd[0] < sd
    assert gains[0.1][0] < gains[1.0][0] < gains[3.0][0]
    assert gains[0.1][2] < 0.5 < 0.8 < gains[3.0][2] < 1.2
    assert gains[3.0][1] == pytest.approx(3.05)  # the last one described what was 0.1 s before it arrived


def test_before_the_first_fix_nothing_is_known_and_it_is_taken_over():
    filter_ = Filter(OwnStateFilter(dt=DT))
    for _ in range(100):
        out = filter_(yaw=1.0)
        assert out.position_sd[0] == UNKNOWN_SD and out.age[0] == LONGEST_AGE
    assert out.eta[3] == pytest.approx(1.0)
    out = filter_(fix=np.array([7.0, -8.0, -0.15]), fix_fresh=1.0)
    assert out.eta[:3] == pytest.approx([7.0, -8.0, -0.15]) and out.age[0] == 0.1
    assert 0.01 <= out.position_sd[0] < 0.02


def settled_filter():
    filter_ = Filter(OwnStateFilter(dt=DT))
    for k in range(200):
        filter_(fix_fresh=float(k % 2 == 0))
    return filter_


def test_a_wrong_fix_is_refused():
    filter_ = settled_filter()
    for k in range(8):  # each in a place of its own: never believed
        out = filter_(fix=np.array([0.5 + 0.3 * k, 0.0, 0.0]), fix_fresh=1.0)
        assert np.abs(out.eta[:3]).max() < 1e-9 and out.state["refused"][0] == 1.0
    assert out.age[0] > 0.4
    assert filter_(fix_fresh=1.0).state["refused"][0] == 0.0


def test_a_right_fix_between_two_wrong_ones_begins_the_count_anew():
    filter_ = settled_filter()
    for k in range(9):
        out = filter_(fix=np.array([0.5 * (k % 3 < 2), 0.0, 0.0]), fix_fresh=1.0)
        assert np.abs(out.eta[0]) < 0.05
    assert out.state["refused"][0] == 0.0


def test_three_refused_fixes_that_agree_are_believed():
    filter_ = settled_filter()
    xs = [filter_(fix=np.array([0.5, 0.0, 0.0]), fix_fresh=1.0).eta[0] for _ in range(3)]
    assert np.abs(xs[:2]).max() < 1e-9 and xs[2] == pytest.approx(0.5)


def test_a_robot_that_moves_on_is_believed_too():
    """Refused fixes agree by how far they lie off, not by where they are."""
    own = OwnStateFilter(dt=DT)
    filter_, x, xs = Filter(own), 0.0, []
    for k in range(240):
        x = 0.22 * DT * k + 0.5 * (k > 200)
        out = filter_(fix=np.array([x, 0, 0]), fix_fresh=float(k % 4 == 0), tau=np.array([3.344, 0, 0, 0]))
        xs.append(out.eta[0] - x)
    assert xs[208] < -0.4 and abs(xs[212]) < 0.05


@pytest.mark.parametrize("turns", [0, 3, -2])
def test_yaw_turns_through_the_cut_without_a_jump(turns):
    filter_, rng = Filter(OwnStateFilter(dt=DT)), np.random.default_rng(1)
    errors = []
    for k in range(400):
        psi = 2.5 + 0.45 * DT * k
        tau = np.array([0.0, 0.0, 0.0, 0.3 * 0.45 + 0.45**2])
        measured = psi + 2 * math.pi * turns + rng.normal(0, 0.01)
        out = filter_(yaw=measured, yaw_rate=0.45 + rng.normal(0, 0.005), tau=tau)
        assert -math.pi < out.eta[3] <= math.pi
        errors.append((math.remainder(out.eta[3] - psi, 2 * math.pi), out.nu[3] - 0.45))
    late = np.array(errors[100:])
    assert np.sqrt(np.mean(late**2, axis=0))[0] < 0.003
    assert np.sqrt(np.mean(late**2, axis=0))[1] < 0.006


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("position_sd", {"position_sd": math.nan}),
        ("yaw_sd", {"yaw_sd": 0.0}),
        ("latency", {"latency": -0.1}),
        ("latency", {"latency": 1.0}),
        ("latency", {"latency": 0.08}),
        ("dt", {"dt": math.inf}),
        ("thrust_lag", {"thrust_lag": math.nan}),
        ("model_noise", {"model_noise": -1.0}),
        ("gate", {"gate": 0.0}),
    ],
)
def test_mistakes_are_named(key, values):
    with pytest.raises(InputError, match=rf"own_state\.{key}"):
        OwnStateFilter(**{"dt": DT, **values})


def test_the_filter_and_the_sensors_it_is_made_for_agree():
    own, sensors = OwnStateFilter(dt=DT), OwnState()
    for name in ("position_sd", "yaw_sd", "rate_sd"):
        assert getattr(own, name) == getattr(sensors, name)
    assert own.latency == sensors.fixes.latency
