"""Ctrl-C: status 130, one line that says what is kept and how to go on, and what is said is true."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.processes import Running

SWEEP = ("sweep", "k_v=1..3:4000", "--scenario", "tank-static", "--seeds", "50", "--workers", "1", "--out", "a sweep")
CASES = {
    "sweep": (SWEEP, "points,", "the finished points are in a sweep; to continue: surctl sweep", "'a sweep'"),
}


@pytest.mark.parametrize("case", CASES)
def test_ctrl_c_says_what_is_kept(case: str, tmp_path: Path) -> None:
    words, begun, kept, again = CASES[case]
    with Running(["-m", "surctl", *words], cwd=tmp_path) as running:
        running.until(lambda: begun in running.err)
        running.send(signal.SIGINT)
        status, out, err = running.wait(), running.out, running.err
    last = err.splitlines()[-1]
    assert status == 130, (out, err)
    assert last.startswith("surctl: stopped; ") and kept in last and again in last, err
    assert "Traceback" not in err
    assert any((tmp_path / "a sweep").iterdir()) and out == ""
