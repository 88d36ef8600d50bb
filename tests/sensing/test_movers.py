"""Moving obstacles from messages: the twin, the way carried on, the bound, and when a slot is empty."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, Port, lower
from surctl.marine.sensing import BaseStation, Delivery
from surctl.marine.sensing.localisation.movers import MoverTracker
from tests.oracles import measurements
from tests.oracles.movers import mover_step

DT = 0.05


def compiled(tracker, prefix=""):
    layout = Layout(tracker.ports(prefix))
    x, state = layout.symbols("x")
    given = Layout((Port("message", (tracker.slots, 6), "SI", ""), Port("message_fresh", (1,), "1", "")))
    u, told = given.symbols("u")
    out = tracker.update(state, prefix=prefix, **told)
    rows = ca.reshape(out.rows.T, -1, 1)
    return ca.Function("f", [x, u], [layout.join(out.state), rows, out.bound, out.age]), layout


class Tracker:
    """The numeric twin with its state."""

    def __init__(self, tracker):
        self.tracker = tracker
        self.state = {p.name: np.full(p.shape, p.default) for p in tracker.ports()}

    def __call__(self, message=None):
        given = np.zeros((self.tracker.slots, 6)) if message is None else np.array(message)
        out = mover_step(self.tracker, self.state, message=given, message_fresh=float(message is not None))
        self.state = out.state
        return out


@pytest.mark.parametrize(("slots", "prefix"), [(1, ""), (3, "movers_")])
def test_symbols_and_numbers_agree(slots, prefix):
    tracker = MoverTracker(dt=DT, slots=slots, forget=0.6)
    f, layout = compiled(tracker, prefix)
    rng, x, seen = np.random.default_rng(2), layout.pack(), set()
    for _ in range(800):
        message, fresh = rng.normal(0, 2, (slots, 6)), float(rng.random() < 0.1)
        message[:, 5] = rng.random(slots) < 0.7
        got = [np.array(v) for v in f(x, np.append(message, fresh))]
        out = mover_step(tracker, layout.unpack(x), message=message, message_fresh=fresh, prefix=prefix)
        for a, b in zip(got, (layout.pack(out.state), out.rows, out.bound, out.age), strict=True):
            assert np.abs(a.reshape(-1) - np.reshape(b, -1)).max() <= 1e-12
        seen |= {(bool(fresh), bool(v)) for v in out.rows[:, 5]}
        x = got[0].ravel()
    assert len(seen) == 4
    assert len(lower(f).instructions) < 60 * slots + 40


def test_it_starts_empty():
    out = Tracker(MoverTracker(dt=DT, slots=2))()
    assert not out.rows.any() and not out.bound.any()


def test_an_obstacle_is_carried_on_from_what_the_message_describes():
    """Told at 0.1 s of age: it is already 0.1 s further, and goes on while nothing comes."""
    track = Tracker(MoverTracker(dt=DT, slots=1))
    out = track([[1.0, 2.0, 0.27, 0.2, -0.1, 1.0]])
    assert out.rows[0] == pytest.approx([1.02, 1.99, 0.27, 0.2, -0.1, 1.0]) and out.age[0] == pytest.approx(0.1)
    for _ in range(20):
        out = track()
    assert out.rows[0] == pytest.approx([1.22, 1.89, 0.27, 0.2, -0.1, 1.0]) and out.age[0] == pytest.approx(1.1)


def test_the_bound_grows_by_the_square_of_the_age():
    track = Tracker(
        MoverTracker(dt=DT, slots=1, position_sd=0.01, velocity_sd=0.02, acceleration=0.05, sigmas=2.0, latency=0.5)
    )
    assert track([[0.0] * 5 + [1.0]]).bound[0] == pytest.approx(2 * (0.01 + 0.02 * 0.5) + 0.025 * 0.25)
    for _ in range(30):
        out = track()
    assert out.bound[0] == pytest.approx(2 * (0.01 + 0.02 * 2.0) + 0.025 * 4.0)


def test_a_slot_is_forgotten_in_time_or_cleared_at_once():
    track = Tracker(MoverTracker(dt=DT, slots=2, forget=1.0))
    track([[1.0, 0, 0.3, 0, 0, 1.0], [2.0, 0, 0.3, 0, 0, 1.0]])
    valid = [track().rows[:, 5].tolist() for _ in range(20)]
    assert valid[:18] == [[1.0, 1.0]] * 18 and valid[18:] == [[0.0, 0.0]] * 2  # 0.1 s old + 18 steps = 1 s
    track([[1.0, 0, 0.3, 0, 0, 1.0], [2.0, 0, 0.3, 0, 0, 1.0]])
    assert track([[1.0, 0, 0.3, 0, 0, 1.0], [0.0] * 6]).rows[:, 5].tolist() == [1.0, 0.0]


@pytest.mark.parametrize("loss", [0.0, 0.9])
def test_the_bound_holds_what_it_says(loss):
    """Obstacles turn under the largest acceleration: outside in at most the 1.1 % of three deviations."""
    station, tracker = BaseStation(messages=Delivery(loss=loss)), MoverTracker(dt=DT, slots=200)
    track, rng, outside, worst = Tracker(tracker), np.random.default_rng(0), [], []
    turn = tracker.acceleration / 0.25  # [rad/s] at 0.25 m/s
    phase = rng.uniform(0, 2 * np.pi, tracker.slots)

    def at(time):
        angle = phase + turn * time
        place = 0.25 / turn * np.column_stack([np.sin(angle), -np.cos(angle)])
        return np.column_stack(
            [place, np.full(len(phase), 0.27), 0.25 * np.cos(angle), 0.25 * np.sin(angle), np.ones(len(phase))]
        )

    for tick in range(300):
        then = at((tick - station.messages.late(DT)) * DT)
        noise, chance = rng.standard_normal((tracker.slots, 4)), rng.standard_normal()
        message, fresh = measurements.message(station, then, tick, noise=noise, chance=chance, dt=DT)
        out = track(message if fresh else None)
        if out.rows[0, 5]:
            off = np.linalg.norm(out.rows[:, :2] - at(tick * DT)[:, :2], axis=1)
            outside.append(off > out.bound)
            worst.append(out.age[0])
    assert len(outside) > 250 and (loss == 0 or max(worst) > 0.5)
    assert 0.0001 < np.mean(outside) < 0.0112


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("slots", {"slots": 0}),
        ("slots", {"slots": 1.5}),
        ("dt", {"dt": 0.0}),
        ("latency", {"latency": -0.1}),
        ("position_sd", {"position_sd": math.nan}),
        ("velocity_sd", {"velocity_sd": -1.0}),
        ("acceleration", {"acceleration": math.inf}),
        ("forget", {"forget": 0.1}),
        ("forget", {"forget": math.nan}),
        ("sigmas", {"sigmas": -1.0}),
    ],
)
def test_mistakes_are_named(key, values):
    with pytest.raises(InputError, match=rf"movers\.{key}"):
        MoverTracker(**{"dt": DT, "slots": 2, **values})
