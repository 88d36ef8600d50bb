"""Report: the certified region on the robot's tuning page, and the titles of all pictures of a page."""

from __future__ import annotations

import re

import pytest
from matplotlib.figure import Figure

from surctl.marine.report import render_page
from surctl.marine.report.bench import Bench
from surctl.report.theme import png
from tests.pictures import blank_pictures
from tests.report.data import report
from tests.report.test_titles import outside
from tests.report.test_tuning_page import ROBOT


def test_the_page_of_the_robot_draws_the_certified_region_and_the_falsified_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Bench, "verdicts", lambda self, values: ())  # claims have tests of their own
    view = ROBOT.decide({one.name: one.value for one in ROBOT.sliders})
    assert view.picture is not None
    figure, _ = view.picture
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    [level] = [float(text.removeprefix("V = ").split(",")[0]) for text in labels if text.endswith("falsified")]
    [(text, mark)] = [line for line in view.lines if "certified level" in line[0]]
    told = re.search(r"certified level: (\d+)%", text)
    assert told is not None and abs(level * float(told[1]) / 100 - 1) < 0.1
    assert mark == "good" and labels[0] == "V = 1, certified"


def test_no_title_of_any_picture_of_a_page_is_clipped() -> None:
    figures: list[Figure] = []

    def keep(figure: Figure, **metadata: str | None) -> bytes:
        figures.append(figure)
        return png(figure, **metadata)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("surctl.report.document.png", keep)
        blank_pictures(patch)
        render_page(report())
    assert len(figures) == 14 and not any(outside(figure) for figure in figures)
