import json
from dataclasses import replace

from surctl.certcheck import check_file
from surctl.cli import regions
from surctl.verification.region import REGION_CLAIMS


def test_names_of_regions_are_told_apart() -> None:
    assert all(regions.is_region(name) for name in REGION_CLAIMS)
    assert not regions.is_region("v1-corrected")


def test_a_proved_region_leaves_a_certificate_that_is_accepted(tmp_path, monkeypatch) -> None:
    name = "region-cruise-20-soft"
    monkeypatch.setitem(REGION_CLAIMS, name, REGION_CLAIMS[name]._replace(attempts=12))
    found = regions.prove_regions([name], vehicle="sur540-flooded", gains="default", out=tmp_path / "proofs")
    assert found.passed and found.lines[0].startswith("ok   region-cruise-20-soft")
    assert check_file(tmp_path / "proofs" / f"{name}.json").accepted
    json.dumps(found.claims)


def test_a_region_that_is_not_proved_fails_and_leaves_nothing(tmp_path, monkeypatch) -> None:
    name = "region-cruise-20"
    entry = REGION_CLAIMS[name]
    fast = entry._replace(attempts=2, build=lambda *given: replace(entry.build(*given), rate=5.0))
    monkeypatch.setitem(REGION_CLAIMS, name, fast)
    found = regions.prove_regions([name], vehicle="sur540-flooded", gains="default", out=tmp_path)
    assert not found.passed and found.claims[0]["verdict"] == "unknown" and "FAIL" in found.lines[0]
    assert not list(tmp_path.iterdir())
