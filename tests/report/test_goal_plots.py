from dataclasses import replace

import numpy as np
import pytest

from surctl.marine.report import GoalBars, plot_goal_bars
from surctl.marine.report.goals import goal_bars, plot_front
from surctl.tuning import tune
from tests.pictures import rendered
from tests.tuning.synthetic import CLEAR, MARGIN, NEAR, THRIFT, case, install, request


@pytest.fixture(scope="module")
def tuning():
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        asked = request(goals=(NEAR, CLEAR, THRIFT, MARGIN))
        behind = case("pool-behind")
        asked = replace(asked, conditions=tuple(replace(c, case=behind) for c in asked.conditions))
        yield tune(asked, trials=64, rounds=1, runs=0)


def drawn(ax):
    rendered(ax)
    return ax


def test_bars_show_every_goal_against_one(tuning):
    data = goal_bars(tuning)
    assert data.names[:2] == ("keep clear", "delay margin") and data.hard == (True, True, False, False)
    ax = drawn(plot_goal_bars(data))
    widths = [p.get_width() for p in ax.patches if p.get_height() == pytest.approx(0.32)]
    assert widths == pytest.approx([*data.hand, *data.tuned])
    assert any(line.get_xdata()[0] == 1 for line in ax.lines)


def test_bars_that_are_not_met_at_all_are_cut_and_say_so():
    hand, tuned, speed = np.array([np.inf, 0.5]), np.array([np.nan, 40.0]), np.array([0.22, np.nan])
    data = GoalBars(("a", "$b_{"), (True, False), hand, tuned, speed)
    ax = drawn(plot_goal_bars(data))
    assert [t.get_text() for t in ax.texts] == ["not met", "0.5", "not met", "40"]
    assert max(p.get_width() for p in ax.patches) <= 2.0


def test_the_front_marks_start_and_tuned(tuning):
    ax = drawn(plot_front(tuning))
    start = tuning.hand.evaluation.normalised[0]
    marked = {line.get_label(): line.get_xydata() for line in ax.lines}
    assert marked["tuned"][0] == pytest.approx([tuning.tuned.score(start)[0], tuning.tuned.evaluation.effort[0]])
    assert len(marked["undominated"]) == tuning.front.evaluation.effort.size
    assert (np.diff(marked["undominated"][:, 1]) < 0).all()
