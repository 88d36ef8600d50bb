"""Verification: every claim of the library, runs from the edge of the largest region, a rate that no search proves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.certcheck import check_document
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims, cruise_loop
from surctl.marine.verification.braking import BRAKING_CLAIMS
from surctl.marine.verification.linear import corners, linear_side, margin_speed, open_loop, worst_linear_side
from surctl.marine.verification.region import prove_turning, turning_claim
from surctl.verification import prove
from surctl.verification.linear import disk_margin
from tests.verification import test_claim_file, test_counterexample, test_functions_of_claims, test_margins
from tests.verification.braking import test_proof as braking
from tests.verification.linear import test_sampled
from tests.verification.linear.test_margin_speed import GAINS, WU, ranged
from tests.verification.linear.test_sampled import ABOUT, VEHICLE
from tests.verification.proving import test_squares
from tests.verification.test_library import one


def test_an_impossible_rate_of_a_turning_hull_is_not_proved() -> None:
    vehicle, gains = load_vehicle("bluerov2-wu"), load_gains("default")
    claim = turning_claim("test", vehicle, gains, share=0.0, mass_share=0.0, rate=0.02, rest=True)
    again = prove_turning(replace(claim, rate=5.0), attempts=1)
    assert again.verdict == "unknown" and again.sentence.startswith("unknown: not provable for this vehicle")


@pytest.mark.parametrize("name", BRAKING_CLAIMS)
def test_every_braking_claim(name: str, tmp_path: Path) -> None:
    braking.test_every_claim_is_proved_of_the_paper_s_robot(name, tmp_path)
    braking.test_the_kept_certificates_are_those_of_the_claims(name)


@pytest.mark.parametrize("name", [claim.name for claim in claims()])
def test_every_claim_goes_out_and_comes_back(name: str, tmp_path: Path) -> None:
    test_claim_file.test_every_claim_of_the_library_goes_out_and_comes_back(name, tmp_path)


def test_a_polynomial_with_several_zeros() -> None:
    test_squares.test_a_polynomial_with_several_zeros_is_proved_without_slack(test_squares.ROBINSON)


@pytest.mark.parametrize(("left", "right", "box", "slack"), test_functions_of_claims.TRUE)
def test_functions(left: str, right: str, box: dict[str, tuple[float, float]], slack: float, tmp_path: Path) -> None:
    test_functions_of_claims.test_a_true_claim_is_proved_and_one_that_is_false_by_a_millionth_is_refuted(
        left, right, box, slack, tmp_path
    )


@pytest.mark.parametrize("name", test_counterexample.REFUTED)
def test_every_counterexample_is_confirmed_from_its_json(name: str) -> None:
    test_counterexample.test_every_counterexample_is_confirmed_from_its_json(name)


def test_the_margin_is_kept_at_every_corner_below_that_speed_and_lost_above() -> None:
    tried = corners(ranged())
    speed = margin_speed(tried, GAINS, dt=0.05, highest=0.2)

    def least(cruise: float) -> float:
        loops = [cruise_loop(v, GAINS, cruise=cruise, dt=0.05, model=tried.vehicles[0]) for v in tried.vehicles]
        return min(disk_margin(open_loop(c, place)).guaranteed for c in loops for place in ("thrust", "measurement"))

    assert least(0.97 * speed) > 0.3 > least(1.03 * speed)
    stable = margin_speed(tried, GAINS, dt=0.05, highest=0.2, least=0.0)
    worst = replace(WU).with_values({"m11": 15.0, "m22": 27.0})
    for factor, good in ((0.98, True), (1.02, False)):
        assert cruise_loop(worst, GAINS, cruise=factor * stable, dt=0.05, model=WU).stable is good


@pytest.mark.parametrize("name", test_margins.LOOPS)
def test_margins_of_every_loop(name: str) -> None:
    test_margins.test_python_control_has_the_margins_that_are_printed(name)


def test_a_loop_without_delay_decays_below_the_largest_period_and_grows_above() -> None:
    test_sampled.test_the_loop_flown_step_by_step_decays_below_the_largest_period_and_grows_above(0, 0.0)


def test_braking_of_another_hull_with_unequal_masses() -> None:
    braking.test_unequal_masses_are_proved_with_their_coupling("bluerov2-wu")


def test_the_sides_of_corners_with_and_without_lag_are_the_least_of_each() -> None:
    whole = corners(VEHICLE, 0.2)
    assert len(whole.vehicles) == 5
    tried = replace(whole, vehicles=(VEHICLE, whole.vehicles[-1].with_values({"thrust_lag": 0.0})))
    sides = [linear_side(v, test_sampled.GAINS, dt=0.05, model=VEHICLE, **ABOUT) for v in tried.vehicles]
    worst = worst_linear_side(tried, test_sampled.GAINS, dt=0.05, **ABOUT)
    for k, disk in enumerate(worst.disks):
        assert disk.guaranteed == pytest.approx(min(s.disks[k].guaranteed for s in sides), rel=2e-3)
    assert worst.least_damping == min(s.least_damping for s in sides)
    assert worst.sampled.largest_period_s[1] == min(s.sampled.largest_period_s[1] for s in sides)
    assert worst.slowest_per_s == pytest.approx(max(s.slowest_per_s for s in sides), rel=1e-9)
    assert worst.sampled.radius == pytest.approx(max(s.sampled.radius for s in sides), rel=1e-9)
    assert worst.stable and "±20%" in worst.lines()[0]
    assert sides[0].slowest_per_s == pytest.approx(
        cruise_loop(VEHICLE, test_sampled.GAINS, dt=0.05, **ABOUT).rates[0].real
    )


def test_the_speed_cap_region_ends_where_equality_is_met_so_that_rounding_decides() -> None:
    # its end, -5 m, is a rounded number: either it or its neighbour is beyond the closed form
    proof = prove(one("v1-speed-cap-region"), slack=1e-9)
    assert proof.certificate is not None and check_document(proof.certificate).accepted and 0 < proof.slack <= 1e-12
