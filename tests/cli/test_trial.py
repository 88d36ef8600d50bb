"""As a new user with a vehicle of one's own: from a tape measure to C, by the commands that each output names."""

from __future__ import annotations

import shlex
import zipfile
from pathlib import Path

import pytest

from tests.cli.process import Outcome, surctl
from tests.tools import need_compiler

FIRST = (
    *("surctl", "vehicle", "from-geometry", "--name", "scout", "--diameter", "30 cm"),
    *("--mass", "4 kg", "--thrust", "0.8 kgf", "--yaw-thrust", "0.6 N m"),
)


class Shell:
    """Gives a command with --json, and knows the commands that its answer says are next."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.next = folder, [shlex.join(FIRST)]

    def follow(self, beginning: str, *words: str) -> Outcome:
        """The next command that begins so, with a few more words."""
        (command,) = {line for line in self.next if line.startswith(beginning)}
        program, *rest = shlex.split(command)
        assert program == "surctl"
        done = surctl(*rest, *words, "--json", cwd=self.folder)
        assert done.status == 0, done.err
        self.next = done.json.get("next", [])
        return done


def test_from_a_tape_measure_to_code(tmp_path: Path) -> None:
    need_compiler()
    shell = Shell(tmp_path)
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
    shell.follow("surctl gains derive")
    shell.next = then
    words = ("--sensing", "truth", "--target", "fmu", "--out", "code")
    made = shell.follow("surctl export", *words).json
    assert made["sil"]["passed"] and (made["run"]["vehicle"], made["run"]["sensing"]) == ("scout", "truth")
    header = (tmp_path / "code" / "surctl_guarded.h").read_text()
    assert "double eta[4];" in header and "double samples" not in header
    assert shell.next[1:3] == [
        "make -C code controller && code/controller 5555",
        "surctl simulate pool-static --vehicle scout.toml --gains gains.toml --law guarded"
        " --controller tcp://127.0.0.1:5555",
    ]
    belongs = shell.follow("surctl check").json
    assert belongs["accepted"] and belongs["bundle"]["belongs"]
    with zipfile.ZipFile(tmp_path / "code" / "surctl_guarded.fmu") as unit:
        assert "modelDescription.xml" in unit.namelist()


@pytest.mark.parametrize("kind", ["vehicle", "scenario", "study"])
def test_what_lint_accepts_has_a_next_step(kind: str, tmp_path: Path) -> None:
    shell = Shell(tmp_path)
    shell.next = [f"surctl new {kind} mine"]
    shell.follow("surctl new")
    shell.follow("surctl lint")
    assert shell.next and all("mine.toml" in command for command in shell.next)
