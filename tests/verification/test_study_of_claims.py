import runpy
from pathlib import Path
from typing import Any

import pytest

STUDY = Path(__file__).parents[2] / "analysis" / "01_two_claims" / "run.py"


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    return runpy.run_path(str(STUDY))


def test_the_study_reproduces_its_figures_and_one_that_is_off_ends_with_1(
    study: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    config = study["load_model"](study["CONFIG"], study["Config"])
    wrong = config.model_copy(update={"figures": {**config.figures, "v1_rate": 0.122}})
    assert study["study"](wrong, quick=True) == 1
    printed = capsys.readouterr().out
    assert printed.count("**differs**") == 1 and printed.count("agrees") == 11


def test_an_unknown_option_ends_with_2(study: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert study["main"](["--fast"]) == 2
    assert "--quick" in capsys.readouterr().err
