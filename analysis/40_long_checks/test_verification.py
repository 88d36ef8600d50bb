"""Verification: every claim of the library, runs from the edge of the largest region, a rate that no search proves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.certcheck import check_document
from surctl.marine.control import build_law, load_gains
from surctl.marine.verification import claims, cruise_loop, law_corners
from surctl.marine.verification.braking import BRAKING_CLAIMS
from surctl.marine.verification.corners import corners
from surctl.marine.verification.linear import bearable_speed
from surctl.marine.verification.region import prove_turning
from surctl.verification import prove
from surctl.verification.sampled_margins import SampledLoop
from tests.verification import test_claim_file, test_counterexample, test_functions_of_claims, test_margins
from tests.verification.braking import test_proof as braking
from tests.verification.linear import test_corners
from tests.verification.linear.test_margin_speed import WU, ranged
from tests.verification.proving import test_squares
from tests.verification.region.test_proof import turning
from tests.verification.test_library import one

GAINS = load_gains("default").values


def test_an_impossible_rate_of_a_turning_hull_is_not_proved() -> None:
    claim = turning("bluerov2-wu", share=0.0, mass_share=0.0, rate_per_s=0.02, at_rest=True)
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
    speed = bearable_speed(tried, GAINS, dt=0.05, least=0.3)

    def least(cruise: float) -> float:
        loops = [cruise_loop(v, GAINS, cruise=cruise, dt=0.05, model=tried.vehicles[0]) for v in tried.vehicles]
        return min(SampledLoop(loop).disk for loop in loops)

    assert least(0.97 * speed) > 0.3 > least(1.03 * speed)
    stable = bearable_speed(tried, GAINS, dt=0.05)
    worst = replace(WU).with_values({"m11": 15.0, "m22": 27.0})
    for factor, good in ((0.98, True), (1.02, False)):
        assert cruise_loop(worst, GAINS, cruise=factor * stable, dt=0.05, model=WU).stable is good


@pytest.mark.parametrize("name", test_margins.LOOPS)
def test_margins_of_every_loop(name: str) -> None:
    test_margins.test_python_control_has_the_margins_that_are_printed(name)


def test_braking_of_another_hull_with_unequal_masses() -> None:
    braking.test_unequal_masses_are_proved_with_their_coupling("bluerov2-wu")


def test_corners_with_and_without_lag_are_the_least_of_each() -> None:
    vehicle, gains = test_corners.VEHICLE, test_corners.GAINS
    whole = corners(vehicle, 0.2)
    other = whole.vehicles[-1].with_values({"thrust_lag": 0.0})
    tried = replace(whole, vehicles=(vehicle, other), labels=(whole.labels[0], whole.labels[-1]))
    loops = [SampledLoop(cruise_loop(v, gains.values, cruise=0.15, dt=0.05, model=vehicle)) for v in tried.vehicles]
    worst = law_corners(build_law(), tried, gains, cruise=0.15)
    for k, disk in enumerate(worst.disks):
        assert disk.guaranteed == pytest.approx(min(s.disks[k].guaranteed for s in loops), rel=2e-3)
    assert worst.slowest_per_s == pytest.approx(max(s.slowest_per_s for s in loops), rel=1e-9)
    assert worst.delay.delay_s == pytest.approx(min(m.delay_margin_s for s in loops for m in s.judged), rel=1e-9)
    assert worst.stable and "±20%" in worst.of


def test_the_speed_cap_region_ends_where_equality_is_met_so_that_rounding_decides() -> None:
    # its end, -5 m, is a rounded number: either it or its neighbour is beyond the closed form
    proof = prove(one("v1-speed-cap-region"), slack=1e-9)
    assert proof.certificate is not None and check_document(proof.certificate).accepted and 0 < proof.slack <= 1e-12
