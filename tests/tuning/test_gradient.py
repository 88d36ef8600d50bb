"""Gradients of a run: it is the run of the loop in NumPy; they are those of finite differences, and of use."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario, simulate
from surctl.marine.tuning.gradient import SURROGATES, DifferentiableRun, prepare
from surctl.marine.tuning.refine import refine
from surctl.marine.vehicle import load_vehicle
from tests.oracles.mission_loop import simulate as in_numpy

GAINS = load_gains("default")
NAMES = ("k_v", "lookahead", "margin", "k1", "k_r")
AT = np.array([1.37, 0.93, 0.061, 0.33, 1.2])
WEIGHTS = {"deviation": 1.0, "clearance": 0.7, "effort": 0.01, "remaining": 0.4}
# steps to where an obstacle counts; `analysis/40_long_checks` takes the second
SCENARIOS = {"pool-static": 60, "tank-speed-015": 160}


def case(name: str) -> Case:
    scenario = load_scenario(name)
    return Case(scenario, load_vehicle(scenario.vehicle), GAINS)


@cache
def prepared(name: str) -> DifferentiableRun:
    return prepare(case(name), NAMES, steps=SCENARIOS[name], seed=3)


@pytest.mark.parametrize("name", ["pool-static"])
def test_the_run_is_that_of_the_loop_in_numpy(name: str) -> None:
    flown = case(name)
    gains = GAINS.with_values(dict(zip(NAMES, AT, strict=True)))
    record = in_numpy(flown.scenario, flown.vehicle, gains=gains, seed=3).record
    track = prepared(name).track(AT)
    shared = min(SCENARIOS[name], len(record.eta) - 1)
    np.testing.assert_allclose(track[:shared, :4], record.eta[1 : shared + 1], atol=1e-9)


@pytest.mark.parametrize("name", ["pool-static"])
def test_the_gradient_is_that_of_central_differences(name: str) -> None:
    run = prepared(name)
    gradient = run.gradient(AT, WEIGHTS)

    def cost(values: np.ndarray) -> float:
        found = run.surrogates(values)
        return sum(WEIGHTS[key] * found[key] for key in SURROGATES)

    scale, smooth = np.abs(gradient * AT).max(), 0
    for k in range(len(NAMES)):
        step = np.zeros(len(NAMES))
        step[k] = 1e-6 * AT[k]
        up, here, down = (cost(AT + side * step) for side in (1, 0, -1))
        switched = not np.array_equal(run.branches(AT + step), run.branches(AT - step))
        # a comparison may turn without effect: a kink shows as well in the slopes on either side
        if switched and abs(up - 2 * here + down) > 1e-4 * abs(up - down):
            continue
        smooth += 1
        difference = (up - down) / (2 * step[k])
        assert gradient[k] == pytest.approx(difference, rel=1e-5, abs=1e-6 * scale / AT[k])
    assert smooth >= 3 and scale > 1e-4


def test_a_switch_shows_in_the_branches() -> None:
    run = prepared("pool-static")
    assert np.array_equal(run.branches(AT), run.branches(AT))
    assert not np.array_equal(run.branches(AT), run.branches(AT * [2.0, 1, 1, 1, 1]))


def test_the_soft_clearance_lies_just_below_the_least() -> None:
    flown = case("tank-static")
    run = prepare(flown, ("k_v",), steps=400)
    flight = simulate(flown.scenario, flown.vehicle, gains=GAINS)
    least = min(flight.record.clearance[:400])
    assert least - np.log(8 * 400) / 60 < run.surrogates(np.array([1.5]))["clearance"] <= least + 1e-3


def test_refining_poor_gains_lowers_the_true_metrics() -> None:
    flown = case("pool-static")
    poor = GAINS.with_values({"k_v": 0.5, "lookahead": 2.0})
    found = refine(
        [flown], poor, {"k_v": (0.4, 3.0), "lookahead": (0.3, 2.5)}, steps=110, iterations=2, floor=0.0, seed=1
    )
    (history,) = found.history
    assert found.cost == pytest.approx(min(history)) and found.cost < 0.95 * history[0]
    before, after = (simulate(flown.scenario, flown.vehicle, gains=g, seed=1).metrics for g in (poor, found.gains))
    assert after.reached and after.deviation_m < before.deviation_m


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"mode": "projected"}, "mode"),
        ({"sensing": "sonar"}, "sensing"),
    ],
)
def test_what_has_no_gradient_is_refused(change: dict[str, str], key: str) -> None:
    flown = case("pool-static")
    with pytest.raises(InputError, match=key):
        prepare(Case(flown.scenario, flown.vehicle, GAINS, **change), NAMES, steps=10)  # type: ignore[arg-type]


def test_bad_requests_are_named() -> None:
    flown = case("pool-static")
    with pytest.raises(InputError, match="no such gain"):
        prepare(flown, ("k_w",), steps=10)
    with pytest.raises(InputError, match="steps"):
        prepare(flown, NAMES, steps=0)
    with pytest.raises(InputError, match="not a range"):
        refine([flown], GAINS, {"k_v": (2.0, 1.0)})
    with pytest.raises(InputError, match="no such surrogate"):
        refine([flown], GAINS, {"k_v": (1.0, 2.0)}, weights={"clearence": 1.0})
    with pytest.raises(InputError, match="nothing to simulate"):
        refine([], GAINS, {"k_v": (1.0, 2.0)})
