"""A region claim that is not proved names what is; a region that hardly shrinks is not of use."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import (
    REGION_CLAIMS,
    RegionProof,
    RegionStatement,
    TurningClaim,
    library,
    prove_statement,
    region_statement,
)
from surctl.marine.verification.region.library import implies

ROV = load_vehicle("bluerov2-heavy")
GAINS = derived_gains(ROV, cruise=0.17)
HARDER = ("mass_asymmetry", "drag_asymmetry", "yaw_rate", "rate", "current", "curvature", "turn_rate")


def claimed(**changes: Any) -> TurningClaim:
    claim = RegionStatement(name="test", loop="turning", rate_per_s=0.02).claim(ROV, GAINS, cruise=0.17, cap=0.24)
    assert isinstance(claim, TurningClaim)
    return replace(claim, **changes)


@pytest.mark.parametrize("seed", range(20))
def test_a_claim_proves_another_one_exactly_if_nothing_in_it_is_easier(seed: int) -> None:
    rng = np.random.default_rng(seed)
    easy = claimed(current=0.01, curvature=0.1)
    grown = {key: getattr(easy, key) * rng.uniform(1.0, 2.0) for key in HARDER if rng.random() < 0.5}
    low, high = easy.drag_factor
    grown |= {"drag_factor": (0.9 * low, 1.1 * high), "thrust": (0.9 * easy.thrust[0], easy.thrust[1])}
    hard = replace(easy, name="hard", rest=bool(rng.random() < 0.5), **grown)
    assert implies(hard, easy) and implies(easy, easy) and not implies(easy, hard)
    key = str(rng.choice(HARDER))
    assert not implies(replace(hard, **{key: 0.9 * getattr(easy, key)}), easy)
    assert not implies(hard, replace(easy, cruise=0.16)) and not implies(hard, replace(easy, mass=(1.0, 2.0)))


def proofs(monkeypatch: pytest.MonkeyPatch, holds: Any) -> list[str]:
    """Let a rule decide the claims in place of the search; return the names of the claims that were searched."""
    searched: list[str] = []

    def prove(statement: Any, claim: Any, *, seed: int) -> RegionProof:
        searched.append(statement.name)
        good = holds(statement, claim)
        return RegionProof(claim, "proved" if good else "unknown", {}, "" if good else "why", 0.4, (0.1, 0.1), 0.0, 0.0)

    monkeypatch.setattr(library, "_prove", prove)
    return searched


def decided(name: str) -> RegionProof:
    return prove_statement(region_statement(name), ROV, GAINS, cruise=0.17, cap=0.24)


RULES = {
    "without a start at rest": lambda s, c: not c.rest,
    "at a decay rate of 0.005/s": lambda s, c: c.rate < 0.01,
    "with masses off by up to 0.025 and drag by up to 0.1 of their values": lambda s, c: s.share < 0.15,
    "at a cruise speed of 0.128 m/s": lambda s, c: c.cruise < 0.13 and c.cap < 0.19,
}


@pytest.mark.parametrize("words", RULES)
def test_what_is_not_proved_names_the_assumption_that_decides(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    proofs(monkeypatch, RULES[words])
    proof = decided("region-turning-20-rest")
    assert proof.verdict == "unknown" and proof.sentence.endswith(f"why; proved {words}: from 0.4 m beside the path")


def test_what_nothing_weaker_proves_says_what_was_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    proofs(monkeypatch, lambda s, c: False)
    assert all(words in decided("region-turning-20-rest").reason for words in RULES)


def test_a_stronger_claim_that_is_proved_proves_the_weaker_one(monkeypatch: pytest.MonkeyPatch) -> None:
    proofs(monkeypatch, lambda s, c: s.name == "region-turning-20-rest")
    proof = decided("region-turning")
    assert proof.verdict == "proved" and proof.claim.name == "region-turning"
    assert proof.sentence.endswith("by the stronger claim region-turning-20-rest")
    searched = proofs(monkeypatch, lambda s, c: s.name == "region-turning-20-lag")
    assert decided("region-turning-20").verdict == "unknown" and "region-turning-20-lag" not in searched
    assert set(searched) <= set(REGION_CLAIMS)


@pytest.mark.parametrize("within", [0.1, 0.26, 0.28, 0.39])
def test_a_region_that_hardly_shrinks_is_called_so(within: float) -> None:
    proof = RegionProof(claimed(), "proved", {}, "", 0.4, (0.05, within), 0.0, 0.0)
    assert proof.useful is (within < 0.27) is ("hardly shrinks" not in proof.sentence)
    assert proof.to_dict()["useful"] is proof.useful
