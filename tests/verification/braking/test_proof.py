import copy
import json
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import check_document, check_file, seal
from surctl.certcheck.braking import thrust_ahead, upper
from surctl.errors import InputError
from surctl.marine.control import build_law, load_gains
from surctl.marine.guidance.braking import fastest_obstacle, stopping_distance, stopping_distance_with_drag
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.braking import (
    BrakingClaim,
    BrakingProof,
    braking_claim_named,
    law_numbers,
    prove_braking,
)
from surctl.marine.verification.braking.proof import distance_of, largest_obstacle, stated
from tests.oracles.braking_episodes import run_episodes

KEPT = Path(__file__).parents[2] / "certcheck"
GAINS = load_gains("default")
FLOODED, SMALL = load_vehicle("sur540-flooded"), load_vehicle("sur400")


def claimed(name: str, vehicle: str = "sur540-flooded", **gains: float) -> BrakingClaim:
    return braking_claim_named(name, load_vehicle(vehicle), GAINS.with_values(gains))


@cache
def proved(name: str, vehicle: str = "sur540-flooded") -> BrakingProof:
    return prove_braking(claimed(name, vehicle))


QUICK = ("braking-simple-20", "braking-inertia-20", "braking-rule-20")  # all of them: study 40


@pytest.mark.parametrize("name", QUICK)
def test_every_claim_is_proved_of_the_paper_s_robot(name: str, tmp_path: Path) -> None:
    proof = proved(name)
    assert proof.verdict == "proved", proof.reason
    proof.write(tmp_path / "c.json")
    assert check_file(tmp_path / "c.json").accepted
    assert len(proof.text()) < 10_000
    told = json.loads(json.dumps(proof.to_dict()))
    assert told["range_needed_m"] == proof.range_needed > 0
    assert f"{proof.range_needed:.2f} m" in proof.sentence


# what the small vehicle's margin is too small for: its file states no ranges, so that its law believes it is exact
NOT_OF_SUR400 = {"braking-inertia-20-axes"}


@pytest.mark.parametrize("name", ["braking-rule-20", "braking-simple-20", *sorted(NOT_OF_SUR400)])
def test_what_is_proved_of_the_small_vehicle(name: str) -> None:
    proof = proved(name, "sur400")
    assert (proof.verdict == "unknown") == (name in NOT_OF_SUR400)
    if proof.verdict == "unknown":
        assert "margin is too small" in proof.sentence and not proof.certificate()
        assert prove_braking(claimed(name, "sur400", margin=0.13)).verdict == "proved"


@pytest.mark.parametrize("name", QUICK)
def test_the_kept_certificates_are_those_of_the_claims(name: str) -> None:
    kept = KEPT / f"{name}.json"
    if not kept.exists():
        return
    stated, own = json.loads(kept.read_text()), copy.deepcopy(proved(name).document)
    for whole in (stated, own):  # the law's hash goes with every change of the law
        whole["claim"].pop("sha256_law")
    assert stated["claim"] == own["claim"] and check_document(json.loads(kept.read_text())).accepted


def test_a_certificate_names_the_law_that_flies() -> None:
    for name, barrier in (("braking-inertia-20", "inertia"), ("braking-simple-20", "simple")):
        claim = claimed(name)
        assert claim.digests[1] == build_law(barrier=barrier).block.digest()
        assert proved(name).document["claim"]["law"]["barrier"] == barrier
    assert claimed("braking-inertia-20").digests[0] != claimed("braking-inertia-20", "sur400").digests[0]


# least range [m] at 0.10, 0.15, 0.22 m/s (rows) before obstacles at 0, 0.05, 0.10, 0.15 m/s, and the fastest obstacle
RANGES = {
    ("sur540-flooded", "braking-rule-20"): (
        [[0.30, 0.52, 0.81, 1.19], [0.48, 0.74, 1.09, 1.52], [0.75, 1.08, 1.47, 1.96]],
        0.227,
    ),
    ("sur540-flooded", "braking-rule-ranges"): (
        [[0.33, 0.58, 0.91, 1.35], [0.53, 0.84, 1.22, 1.72], [0.85, 1.22, 1.68, 2.24]],
        0.182,
    ),
    ("sur400", "braking-rule-20"): (
        [[0.24, 0.38, 0.56, 0.78], [0.36, 0.53, 0.74, 0.98], [0.55, 0.76, 1.00, 1.28]],
        0.314,
    ),
}


@pytest.mark.parametrize(("vehicle", "name"), RANGES)
def test_the_certified_ranges_are_those_of_the_prototype(vehicle: str, name: str) -> None:
    ranges, fastest = RANGES[vehicle, name]
    claim = proved(name, vehicle).document["claim"]
    # the prototype's age and errors are not written down: those of the claim are fitted
    assert np.abs(np.array(claim["table"]["needed_m"]) / ranges - 1).max() < 0.035
    assert claim["table"]["limit_obstacle_m_per_s"] == pytest.approx(fastest, abs=5e-4)


@pytest.mark.parametrize("name", ["braking-rule-20", "braking-rule-ranges"])
def test_the_tables_are_those_of_the_numbers_that_the_project_flies_by(name: str) -> None:
    claim = claimed(name)
    own = stated(claim)
    for obstacle in claim.obstacles:
        distance = distance_of(own, Fraction(repr(obstacle)))
        for speed in claim.speeds:
            way = max(float(upper(distance.length(f"({speed + obstacle!r})", mass))) for mass in own.mass)
            assert way == pytest.approx(stopping_distance_with_drag(claim.brakes, speed, obstacle=obstacle), rel=0.02)
            assert way <= stopping_distance(claim.brakes, speed, obstacle=obstacle)
    limit = proved(name).document["claim"]["table"]["limit_obstacle_m_per_s"]
    assert limit == pytest.approx(fastest_obstacle(claim.brakes), abs=1e-4)


def test_less_margin_or_more_speed_is_not_proved() -> None:
    assert prove_braking(claimed("braking-simple-20", margin=0.02)).verdict == "unknown"
    quick = replace(claimed("braking-inertia-20"), sideways=2.0)
    assert prove_braking(quick).verdict == "unknown"


def test_before_what_is_too_fast_nothing_is_guaranteed() -> None:
    proof = prove_braking(replace(claimed("braking-rule-20"), obstacles=(0.3,)))
    assert proof.verdict == "unknown" and "0.2268 m/s" in proof.sentence


@pytest.mark.parametrize("share", [0.5, 1.5])
def test_a_claim_without_force_to_brake_names_the_forces_that_it_assumes(share: float) -> None:
    plain = claimed("braking-rule-20")
    force = round(share * plain.brakes.least, 2)
    pushed = replace(plain, brakes=replace(plain.brakes, disturbance=force), obstacles=(0.3,))
    reason = prove_braking(pushed).reason
    assert f"a braking force of {plain.brakes.least:.3g} N" in reason and f"{force:.3g} N against it" in reason
    limit = largest_obstacle(stated(pushed))
    assert ("even at rest" if share > 1 else f"leaves none from {limit:.4g} m/s") in reason


def test_current_and_other_forces_lengthen_the_way() -> None:
    plain = claimed("braking-rule-20")
    for brakes in (replace(plain.brakes, current=0.05), replace(plain.brakes, disturbance=0.5)):
        worse = replace(plain, brakes=brakes, obstacles=(0.0, 0.05))
        assert prove_braking(worse).verdict == "proved"
        more, less = (distance_of(stated(c), Fraction(1, 20)).needed(Fraction(1, 10)) for c in (worse, plain))
        assert more > less


@pytest.mark.parametrize("vehicle", ["bluerov2-heavy"])  # bluerov2-wu: study 40
def test_unequal_masses_are_proved_with_their_coupling(vehicle: str) -> None:
    claim = claimed("braking-rule-20", vehicle)
    proof, equal = prove_braking(claim), prove_braking(replace(claim, ratio=1.0))
    assert claim.ratio > 1 and claim.drag == "axes" and claim.side == claim.brakes.most
    assert proof.verdict == "proved" and proof.range_needed > equal.range_needed
    for ratio in (1.0, 1.1 * claim.ratio):
        changed = copy.deepcopy(proof.document)
        changed["claim"]["vehicle"]["mass_ratio"] = ratio
        proved_parts = {key: changed[key] for key in ("distances", "proofs")}
        assert not check_document(seal("braking", changed["claim"], proved_parts)).accepted
    assert run_episodes(claim, obstacle=0.1, runs=30, seconds=10.0).hits == 0
    assert prove_braking(replace(claim, turn=3.0)).verdict == "unknown"
    with pytest.raises(InputError, match=r"m22 .* no ranges"):
        claimed("braking-rule-ranges", vehicle)


FORGED: dict[str, dict[str, Any]] = {
    "the Coriolis force": {"turn": 0.0},
    "the thrust across": {"side": 0.0},
    "the coupling of the masses": {"ratio": 1.0},
    "a speed of the loop": {"cap": 0.05},
    "lag": {"lag": 0.25},
}


@pytest.mark.parametrize("what", FORGED)
def test_a_law_s_claim_whose_proof_lacks_a_term_is_rejected(what: str) -> None:
    claim = replace(claimed("braking-inertia-20", "bluerov2-vonbenzon"), fastest=0.25).braking_with(34.0)
    assert claim.law is not None and thrust_ahead(stated(claim)) < claim.brakes.most
    change = dict(FORGED[what])
    law, brakes = (
        replace(claim.law, cap=Fraction(repr(change.pop("cap", 0.22)))),
        replace(claim.brakes, lag=change.pop("lag", 0.3)),
    )
    other = prove_braking(replace(claim, law=law, brakes=brakes, **change))
    assert other.verdict == "proved", other.reason
    own = {key: other.document[key] for key in ("distances", "proofs")}
    needed = [[9.0] for _ in claim.speeds]  # so that the inequalities decide
    whole = claim.document(needed, largest_obstacle(stated(claim)))
    assert "inequality" in check_document(seal("braking", whole, own)).reason


def test_claims_that_do_not_fit_are_the_users_mistake() -> None:
    with pytest.raises(InputError, match="k_i"):
        law_numbers("inertia", FLOODED, GAINS.with_values({"k_i": 0.1}))
    assert law_numbers("inertia", FLOODED.with_values({"m22": 80.0}), GAINS).mass == (95, 80)
    with pytest.raises(InputError, match="braking-inertia-20"):
        braking_claim_named("braking-inertia-21", FLOODED, GAINS)


def test_the_law_s_numbers_in_a_certificate_are_those_of_the_exported_law() -> None:
    # a third has no short decimals; a rounded number would not be that of the law
    claim = claimed("braking-inertia-20", margin=1 / 7, brake=2 / 3)
    law = claim.law
    assert law is not None
    law = replace(law, stopping={key: Fraction(repr(float(x) / 3)) for key, x in law.stopping.items()})
    written = stated(replace(claim, law=law)).law
    assert written == law and float(law.margin) == 1 / 7
