"""Pictures of ranging."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from surctl.marine.report.sonar_plots import (
    FilterErrors,
    LmsTrace,
    RangeTrace,
    plot_filter_errors,
    plot_lms_trace,
    plot_range_trace,
)
from surctl.report.theme import new_axes


def drawn(ax: Axes) -> Axes:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FigureCanvasAgg(ax.figure.figure).draw()
    return ax


def trace(healthy: np.ndarray, truth: np.ndarray | None = None) -> RangeTrace:
    time = 0.05 * np.arange(len(healthy))
    reading = 3.0 - 0.2 * time[::2]
    return RangeTrace(
        title="approach $x$",
        time=time,
        range=3.0 - 0.2 * time,
        bound=np.full(len(time), 0.03),
        healthy=healthy,
        reading_time=time[::2],
        reading=reading,
        truth=truth,
    )


def label(ax: Axes, name: str) -> np.ndarray:
    return np.asarray(next(line for line in ax.lines if line.get_label() == name).get_ydata(), dtype=float)


def test_a_trace_shows_the_range_only_where_it_is_believed() -> None:
    healthy = np.ones(100)
    healthy[40:60] = 0.0
    ax = drawn(plot_range_trace(trace(healthy, truth=np.linspace(3.0, 2.0, 100))))
    shown = label(ax, "filtered, healthy")
    assert np.isnan(shown[40:60]).all() and np.isfinite(shown[:40]).all()
    assert label(ax, "true")[-1] == pytest.approx(2.0)
    assert {text.get_text() for text in ax.get_legend().get_texts()} >= {"promised", "readings", "not healthy"}


def test_a_trace_without_truth_or_faults_and_an_empty_one_are_drawn() -> None:
    ax = drawn(plot_range_trace(trace(np.ones(10))))
    assert {text.get_text() for text in ax.get_legend().get_texts()} == {"promised", "readings", "filtered, healthy"}
    drawn(plot_range_trace(trace(np.ones(0))))
    mine = new_axes(4.0, 3.0)
    assert plot_range_trace(trace(np.ones(10)), mine) is mine


def test_bars_of_errors_are_cut_and_say_their_length() -> None:
    data = FilterErrors(
        names=("raw", "robust"), still=(0.016, 0.005), closing=(2.0, 0.0051), still_limit=0.01, closing_limit=0.02
    )
    ax = drawn(plot_filter_errors(data))
    heights = sorted(float(p.get_height()) for p in ax.patches)
    assert heights[:3] == pytest.approx([0.5, 0.51, 1.6]) and heights[3] == pytest.approx(3.2)
    assert "2e+02" in {text.get_text() for text in ax.texts}


def test_prediction_errors_are_drawn_on_a_logarithmic_scale() -> None:
    data = LmsTrace(title="steps", errors={"printed": np.ones(20), "corrected": 0.5 ** np.arange(20.0)})
    ax = drawn(plot_lms_trace(data))
    assert ax.get_yscale() == "log"
    assert label(ax, "corrected")[3] == pytest.approx(0.125)
