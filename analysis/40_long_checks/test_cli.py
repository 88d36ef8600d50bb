"""Command line: from a tape measure to C, a region claim of one's own, exports of laws with limits and sonars."""

from __future__ import annotations

import json
import re
import shlex
import zipfile
from pathlib import Path

import pytest

from surctl.marine.cli.linear_part import over_speeds
from tests.cli.process import surctl
from tests.cli.test_speeds import parts
from tests.cli.test_systems import FILE, data
from tests.cli.test_trial import Shell
from tests.tools import need, need_compiler


def test_a_region_claim_of_ones_own_is_proved(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        'kind = "region"\nname = "mine"\nshare = 0.1\nforce_n = 0.1\nattempts = 2\n[gains]\nk_v = 1.2\n'
    )
    assert surctl("gains", "derive", "sur540-flooded", "--out", "gains.toml", cwd=tmp_path).status == 0
    done = surctl("verify", "mine.toml", "--gains", "gains.toml", "--out", "proofs", "--json", cwd=tmp_path)
    assert done.status == 0, done.err
    (told,) = done.json["claims"]
    assert told["claim"] == "mine" and told["verdict"] == "proved"
    stated = json.loads((tmp_path / "proofs" / "mine.json").read_text())["claim"]
    assert stated["vehicle"]["mass_factor"] == [0.9, 1.1] and stated["vehicle"]["force_n"] == 0.1
    assert stated["law"]["mass_kg"] == [95.0, 95.0] and stated["law"]["k_v"] == 1.2
    assert surctl("check", "proofs/mine.json", cwd=tmp_path).status == 0
    assert [path.name for path in (tmp_path / "proofs").glob("mine*.png")] == ["mine-levels.png"]
    # it is not about the law with the gains that are exported: it has gains of its own
    check, export = done.json["next"]
    assert check == "surctl check proofs/mine.json" and "--certificate" not in export


def test_a_loop_that_is_unstable_at_one_speed_is_told_whichever_comes_last() -> None:
    slow, fast = parts("bluerov2-wu", 0.1, 0.47)
    assert slow.stable and not fast.stable
    assert not over_speeds([slow, fast]).stable and not over_speeds([fast, slow]).stable


def test_export_ships_the_law_that_senses_and_checks_it_over_its_flight(tmp_path: Path) -> None:
    need_compiler()
    done = surctl(
        *("export", "--scenario", "pool-behind", "--fault", "dropout:0:2:3", "--out", "c", "--name", "pilot", "--json"),
        cwd=tmp_path,
    )
    assert done.status == 1  # with the set `default`, the no-contact claim lacks margin
    assert done.json["sil"]["passed"] and done.json["failure"] is None
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
    assert done.status == 1  # as above
    sil = done.json["sil"]
    assert sil["passed"] and sil["tau"] == sil["state"] == 0.0 and sil["steps"] > 300


FIRST = (
    *("surctl", "vehicle", "from-geometry", "--name", "scout", "--diameter", "30 cm"),
    *("--mass", "4 kg", "--thrust", "0.8 kgf", "--yaw-thrust", "0.6 N m"),
)


def test_from_a_tape_measure_to_code(tmp_path: Path) -> None:
    need_compiler()
    shell = Shell(tmp_path, shlex.join(FIRST))
    shell.follow("surctl vehicle from-geometry")
    shell.follow("surctl lint")
    assert shell.next == ["surctl tune --vehicle scout.toml --out tuned", "surctl study scout.toml"]
    # tuning and the region claim take long, and README's page and the guide to tuning run them
    shell.next = ["surctl verify v1-corrected --vehicle scout.toml --out proofs"]
    (claim,) = shell.follow("surctl verify").json["claims"]
    assert (claim["claim"], claim["verdict"]) == ("v1-corrected", "proved")
    then = shell.next
    assert shell.follow("surctl check").json["accepted"]
    shell.next = then
    shell.follow("surctl gains derive", "--margin", "0.218")  # the derived margin is too small for no contact
    shell.next = then
    words = ("--scenario", "pool-behind", "--sensing", "truth", "--target", "fmu", "--out", "code")
    made = shell.follow("surctl export", *words).json
    assert made["sil"]["passed"] and (made["run"]["vehicle"], made["run"]["sensing"]) == ("scout", "truth")
    header = (tmp_path / "code" / "surctl_guarded.h").read_text()
    assert "double eta[4];" in header and "double samples" not in header
    assert shell.next[1:3] == [
        "make -C code controller && code/controller 5555",
        "surctl simulate pool-behind --vehicle scout.toml --gains gains.toml --law guarded"
        " --controller tcp://127.0.0.1:5555",
    ]
    belongs = shell.follow("surctl check").json
    assert belongs["accepted"] and belongs["bundle"]["belongs"]
    with zipfile.ZipFile(tmp_path / "code" / "surctl_guarded.fmu") as unit:
        assert "modelDescription.xml" in unit.namelist()


def test_a_system_is_exported_with_its_proof_and_its_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("frama-c")
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(FILE)
    words = ("--seconds", "1", "--real", "float32", "--prove", "--check", "--steps", "50", "--targets", "gcc-O2")
    done = data("export", "mine.py:build", *words, "--out", "c")
    assert done["largest_difference"] == 0.0 and done["check"]["passed"]
    assert done["proof"]["status"] == "proved" and "thrust" not in done["proof"]["claim"]


def test_a_run_in_a_random_world_is_flown_again(tmp_path: Path) -> None:
    words = ("--random-worlds", "2", "--seed", "4", "--law", "closed_form", "--worst", "1", "--out", "w", "--json")
    (row,) = surctl("simulate", *words, cwd=tmp_path).json["campaigns"][0]["worst"]
    (run,) = surctl("simulate", "--from", f"w/{row['file']}", "--json", cwd=tmp_path).json["runs"]
    assert run["same"] and run["scenario"] == f"world-{row['seed']}"
