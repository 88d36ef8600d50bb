"""The manifest's claims are about the law's own cruise speed and cap."""

from dataclasses import replace

import pytest

from surctl.certcheck.bundle import stated_sha256
from surctl.marine.control import build_law, load_gains
from surctl.marine.export.origin import _stated, manifest_of, origin_of
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims

GAINS, LAW = load_gains("default"), build_law(barrier="inertia")


@pytest.mark.parametrize(("cruise", "cap"), [(0.15, 0.22), (1.0, 1.3)])
def test_a_fast_mission_has_the_claims_of_its_own_speeds(cruise: float, cap: float) -> None:
    mission, vehicle = replace(load_scenario("pool-static"), cruise=cruise, cap=cap), load_vehicle("sur400")
    told = manifest_of(LAW, law_numbers(mission, GAINS, vehicle), origin_of(LAW, vehicle)).claims
    [expected] = claims({**GAINS.values, "speed": cruise, "speed_max": cap}, ["v1-speed-cap-region"])
    assert told["v1-speed-cap-region"] == stated_sha256(_stated(expected))
    assert {"v1-corrected", "course-corrected", "braking-mass"} <= set(told)


def test_a_claim_that_does_not_apply_leaves_the_others_in_the_manifest() -> None:
    mission, vehicle = load_scenario("pool-static"), load_vehicle("bluerov2-wu")
    told = manifest_of(LAW, law_numbers(mission, GAINS, vehicle), origin_of(LAW, vehicle)).claims
    assert "v1-corrected" in told and not any(name.startswith("braking-") for name in told)
    level = replace(mission, cruise=0.22, cap=0.22)
    told = manifest_of(LAW, law_numbers(level, GAINS, vehicle), origin_of(LAW, vehicle)).claims
    assert "v1-corrected" in told and "v1-speed-cap-region" not in told
