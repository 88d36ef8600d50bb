"""Reproduction: all rows computed, every scenario simulated by true positions and by sonar."""

from __future__ import annotations

from pathlib import Path

from surctl.marine.reproduction import WORDS, required
from tests.cli.process import surctl


def test_the_whole_as_json_and_as_a_page(tmp_path: Path) -> None:
    done = surctl("reproduce", "--quick", "--seeds", "1", "--json", "--out", "paper", cwd=tmp_path)
    data = done.json
    # by sonar, not every run of pool-static arrives in time
    assert [row["id"] for row in data["rows"] if not row["as_expected"]] == ["pool-static-sonar"]
    assert done.status == 1 and not data["passed"] and data["missing"] == []
    assert set(required()) <= {row["id"] for row in data["rows"]}
    for row in data["rows"]:
        assert row["verdict"].split(":")[0] in WORDS and row["ours"], row
        assert row["expected"] in (None, row["verdict"].split(":")[0])
    text = (tmp_path / "paper" / "reproduction.html").read_text(encoding="utf-8")
    assert all(name in text for name in required())
