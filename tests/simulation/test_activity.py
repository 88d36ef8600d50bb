"""Metrics of attitude and thrust activity: their definitions, and the same in the compiled loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import Run, load_scenario, simulate
from surctl.marine.vehicle import load_vehicle
from tests.oracles.path_follower import PlainFollower
from tests.oracles.run_metrics import measure

GAINS = load_gains("default")


@pytest.fixture(scope="module")
def run() -> Run:
    # a corner, a current, and a hull that the Munk moment turns
    base = load_scenario("tank-slalom")
    scenario = replace(base, obstacles=(), time_limit=20.0)
    return simulate(scenario, load_vehicle("bluerov2-wu"), gains=GAINS)


def test_each_metric_is_what_its_text_says(run: Run) -> None:
    record, m, dt = run.record, run.metrics, run.law.dt
    duration = (len(record.tau) - 1) * dt
    axes = (m.variation_surge_n_per_s, m.variation_sway_n_per_s, m.variation_heave_n_per_s, m.variation_yaw_n_m_per_s)
    assert axes == pytest.approx(np.abs(np.diff(record.tau, axis=0)).sum(axis=0) / duration)
    assert m.energy_n15_s == pytest.approx((np.abs(record.tau[:, :3]) ** 1.5).sum() * dt)
    # impulses of the horizontal thrust and of the drag along the path, by hand
    spent = np.hypot(*record.tau[:, :2].T).sum() * dt
    direction = PlainFollower(run.scenario.path, visit=run.scenario.visit).directions(record.eta[:, :2])
    off = record.eta[:, 3] - direction
    along = np.maximum(record.nu[:, 0] * np.cos(off) - record.nu[:, 1] * np.sin(off), 0)
    needed = (run.vehicle["Xu"] * along + run.vehicle["Xuu"] * along**2).sum() * dt
    assert m.wasted_impulse_n_s == pytest.approx(spent - needed) and m.wasted_share == pytest.approx(1 - needed / spent)
    moving = np.hypot(*record.nu[:, :2].T) > 0.25 * run.scenario.cruise
    crab = np.rad2deg(np.abs(np.arctan2(record.nu[:, 1], record.nu[:, 0])))[moving]
    assert (m.crab_angle_deg, m.max_crab_angle_deg) == pytest.approx((crab.mean(), crab.max()))
    assert m.heading_error_deg == pytest.approx(np.rad2deg(np.sqrt(np.mean(np.sin(off[moving]) ** 2))), rel=0.3)


def test_signs_below_one_percent_of_the_limit_do_not_count(run: Run) -> None:
    limit, count = run.vehicle.thrust_limit, len(run.record.tau)
    signs = np.where(np.arange(count) % 2, 1.0, -1.0)
    for share, changes in ((0.005, 0), (0.02, count - 1)):
        tau = np.zeros((count, 4))
        tau[:7, 1], tau[7:10, 0] = -limit[1], limit[0]
        tau[:, 3] = share * limit[3] * signs
        m = measure(run.scenario, run.law, replace(run.record, tau=tau), reason="reached", least=1.0)
        assert m.sign_changes_per_s == pytest.approx(changes / (count * run.law.dt))
        assert m.axis_sign_changes_per_s == pytest.approx(m.sign_changes_per_s)  # one axis changes sign
        assert m.axis_saturated_share == pytest.approx(7 / count)  # of the axis that is at its limit most often


def test_a_law_that_turns_the_hull_to_scan_has_no_crab_angle(run: Run) -> None:
    law = build_law(sonar=True)
    blind = replace(run.record, telemetry=np.zeros((len(run.record.time), law.outputs.size - 4)))
    blind = replace(blind, law_parameters=np.resize(run.record.law_parameters, law.gains.size))
    m = measure(run.scenario, law, blind, reason="reached", least=1.0)
    assert np.isnan([m.crab_angle_deg, m.max_crab_angle_deg, m.heading_error_deg]).all()
