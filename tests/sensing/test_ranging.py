"""The range tracker: accuracy, and what it makes of every fault of a stream."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, on_vectors
from surctl.marine.sensing import RangeTracker, SonarArray
from surctl.marine.sensing.ranging.tracker import Ranging
from surctl.marine.world import Wall
from tests.oracles.echoes import fire
from tests.sensing.test_filters import ALLOWED

DT = 0.05
ONE = SonarArray(azimuths=(0.0,), order=(0,), firing_period=0.1)
TWO = SonarArray(azimuths=(0.0, np.pi / 2), order=(0, 1), firing_period=0.05)
UNKNOWN = 9.0


@cache
def compiled(tracker: RangeTracker, prefix: str = "") -> tuple[ca.Function, Layout]:
    """(state, samples, fresh, closing, expected, turn) → (state, the other fields of `Ranging`)."""
    n, k = tracker.array.size, tracker.array.samples
    layout = Layout(tracker.ports(prefix))
    x, parts = layout.symbols("x")
    samples, fresh = ca.SX.sym("s", n, k), ca.SX.sym("f", n)
    closing, expected, turn = ca.SX.sym("c", n), ca.SX.sym("e", n), ca.SX.sym("w")
    out = tracker.update(parts, samples, fresh=fresh, closing=closing, expected=expected, turn=turn, prefix=prefix)
    inputs = [x, samples, fresh, closing, expected, turn]
    return ca.Function("tracker", inputs, [layout.join(out.state), *out[1:]]), layout


def test_every_operation_can_be_exported() -> None:
    function, _ = compiled(RangeTracker())
    assert {function.instruction_id(k) for k in range(function.n_instructions())} <= ALLOWED
    assert function.n_instructions() < 6000


# ------------------------------------------------------------------------------------------------------------- streams


@dataclass
class Flight:
    """One sensor looking at a thing that may move; every step is recorded."""

    truth: Callable[[float], float]
    closing: Callable[[float], float] = lambda t: 0.0
    expected: Callable[[float], float] = lambda t: UNKNOWN
    turn: Callable[[float], float] = lambda t: 0.0
    array: SonarArray = ONE
    other: float = 3.0
    seed: int = 0
    tracker: RangeTracker | None = None
    rows: dict[str, list[float]] = field(default_factory=dict)

    def fly(self, seconds: float, fault: Callable[[int, list[np.ndarray]], np.ndarray | None] | None = None) -> Flight:
        """`fault` gets the firing's number and all honest samples so far; None: nothing arrives."""
        tracker = self.tracker or RangeTracker(array=self.array, dt=DT)
        rng = np.random.default_rng(self.seed)
        function, layout = compiled(tracker)
        step, state, honest = on_vectors(function), layout.pack(), []
        for tick in range(round(seconds / DT)):
            t = tick * DT
            samples, fresh = np.full((self.array.size, self.array.samples), 1.0), np.zeros(self.array.size)
            if tick % 2 == 0:
                honest.append(self._heard(self.truth(t), rng))
                given = fault(tick // 2, honest) if fault else honest[-1]
                fresh[0] = given is not None
                if given is not None:
                    samples[0] = given
                if self.array.size > 1:
                    samples[1], fresh[1] = self._heard(self.other, rng), 1.0
            along = np.zeros(self.array.size)
            along[0] = self.closing(t) + 0.01 * rng.standard_normal()
            walls = np.full(self.array.size, UNKNOWN)
            walls[0] = self.expected(t)
            state, *found = step(state, samples, fresh, along, walls, self.turn(t))
            for name, value in zip(Ranging._fields[1:], found, strict=True):
                self.rows.setdefault(name, []).append(float(value[0]))
            self.rows.setdefault("time", []).append(t)
            self.rows.setdefault("truth", []).append(min(self.truth(t), self.array.maximum))
        return self

    def _heard(self, distance: float, rng: np.random.Generator) -> np.ndarray:
        wall = Wall((self.array.hull_radius + distance, 0.0), (-1.0, 0.0))
        noise = rng.standard_normal(self.array.samples)
        return fire(self.array, 0, position=(0, 0), heading=0.0, shapes=(wall,), noise=noise)

    def __getitem__(self, name: str) -> np.ndarray:
        return np.array(self.rows[name])

    def after(self, t: float, name: str) -> np.ndarray:
        return self[name][self["time"] >= t - 1e-9]

    def kept(self) -> float:
        """Share of the steps in which the promise holds."""
        return float(np.mean(np.abs(self["range"] - self["truth"]) <= self["bound"] + 1e-9))


def approaching(t: float) -> float:
    """Range [m] from 4 m at 0.2 m/s, held at 1 m from t = 15 s on."""
    return max(4.0 - 0.2 * t, 1.0)


def speed(t: float) -> float:
    return 0.2 if t < 15.0 else 0.0


def approach(**changes: object) -> Flight:
    return Flight(approaching, speed, **changes)


def test_a_still_thing_and_an_approach_are_measured_within_their_bars() -> None:
    still = [Flight(lambda t: 1.517, seed=s).fly(15.0) for s in range(5)]
    moving = [approach(seed=s).fly(14.0) for s in range(5)]
    for flights, limit in ((still, 0.010), (moving, 0.020)):
        off = np.concatenate([(f["range"] - f["truth"])[100:] for f in flights])
        assert np.sqrt(np.mean(off**2)) < limit
        assert all(f.after(0.5, "healthy").all() and f.kept() == 1.0 for f in flights)
    lag = np.mean([(f["range"] - f["truth"])[100:] for f in moving]) / 0.2
    assert abs(lag) < 0.05
    assert np.mean([f.after(1.0, "bound") for f in still]) < 0.04
    assert np.mean([f.after(1.0, "bound") for f in moving]) < 0.06


def test_own_motion_that_is_not_known_shows_as_a_rate() -> None:
    found = Flight(approaching).fly(14.0)
    assert found.after(0.5, "healthy").mean() > 0.99
    assert found.after(5.0, "rate").mean() == pytest.approx(-0.2, abs=0.01)
    assert found.kept() > 0.999
    known = approach().fly(14.0)
    assert known.after(5.0, "rate").mean() == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("rate", [-0.25, -0.1, 0.15, 0.25])
def test_an_obstacle_that_starts_and_stops_stays_within_the_bound(rate: float) -> None:
    def truth(t: float) -> float:
        return 2.3 + rate * (min(max(t - 4.0, 0.0), 5.0))

    flights = [Flight(truth, seed=s).fly(14.0) for s in range(8)]
    assert np.mean([f.kept() for f in flights]) >= 0.999
    assert np.mean([f.after(0.5, "healthy") for f in flights]) > 0.99
    assert np.mean([f["rate"][(f["time"] > 6) & (f["time"] < 9)] for f in flights]) == pytest.approx(rate, abs=0.02)


def test_at_the_minimum_everything_nearer_is_allowed_for() -> None:
    near = Flight(lambda t: 0.05).fly(3.0)
    assert near.kept() == 1.0 and near.after(0.5, "healthy").all()
    assert np.all(near["range"] - near["bound"] <= 1e-9)


def test_open_water_is_no_fault() -> None:
    far = Flight(lambda t: 20.0, speed).fly(5.0)
    assert far.after(0.5, "healthy").all() and far.kept() == 1.0
    assert far.after(0.5, "range").min() > 4.4


def test_nothing_is_known_before_the_first_readings_agree() -> None:
    found = approach().fly(2.0)
    ill = found["healthy"] < 0.5
    assert ill[0] and 2 <= ill.sum() <= 6 and not ill[6:].any()
    assert found["range"][0] - found["bound"][0] == 0.0 and found["range"][0] + found["bound"][0] == 4.5


# -------------------------------------------------------------------------------------------------------------- faults


def last(firing: int, honest: list[np.ndarray]) -> np.ndarray:
    return honest[-1]


def from_firing(first: int, change: Callable[[int, list[np.ndarray]], np.ndarray | None], *, until: int = 10**6):
    return lambda k, honest: change(k, honest) if first <= k < until else honest[-1]


FAULTS = {
    "dead": lambda k, honest: None,
    "stuck": lambda k, honest: honest[79],
    "zero": lambda k, honest: np.zeros(5),
    "maximum": lambda k, honest: np.full(5, 4.5),
    "second echo": lambda k, honest: np.minimum(2.0 * honest[-1], 4.5),
}


@pytest.mark.parametrize("known", [False, True], ids=["obstacle", "wall"])
@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("seed", range(1))
def test_a_fault_that_lasts_is_found_and_the_bound_is_kept(name: str, known: bool, seed: int) -> None:
    wall = approaching if known else lambda t: UNKNOWN
    found = approach(expected=wall, seed=seed).fly(18.0, from_firing(80, FAULTS[name]))
    assert found["healthy"][20:160].all()
    during = found.after(8.0, "healthy")
    assert not during[6:].any(), "from 0.3 s on"
    assert not found.after(8.0, "accepted").any()
    assert not found.after(8.3, "carve").any()
    assert found.kept() == 1.0


@pytest.mark.parametrize("name", FAULTS)
def test_a_sensor_recovers_when_the_fault_ends(name: str) -> None:
    found = approach(expected=approaching).fly(12.0, from_firing(80, FAULTS[name], until=95))
    assert not found["healthy"][168:190].any()
    assert found.after(10.0, "healthy").all()
    assert found.kept() == 1.0


def test_one_repetition_is_a_sign_and_two_are_stuck() -> None:
    once = Flight(lambda t: 1.5).fly(10.0, from_firing(80, lambda k, h: h[79], until=81))
    assert once["healthy"][20:].all() and once["accepted"][160] == 0.0
    twice = Flight(lambda t: 1.5).fly(10.0, from_firing(80, lambda k, h: h[79], until=82))
    assert twice["healthy"][162] == 0.0 and twice["healthy"][164] == 1.0


def test_the_rule_against_repetition_knows_the_noise() -> None:
    assert RangeTracker().repeats == 2
    assert RangeTracker(array=SonarArray(noise_sd=0.0)).repeats == 0
    assert RangeTracker(array=SonarArray(noise_sd=0.002)).repeats == 0
    assert RangeTracker(array=SonarArray(samples=2)).repeats > 2
    assert RangeTracker(array=SonarArray(samples=1)).repeats == 8
    quiet = SonarArray(azimuths=(0.0,), order=(0,), firing_period=0.1, noise_sd=0.0)
    found = Flight(lambda t: 1.5, array=quiet).fly(5.0)
    assert found.after(0.5, "healthy").all() and found.kept() == 1.0


def test_a_spike_is_ignored() -> None:
    for value in (0.5, 1.6, 3.4, 4.5):
        found = approach().fly(12.0, from_firing(80, lambda k, h, v=value: np.full(5, v), until=81))
        assert found["accepted"][160] == 0.0 and found["healthy"][160] == 0.0
        assert found["healthy"][162:].all() and found.kept() == 1.0


@pytest.mark.parametrize("value", [0.0, 4.5])
def test_one_bad_sample_of_a_firing_is_ignored(value: float) -> None:
    def one_bad(k: int, honest: list[np.ndarray]) -> np.ndarray:
        samples = honest[-1].copy()
        samples[k % len(samples)] = value
        return samples

    found = Flight(lambda t: 1.5).fly(6.0, from_firing(40, one_bad))
    assert found["healthy"][20:].all() and found["accepted"][80::2].all() and found.kept() == 1.0
    assert np.abs(found["reading"] - 1.5)[80::2].max() < 0.03
    assert found.after(4.0, "bound").max() < 0.05


def test_a_known_wall_that_comes_into_a_turning_beam_is_believed_at_once_unless_another_sensor_reads_it() -> None:
    def seen(*, expected: float, array: SonarArray = ONE, other: float = 3.0) -> Flight:
        def wall(t: float) -> float:
            return UNKNOWN if t < 4.0 else expected

        flight = Flight(lambda t: 3.0 if t < 4.0 else 1.5, expected=wall, turn=lambda t: 0.4, array=array, other=other)
        return flight.fly(5.0)

    found = seen(expected=1.5)
    assert found["accepted"][80:86:2].all() and found["healthy"][20:].all() and found.kept() == 1.0
    assert np.abs(found["range"] - found["truth"])[80::2].max() < 0.03
    for doubtful in (seen(expected=UNKNOWN), seen(expected=1.5, array=TWO, other=1.5)):
        assert not doubtful["accepted"][80:82].any() and not doubtful["healthy"][80]
    assert seen(expected=1.5, array=TWO)["accepted"][80:86:2].all()


@pytest.mark.parametrize("missing", [1, 3, 8, 20])
def test_a_gap_is_noticed_and_bridged(missing: int) -> None:
    fault = from_firing(80, lambda k, h: None, until=80 + missing)
    found = Flight(lambda t: 2.0).fly(14.0, fault)
    gap = slice(161, 160 + 2 * missing)
    assert not found["healthy"][gap].any()
    assert np.all(np.diff(found["bound"][gap]) >= 0.0)
    assert found["age"][160 + 2 * missing - 1] == pytest.approx(0.1 * missing + 0.05)
    assert found["healthy"][160 + 2 * missing + 2 :].all() and found.kept() == 1.0


@pytest.mark.parametrize("rate", [-0.25, 0.25])
def test_while_nothing_is_heard_an_obstacle_may_move(rate: float) -> None:
    def truth(t: float) -> float:
        return 2.0 + rate * min(max(t - 8.0, 0.0), 3.0)

    found = Flight(truth).fly(14.0, from_firing(80, lambda k, h: None, until=120))
    assert found.kept() == 1.0
    assert found["bound"][230] < 0.25 * 3.5 + 0.1, "and no more than that"
    assert found["healthy"][246:].all()


@pytest.mark.parametrize("cycles", [1, 2, 4, 8])
@pytest.mark.parametrize("known", [False, True], ids=["obstacle", "wall"])
def test_a_stream_that_comes_late_is_within_the_bound(cycles: int, known: bool) -> None:
    def late(k: int, honest: list[np.ndarray]) -> np.ndarray | None:
        return None if k < 80 + cycles else honest[k - cycles]

    wall = approaching if known else lambda t: UNKNOWN
    for seed in range(4):
        found = approach(expected=wall, seed=seed).fly(18.0, from_firing(80, late))
        assert found["healthy"][161:166].min() == 0.0
        assert found.kept() == 1.0
        late_by = 0.2 * 0.1 * cycles
        if late_by > 0.06:
            assert not found["healthy"][200:290].any(), "while it matters"
        assert found.after(16.5, "healthy").all(), "a late reading of a still range is right"


@pytest.mark.parametrize("known", [False, True], ids=["obstacle", "wall"])
def test_a_true_stream_after_a_gap_is_trusted_again(known: bool) -> None:
    wall = approaching if known else lambda t: UNKNOWN
    for seed in range(4):
        found = approach(expected=wall, seed=seed).fly(14.0, from_firing(80, lambda k, h: None, until=86))
        assert found["healthy"][190:].all() and found.kept() == 1.0


def test_what_is_also_another_sensor_s_reading_does_not_become_the_track() -> None:
    rng = np.random.default_rng(5)
    beside = {"value": np.zeros(5)}

    def crosstalk(k: int, honest: list[np.ndarray]) -> np.ndarray:
        beside["value"] = np.round((2.4 + rng.normal(0, 0.015, 5)) / TWO.resolution) * TWO.resolution
        return beside["value"]

    # the track passes 2.4 m while the fault lasts, which must not catch it
    found = approach(array=TWO, other=2.4).fly(18.0, from_firing(60, crosstalk))
    assert not found.after(6.5, "healthy")[:300].any()
    assert found.kept() == 1.0


# ------------------------------------------------------------------------------------------------------ jumps and maps


def test_a_thing_that_appears_is_believed_at_the_third_reading() -> None:
    found = Flight(lambda t: 3.0 if t < 5.0 else 1.2).fly(7.0)
    assert found["accepted"][100:104].tolist() == [0.0] * 4
    assert found["accepted"][104] == 1.0 and found["range"][104] == pytest.approx(1.2, abs=0.04)
    assert found["range"][100] - found["bound"][100] < 1.2, "the bound allows for it at once"


def test_a_thing_that_vanishes_stays_possible_until_the_beam_has_turned() -> None:
    def gone(t: float) -> float:
        return 1.5 if t < 5.0 else 20.0

    still = Flight(gone).fly(30.0)
    assert not still.after(5.0, "healthy").any()
    assert np.all(still.after(5.0, "range") - still.after(5.0, "bound") < 1.5)
    turned = Flight(gone, turn=lambda t: 0.3 if t > 4.9 else 0.0).fly(15.0)
    angle = 75.0 * np.pi / 180.0
    assert not turned["healthy"][100 : 100 + int(angle / 0.3 / DT) - 2].any()
    assert turned.after(5.0 + angle / 0.3 + 0.5, "healthy").all()
    dither = Flight(gone, turn=lambda t: 0.0 if t < 4.9 else 0.3 * np.sign(np.sin(2.0 * t))).fly(25.0)
    assert not dither.after(5.1, "healthy").any(), "to and fro is not a turn"
    forgetful = Flight(gone, tracker=RangeTracker(array=ONE, dt=DT, hold=1.0)).fly(10.0)
    assert forgetful.after(6.4, "healthy").all()


def test_one_missed_echo_does_not_block_the_sensor() -> None:
    """A thing at 1.0 m, one firing without echo, then nothing but 1.6 m."""
    missed = from_firing(50, FAULTS["maximum"], until=51)
    found = Flight(lambda t: 1.0 if t < 5.0 else 1.6).fly(10.0, missed)
    assert not found["healthy"][101:130].any(), "a suspicion lasts for many readings"
    assert found.after(7.0, "healthy").all() and abs(found["range"][-1] - 1.6) < 0.02 and found.kept() > 0.99
    rng = np.random.default_rng(4)
    split = from_firing(50, lambda k, honest: 2.0 * honest[-1] + (0.07 if k == 50 else rng.choice([0.07, 0.13])))
    twice = Flight(lambda t: 1.0).fly(25.0, split)
    assert not twice.after(5.0, "healthy").any(), "a second echo whose noise hides it in half of the readings"


def test_a_known_wall_behind_what_vanished_settles_it() -> None:
    found = Flight(lambda t: 1.5 if t < 5.0 else 3.5, expected=lambda t: 3.5).fly(8.0)
    assert found["healthy"][100:104].max() == 0.0 and found["healthy"][105:].all()
    twice = Flight(lambda t: 1.5 if t < 5.0 else 3.0, expected=lambda t: 3.0).fly(8.0)
    assert not twice.after(5.0, "healthy").any(), "at twice the range it may as well be a second echo"


def test_no_reading_is_longer_than_the_walls_allow() -> None:
    found = Flight(lambda t: 2.5, expected=lambda t: 2.0).fly(4.0)
    assert not found["healthy"].any() and not found["accepted"].any()
    assert np.all(found["range"] + found["bound"] <= 2.0 + 0.1 + 1e-9)


def test_a_map_is_cleared_no_further_than_three_readings_agree() -> None:
    found = approach().fly(12.0, from_firing(80, lambda k, h: np.full(5, 4.5), until=82))
    carve, truth = found["carve"], found["truth"]
    assert np.all(carve <= truth + 0.04)
    assert np.all(carve[161::2] == 0.0), "no firing, nothing to clear"
    assert carve[150:160:2].min() > truth[150] - 0.1
    assert carve[160] == carve[162] == 0.0
    short = Flight(lambda t: 2.0).fly(6.0, from_firing(40, lambda k, h: np.full(5, 0.8), until=41))
    assert short["carve"][82] < 0.85 and short["carve"][84] < 0.85 and short["carve"][86] > 1.9


def test_a_beam_that_turns_past_a_wall_follows_it() -> None:
    """A wall at 1 m whose foot has left the cone: the range slides outward at up to 1.4 m/s."""

    def slid(t: float) -> float:
        return 1.0 / np.cos(max(0.3 * (t - 3.0), 0.0))

    rng = np.random.default_rng(2)
    found = Flight(slid, expected=lambda t: slid(t + 0.02 * rng.standard_normal()), turn=lambda t: 0.3).fly(7.4)
    assert found.after(0.5, "healthy").mean() > 0.98
    assert found.kept() > 0.99
    assert np.median(found.after(1.0, "bound")) < 0.1


# ---------------------------------------------------------------------------------------------------------- validation


@pytest.mark.parametrize(
    ("name", "value"),
    [("dt", 0.0), ("tolerance", -0.1), ("hold", np.inf), ("obstacle_speed", -1.0), ("longest_delay", np.nan)],
)
def test_wrong_values_are_named(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"tracker.{name}"):
        RangeTracker(**{name: value})
