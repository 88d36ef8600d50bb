import json

import pytest

from surctl.certcheck import check_file
from surctl.errors import InputError
from surctl.marine.cli import claims as braking
from surctl.marine.verification import claims
from surctl.marine.verification.braking import BRAKING_CLAIMS
from tests.cli.process import surctl_here


def test_names_of_braking_claims_are_told_apart_from_the_steps_of_their_proof() -> None:
    assert all(braking.is_braking(name) for name in BRAKING_CLAIMS)
    assert not any(braking.is_braking(claim.name) for claim in claims())


def test_a_proved_claim_leaves_a_certificate_that_is_accepted_and_tells_what_it_rests_on(tmp_path) -> None:
    name = "braking-rule-20"
    found = braking.prove_all(
        [name], vehicle="sur540-flooded", gains="default", law="guarded", cap=0.22, out=tmp_path / "proofs"
    )
    assert found.claims[0]["verdict"] == "proved" and found.lines[0].startswith(f"ok   {name}")
    file = tmp_path / "proofs" / f"{name}.json"
    assert check_file(file).accepted
    json.dumps(found.claims)
    checked = surctl_here("check", file, cwd=tmp_path)
    assert checked.status == 0 and "    - there is one obstacle or wall at a time" in checked.out


def test_what_is_not_proved_fails_and_leaves_nothing(tmp_path) -> None:
    found = braking.prove_all(
        ["braking-inertia-20-axes"], vehicle="sur400", gains="default", law="guarded", cap=0.22, out=tmp_path
    )
    assert found.claims[0]["verdict"] == "unknown" and "FAIL" in found.lines[0]
    assert not list(tmp_path.iterdir())


def test_an_unknown_name_is_a_mistake() -> None:
    with pytest.raises(InputError, match="did you mean 'braking-rule-20'"):
        braking.prove_all(["braking-rule-21"], vehicle="sur540-flooded", gains="default", law="guarded", cap=0.22)
