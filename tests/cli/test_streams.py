"""What a command does where its output cannot go as it is."""

import errno
import io
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from surctl.cli import main
from surctl.cli.output import progress

NARROW = ("cp1252", "ascii", "latin-1")
CHEAP = [
    ["list"], ["list", "--json"], ["--help"], ["--version"], ["verify", "--help"], ["completion", "bash"],
    ["lint", "tank-static"], ["list", "--show", "sur400"], ["verify", "v1-printed", "--show", "--json"],
]  # fmt: skip


class Full(io.BytesIO):
    """A file on a full disk."""

    def write(self, _) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def run(words: list[str], out: io.TextIOWrapper, monkeypatch: pytest.MonkeyPatch) -> int:
    """The status of a command that prints to `out`."""
    monkeypatch.setattr("sys.argv", ["surctl", *words])
    monkeypatch.setattr("sys.stdout", out)
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def printed(words: list[str], encoding: str, monkeypatch: pytest.MonkeyPatch) -> str:
    raw = io.BytesIO()
    assert run(words, io.TextIOWrapper(raw, encoding=encoding), monkeypatch) == 0
    return raw.getvalue().decode(encoding)


@pytest.mark.parametrize("encoding", NARROW)
def test_what_an_encoding_does_not_have_is_escaped(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = printed(["verify", "v1-printed", "--show"], encoding, monkeypatch)
    assert tomllib.loads(shown)["statement"].startswith("V̇1")  # TOML reads the escapes back
    told = printed(["verify", "v1-printed", "--show", "--json"], encoding, monkeypatch)
    assert told.isascii() and "V̇1" in json.loads(told)["claims"]["v1-printed"]
    plain = printed(["reproduce", "E1"], encoding, monkeypatch)
    assert "V\\u03072" in plain and "wrong in print" in plain


def test_utf_8_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    told = printed(["verify", "v1-printed", "--show", "--json"], "utf-8", monkeypatch)
    assert "V̇1" in told and "V̇1" in json.loads(told)["claims"]["v1-printed"]


def test_an_error_handler_that_the_user_chose_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    chosen = io.TextIOWrapper(raw, encoding="ascii", errors="ignore")
    assert run(["verify", "v1-printed", "--show"], chosen, monkeypatch) == 0
    assert 'statement = "V1 ' in raw.getvalue().decode("ascii")


@pytest.mark.parametrize("words", CHEAP, ids=" ".join)
def test_a_full_disk_under_stdout_is_one_line_and_a_status(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status = run(words, io.TextIOWrapper(Full(), encoding="utf-8"), monkeypatch)
    line = (
        "surctl: the output cannot be written (no space left on device); free disk space, or write to another place\n"
    )
    assert (status, capsys.readouterr().err) == (3, line)


def test_a_full_disk_under_the_log_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", io.TextIOWrapper(Full(), encoding="utf-8", write_through=True))
    progress("on the way")
    assert run(["list", "--show", "no-such"], io.TextIOWrapper(io.BytesIO()), monkeypatch) == 2


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_process_on_a_full_disk_ends_with_that_line_alone(tmp_path: Path, unbuffered: str) -> None:
    # with a buffer, Python writes the rest at its end, and reports a second failure there
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "surctl", "--version"]
        done = subprocess.run(
            command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )  # fmt: skip
    assert (done.returncode, done.stderr.count("\n")) == (3, 1) and "no space left" in done.stderr
