"""The tuning page as a user has it: served by the command, moved in Chromium, compared with the same sums in Python."""

import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.control import load_gains
from surctl.errors import InputError
from surctl.report.bench import Bench, save_gains, slider_steps, step_responses
from surctl.report.page_parts import BY_SPEED, attempt, picture, speeds
from surctl.simulation import load_scenario
from surctl.tuning import GainRange, Goal, load_goals
from surctl.vehicle import load_vehicle
from surctl.verification import claims, decide, linear_table
from surctl.verification.loops import LOOP_NAMES
from tests.browser import WIDTHS, open_page
from tests.cli.process import surctl
from tests.tools import PATIENCE, need, need_compiler

ROOT = Path(__file__).parents[2]
BENCH = Bench(load_vehicle("sur400"), load_scenario("pool-behind"), load_gains("default"), load_goals(), (0.05, 0.22))
SHOWN = "() => document.querySelector('#time_s') && document.querySelectorAll('img.picture').length === 5"
MISSED = """() => [...document.querySelectorAll('img.picture, .sur, .sliders, .line, button')].filter(
    e => e.getBoundingClientRect().right > innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"""


@pytest.fixture
def address(tmp_path):
    """Of the page, served from a folder of its own; it must end by Ctrl-C with 130 and one line."""
    need_compiler()
    need("chromium")
    words = ["surctl", "tune", "--page", "--scenario", "pool-behind", "--cruise", "0.05,0.22", "--no-browser"]
    served = subprocess.Popen(
        [sys.executable, "-m", *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        found = re.match(r"(http://127\.0\.0\.1:\d+/\S*)", served.stdout.readline())
        assert found, served.communicate()[1]
        yield found[1]
        served.send_signal(signal.SIGINT)
        _, complaint = served.communicate(timeout=30)
        assert served.returncode == 130, complaint
        assert "Traceback" not in complaint and "stopped" in complaint
    finally:
        served.kill()
        served.communicate()


def shown(page, name: str) -> float:
    return float(page.locator(f"[id='{name}']").get_attribute("data-value"))


def told(page, words: str) -> str:
    page.wait_for_function("w => document.querySelector('#message')?.innerText.includes(w)", arg=words)
    return page.inner_text("#message")


def assert_shows(page, gains) -> None:
    """Every number is the one of the same call in Python."""
    flown, linear, judged = BENCH.simulate(gains).metrics, BENCH.linear(gains), BENCH.judge(gains)
    for name in ("time_s", "min_clearance_m", "deviation_m", "effort_n"):
        assert shown(page, name) == getattr(flown, name)
    for name in ("delay_margin_s", "disk_margin", "slowest_pole_per_s", "settling_time_s.surge_speed"):
        assert shown(page, name) == pytest.approx(linear[name], rel=1e-9)
    at = BENCH.over_speeds(gains, BY_SPEED)
    for speed, margin in zip(at.cruise, at.figures["disk_margin"], strict=True):
        assert shown(page, f"disk_margin at {speed:g}") == pytest.approx(margin, rel=1e-9)
    for goal, figure in zip(judged.goals, judged.figure[0], strict=True):
        assert shown(page, f"goal {goal.name}") == pytest.approx(figure, rel=1e-9)


def test_move_check_save_and_load(address, tmp_path):
    with open_page(address) as opened:
        page = opened.page
        page.set_default_timeout(1000 * PATIENCE)
        page.wait_for_function(SHOWN)
        assert_shows(page, BENCH.gains)
        pictures = page.locator("img.picture").evaluate_all("all => all.map(e => e.src)")

        ranges = BENCH.ranges(BENCH.gains)
        k = [r.name for r in ranges].index("k_v")
        steps = slider_steps(ranges[k], 1.5)
        moved = BENCH.gains.with_values({"k_v": steps[-1]})
        before = shown(page, "settling_time_s.surge_speed")
        page.get_by_role("slider").nth(k).press("End")
        page.wait_for_function(
            "v => +document.querySelector('[id=\"settling_time_s.surge_speed\"]').dataset.value !== v", arg=before
        )
        assert_shows(page, moved)
        page.wait_for_function(
            "old => [...document.querySelectorAll('img.picture')].every((e, k) => e.src !== old[k])", arg=pictures
        )

        assert "Not checked" in page.inner_text("p#verdicts")
        page.get_by_text("Check the claims").click()
        page.wait_for_selector("div#verdicts", timeout=120_000)
        rows = page.locator("div#verdicts tbody tr").evaluate_all(
            "all => all.map(r => [...r.cells].map(c => c.innerText))"
        )
        library = claims(moved.values, vehicle=BENCH.vehicle)
        assert [name for name, _ in rows] == [claim.name for claim in library]
        some = [claim for claim in library if claim.name in ("m-norm-printed", "m-norm-corrected", "v2-obstacle")]
        assert {c.name: decide(c).verdict for c in some}.items() <= dict(rows).items()
        assert {word for _, word in rows} >= {"proved", "refuted"}

        page.get_by_text("Save", exact=True).click()
        told(page, "saved gains.toml")
        assert load_gains(str(tmp_path / "gains.toml")).values == moved.values

        other = BENCH.gains.with_values({"k_psi": 0.9, "k_v": 1.1})
        save_gains(other, str(tmp_path / "other.toml"))
        bad = (tmp_path / "other.toml").read_text().replace("k_psi = { value = 0.9", "k_psi = { value = -0.9")
        (tmp_path / "bad.toml").write_text(bad)
        box = page.locator("input[type=text]")
        for file, button, problem in (
            ("bad.toml", "Load", "gains.k_psi"),
            ("none.toml", "Load", "none.toml"),
            ("/proc/none/gains.toml", "Save", "cannot be written"),
            ("gains.txt", "Save", ".toml"),
        ):
            box.fill(file)
            box.press("Enter")
            box.blur()
            page.wait_for_timeout(300)
            page.get_by_text(button, exact=True).click()
            line = told(page, problem)
            assert line.startswith("error:") and "\n" not in line and "Traceback" not in line
        box.fill("other.toml")
        box.press("Enter")
        box.blur()
        page.wait_for_timeout(300)
        page.get_by_text("Load", exact=True).click()
        told(page, "loaded other.toml")
        page.wait_for_function(
            "v => Math.abs(document.querySelector('#time_s').dataset.value - v) < 1e-9",
            arg=BENCH.simulate(other).metrics.time_s,
        )
        page.wait_for_timeout(1000)
        assert_shows(page, other)
        for width in WIDTHS:
            assert opened.overflow(width) <= 0
            assert page.evaluate(MISSED) == []
        assert opened.errors == []
        assert opened.outside == []


def test_a_slider_has_its_value_and_its_ends():
    steps = slider_steps(GainRange("k_v", 0.3, 3.0), 1.234567)
    assert steps == sorted(set(steps)) and steps[0] == 0.3 and steps[-1] == 3.0 and 1.234567 in steps
    assert slider_steps(GainRange("k_v", 0.3, 3.0), 5.0)[-1] == 5.0


def test_one_loop_the_steps_and_s_and_t_are_overlaid_over_all_speeds():
    assert BENCH.speeds == (0.05, 0.15, 0.22)
    goal = Goal("robust", "disk_margin", "1", 0.6, "at least", cruise=(0.1, 0.15))
    assert replace(BENCH, goals=(goal,), cruise=()).speeds == (0.1, 0.15)
    names = ["0.05 m/s", "0.15 m/s", "0.22 m/s"]
    for ax in BENCH.bode(BENCH.gains, "cross_track").axes:
        assert [line.get_label() for line in ax.lines if len(line.get_xdata()) > 2] == [
            f"cross_track at {n}" for n in names
        ]
    gains = [line.get_ydata()[0] for line in BENCH.bode(BENCH.gains, "cross_track").axes[0].lines[::2][:3]]
    assert np.diff(gains) == pytest.approx(20 * np.log10([3, 0.22 / 0.15]), abs=0.1), "its gain is U over lookahead"
    assert len({line.get_label() for line in BENCH.bode(BENCH.gains).axes[0].lines} & set(LOOP_NAMES)) == 8
    for ax in BENCH.sensitivity(BENCH.gains).axes:
        assert [line.get_label().partition(":")[0] for line in ax.lines] == [f"thrust at {n}" for n in names]
    for ax in BENCH.steps(BENCH.gains).axes:
        assert [line.get_label() for line in ax.lines] == names


def test_steps_are_drawn_over_linear_time_from_zero():
    for ax in BENCH.steps(BENCH.gains).axes:
        assert ax.get_xscale() == "linear" and ax.get_xlim()[0] == 0.0
        assert all(line.get_xdata()[0] == 0.0 for line in ax.lines)
    assert BENCH.steps(BENCH.gains).axes[-1].get_xlabel() == "time [s]"


def test_loops_by_speed_are_a_table_with_the_worst_named():
    told = speeds(BENCH.over_speeds(BENCH.gains, ("settling_time_s.cross_track",)))
    assert [f'scope="col">{n}' in told for n in ("0.05 m/s", "0.22 m/s", "worst at")] == [True] * 3
    assert told.endswith("<td>0.05 m/s</td></tr></tbody></table></div>"), "a slow vehicle returns slowly"
    assert speeds(replace(BENCH, cruise=()).over_speeds(BENCH.gains, BY_SPEED)) == ""


def test_steps_settle_when_the_table_says():
    drawn = step_responses(BENCH.vehicle, BENCH.gains.values, cruise=0.2, dt=BENCH.dt)
    for name, value in drawn.value.items():
        column = f"settling_time_s.{name}"
        table = linear_table(BENCH.vehicle, {}, base=BENCH.gains.values, cruise=0.2, dt=BENCH.dt, columns=(column,))
        outside = drawn.time[name][abs(value - 1) >= 0.02]
        spacing = drawn.time[name][1]
        assert outside[-1] == pytest.approx(table[column][0], abs=1.01 * spacing)


def test_an_unstable_loop_has_no_step_response():
    fast = {**BENCH.gains.values, "k_v": 40.0, "k_r": 40.0}
    with pytest.raises(InputError, match="unstable"):
        step_responses(BENCH.vehicle, fast, cruise=0.2, dt=BENCH.dt)


def test_the_page_says_in_one_line_what_gains_do_not_have():
    fast = BENCH.gains.with_values({"k_v": 40.0, "k_r": 40.0})
    for draw in (BENCH.steps, BENCH.sensitivity):
        said = attempt(lambda draw=draw: picture(draw(fast), "steps"))
        assert "unstable" in said and "<img" not in said and "\n" not in said


MISTAKES = {
    "no such scenario": (("--page", "--scenario", "pool-behin"), "pool-behind"),
    "no such gains": (("--page", "--gains", "none.toml"), "no such file"),
    "two vehicles": (("--page", "--vehicle", "sur400", "--vehicle", "sur540-flooded"), "one vehicle"),
    "a speed above the cap": (("--page", "--cruise", "0.1,0.9"), "--cruise = 0.9: is above the cap"),
    "a port without a page": (("--port", "8000"), "--page"),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, what):
    words, problem = MISTAKES[what]
    done = surctl("tune", *words, cwd=tmp_path)
    assert done.status == 2 and problem in done.complaint


def test_without_marimo_it_names_the_remedy(tmp_path):
    (tmp_path / "hide.py").write_text(
        "import sys, importlib.util as u\nfind = u.find_spec\n"
        "u.find_spec = lambda name, *rest: None if name == 'marimo' else find(name, *rest)\n"
        "sys.argv = ['surctl', 'tune', '--page']\nfrom surctl.cli import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "hide.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert 'pip install "surctl[notebooks]"' in done.stderr and done.stderr.count("\n") == 1
