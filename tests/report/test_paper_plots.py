from __future__ import annotations

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.marine.report.paper_plots import plot_coordinates, plot_position_errors, plot_series
from tests.report.data import run


def test_coordinates_are_those_of_the_record() -> None:
    flown = run()
    axes = plot_coordinates([flown], title="t").axes
    assert [ax.get_ylabel() for ax in axes] == ["x [m]", "y [m]", "z [m]"]
    for k, ax in enumerate(axes):
        assert np.array_equal(ax.get_lines()[0].get_ydata(), flown.record.eta[:, k])


def test_position_errors_are_distances_in_three_axes_beside_the_papers() -> None:
    flown = run()
    lines = plot_position_errors([flown], title="t", bound=0.04).get_lines()
    away = flown.scenario.follower().track(flown.record.eta[:, :2])
    expected = np.sqrt(away**2 + (flown.record.eta[:, 2] - flown.scenario.depth) ** 2)
    assert np.asarray(lines[0].get_ydata()) == pytest.approx(expected)
    assert list(lines[1].get_ydata()) == [0.04, 0.04]
    assert len(plot_position_errors([flown], title="t").get_lines()) == 1


def test_a_series_tells_when_each_arrived() -> None:
    flown = run()
    ax = plot_series([flown, flown], title="t")
    legend = ax.get_legend()
    assert legend is not None
    told = [text.get_text() for text in legend.get_texts()]
    assert told == 2 * [f"{flown.scenario.name}: {flown.metrics.stopped_because} at {flown.metrics.time_s:.1f} s"]


@pytest.mark.parametrize("plot", [plot_coordinates, plot_position_errors, plot_series])
def test_nothing_to_draw_is_a_mistake(plot: object) -> None:
    with pytest.raises(InputError, match="must not be empty"):
        plot([], title="t")  # type: ignore[operator]
