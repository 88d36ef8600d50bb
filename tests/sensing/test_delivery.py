"""When messages arrive: numbers and symbols agree, late, lost, and none in a gap."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.sensing import Delivery
from surctl.marine.sensing.localisation.base_station import delayed_symbols
from tests.oracles.measurements import arrives, delayed

DT = 0.05


def arrivals(delivery, ticks, *, chance=0.0):
    return [k for k in range(ticks) if arrives(delivery, k, chance=chance, dt=DT)]


def test_messages_come_at_their_period_after_the_latency():
    assert arrivals(Delivery(), 10) == [2, 4, 6, 8]
    assert arrivals(Delivery(period=0.15, latency=0.25), 15) == [5, 8, 11, 14]
    assert arrivals(Delivery(latency=0.0), 5) == [0, 2, 4]


def test_a_gap_is_of_the_measurements_not_of_the_arrivals():
    """Nothing is measured at 0.2 s and 0.3 s (ticks 4 and 6), so nothing arrives at ticks 6 and 8."""
    assert arrivals(Delivery(gaps=((0.2, 0.4),)), 14) == [2, 4, 10, 12]
    assert arrivals(Delivery(gaps=((0.0, 0.1), (0.3, 0.35))), 14) == [4, 6, 10, 12]


def test_the_chance_of_a_loss():
    rng, delivery = np.random.default_rng(0), Delivery(loss=0.2)
    lost = [not arrives(delivery, 2, chance=c, dt=DT) for c in rng.standard_normal(20_000)]
    assert np.mean(lost) == pytest.approx(0.2, abs=0.01)
    assert arrivals(Delivery(loss=1.0), 50, chance=40.0) == []
    assert len(arrivals(Delivery(loss=0.0), 51, chance=-40.0)) == 25


@given(
    period=st.integers(1, 7),
    latency=st.integers(0, 6),
    loss=st.sampled_from([0.0, 0.3, 1.0]),
    start=st.floats(0.0, 3.0),
    length=st.floats(0.01, 2.0),
    chance=st.floats(-4.0, 4.0),
)
def test_symbols_and_numbers_agree(period, latency, loss, start, length, chance):
    delivery = Delivery(period=period * DT, latency=latency * DT, loss=loss, gaps=((start, start + length),))
    tick, number = ca.SX.sym("tick"), ca.SX.sym("chance")
    f = ca.Function("f", [tick, number], [delivery.arrives_symbols(tick, chance=number, dt=DT)])
    ticks = np.arange(120)
    got = np.array(f(ticks[None], np.full((1, 120), chance))).ravel()
    assert np.array_equal(got == 1, [arrives(delivery, int(k), chance=chance, dt=DT) for k in ticks])


@pytest.mark.parametrize("steps", [0, 1, 3])
def test_what_was_so_many_steps_ago(steps):
    ring, symbol = np.zeros((steps, 2)), ca.SX.sym("ring", steps, 2)
    now = ca.SX.sym("now", 2)
    f = ca.Function("f", [symbol, now], list(delayed_symbols(symbol, now)))
    for k in range(8):
        value = np.array([k + 1.0, -k - 1.0])
        same = [np.array(v) for v in f(ring, value)]
        then, ring = delayed(ring, value)
        assert then == pytest.approx(max(0, k + 1 - steps) * np.array([1.0, -1.0]))
        assert np.array_equal(same[0].ravel(), then) and np.array_equal(same[1], ring)


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("period", {"period": 0.0}),
        ("period", {"period": math.nan}),
        ("latency", {"latency": -0.1}),
        ("latency", {"latency": math.inf}),
        ("loss", {"loss": 1.1}),
        ("loss", {"loss": math.nan}),
        ("gaps", {"gaps": ((1.0, 1.0),)}),
        ("gaps", {"gaps": ((-1.0, 1.0),)}),
        ("gaps", {"gaps": ((1.0, math.nan),)}),
    ],
)
def test_mistakes_are_named(key, values):
    with pytest.raises(InputError, match=rf"delivery\.{key}"):
        Delivery(**values)


def test_times_that_are_no_multiple_of_the_period_are_refused():
    with pytest.raises(InputError, match=r"delivery\.latency"):
        Delivery(latency=0.12).late(DT)
    with pytest.raises(InputError, match=r"delivery\.period"):
        Delivery(period=0.12).every(DT)
    with pytest.raises(InputError, match=r"delivery\.period"):
        Delivery(period=0.01, latency=0.0).every(DT)
