"""Every kind of fault by its own words, the compiled loop's twin against the reference, and mistakes."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.files import Strict, validate
from surctl.ir import Layout
from surctl.marine.sensing import FAULT_KINDS, Fault, FaultChances, SonarArray
from surctl.marine.sensing.sonar.faults import SLOT, check_faults, fault_ports, fault_slots, faulty_samples
from surctl.noise import draw_uniforms, noise_states
from tests.oracles.echoes import fault_state, faulty, firing_samples, strikes
from tests.oracles.noise_stream import NoiseStream


class File(Strict):
    """As a file would hold them."""

    faults: tuple[Fault, ...] = ()
    chances: FaultChances = FaultChances()


ARRAY = SonarArray(order=(0, 2, 1, 3))
FIRINGS = 100


def _fly(faults=(), chances=None, *, array=ARRAY, firings=FIRINGS, seed=0, shift=0.0):
    """Per firing: time, sensor, distance, noise, uniforms, what a sound sensor hears, what arrives, state before."""
    rng, state, rows = np.random.default_rng(seed), fault_state(array), []
    for k in range(firings):
        time, sensor = k * array.firing_period + shift, array.sensor_at(k)
        distance = rng.uniform(0.1, 2.0) if rng.random() < 0.9 else math.inf
        noise, uniforms = rng.standard_normal(array.samples), rng.uniform(size=2)
        given, after = faulty(
            array,
            state,
            sensor,
            time=time,
            distance=distance,
            noise=noise,
            faults=faults,
            chances=chances,
            uniforms=uniforms,
        )
        own = firing_samples(array, distance, noise=noise)
        rows.append((time, sensor, distance, noise, uniforms, own, given, state))
        state = after
    return rows


def _of(rows, sensor, kind_acts):
    return [row for row in rows if row[1] == sensor and kind_acts(row[0])]


def test_a_sound_sensor_gives_what_it_hears():
    for _, _, _, _, _, own, given, _ in _fly((), FaultChances()):
        assert np.array_equal(own, given)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_fault_acts_on_its_sensor_in_its_time_alone(kind):
    more = {"delay_s": 0.2} if kind == "delay" else {}
    until = None if kind == "dead" else 0.8
    fault = Fault(sensor=1, kind=kind, start_s=0.5, duration_s=until, **more)
    changed = set()
    for time, sensor, _, _, _, own, given, _ in _fly((fault,)):
        if given is None or not np.array_equal(own, given):
            changed.add((sensor, round(time / ARRAY.firing_period)))
    begin, end = 20, FIRINGS if until is None else 52
    assert changed == {(1, k) for k in range(FIRINGS) if begin <= k < end and ARRAY.sensor_at(k) == 1}


@pytest.mark.parametrize("kind", ["dropout", "dead"])
def test_nothing_arrives(kind):
    rows = _of(_fly((Fault(sensor=2, kind=kind, start_s=0.3),)), 2, lambda t: t > 0.3)
    assert len(rows) > 10 and all(row[6] is None for row in rows)


def test_a_stuck_sensor_repeats_what_arrived_last():
    rows = _of(_fly((Fault(sensor=1, kind="stuck", start_s=1.0),)), 1, lambda t: True)
    before = [row[5] for row in rows if row[0] < 0.999][-1]
    after = [row[6] for row in rows if row[0] >= 0.999]
    assert len(after) > 10 and all(np.array_equal(given, before) for given in after)
    from_the_start = _fly((Fault(sensor=1, kind="stuck"),))
    assert all(np.all(row[6] == ARRAY.maximum) for row in from_the_start if row[1] == 1)


@pytest.mark.parametrize(("kind", "value"), [("zero", 0.0), ("maximum", 4.5)])
def test_a_constant_arrives(kind, value):
    rows = _of(_fly((Fault(sensor=0, kind=kind),)), 0, lambda t: True)
    assert all(np.all(row[6] == value) for row in rows)


def test_a_spike_is_one_firing_of_one_wrong_value():
    rows = _fly((Fault(sensor=0, kind="spike", start_s=0.95),))
    wrong = [row for row in rows if not np.array_equal(row[5], row[6])]
    assert [(row[1], round(row[0], 9)) for row in wrong] == [(0, 1.0)]
    assert np.ptp(wrong[0][6]) == 0.0
    many = _fly((Fault(sensor=0, kind="spike", duration_s=1e3),), firings=4000)
    values = np.array([row[6][0] for row in many if row[1] == 0])
    codes = values / ARRAY.resolution
    assert np.allclose(codes, np.rint(codes), rtol=0, atol=1e-9)
    assert abs(values.min() - ARRAY.minimum) < 0.03 and abs(values.max() - ARRAY.maximum) < 0.03
    evenly = 0.5 * (ARRAY.minimum + ARRAY.maximum)
    assert abs(values.mean() - evenly) < 4 * 4.3 / math.sqrt(12 * len(values))


def test_the_second_echo_is_twice_the_true_range_or_the_maximum():
    quiet = SonarArray(noise_sd=0.0, bias=0.0)
    state, noise = fault_state(quiet), np.zeros(5)
    for distance, wanted in ((1.0, 2.0), (2.2, 4.4), (2.3, 4.5), (math.inf, 4.5)):
        given, _ = faulty(
            quiet,
            state,
            0,
            time=0.0,
            distance=distance,
            noise=noise,
            faults=(Fault(sensor=0, kind="second_echo"),),
        )
        assert given is not None and np.all(np.abs(given - wanted) <= 0.5 * quiet.resolution + 1e-12)


def test_crosstalk_is_what_arrived_from_the_sensor_before():
    rows = _fly((Fault(sensor=1, kind="crosstalk"), Fault(sensor=2, kind="zero", start_s=1.0)))
    for k, row in enumerate(rows):
        if row[1] == 1:  # sensor 2 fires just before it
            assert np.array_equal(row[6], rows[k - 1][6])
            assert np.all(row[6] == 0.0) == (row[0] > 1.0)


@pytest.mark.parametrize(("delay", "m"), [(0.1, 1), (0.25, 3), (0.34, 3), (0.8, 8)])
def test_a_delay_is_silent_for_m_firings_and_then_late_by_m(delay, m):
    rows = _of(_fly((Fault(sensor=3, kind="delay", start_s=0.5, delay_s=delay),)), 3, lambda t: True)
    first = next(k for k, row in enumerate(rows) if row[0] >= 0.5)
    assert all(np.array_equal(row[5], row[6]) for row in rows[:first])
    assert all(row[6] is None for row in rows[first : first + m])
    late = rows[first + m :]
    assert len(late) > 5
    assert all(np.array_equal(row[6], rows[first + k][5]) for k, row in enumerate(late))


def test_faults_count_firings_whatever_the_rounding_of_times():
    for start in range(1, 60, 7):
        sensor = ARRAY.sensor_at(start)
        delay = Fault(sensor=sensor, kind="delay", start_s=start / 40, delay_s=0.3)
        burst = Fault(sensor=sensor, kind="dropout", start_s=start / 40, duration_s=0.3)
        for fault in (delay, burst):
            for shift in (-1e-9, 0.0, 1e-9):
                lost = [k for k, row in enumerate(_fly((fault,), shift=shift)) if row[6] is None]
                assert lost == [start, start + 4, start + 8]


def test_a_delay_that_ends_loses_what_is_under_way():
    fault = Fault(sensor=3, kind="delay", start_s=0.5, duration_s=0.6, delay_s=0.3)
    rows = _of(_fly((fault,)), 3, lambda t: t >= 1.0999)
    assert all(np.array_equal(row[5], row[6]) for row in rows)


def test_of_two_faults_the_first_acts_and_chance_comes_last():
    rows = _fly(
        (Fault(sensor=0, kind="zero", duration_s=1.0), Fault(sensor=0, kind="maximum")), FaultChances(dropout=1.0)
    )
    for time, sensor, *_, given, _ in rows:
        if sensor:
            assert given is None
        else:
            assert np.all(given == (0.0 if time < 0.999 else ARRAY.maximum))


def test_chances_strike_as_often_as_they_say():
    chances = FaultChances(dropout=0.05, zero=0.1, maximum=0.15, spike=0.2, second_echo=0.1, crosstalk=0.3)
    stream, count = NoiseStream(3), 40_000
    struck = [strikes(chances, u) for u in stream.uniforms(count)]
    for kind, chance in zip(FaultChances.kinds(), chances.numbers, strict=True):
        assert abs(struck.count(kind) / count - chance) < 4 * math.sqrt(chance * (1 - chance) / count)
    assert strikes(chances, 0.049) == "dropout" and strikes(chances, 0.051) == "zero" and strikes(chances, 0.91) is None


FAULTS = {
    "none": (),
    "told": (
        Fault(sensor=0, kind="dropout", start_s=0.3, duration_s=0.4),
        Fault(sensor=1, kind="delay", start_s=0.4, duration_s=1.0, delay_s=0.3),
        Fault(sensor=2, kind="second_echo", start_s=0.2, duration_s=0.5),
        Fault(sensor=2, kind="stuck", start_s=0.6, duration_s=0.5),
        Fault(sensor=3, kind="crosstalk", start_s=0.1, duration_s=0.7),
        Fault(sensor=3, kind="spike", start_s=1.2),
        Fault(sensor=0, kind="zero", start_s=0.9, duration_s=0.3),
        Fault(sensor=0, kind="maximum", start_s=1.4),
        Fault(sensor=2, kind="dead", start_s=1.8),
        Fault(sensor=1, kind="delay", start_s=1.0, delay_s=0.8),
    ),
    # each starts at a firing of its sensor, where sums of steps are not exact
    "on time": tuple(
        Fault(sensor=sensor, kind="delay", start_s=start, duration_s=0.5, delay_s=0.3)
        for sensor, start in ((0, 0.3), (0, 1.1), (1, 0.45), (1, 1.35), (2, 0.725), (2, 1.625), (3, 0.975), (3, 1.775))
    ),
    **{
        kind: (Fault(sensor=2, kind=kind, start_s=0.5, delay_s=0.4 if kind == "delay" else None),)
        for kind in FAULT_KINDS
    },
}
CHANCES = (
    FaultChances(),
    FaultChances(dropout=0.1, zero=0.1, maximum=0.1, spike=0.1, second_echo=0.1, crosstalk=0.1),
    FaultChances(spike=0.5, crosstalk=0.5),
)


def _twin(array, *, slots, delays):
    layout = Layout(fault_ports(array, delays=delays))
    flat, state = layout.symbols("state")
    sensor, time, distance = (ca.SX.sym(name) for name in ("sensor", "time", "distance"))
    noise, told = ca.SX.sym("noise", array.samples), ca.SX.sym("told", slots, SLOT)
    chances, uniforms = ca.SX.sym("chances", 6), ca.SX.sym("uniforms", 2)
    found = faulty_samples(
        array,
        state,
        sensor,
        time=time,
        distance=distance,
        noise=noise,
        slots=told,
        chances=chances,
        uniforms=uniforms,
        delays=delays,
    )
    inputs = [flat, sensor, time, distance, noise, told, chances, uniforms]
    return layout, ca.Function("arrives", inputs, [found.samples, found.arrived, layout.join(found.state)])


@pytest.mark.parametrize("told", FAULTS)
@pytest.mark.parametrize("chances", CHANCES[1:2], ids=["some"])
@pytest.mark.parametrize("array", [SonarArray(order=(0, 2, 1, 3), calibrated_for=1400.0)], ids=["order and scale"])
def test_symbols_and_numbers_give_the_same_arrivals(told, chances, array):
    faults = FAULTS[told]
    delays = any(f.kind == "delay" for f in faults)
    slots = len(faults) + 1
    layout, twin = _twin(array, slots=slots, delays=delays)
    numbers = ca.DM(fault_slots(array, faults, slots))
    state, lost = np.concatenate([np.full(p.size, p.default) for p in layout.ports]), 0
    for time, sensor, distance, noise, uniforms, _, given, before in _fly(faults, chances, array=array, shift=-1e-9):
        there = layout.unpack(state)
        assert np.allclose(there["last"], before.last, rtol=0, atol=1e-12)
        if delays:
            assert np.allclose(there["history"].reshape(before.history.shape), before.history, rtol=0, atol=1e-12)
        far = min(distance, 2.0 * array.maximum)
        samples, arrived, state = (
            np.asarray(part).ravel()
            for part in twin(state, sensor, time, far, noise, numbers, chances.numbers, uniforms)
        )
        assert bool(arrived[0]) == (given is not None)
        wanted = before.last[sensor] if given is None else given
        assert np.allclose(samples, wanted, rtol=0, atol=1e-12)
        lost += given is None
    assert (lost > 0) == (told in ("told", "on time", "dropout", "dead", "delay") or chances.dropout > 0)


def test_uniform_numbers_in_symbols_are_those_of_the_stream():
    state = ca.SX.sym("state", 6)
    draw = ca.Function("draw", [state], list(draw_uniforms(state, 3)))
    here, stream = noise_states([11])[0], NoiseStream(11)
    for _ in range(50):
        found, here = (np.asarray(part).ravel() for part in draw(here))
        assert np.array_equal(found, stream.uniforms(3))


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ({"kind": "delay"}, "a delay fault needs delay_s; give 0.1 to 0.8 s"),
        ({"kind": "delay", "delay_s": 0.05}, "delay_s"),
        ({"kind": "delay", "delay_s": 0.9}, "delay_s"),
        ({"kind": "zero", "delay_s": 0.2}, "a zero fault takes no delay_s"),
        ({"kind": "dead", "duration_s": 1.0}, "a dead sensor takes no duration_s"),
        ({"kind": "deaf"}, "kind"),
        ({"kind": "zero", "start_s": -1.0}, "start_s"),
        ({"kind": "zero", "duration_s": 0.0}, "duration_s"),
        ({"kind": "zero", "until_s": 1.0}, "until_s: unknown key"),
        ({"kind": "zero", "sensor": -1}, "sensor"),
    ],
)
def test_mistakes_of_a_fault_are_named(table, problem):
    with pytest.raises(InputError, match=problem):
        validate({"faults": [{"sensor": 0} | table]}, File, file="faults.toml")


@pytest.mark.parametrize("table", [{"spike": -0.1}, {"spike": 1.1}, {"spike": 0.6, "zero": 0.6}, {"stuck": 0.1}])
def test_mistakes_of_chances_are_named(table):
    with pytest.raises(InputError, match=r"spike|exceed 1|unknown key"):
        validate({"chances": table}, File, file="faults.toml")


def test_faults_that_the_array_cannot_have_are_named():
    lone = SonarArray(azimuths=(0.0,), order=(0,))
    cases = [
        (ARRAY, Fault(sensor=4, kind="zero"), "faults.0.sensor"),
        (lone, Fault(sensor=0, kind="crosstalk"), "faults.0.kind"),
        (lone, Fault(sensor=0, kind="delay", delay_s=0.3), "faults.0.delay_s"),
    ]
    for array, fault, key in cases:
        with pytest.raises(InputError) as caught:
            check_faults(array, (fault,))
        assert caught.value.key == key
    with pytest.raises(InputError, match="at least two sensors"):
        check_faults(lone, (), FaultChances(crosstalk=0.1))
    with pytest.raises(InputError, match="at most 1 are possible"):
        fault_slots(ARRAY, FAULTS["told"], 1)
