"""As a new user with files of one's own: by the commands that each output names; study 40 goes on to C."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from tests.cli.process import Outcome, surctl


class Shell:
    """Gives a command with --json, and knows the commands that its answer says are next."""

    def __init__(self, folder: Path, first: str) -> None:
        self.folder, self.next = folder, [first]

    def follow(self, beginning: str, *words: str) -> Outcome:
        """The next command that begins so, with a few more words."""
        (command,) = {line for line in self.next if line.startswith(beginning)}
        program, *rest = shlex.split(command)
        assert program == "surctl"
        done = surctl(*rest, *words, "--json", cwd=self.folder)
        assert done.status == 0, done.err
        self.next = done.json.get("next", [])
        return done


@pytest.mark.parametrize("kind", ["vehicle", "scenario", "study"])
def test_what_lint_accepts_has_a_next_step(kind: str, tmp_path: Path) -> None:
    shell = Shell(tmp_path, f"surctl new {kind} mine")
    shell.follow("surctl new")
    shell.follow("surctl lint")
    assert shell.next and all("mine.toml" in command for command in shell.next)
