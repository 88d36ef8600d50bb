import json
import re
from functools import cache

import pytest
from click.testing import CliRunner

from surctl.assessment import assess
from surctl.certcheck.belonging import compare
from surctl.cli.app import app
from surctl.cli.verify import decide_claims
from surctl.errors import NotApplicable
from surctl.marine.assessment import Mission
from surctl.marine.cli import claims as regions
from surctl.marine.control import LAW_NAMES, build_law, load_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification.region import REGION_CLAIMS, applicable_region, load_region
from tests.certcheck import test_bundle
from tests.cli.process import surctl, surctl_here
from tests.cli.test_braking import decided


def test_names_of_regions_are_told_apart() -> None:
    assert all(regions.is_region(name) for name in REGION_CLAIMS)
    assert not regions.is_region("v1-corrected")


def test_a_region_that_is_not_proved_fails_and_leaves_nothing(tmp_path, monkeypatch) -> None:
    name = "region-cruise-20"
    fast = REGION_CLAIMS[name].model_copy(update={"attempts": 1, "rate_per_s": 5.0})
    monkeypatch.setitem(REGION_CLAIMS, name, fast)
    mission = Mission(load_vehicle("sur540-flooded"), load_gains("default"), 0.15, 0.22, "guarded")
    claims, _ = regions.region_claims([name], mission, out=tmp_path)
    [found] = decide_claims(claims, out=tmp_path, as_json=True)
    assert found.data["verdict"] == "unknown" and "FAIL" in found.lines[0]
    assert not list(tmp_path.iterdir())


def test_what_show_prints_is_the_claim_again(tmp_path) -> None:
    for name, statement in REGION_CLAIMS.items():
        done = CliRunner().invoke(app, ["verify", name, "--show"])
        assert done.exit_code == 0, done.output
        file = tmp_path / f"{name}.toml"
        file.write_text(done.stdout)
        assert load_region(file) == statement
    assert "nothing found" in surctl("lint", file.name, cwd=tmp_path).out


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("share = 1.5", "share = 1.5"),
        ("shar = 0.1", "did you mean 'share'"),
        ("force_n = nan", "force_n"),
        ('loop = "steered"\nsampled = true', "sampled = True: has no effect on the heading loop of craft without"),
        ("[gains]\nk_w = 1.0", "gains.k_w: no such gain"),
        ("force_n = 0.05\nsampled = true", "force = 0.05"),
        ("cruise_m_per_s = 0.3", "cruise = 0.3"),
    ],
)
def test_a_region_claim_with_a_mistake_is_told_in_one_line(tmp_path, text: str, complaint: str) -> None:
    (tmp_path / "mine.toml").write_text(f'kind = "region"\nname = "mine"\n{text}\n')
    done = surctl_here("verify", "mine.toml", cwd=tmp_path)
    assert done.status == 2 and "mine.toml" in done.complaint and complaint in done.complaint, done.err


def test_lint_reads_claims_and_names_the_kinds(tmp_path) -> None:
    (tmp_path / "claim.toml").write_text(surctl("verify", "v1-printed", "--show", cwd=tmp_path).out)
    assert surctl("lint", "claim.toml", cwd=tmp_path).status == 0
    (tmp_path / "other.toml").write_text('kind = "regin"\n')
    assert '"region"' in surctl("lint", "other.toml", cwd=tmp_path).complaint


def test_a_braking_claim_has_no_file(tmp_path) -> None:
    assert "has no claim file" in surctl("verify", "braking-rule-20", "--show", cwd=tmp_path).complaint


def test_a_region_for_another_kind_of_vehicle_names_the_one_that_applies(tmp_path) -> None:
    assert surctl("new", "vehicle", "hull", cwd=tmp_path).status == 0
    text = (tmp_path / "hull.toml").read_text()

    def written(file: str, m22: str, sway: str) -> str:
        changed = re.sub(r"(?m)^m22 = .*", f'm22 = "{m22}"', text)
        (tmp_path / file).write_text(re.sub(r"(?m)^Fv_max = .*", f'Fv_max = "{sway}"', changed))
        return file

    for file, law, kind in (
        (written("steered.toml", "50 kg", "0 N"), "steered", "region-steered-20"),
        (written("turning.toml", "60 kg", "5 N"), "guarded", "region-turning-20"),
    ):
        mission = Mission(load_vehicle(str(tmp_path / file)), load_gains("default"), 0.15, 0.22, law)
        [found], instead = regions.region_claims(["region-cruise-20"], mission)
        assert instead == kind and found.data["verdict"] == "not applicable"


def test_an_option_does_not_exchange_the_speed_of_a_region_file(tmp_path) -> None:
    (tmp_path / "own.toml").write_text('kind = "region"\nname = "own"\ncruise_m_per_s = 0.15\ncap_m_per_s = 0.22\n')
    for option, value in (("--cruise", "0.2"), ("--cap", "0.3")):
        done = surctl("verify", "own.toml", option, value, cwd=tmp_path)
        assert done.status == 2
        assert f"{option} = {value}: is not the speed of the region claim, which is proved at 0." in done.complaint
    assert surctl("verify", "own.toml", "--show", "--cruise", "0.15", cwd=tmp_path).status == 0


@cache
def _braked(law: str) -> bool:
    """Whether a claim about braking is proved of a law: it is about no guidance."""
    [found] = decided(["braking-simple-20"], "sur400", law=law)
    return bool(found.data["verdict"] == "proved")


@pytest.mark.parametrize("guidance", ["los", "ilos", "alos"])
@pytest.mark.parametrize("law", LAW_NAMES)
def test_a_claim_is_about_the_laws_that_its_certificate_fits(law: str, guidance: str) -> None:
    """What applies to a law is compared with what the checker finds in the law's instruction list."""
    vehicle, gains, names = load_vehicle("sur400"), load_gains("default"), ("region-cruise-20",)
    speeds = {"cruise": 0.15, "cap": 0.22}
    claim = applicable_region(names, vehicle, gains, law=law, guidance=guidance, **speeds)
    braked = _braked(law)
    subject = Mission(vehicle, gains, 0.15, 0.22, law, guidance, (load_scenario("pool-static"),))
    judged = assess(subject, parts=["no contact"]).lines[0]
    assert ("the claim concerns law guarded" in judged.text) != braked
    if law in ("steered", "calm"):  # the one needs another craft, the other has gains of its own
        assert isinstance(claim, NotApplicable) and not braked
        return
    built = build_law(law, guidance=guidance)
    manifest = test_bundle.manifest_for(law=built, spin=0.0)
    fits = not compare(test_bundle.region(law=built.block.digest()), manifest).differs
    assert fits == (not isinstance(claim, NotApplicable))
    if guidance == "los":
        certificate = test_bundle.braking("braking-simple-20", lambda c: c.update(sha256_law=built.block.digest()))
        assert braked == (not compare(certificate, manifest).differs)


def test_verify_says_of_a_law_only_what_is_about_it() -> None:
    words = ["verify", "region-cruise-20", "braking-inertia-20", "--law", "calm", "--vehicle", "sur400", "--json"]
    done = CliRunner().invoke(app, words)
    assert [one["verdict"] for one in json.loads(done.stdout)["claims"]] == ["not applicable"] * 2
