"""Tuning: derived gains reach the margin at the speed stated as bearable, and the stated remedy helps."""

from __future__ import annotations

from dataclasses import replace

import pytest

from surctl.marine.simulation import Case, simulate, simulate_batch
from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import load_vehicle
from tests.craft import mission
from tests.tuning import test_derived
from tests.tuning.test_derived import REXROV, WU, made


def test_derived_gains_of_further_vehicles_have_the_margin() -> None:
    for vehicle, cruise in ((REXROV, 0.66), (WU, 0.15)):
        test_derived.test_derived_gains_have_the_margin_of_all_loops_at_once(vehicle, cruise)


def test_the_bearable_speed_is_borne_and_less_thrust_lag_raises_the_margin() -> None:
    fast = derive_gains(WU, cruise=0.47)
    assert not fast.reached
    assert derive_gains(WU, cruise=fast.bearable).reached
    quick = made("quick", **{n: p.value for n, p in WU.parameters.items()} | {"thrust_lag": 0.05})
    assert derive_gains(quick, cruise=0.47).reached, "the remedy that it names"


def test_a_craft_without_sway_force_arrives_beyond_its_limit_astern_in_both_loops() -> None:
    otter = load_vehicle("otter")  # 239 N ahead, 133 N astern; 2 m/s need 155 N
    gains = derive_gains(otter, cruise=2.0).gains
    scenario = replace(
        mission([[30.0, 30.0], [60.0, 30.0]], "otter", size=(120.0, 120.0), time=90.0), cruise=2.0, cap=2.2
    )
    run = simulate(scenario, otter, gains=gains)
    assert run.metrics.reached and run.record.nu[:, 0].max() > 1.95
    assert 133.5 < run.record.tau[:, 0].max() < 239.4 and run.record.tau[:, 0].min() > -133.5
    batch = simulate_batch(Case(scenario, otter, gains))
    assert batch.column("peak_thrust_share")[0] == pytest.approx(run.metrics.peak_thrust_share, abs=1e-6)
    assert batch.column("time_s")[0] == run.metrics.time_s and run.metrics.peak_thrust_share <= 1.0 + 1e-9
