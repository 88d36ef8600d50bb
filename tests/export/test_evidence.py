"""Evidence travels with a bundle, and a bundle appears only when it is complete and checked."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from click.testing import CliRunner

import surctl.marine.simulation
from surctl.assessment import Assessment, Figure
from surctl.certcheck.bundle import read_bundle
from surctl.cli.app import app
from surctl.errors import InputError
from surctl.export import Bundle, SilReport, write_bundle
from surctl.export.bundle import check_folder
from surctl.export.evidence import ReplayedRun, write_evidence
from surctl.export.sil import Difference
from tests.export.test_gains_in_c import guarded
from tests.tools import need_compiler

OPTIONS = ("--law", "closed_form", "--sensing", "truth", "--scenario", "pool-behind", "--out", "fw")


def test_the_bundle_of_a_command_carries_what_was_run_and_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SURCTL_CFLAGS", "-O0")
    more = ("--target", "fmu", "--check", "--targets", "gcc-O0", "--steps", "200")
    done = CliRunner().invoke(app, ["export", *OPTIONS, *more], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    manifest = json.loads(Path("fw/manifest.json").read_text())
    evidence = manifest["evidence"]
    assert evidence["run"]["scenario"] == "pool-behind" and evidence["run"]["failure"] is None
    assert evidence["sil"]["passed"] and evidence["sil"]["steps"] > 100 and not evidence["sil"]["fault_failures"]
    (build,) = evidence["check"]["builds"]
    assert build["same"] and build["runtime_bytes"] > 1000 and evidence["instruction_bound"] is None
    assert (
        manifest["sha256"]["surctl_closed_form.fmu"]
        == hashlib.sha256(Path("fw/surctl_closed_form.fmu").read_bytes()).hexdigest()
    )
    written = {file.relative_to("fw").as_posix() for file in Path("fw").rglob("*") if file.is_file()}
    assert set(manifest["sha256"]) == written - {"manifest.json"} and "ros2/package.xml" in written
    assert read_bundle(Path("fw")).wrong == ()
    readme = Path("fw/README.md").read_text().split("## Evidence")[1]
    assert "pool-behind by sur400, truth, seed 0: arrived without contact." in readme
    assert "| gcc-O0 | same |" in readme and "not a proved bound" in readme
    assert "MIT License" in Path("fw/LICENSE").read_text()


def test_each_replayed_run_is_evidence(tmp_path: Path) -> None:
    bundle, none = guarded()[1], Difference(0.0, 0.0, 0.0, None)
    replays = [ReplayedRun({"system": "a.py:b", "text": text, "failure": None}, []) for text in ("one", "two")]
    reports = [SilReport("c", "1f", n, (), none, none, none, 0, 837, (), True, "cc 12", 9) for n in (400, 500)]
    figure = {"x": Figure("x", float("nan"), "1", "", "high")}
    write_evidence(bundle, tmp_path / "b", replays, reports, Assessment("a", figure, (), {}), command="surctl export")
    evidence = json.loads((tmp_path / "b" / "manifest.json").read_text())["evidence"]
    [further] = evidence["further_runs"]
    assert (evidence["run"]["text"], evidence["sil"]["steps"]) == ("one", 400)
    assert (further["run"]["text"], further["sil"]["steps"]) == ("two", 500)
    assert evidence["assessment"]["figures"]["x"]["value"] is None, "JSON has no NaN"
    readme = (tmp_path / "b" / "README.md").read_text()
    assert [readme.count(f"Simulated run: {text}.") for text in ("one", "two")] == [1, 1]
    assert "over 400 steps" in readme and "over 500 steps" in readme and read_bundle(tmp_path / "b").wrong == ()


def test_a_command_that_ends_half_way_leaves_no_bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)

    def killed(*args: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(surctl.marine.simulation, "simulate", killed)
    assert CliRunner().invoke(app, ["export", *OPTIONS]).exit_code != 0
    assert not list(tmp_path.iterdir())


def test_a_folder_with_a_manifest_is_complete_at_any_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, bundle = tmp_path / "b", guarded()[1]
    write_bundle(bundle, folder)
    other: Bundle = replace(bundle, files=MappingProxyType({**bundle.files, "README.md": "other"}))
    moved, real = [], Path.replace

    def crashes(self: Path, target: Path) -> Path:
        moved.append(target.name)
        if len(moved) > 3:
            raise OSError(28, "No space left on device")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", crashes)
    with pytest.raises(InputError, match="No space left"):
        write_bundle(other, folder)
    assert "manifest.json" not in moved and not (folder / "manifest.json").exists()
    monkeypatch.undo()
    write_bundle(bundle, folder)
    assert read_bundle(folder).wrong == () and [p.name for p in tmp_path.iterdir()] == ["b"]


def test_a_folder_that_cannot_hold_a_bundle_is_reported_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for place in ("file", "file/inside"):
        with pytest.raises(InputError, match="cannot be written"):
            check_folder(tmp_path / place)
    check_folder(tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
