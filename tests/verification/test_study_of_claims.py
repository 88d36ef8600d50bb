import runpy
from pathlib import Path
from typing import Any

import pytest

STUDY = Path(__file__).parents[2] / "analysis" / "01_two_claims" / "run.py"


@pytest.fixture(scope="module")
def study() -> dict[str, Any]:
    return runpy.run_path(str(STUDY))


def test_a_figure_that_is_off_ends_with_1(
    study: dict[str, Any], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its own figures are computed and compared where all studies are run, in `tests/test_analysis.py`."""
    config = study["load_model"](study["CONFIG"], study["Config"])
    figures = {key: (key, value) for key, value in study["expected_figures"](config).items()}
    names = study["study"].__globals__
    for name, value in (("claims", []), ("print_verdicts", True), ("tracking_figures", figures)):
        monkeypatch.setitem(names, name, lambda *_, value=value: value)
    monkeypatch.setitem(names, "avoidance_figures", lambda *_: {})
    assert study["study"](config, quick=True) == 0
    assert capsys.readouterr().out.count("agrees") == len(figures) == 12
    wrong = config.model_copy(update={"figures": {**config.figures, "v1_rate": 0.122}})
    assert study["study"](wrong, quick=True) == 1
    printed = capsys.readouterr().out
    assert printed.count("**differs**") == 1 and printed.count("agrees") == 11


def test_an_unknown_option_ends_with_2(study: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert study["main"](["--fast"]) == 2
    assert "--quick" in capsys.readouterr().err
