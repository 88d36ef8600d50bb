"""Gains from a regulator: stable, with margins, and near what the regulator does."""

from __future__ import annotations

import control
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.control import load_gains
from surctl.marine.simulation import Case, load_scenario
from surctl.marine.tuning import Goal, Request, conditions, gain_ranges
from surctl.marine.tuning.start import lqr_start, starting_sets
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import CASCADE_GAINS
from surctl.marine.verification.linear import corner_margin
from surctl.verification.linear import LEAST_DISK_MARGIN

ABOUT = {"cruise": 0.15, "dt": 0.05}


@pytest.mark.parametrize("name", ["sur400", "sur540-flooded", "bluerov2-vonbenzon"])
def test_the_start_is_stable_with_the_stated_disk_margin(name: str) -> None:
    vehicle = load_vehicle(name)
    gains = lqr_start(vehicle, **ABOUT)
    assert tuple(gains) == CASCADE_GAINS
    assert corner_margin(vehicle, gains, **ABOUT).margin >= LEAST_DISK_MARGIN
    load_gains("default").with_values(gains)


def test_dearer_thrust_makes_a_slower_loop() -> None:
    vehicle = load_vehicle("sur540-flooded")
    mild, milder = (lqr_start(vehicle, r=f / vehicle.thrust_limit**2, **ABOUT) for f in (30.0, 300.0))
    assert milder["k_v"] < mild["k_v"] and milder["k_psi"] < mild["k_psi"]
    assert milder["lookahead"] > mild["lookahead"]


def test_a_single_axis_gets_the_regulators_own_gains() -> None:
    # yaw alone: ψ̇ = r, m ṙ = −d r + F has the LQR gains √(q/r) and −d + √(d² + r-weighted …) in closed form
    vehicle = load_vehicle("sur540-flooded")
    q, r = np.full(8, 1e-8), 1e3 / vehicle.thrust_limit**2
    q[3], q[7] = 4.0, 1.0
    gains = lqr_start(vehicle, q=q, r=r, **ABOUT)
    m, d = vehicle["m44"], vehicle["Nr"]
    heading = np.sqrt(q[3] / r[3])
    rate = -d + np.sqrt(d**2 + q[7] / r[3] + 2 * m * heading)
    assert m * gains["k_r"] == pytest.approx(rate, rel=0.05)
    assert (m * gains["k_r"] + d) * gains["k_psi"] == pytest.approx(heading, rel=0.05)


@pytest.mark.parametrize(("key", "value"), [("q", np.ones(4)), ("r", np.zeros(4)), ("q", np.full(8, np.nan))])
def test_bad_weights_are_named(key: str, value: np.ndarray) -> None:
    with pytest.raises(InputError, match=key):
        lqr_start(load_vehicle("sur400"), **{key: value}, **ABOUT)


def test_a_search_without_a_regulator_advises_nothing_that_no_option_can_set(monkeypatch) -> None:
    def none(*_: object, **__: object) -> None:
        raise InputError("no cascade has a margin at the control period of 0.05 s", key="dt", remedy="shorten it")

    monkeypatch.setattr("surctl.marine.tuning.start.lqr_start", none)
    gains = load_gains("default")
    runs = conditions([Case(load_scenario("pool-behind"), load_vehicle("sur400"), gains)], seeds=[0])
    told: list[str] = []
    request = Request((Goal("near", "deviation_m", "m", 0.1),), runs, gains, gain_ranges(gains, ["k_v"]))
    assert starting_sets(request, progress=told.append) == []
    assert told == [
        "sur400: no cascade has a margin at the control period of 0.05 s; the search starts without LQR gains"
    ]


def test_a_search_starts_from_the_regulator_within_the_ranges() -> None:
    scenario, vehicle = load_scenario("pool-behind"), load_vehicle("sur400")
    poor = load_gains("default").with_values({"lookahead": 2.0})
    space = gain_ranges(poor, {"k_v": (0.9, 1.0), "lookahead": (0.3, 2.5), "margin": (0.05, 0.3)})
    runs = conditions([Case(scenario, vehicle, poor)], seeds=[0], with_corners=False)
    [regulator] = starting_sets(Request((Goal("near", "deviation_m", "m", 0.1),), runs, poor, space))
    wanted = lqr_start(vehicle, cruise=scenario.cruise, dt=0.05)
    assert wanted["k_v"] > 1.0 > regulator["lookahead"]
    assert regulator == {"k_v": 1.0, "lookahead": wanted["lookahead"], "margin": poor["margin"]}


@pytest.mark.parametrize("seed", range(3))
def test_weights_without_a_numerical_regulator_are_a_mistake_with_a_name(seed: int) -> None:
    far = 10.0 ** np.random.default_rng(seed).uniform(12, 24)
    with pytest.raises(InputError, match="no numerical solution"):
        lqr_start(load_vehicle("sur400"), q=np.full(8, 1 / far), r=np.full(4, far), **ABOUT)


def test_a_regulator_that_fails_at_milder_weights_leaves_the_reason_of_the_others(monkeypatch) -> None:
    whole, calls = control.lqr, []

    def lqr(*matrices: np.ndarray) -> tuple[np.ndarray, ...]:
        calls.append(matrices)
        if len(calls) > 1:
            raise np.linalg.LinAlgError("ill-conditioned")
        return whole(*matrices)

    monkeypatch.setattr(control, "lqr", lqr)
    with pytest.raises(InputError, match="no fitted cascade"):
        lqr_start(load_vehicle("bluerov2-wu"), cruise=0.47, dt=0.05)
    assert len(calls) == 2
