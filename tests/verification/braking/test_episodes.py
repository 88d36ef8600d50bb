from dataclasses import replace

import pytest

from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.braking import BrakingClaim, braking_claim_named
from tests.oracles.braking_episodes import rule_of, run_episodes


def claimed(name: str, vehicle: str = "sur540-flooded") -> BrakingClaim:
    return braking_claim_named(name, load_vehicle(vehicle), load_gains("default"))


@pytest.mark.parametrize("name", ["inertia-ranges", "inertia-20-movers"])
def test_nothing_is_touched_inside_the_assumptions(name: str) -> None:
    claim = claimed(f"braking-{name}")
    found = run_episodes(claim, obstacle=claim.obstacles[-1], runs=80, seconds=12.0, seed=2)
    assert found.hits == 0 and found.least >= 0
    assert found.braked > 0.9 and found.near > 0.1  # it comes near: what never lets go would pass too


def test_a_shorter_way_hits() -> None:
    claim, obstacle = claimed("braking-rule-20"), 0.1
    short = rule_of(claim, obstacle=obstacle, share=0.85)
    assert run_episodes(claim, obstacle=obstacle, runs=300, seconds=12.0, rule=short).hits > 0


@pytest.mark.parametrize("change", ["margin", "brake"])
def test_a_law_that_keeps_less_hits(change: str) -> None:
    claim = claimed("braking-simple-20")
    assert claim.law is not None
    law = replace(claim.law, **{change: {"margin": 0.0, "brake": 1.4 * claim.law.brake}[change]})
    rule = rule_of(replace(claim, law=law), obstacle=0.0)
    assert run_episodes(claim, obstacle=0.0, runs=150, seconds=12.0, rule=rule).hits > 0


def test_the_same_seed_flies_the_same_flights() -> None:
    claim = claimed("braking-rule-20")
    first, second = (run_episodes(claim, obstacle=0.05, runs=20, seconds=2.0, seed=s) for s in (1, 1))
    assert first == second != run_episodes(claim, obstacle=0.05, runs=20, seconds=2.0, seed=2)
