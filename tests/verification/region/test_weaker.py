"""The weaker claims that are tried where one about a craft without sway force is not proved."""

from __future__ import annotations

import pytest

from surctl.marine.tuning import derive_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import library
from surctl.marine.verification.region.proof import RegionProof

REMUS = load_vehicle("remus100")
GAINS = derive_gains(REMUS, cruise=0.3).gains
STATED = library.REGION_CLAIMS["region-steered-20"]


@pytest.mark.parametrize("proved", ["at a cruise speed of 0.45 m/s", ""])
def test_an_unknown_claim_about_steering_names_what_is_proved(proved: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def decided(statement, claim, *, seed):
        tried.append((statement.rate_per_s, statement.mass_share, claim.speed))
        good = bool(proved) and claim.speed[0] > 0.4
        return RegionProof(claim, "proved" if good else "unknown", {}, "none found", 0.81, (0.0, 0.0), 1.0, 0.0)

    monkeypatch.setattr(library, "_prove", decided)
    reason = library.prove_statement(STATED, REMUS, GAINS, cruise=0.3, cap=0.36).reason
    assert len(set(tried)) == len(tried) == (4 if proved else 7), "the claim, then one change each"
    assert tried[1][0] == STATED.rate_per_s / 4 and tried[2][1] == STATED.mass_share / 2
    end = f"; proved {proved}: from 0.81 m beside the path" if proved else ", or at a cruise speed of 0.15 m/s"
    assert reason.startswith("none found; ") and reason.endswith(end)
