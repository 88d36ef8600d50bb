"""What every command prints."""

import io
import json
import math
from types import SimpleNamespace
from typing import Any

import click
import pytest

from surctl.cli.output import finish, finite
from surctl.marine.cli.runs import activity_line, series_lines
from surctl.verification import LoopMargins


def test_json_holds_numbers_that_are_finite_alone() -> None:
    told = {"a": math.inf, "b": [math.nan, 1.5, ("x", -math.inf)], 3: {"c": 0, "d": None}}
    assert finite(told) == {"a": None, "b": [None, 1.5, ["x", None]], "3": {"c": 0, "d": None}}
    assert json.loads(json.dumps(finite(told), allow_nan=False)) == finite(told)


def test_a_variation_within_rounding_is_0() -> None:
    names = "crab_angle_deg max_crab_angle_deg heading_error_deg axis_sign_changes_per_s axis_saturated_share "
    names += "wasted_impulse_n_s wasted_share variation_surge_n_per_s variation_sway_n_per_s "
    metrics = dict.fromkeys((names + "variation_heave_n_per_s variation_yaw_n_m_per_s").split(), 0.0)
    metrics |= {"variation_surge_n_per_s": 1.5, "variation_heave_n_per_s": 1.3e-17}
    run: Any = SimpleNamespace(metrics=SimpleNamespace(**metrics))
    assert "varies by 1.5, 0, 0, 0 (" in activity_line(run)


def test_many_runs_have_a_summary_that_names_what_fails() -> None:
    def run(seed: int, **values: Any) -> dict[str, Any]:
        reached = {"reached": True, "stopped_because": "reached", "time_s": 40.0 + seed, "min_clearance_m": 0.2}
        names = {"scenario": "tank", "vehicle": "ball", "sensing": "truth", "linear": None}
        return names | reached | {"seed": seed} | values

    calm = series_lines([run(0), run(1)])
    assert calm[0] == "tank by ball, truth: 2 of 2 runs arrive, 0 collide" and "40.00 to 41.00 s" in calm[1]
    late = {"reached": False, "stopped_because": "time limit"}
    low = {"linear": {"cruise_m_per_s": 0.15, "stable": True, "disk_margin": 0.1, "short": "a disk margin of 0.10"}}
    hit = run(7, min_clearance_m=-0.01, **low)
    lines = series_lines([hit, *(run(seed, **late, **low) for seed in range(4))])
    assert lines[0] == "tank by ball, truth: 1 of 5 runs arrive, 1 collide" and "-0.010 m (seed 7)" in lines[1]
    assert series_lines([run(0, **late, **low, echo_warnings=["no echo"]), run(1)])[-1] == "  no echo"
    assert "seed 7: reached" in lines[2] and "seed 0: time limit" in lines[3] and "disk margin of 0.10" in lines[4]
    assert len(lines) == 5 and max(map(len, lines)) <= 100
    assert "arrival" not in series_lines([run(0, **late)])[1]
    assert "unstable" in series_lines([run(0, linear={"cruise_m_per_s": 0.15, "stable": False})])[-1]


def test_a_margin_without_bound_is_never_lost() -> None:
    margin = LoopMargins("heave", True, 2.5, math.inf, math.inf, 0.9, 1.0, 0.0, 1.5, 0.3)
    assert margin.line() == "heave: gain factor below 2.5, phase never lost, delay never lost, disk margin 0.9"


@pytest.mark.parametrize(
    ("terminal", "environment", "coloured"),
    [
        (True, {"TERM": "xterm"}, True),
        (True, {"TERM": "xterm", "NO_COLOR": "1"}, False),
        (True, {"TERM": "dumb"}, False),
        (False, {"TERM": "xterm"}, False),
    ],
)
def test_marks_have_colours_on_a_terminal_only(terminal, environment, coloured, monkeypatch) -> None:
    class Stream(io.StringIO):
        def isatty(self) -> bool:
            return terminal

    stream = Stream()
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.stdout", stream)
    with click.Context(click.Command("any")), pytest.raises(click.exceptions.Exit):
        finish({}, ["ok   margins", "FAIL ok", "  ok"], as_json=False, passed=True)
    plain = "ok   margins\nFAIL ok\n  ok\n"
    expected = "\x1b[32mok\x1b[0m   margins\n\x1b[31mFAIL\x1b[0m ok\n  ok\n"
    assert stream.getvalue() == (expected if coloured else plain)
