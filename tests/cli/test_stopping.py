"""Ctrl-C: status 130, one line that says what is kept and how to go on, and what is said is true."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.process import LIBRARY
from tests.tools import PATIENCE

SWEEP = ("sweep", "k_v=1..3:4000", "--scenario", "tank-static", "--seeds", "50", "--workers", "1", "--out", "a sweep")
CASES = {
    "sweep": (SWEEP, "points,", "the finished points are in a sweep; to continue: surctl sweep", "'a sweep'"),
}


@pytest.mark.parametrize("case", CASES)
def test_ctrl_c_says_what_is_kept(case: str, tmp_path: Path) -> None:
    words, begun, kept, again = CASES[case]
    with subprocess.Popen(
        [sys.executable, "-m", "surctl", *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(LIBRARY.parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # a terminal sends it to all processes of the command
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as running:
        try:
            assert running.stderr is not None
            assert any(begun in line for line in running.stderr), "it ended by itself"
            os.killpg(running.pid, signal.SIGINT)
            out, err = running.communicate(timeout=PATIENCE)
        finally:
            running.kill()
    last = err.splitlines()[-1]
    assert running.returncode == 130, (out, err)
    assert last.startswith("surctl: stopped; ") and kept in last and again in last, err
    assert "Traceback" not in err
    assert any((tmp_path / "a sweep").iterdir()) and out == ""
