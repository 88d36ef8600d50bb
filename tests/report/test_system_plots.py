"""Pictures of runs of any system, and `plot()` of results."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

import surctl
from surctl.errors import InputError
from surctl.plotted import Plotted
from surctl.report import (
    plot_dependence,
    plot_fan,
    plot_phase_plane,
    plot_record,
)
from surctl.report.theme import new_axes, save_figure
from surctl.system import Record, Runs, run_system
from tests.system.examples import pendulum

STARTS = np.linspace(-0.4, 0.4, 7)


@cache
def runs() -> list[Record]:
    return [run_system(pendulum(), 0.5, {"start.angle": a}) for a in (*STARTS, 1.6)]


def test_every_result_with_a_picture_has_one() -> None:
    for module in ("system", "tuning", "verification", "lyapunov"):
        package = importlib.import_module(f"surctl.{module}")
        for name in package.__all__:  # a package loads its modules at first use
            getattr(package, name)
    for kind in Plotted.__subclasses__():
        module, _, function = kind.PLOT.partition(":")
        assert callable(getattr(importlib.import_module(module), function)), kind
    assert {kind.__name__ for kind in Plotted.__subclasses__()} >= {
        "Record",
        "Runs",
        "LinearLoop",
        "LoopScores",
    }
    assert "plotted" in [m.name for m in pkgutil.iter_modules(surctl.__path__)]


def test_a_fan_has_the_percentiles_of_the_runs() -> None:
    ax = plot_fan(runs()[:7], "angle")
    table = np.array([run["angle"][:, 0] for run in runs()[:7]])
    median, least, greatest = (line.get_ydata() for line in ax.lines)
    assert median == pytest.approx(np.median(table, axis=0))
    assert least == pytest.approx(table.min(axis=0)) and greatest == pytest.approx(table.max(axis=0))
    assert len(ax.collections) == 2 and ax.get_ylabel() == "angle [rad]"
    short = plot_fan(runs(), "angle")  # the last run has fallen at once
    assert len(short.lines[0].get_xdata()) == len(runs()[0].time)
    with pytest.raises(InputError, match="signal = 'angel': is not a signal of the run; did you mean 'angle'"):
        plot_fan(runs(), "angel")


def test_a_phase_plane_marks_what_ended_early() -> None:
    ax = plot_phase_plane(runs(), "angle", "rate")
    ends = [line for line in ax.lines if line.get_marker() == "s"]
    assert [to_rgb(end.get_color())[0] > 0.5 for end in ends] == [False] * 7 + [True]
    assert ax.get_xlabel() == "angle [rad]" and ax.get_ylabel() == "rate [rad/s]"


def test_a_dependence_is_ordered_by_rank() -> None:
    x, y = np.linspace(0, 1, 40), np.tile([0.0, 1.0], 20)
    runs = Runs({"cost": 3 * x**3 + 0.1 * y}, np.full(40, "time"), np.ones(40), np.zeros((40, 1)))
    figure = plot_dependence({"other": y, "first": x, "fixed": 2.0}, runs, "cost")
    assert [ax.get_title("left").partition(":")[0] for ax in figure.axes] == ["first", "other"]
    assert figure.axes[0].get_title("left").endswith("1.00") or "0.9" in figure.axes[0].get_title("left")
    with pytest.raises(InputError, match="vary nothing"):
        plot_dependence({"fixed": 2.0}, runs, "cost")


def test_limits_are_drawn_and_the_figure_turns_dark() -> None:
    figure = plot_record(runs()[0], limits={"torque": (-5.0, 5.0)})
    ax = next(ax for ax in figure.axes if ax.get_ylabel() == "torque [N m]")
    assert ax.get_ylim()[0] < -5 and ax.get_ylim()[1] > 5 and len(ax.collections) == 2


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("/usr/bin/surctl", "surctl sweep 'k v=1'"),
        (str(Path(surctl.__file__).with_name("__main__.py")), "surctl sweep 'k v=1'"),
        ("own/study.py", "python study.py sweep 'k v=1'"),
        ("/usr/lib/python3/pytest/__main__.py", None),
        ("/usr/bin/pytest", None),
    ],
)
def test_a_picture_names_its_command(
    program: str, command: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", [program, "sweep", "k v=1"])
    with Image.open(save_figure(new_axes(2, 2).figure.figure, tmp_path, ("a",))) as picture:
        assert picture.info.get("Description") == command


def test_a_picture_names_the_function_that_plotted_it(tmp_path: Path) -> None:
    figure = plot_phase_plane(runs()[:1], "angle", "rate").figure.figure
    name = "surctl.report.system_plots.plot_phase_plane"
    figure.savefig(tmp_path / "a", metadata={"Author": "me"})  # the format is matplotlib's default
    for path in (tmp_path / "a.png", save_figure(figure, tmp_path, ("b",))):
        with Image.open(path) as picture:
            assert picture.info["Software"] == name
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.info["Author"] == "me"
    figure.savefig(tmp_path / "a.svg")
    assert name in (tmp_path / "a.svg").read_text()
    figure.savefig(tmp_path / "a.jpg")  # a format without metadata
    figure.savefig(tmp_path / "c.png", metadata={"Software": None})
    with Image.open(tmp_path / "c.png") as picture:
        assert "Software" not in picture.info
