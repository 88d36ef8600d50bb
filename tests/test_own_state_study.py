import runpy
from pathlib import Path
from typing import Any

import pytest

from tests.processes import run_python

STUDY = Path(__file__).parents[1] / "analysis" / "11_own_state"


def table(printed: str, width: int) -> dict[str, list[str]]:
    """Table rows of that width by their first cell."""
    split = [[cell.strip() for cell in line[1:-1].split("|")] for line in printed.splitlines() if line.startswith("| ")]
    return {row[0]: row[1:] for row in split if len(row) == width}


def test_the_study_holds_what_its_readme_says() -> None:
    done = run_python([str(STUDY / "run.py"), "--quick"])
    assert done.returncode == 0, done.stdout + done.stderr
    said = table(done.stdout, 3)
    assert [row[1] for name, row in said.items() if name != "statement"] == ["holds"] * 8
    flown = table(done.stdout, 10)
    assert len([name for name in flown if name.endswith("gaps")]) == 10
    filtered, naive, truth = (flown[name] for name in ("filter", "as if now", "truth"))
    assert float(filtered[1]) < 1.0 < float(naive[1]) and truth[1] == "0.00"
    assert float(flown["125 kg, drag 115, gaps"][1]) > float(flown["filter, gaps"][1])


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.syspath_prepend(str(STUDY))
    return runpy.run_path(str(STUDY / "run.py"))


def test_a_bar_that_is_missed_is_named(study: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    config = study["load_model"](study["CONFIG"], study["Config"])
    drag = {"still": 0.0, "moving": 0.0, "velocity_moving": 0.0, "off_track": 0.0, "thrust": 0.0}
    good = study["Figures"](**drag, velocity_still=0.01, after_gap=0.01, honest=1.0, refused=0.0)
    far = study["Figures"](**{**drag, "moving": 0.03}, velocity_still=0.3, after_gap=0.01, honest=1.0, refused=0.0)
    near = study["Figures"](**{**drag, "moving": 0.01}, velocity_still=0.01, after_gap=0.01, honest=1.0, refused=0.0)
    told = {("filter", False): near, ("filter", True): good, ("as if now", False): far, ("differences", False): far}
    assert study["print_statements"](config.bars, told, {(95.0, 60.0, False): near}, 2.0)
    assert not study["print_statements"](config.bars, told, {(95.0, 60.0, False): far}, 1.0)
    failed = [name for name, row in table(capsys.readouterr().out, 3).items() if row[1] == "**does not hold**"]
    assert [name[:16] for name in failed] == ["moving, every hu", "every hull: velo", "ratio of the pos"]


def test_a_wrong_option_ends_with_2() -> None:
    done = run_python([str(STUDY / "run.py"), "--nothing"])
    assert done.returncode == 2
