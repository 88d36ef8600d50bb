import json
from pathlib import Path

import pytest

from surctl.certcheck import check_file
from surctl.cli.verify import Decided, decide_claims
from surctl.errors import InputError
from surctl.marine.assessment import Mission
from surctl.marine.cli import claims as braking
from surctl.marine.control import load_gains
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.braking import BRAKING_CLAIMS
from tests.cli.process import surctl_here


def decided(names: list[str], vehicle: str, *, law: str = "guarded", out: Path | None = None) -> list[Decided]:
    """The named claims at a speed limit of 0.22 m/s, decided."""
    mission = Mission(load_vehicle(vehicle), load_gains("default"), 0.15, 0.22, law)
    return decide_claims(braking.braking_claims(names, mission, out=out), out=out, as_json=True)


def test_names_of_braking_claims_are_told_apart_from_the_steps_of_their_proof() -> None:
    assert all(braking.is_braking(name) for name in BRAKING_CLAIMS)
    assert not any(braking.is_braking(claim.name) for claim in claims())


def test_a_proved_claim_leaves_a_certificate_that_is_accepted_and_tells_what_it_rests_on(tmp_path) -> None:
    name = "braking-rule-20"
    [found] = decided([name], "sur540-flooded", out=tmp_path / "proofs")
    assert found.data["verdict"] == "proved" and found.lines[0].startswith(f"ok   {name}")
    file = tmp_path / "proofs" / f"{name}.json"
    assert check_file(file).accepted
    json.dumps(found.data)
    checked = surctl_here("check", file, cwd=tmp_path)
    assert checked.status == 0 and "    - there is one obstacle or wall at a time" in checked.out


def test_what_is_not_proved_fails_and_leaves_nothing(tmp_path) -> None:
    [found] = decided(["braking-inertia-20-axes"], "sur400", out=tmp_path)
    assert found.data["verdict"] == "unknown" and "FAIL" in found.lines[0] and found.failure
    assert not list(tmp_path.iterdir())


def test_an_unknown_name_is_a_mistake() -> None:
    with pytest.raises(InputError, match="did you mean 'braking-rule-20'"):
        decided(["braking-rule-21"], "sur540-flooded")
