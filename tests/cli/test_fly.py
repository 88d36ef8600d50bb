"""`surctl fly`: mistakes are one line each, and a rehearsal leaves its record."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from surctl.cli.app import app
from surctl.errors import InputError
from tests.tools import need_compiler, need_module


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "needs one of --mavlink and --dry-run"),
        (("--dry-run", "--mavlink", "udp:127.0.0.1:14550"), "needs one of"),
        (("--mavlink", "udp:127.0.0.1:14550", "--loss", "0.2"), "--loss: is only for a rehearsal"),
        (("--mavlink", "serial:/dev/ttyACM0"), "did you mean 'udp'|is not known"),
        (("--mavlink", "udp:127.0.0.1"), "is not an address"),
        (("--dry-run", "--target", "255"), "--target = 255: is the system id of the bridge"),
        (("--mavlink", "udpout:a..b:14550"), "is not a name or number of a computer"),
        (("--dry-run", "--mode", "althold"), "did you mean 'alt_hold'"),
        (("--dry-run", "--send", "mc"), "--send = 'mc'"),
        (("--dry-run", "--origin", "1,2"), "X,Y,DEG"),
        (("--dry-run", "--act", "reboot"), "does not begin with a time"),
        (("--dry-run", "--act", "5:rebot"), "did you mean 'reboot'"),
        (("--dry-run", "--sensing", "sonars"), "did you mean 'sonar'"),
    ],
)
def test_a_mistake_is_one_line(words: tuple[str, ...], message: str) -> None:
    need_module("pymavlink")
    with pytest.raises(InputError, match=message) as error:
        CliRunner().invoke(app, ["fly", "pool-behind", *words], catch_exceptions=False)
    assert "\n" not in str(error.value)


def test_a_rehearsal_prints_its_result_and_leaves_its_record(tmp_path: Path) -> None:
    need_compiler()
    need_module("pymavlink")
    need_module("mcap")
    words = ["fly", "pool-behind", "--law", "closed_form", "--dry-run", "--act", "5:reboot", "--out", str(tmp_path)]
    done = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    result = json.loads(done.stdout.splitlines()[-1])
    assert done.exit_code == 1 and not result["arrived"] and result["neutral_after_s"] == [["reboot", 5.0, 0.0]]
    assert sorted(Path(name).suffix for name in result["files"]) == [".mcap", ".tlog"]
    assert all(Path(name).stat().st_size > 1000 for name in result["files"])
