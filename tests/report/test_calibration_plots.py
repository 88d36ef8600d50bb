from __future__ import annotations

import numpy as np
import pytest

from surctl.marine.report import plot_calibration
from surctl.marine.report.sonar_plots import plot_errors, plot_studentised
from surctl.marine.sensing import SensorCalibration, calibrate
from surctl.marine.sensing.calibration.file import calibrate_table_ii
from tests.pictures import rendered


def one(true: np.ndarray, measured: np.ndarray, sensor: str = "") -> SensorCalibration:
    found = calibrate(true, measured)
    lines = np.zeros(len(true), dtype=np.int64)
    return SensorCalibration(
        sensor=sensor, medium="", source="s", calibration=found, lines=lines, skipped=0, unsorted=0
    )


X = np.linspace(0.3, 4.0, 60)
NOISE = np.random.default_rng(0).standard_normal(60)
SPIKE = np.where(np.arange(60) == 20, 1.0, 0.0)
CASES = {
    "table": lambda: calibrate_table_ii()[1],
    "no noise": lambda: one(X, X),
    "wild outlier": lambda: one(X, X + 0.5 * SPIKE),
    "many": lambda: one(np.tile(X, 1000), np.tile(X, 1000) + 0.01 * np.random.default_rng(1).standard_normal(60_000)),
    "odd name": lambda: one(X, X + 0.01 * NOISE, "$\\frac{$ 潜水"),
}


@pytest.mark.parametrize("case", CASES)
def test_calibrations_are_drawn_without_a_warning(case: str) -> None:
    rendered(plot_calibration(CASES[case]()))


def test_errors_are_drawn_in_millimetres_with_line_and_outliers() -> None:
    what = one(X, X + 0.01 * NOISE + 0.3 * SPIKE)
    ax = plot_errors(what)
    lines = {line.get_label(): line for line in ax.get_lines()}
    assert lines["row"].get_ydata() == pytest.approx(1e3 * what.calibration.errors)
    assert lines["outlier, not in the fit"].get_xdata() == pytest.approx(X[[20]])
    at = np.asarray(lines["fitted line"].get_xdata())
    wanted = 1e3 * ((what.calibration.scale.value - 1) * at + what.calibration.bias.value)
    assert lines["fitted line"].get_ydata() == pytest.approx(wanted)
    rendered(ax)


def test_a_wild_outlier_is_held_to_the_axis_and_says_so() -> None:
    ax = plot_studentised(CASES["wild outlier"]())
    labels = [line.get_label() for line in ax.get_lines()]
    assert "outlier, not in the fit (clipped to the axis)" in labels
    low, high = ax.get_ylim()
    assert -20 < low < 0 < high < 20


def test_the_band_follows_the_noise() -> None:
    band = plot_errors(one(X, X + 0.02 * X * NOISE)).collections[0].get_paths()[0].vertices
    near, far = (np.ptp(band[np.isclose(band[:, 0], x)][:, 1]) for x in (X[0], X[-1]))
    assert far > 4 * near
