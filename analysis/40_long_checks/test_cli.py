"""Command line: a region claim of one's own, and the export of a law with limits and of the law with sonars."""

from __future__ import annotations

import json
import re
from pathlib import Path

from tests.cli.process import surctl
from tests.tools import need_compiler


def test_a_region_claim_of_ones_own_is_proved(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        'kind = "region"\nname = "mine"\nshare = 0.1\nforce_n = 0.1\nattempts = 2\n[gains]\nk_v = 1.2\n'
    )
    done = surctl("verify", "mine.toml", "--out", "proofs", "--json", cwd=tmp_path)
    assert done.status == 0, done.err
    (told,) = done.json["claims"]
    assert told["claim"] == "mine" and told["verdict"] == "proved"
    stated = json.loads((tmp_path / "proofs" / "mine.json").read_text())["claim"]
    assert stated["vehicle"]["mass_kg"] == [85.5, 104.5] and stated["vehicle"]["force_n"] == 0.1
    assert stated["law"]["k_v"] == 1.2
    assert surctl("check", "proofs/mine.json", cwd=tmp_path).status == 0
    assert [path.name for path in (tmp_path / "proofs").glob("mine*.png")] == ["mine-levels.png"]
    # it is not about the law with the gains that are exported: it has gains of its own
    check, export = done.json["next"]
    assert check == "surctl check proofs/mine.json" and "--certificate" not in export


def test_export_ships_the_law_that_senses_and_checks_it_over_its_flight(tmp_path: Path) -> None:
    need_compiler()
    done = surctl(
        *("export", "--scenario", "pool-behind", "--fault", "dropout:0:2:3", "--out", "c", "--name", "pilot", "--json"),
        cwd=tmp_path,
    )
    assert done.status == 0
    assert done.json["sil"]["passed"]
    assert max(done.json["sil"][k] for k in ("tau", "state", "telemetry")) == 0.0
    assert done.json["sil"]["fault_failures"] == []
    assert done.json["sil"]["fault_cases"] > 3 * 2304
    flight = done.json["run"]
    assert (flight["scenario"], flight["sensing"], flight["law"]) == ("pool-behind", "sonar", "guarded")
    assert flight["sensors"]["faults"][0]["kind"] == "dropout"
    assert done.json["sil"]["steps"] > 200
    flown = "surctl simulate pool-behind --sensing sonar --fault dropout:0:2:3 --controller tcp://127.0.0.1:5555"
    assert done.json["next"] == ["make -C c controller && c/controller 5555", flown]
    header = (tmp_path / "c" / "pilot.h").read_text()
    assert (
        "double samples[4][5];" in header and re.search(r"_at_map_cells = \d+", header) and "double eta" not in header
    )
    assert {"pilot.h", "pilot.c", "manifest.json"} <= {p.name for p in (tmp_path / "c").iterdir()}


def test_a_law_with_limits_is_exported_and_replayed(tmp_path: Path) -> None:
    need_compiler()
    done = surctl("export", "--priority-mode", "filter", "--sensing", "truth", "--out", "c", "--json", cwd=tmp_path)
    assert done.status == 0
    sil = done.json["sil"]
    assert sil["passed"] and sil["tau"] == sil["state"] == 0.0 and sil["steps"] > 300
