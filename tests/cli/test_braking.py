import json
import re
import shlex
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
from tests.cli.process import Outcome, surctl_here


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


UNEQUAL = """kind = "vehicle"
name = "muskrat"
hull = { provenance = "drawing", radius = "32 cm" }
inertia = { provenance = "weighed", m11 = "20 kg", m22 = "25 kg", m33 = "28 kg", m44 = "0.5 kg m^2" }
[thrust]
provenance = "data sheet"
thrust_lag = "0.15 s"
Fu_max = "62 N"
Fv_max = "62 N"
Fw_max = "44 N"
Fr_max = "19 N m"
[drag]
provenance = "estimated"
Xu = "5 N s/m"
Yv = "5 N s/m"
Zw = "5 N s/m"
Nr = "0.3 N m s"
Xuu = "60 N s^2/m^2"
Yvv = "75 N s^2/m^2"
Zww = "100 N s^2/m^2"
Nrr = "1.5 N m s^2"
"""


def test_a_margin_too_small_for_the_proof_has_a_remedy_that_the_next_commands_follow_with_all_options(
    tmp_path: Path,
) -> None:
    (tmp_path / "muskrat.toml").write_text(UNEQUAL)
    words = "verify braking-inertia-20 --vehicle muskrat.toml --scenario tank-static --cruise 0.25 --cap 0.35"
    words += " --sensing truth --barrier inertia"

    def run(command: str, *more: str) -> Outcome:
        return surctl_here(*shlex.split(command), *more, cwd=tmp_path)

    first = run(words, "--json")
    derive, again = first.json["next"]
    [claim] = first.json["claims"]
    margin = claim["margin_enough_m"]
    assert first.status == 1 and f'set margin = "{margin:g} m" in the gain file' in claim["remaining"]
    at = r"the gain margin is too small by [\d.]+ m at -?[\d.]+ m/s towards it, speed bound -?[\d.]+ m/s"
    assert re.search(at, claim["remaining"]), claim["remaining"]
    options = f"--cruise 0.25 --margin {margin:g} --barrier inertia --out gains.toml"
    assert derive == f"surctl gains derive muskrat.toml {options}"
    assert again == f"surctl {words} --json --gains gains.toml"
    assert run(f"{words} --gains default", "--json").json.get("next", []) == []  # no export after a FAIL
    assert run(derive.removeprefix("surctl ")).status == 0
    proved = run(again.removeprefix("surctl ").replace(" --json", ""), "--out", "proofs", "--verbose")
    assert proved.status == 0, proved.out
    contact = "no contact in tank-static with true positions holds for obstacles at rest: margin"
    covers = "needed 0 m at the exact values of the vehicle file, without thrust or speed sideways"
    assert contact in proved.out and covers in proved.out
    export = next(line for line in proved.out.splitlines() if line.startswith("  surctl export "))
    assert "--barrier inertia --sensing truth" in export
