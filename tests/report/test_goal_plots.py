from dataclasses import replace

import numpy as np
import pytest

from surctl.marine.report import GoalBars, plot_goal_bars
from surctl.marine.report.goals import goal_bars, goal_views, plot_front, plot_goal_view
from surctl.marine.tuning import Goal
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


def test_a_view_shades_the_bad_side_of_the_bound(tuning):
    goals = {g.name: g for g in tuning.request.goals}
    floor, cap = goal_views(tuning, [goals[name] for name in ("keep clear", "stay near")])
    for view, below in ((floor, True), (cap, False)):
        ax = drawn(plot_goal_view(view))
        (shade,) = ax.patches
        low, high = shade.get_y(), shade.get_y() + shade.get_height()
        assert (high if below else low) == pytest.approx(view.goal.limit)
        assert ax.get_position().width > 0.6 and view.label in " ".join(ax.get_xlabel().split())
    assert floor.values["tuned"].min() > 0
    assert not list(goal_views(tuning, [goals["delay margin"]]))


def test_the_curve_ends_at_the_figure(tuning):
    (view,) = goal_views(tuning, [Goal("near", "deviation_m", "m", 0.3)])
    run_end = view.values["tuned"][-1]
    assert np.isfinite(run_end) and len(view.time["tuned"]) == len(view.values["tuned"])


def test_a_late_arrival_is_shaded_along_the_time(tuning):
    (view,) = goal_views(tuning, [Goal("soon", "time_s", "s", 30.0)])
    ax = drawn(plot_goal_view(view))
    (shade,) = ax.patches
    assert shade.get_x() == pytest.approx(30.0)
    assert view.values["tuned"][-1] < view.values["tuned"][0]


def test_a_goal_about_the_nominal_plant_shows_no_other(tuning):
    runs = tuning.request.conditions
    off = replace(runs[0], plant={"plant.m11": 46.0}, seed=2)  # the least lucky seed
    odd = replace(tuning, request=replace(tuning.request, conditions=(off, *runs)))
    near = Goal("near", "deviation_m", "m", 0.3)
    every, nominal = goal_views(odd, [near, replace(near, plants="nominal")])
    assert every.label == off.label and nominal.label in {c.label for c in runs}
    assert not np.array_equal(every.values["tuned"], nominal.values["tuned"]), "each shows its own run"
