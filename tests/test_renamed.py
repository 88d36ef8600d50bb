"""Names of the release before still work, and each use is answered by one line with the name of today."""

import warnings
from pathlib import Path

import pytest

from surctl.errors import InputError
from surctl.marine.simulation import LIBRARY, load_scenario
from surctl.renamed import OldName, current_arguments, current_table
from tests.cli.process import surctl


def test_a_scenario_with_the_old_key_is_the_scenario(tmp_path: Path) -> None:
    text = (LIBRARY / "tank-static.toml").read_text(encoding="utf-8")
    new, old = tmp_path / "new.toml", tmp_path / "old.toml"
    new.write_text("arrival_m = 0.2\n" + text, encoding="utf-8")
    old.write_text("reach_m = 0.2\n" + text, encoding="utf-8")
    with pytest.warns(OldName, match=r"old\.toml: reach_m is now arrival_m; surctl 0\.2 will refuse the old name"):
        loaded = load_scenario(old)
    assert loaded.arrival_radius == load_scenario(new).arrival_radius == 0.2


def test_both_names_at_once_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "both.toml"
    text = (LIBRARY / "tank-static.toml").read_text(encoding="utf-8")
    file.write_text("arrival_m = 0.2\nreach_m = 0.3\n" + text, encoding="utf-8")
    with pytest.raises(InputError, match=r"both\.toml: reach_m: unknown key; did you mean"):
        load_scenario(file)


@pytest.mark.parametrize(
    ("table", "today"),
    [
        ({"kind": "study", "flights": [1], "law": "lean"}, {"kind": "study", "runs": [1], "law": "closed_form"}),
        (
            {"kind": "run", "stopped_because": "halted", "drawn": {}, "law": "paper"},
            {"kind": "run", "stopped_because": "standstill", "draw": {}, "law": "paper"},
        ),
    ],
)
def test_keys_and_values_by_kind(table: dict[str, object], today: dict[str, object]) -> None:
    with pytest.warns(OldName):
        assert current_table(table, file="file") == today


def test_names_of_today_are_left_alone() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = {"kind": "vehicle", "reach_m": 1.0, "law": "guarded"}
        assert current_table(table, file="file") == table
        typed = ["sweep", "k_v=1,2", "scenario.cruise=0.1", "--law", "paper", "lean"]
        assert current_arguments(typed) == typed


@pytest.mark.parametrize(
    ("typed", "today"),
    [
        (["export", "--ladder", "bounded"], ["export", "--fallback", "bounded"]),
        (["export", "--ladder=bounded", "--law=lean"], ["export", "--fallback=bounded", "--law=closed_form"]),
        (["sweep", "scenario.reach=0.1,0.2"], ["sweep", "scenario.arrival_radius=0.1,0.2"]),
    ],
)
def test_options_and_parameters(typed: list[str], today: list[str]) -> None:
    with pytest.warns(OldName):
        assert current_arguments(typed) == today


def test_the_command_line_says_it_in_one_line(tmp_path: Path) -> None:
    done = surctl("export", "--law", "lean", "--ladder", "tall", cwd=tmp_path)
    assert done.status == 2
    lines = done.err.strip().splitlines()
    assert lines[0] == "surctl: --law lean is now --law closed_form; surctl 0.2 will refuse the old name"
    assert lines[1] == "surctl: --ladder is now --fallback; surctl 0.2 will refuse the old name"
    assert lines[2].startswith("surctl: fallback = 'tall'") and len(lines) == 3
