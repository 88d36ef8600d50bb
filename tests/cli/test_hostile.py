"""Names and numbers that nobody means well: one line, status 2, and nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.process import surctl

SPHERE = ["--diameter", "0.3", "--mass", "8", "--thrust", "5", "--yaw-thrust", "0.4"]
LONG = "x" * 300


@pytest.mark.parametrize("name", ["", " ", "../x", "a/b", 'q"u\nü', LONG], ids=repr)
@pytest.mark.parametrize("command", [["vehicle", "from-geometry", *SPHERE, "--name"], ["new", "vehicle"]], ids=" ".join)
def test_a_name_that_is_no_file_s(tmp_path: Path, command: list[str], name: str) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    done = surctl(*command, name, cwd=folder)
    assert done.status == 2, done
    assert done.complaint.startswith("surctl: ") and done.out == ""
    assert [*tmp_path.rglob("*")] == [folder], "nothing is written, here or above"


HOSTILE = {
    "no vehicle's name": (["simulate", "pool-behind", "--vehicle", ""], "vehicle"),
    "no vehicle's name, exported": (["export", "--vehicle", ""], "vehicle"),
    "no vehicle's name, linted": (["lint", "pool-static", "--vehicle", ""], "vehicle"),
    "a name too long to look for": (["check", LONG], "File name too long"),
    "a run nested too deep": (["simulate", "--from", "deep.toml"], "deep.toml"),
    "a time of NaN": (["verify", "v1-printed", "--time-limit", "nan"], "--time-limit"),
    "endless time": (["verify", "v1-printed", "--time-limit", "inf"], "--time-limit"),
    "a file without an end": (["lint", "/dev/zero"], "is larger than"),
    "a part of a vehicle's name": (["lint", "bluerov2-w"], "'bluerov2-wu'"),
    "a vehicle for a vehicle": (["lint", "sur400", "--vehicle", "otter"], "--vehicle"),
    "a folder whose name is empty": (["sweep", "k_v=1,2", "--out", ""], "--out"),
    "a kind of file that is no text": (["lint", "list.toml"], "is not a kind of file"),
    "a folder that is no text": (["sweep", "k_v=1,2", "--out", "a\udcff"], "--out"),
    "points of two designs": (
        ["sweep", "k_v=1..2", "lookahead=1..2", "--design", "lhs", "--sensitivity", "score"],
        "--sensitivity",
    ),
    "time below 0": (["verify", "v1-printed", "--time-limit", "-1"], "--time-limit"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_word(tmp_path: Path, case: str) -> None:
    words, told = HOSTILE[case]
    (tmp_path / "deep.toml").write_text("a=" + "[" * 3000)
    (tmp_path / "list.toml").write_text("kind = []")
    done = surctl(*words, cwd=tmp_path)
    assert done.status == 2, done
    assert done.complaint.startswith("surctl: ") and told in done.complaint
    assert done.out == "" and {path.name for path in tmp_path.iterdir()} == {"deep.toml", "list.toml"}
