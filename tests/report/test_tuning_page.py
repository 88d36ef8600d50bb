"""The design page as a user has it: served by the command, moved in Chromium, compared with the same sums in Python."""

import re
import signal
from contextlib import nullcontext
from dataclasses import replace
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import pytest

from surctl.assessment import assess
from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.lyapunov import Problem, continuous_dynamics
from surctl.marine import assessment as subjects
from surctl.marine.assessment import Mission
from surctl.marine.control import load_gains
from surctl.marine.report.bench import Bench, save_gains
from surctl.marine.simulation import load_scenario
from surctl.marine.tuning import Goal, load_goals
from surctl.marine.vehicle import load_vehicle
from surctl.report.design_bench import SystemBench, activity
from surctl.report.page_parts import page, respond
from surctl.report.panel import Curve, Panel, Shade, draw_panel, panel_svg
from surctl.report.theme import new_axes
from surctl.system import Controller, Cost, Plant, System
from surctl.tuning import Overshoot, Rejection, Settling
from surctl.tuning.loop_goals import Profile
from surctl.verification import system_margins
from tests.browser import open_page
from tests.cli.process import surctl_here
from tests.processes import Running
from tests.report.test_page_in_chromium import CONTRAST
from tests.tools import PATIENCE, need, need_compiler
from tests.tuning.test_loop_goals import FILE, SYSTEM

ROOT = Path(__file__).parents[2]
FILES = ROOT / "analysis" / "27_own_law"
GOALS = (
    Settling(name="soon", source="target", end="place", at_most=8.0),
    Overshoot(name="calm", source="target", end="place", at_most=0.25),
    Rejection(name="waves", at="force", attenuation=Profile((0.05, 0.5), (50.0, 2.0)), points=("heavy",)),
)
PLACES = {"light": {"plant.mass": 0.5, "reference.target": 1.0}, "heavy": {"plant.mass": 2.0, "reference.target": 1.0}}
RANGES = {"k_p": (1.0, 16.0), "k_d": (0.75, 12.0), "k_i": (0.25, 4.0)}
OWN = SystemBench(SYSTEM, "mine.py:build", 6.0, RANGES, PLACES, GOALS)
ROBOT = Bench(load_vehicle("sur400"), load_scenario("pool-behind"), load_gains("default"), load_goals(), (0.05, 0.22))
MISSED = """() => [...document.querySelectorAll('figure, table, input, select, button, label')].filter(
    e => e.getClientRects().length && !e.closest('.scroll, .panels'))
    .filter(e => e.getBoundingClientRect().right > innerWidth + 1)
    .map(e => e.outerHTML.slice(0, 80))"""


def request(bench, **changed):
    names = bench.loop({one.name: one.value for one in bench.sliders}, bench.points[0]).names
    values = {one.name: one.value for one in bench.sliders}
    asked = {
        "values": values,
        "compared": None,
        "points": list(bench.points[:2]),
        "opening": names.commands[0],
        "source": f"measured.{names.outputs[0]}",
        "end": f"measured.{names.outputs[0]}",
        "locus": next(iter(values)),
    }
    return asked | changed  # fmt: skip


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Address and folder of a page for a system; it must end by Ctrl-C with 130 and one line."""
    need("chromium")
    folder = tmp_path_factory.mktemp("page")
    (folder / "cart.toml").write_text(FILE)
    (folder / "mine.py").write_text(
        "from tests.tuning.test_loop_goals import cart\n\ndef build():\n    return cart()\n"
    )
    words = ["surctl", "tune", "mine.py:build", "reference.target=1", "--page", "--goals", "cart.toml"]
    with Running(["-m", *words, "--seconds", "6", "--no-browser"], cwd=folder) as process:
        process.until(lambda: "\n" in process.out)
        found = re.match(r"(http://127\.0\.0\.1:\d+/\S*)", process.out)
        assert found, process.err
        yield found[1], folder
        process.send(signal.SIGINT)
        assert process.wait() == 130, process.err
        assert "Traceback" not in process.err and "stopped" in process.err


def settled(page):
    """All views are those of the present gains."""
    page.wait_for_function(
        "() => ['linear', 'goals', 'details', 'run'].every(k => document.body.dataset[k] === `${fresh}`)"
    )


def test_the_keyboard_moves_compares_undoes_saves_and_loads(served):
    address, folder = served
    with open_page(address) as opened:
        page = opened.page
        page.set_default_timeout(1000 * PATIENCE)
        settled(page)
        assert page.locator("#linear figure").count() == 8 and page.locator("#goals figure").count() == 12
        assert page.locator("#goals path.miss").count() >= 12  # the violated side of each goal
        times = page.locator("#run figure").evaluate_all("all => all.map(e => e.textContent)")
        assert len(times) == 4 and all("time [s]" in text for text in times)
        drawn = page.locator("#linear").inner_html()
        page.keyboard.press("Tab")  # the link to the views
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "gain-k_p"
        page.keyboard.press("End")
        settled(page)
        assert page.input_value("#gain-k_p-value") == "16" and page.locator("#linear").inner_html() != drawn
        page.keyboard.press("Control+z")
        settled(page)
        assert page.input_value("#gain-k_p-value") == "4" and page.locator("#linear").inner_html() == drawn
        page.keyboard.press("Control+y")
        page.locator("#keep").press("Enter")
        page.locator("#gain-k_p-value").fill("9")
        page.locator("#gain-k_p-value").press("Enter")
        settled(page)
        assert "B: k_p = 16" in page.inner_text("#compared")
        assert page.locator("#linear path.faint").count() > 8  # the curves of B
        page.locator("#swap").press("Enter")
        settled(page)
        assert page.input_value("#gain-k_p-value") == "16"
        page.locator("#opening").select_option("place")
        page.locator("input[value=heavy]").uncheck()
        settled(page)
        assert "opened at place" in page.inner_text("#linear") and "heavy" not in page.inner_text("#linear")

        page.locator("#save").press("Enter")
        page.wait_for_function("() => document.querySelector('#message').textContent.includes('saved')")
        text = (folder / "gains.toml").read_text()
        assert '"k_p" = 16.0' in text and "file_sha256" in text and "mine.py:build" in text
        page.locator("#reset").press("Enter")
        page.locator("#load").press("Enter")
        page.wait_for_function("() => document.querySelector('#message').textContent.includes('loaded')")
        assert page.input_value("#gain-k_p-value") == "16"
        page.fill("#file", "none.txt")
        page.locator("#save").press("Enter")
        page.wait_for_function("() => document.querySelector('#message').textContent.includes('none.txt')")
        assert page.inner_text("#message").startswith("error: save = 'none.txt'")
        settled(page)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert [text for ratio, text in page.evaluate(CONTRAST) if ratio < 4.5] == []
        for width in (1280, 400):
            assert opened.overflow(width) <= 0
            assert page.evaluate(MISSED) == []
        tops = "ids => ids.map(id => document.getElementById(id).getBoundingClientRect().top + scrollY)"
        strip, loops, sliders, margins = page.evaluate(tops, ["strip", "loops", "controls", "margins"])
        assert strip < loops < sliders < margins  # on a telephone, the loops are above the sliders
        assert opened.errors == [] and opened.outside == []


def test_without_the_secret_there_is_no_page(served):
    from urllib.error import HTTPError
    from urllib.request import Request, urlopen

    address, folder = served
    base = address.partition("?")[0]
    body = b'{"values": {}, "file": "stolen.toml"}'
    for asked in (base, f"{base}?token=guess", Request(f"{base}save", data=body, headers={"X-Token": "guess"})):
        with pytest.raises(HTTPError, match="403"):
            urlopen(asked)
    assert not (folder / "stolen.toml").exists()
    place, token = base.partition("//")[2].strip("/"), address.partition("=")[2]
    for path, body, stated, secret, status in (
        ("linear", b"{}", "abc", token, 403), ("linear", b"{}", "99999999999", token, 403),
        ("linear", b"{}", "2", "\xe9", 403), ("linear", b"[" * 90_000, "90000", token, 400),
        ("linear", b"[]", "2", token, 400), ("linear", b'{"values": null, "points": []}', "30", token, 400),
    ):  # fmt: skip
        line = HTTPConnection(place, timeout=PATIENCE)
        line.putrequest("POST", f"/{path}")
        line.putheader("X-Token", secret)
        line.putheader("Content-Length", stated)
        line.endheaders(body)
        assert line.getresponse().status == status, body[:20]
        line.close()
    with pytest.raises(HTTPError, match="403"):
        urlopen(f"{base}?token=%C3%A9")


def test_a_request_that_means_nothing_is_one_line(tmp_path):
    for path, changed in (("linear", {"points": ["none"]}), ("details", {"points": [[1]]}), ("run", {"values": None})):
        with pytest.raises(InputError, match="is not complete") if path == "run" else nullcontext():
            assert "is not an operating point" in respond(OWN, path, request(OWN, **changed))["error"]
    with pytest.raises(InputError, match="is not complete"):
        respond(OWN, "details", request(OWN, locus="none"))


def test_goals_are_judged_at_every_operating_point():
    one = respond(OWN, "goals", request(OWN, points=["heavy"]))
    assert one == respond(OWN, "goals", request(OWN))


def test_a_saved_file_is_read_back_and_replaces_no_other(tmp_path):
    odd = SystemBench(SYSTEM, "my file.py:build", 6.0, RANGES, {'he"a\nvy': {}}, about={"source": "surctl"})
    values = {"k_p": 4.123456789, "k_d": 3.0, "k_i": 1.0}
    path = tmp_path / "gains.toml"
    for _ in range(2):
        assert odd.save(values, str(path)).endswith("surctl verify 'my file.py:build' k_p=4.123456789 k_d=3.0 k_i=1.0")
    assert odd.load(str(path)) == values and "tune --page" in path.read_text()
    with pytest.raises(InputError, match="is another kind of file"):
        save_gains(ROBOT.base, str(path))
    goals = tmp_path / "goals.toml"
    goals.write_text(FILE)
    with pytest.raises(InputError, match="is another kind of file"):
        odd.save(values, str(goals))
    assert goals.read_text() == FILE
    for wrong in ("nan", '"fast"', "true"):
        path.write_text(f'kind = "system-gains"\n[gains]\nk_p = {wrong}\n')
        with pytest.raises(InputError, match=r"gains\.k_p = .*: is not a number"):
            odd.load(str(path))


def test_the_margins_and_goals_on_the_page_are_those_of_python():
    found = respond(OWN, "details", request(OWN))
    (margins,) = system_margins(OWN.loop({}, "light"), "force")
    cells = re.findall(r"<td>(.*?)</td>", found["margins"])[:7]
    assert cells[:2] == ["light", "force"] and float(cells[3]) == pytest.approx(margins.phase_margin_deg, rel=5e-3)
    html = respond(OWN, "goals", request(OWN))["html"]
    worst = max(GOALS[0].judge(OWN.loop({}, point)).value for point in PLACES)
    assert f"{worst:.3g} s for 8" in html
    strip = respond(OWN, "goals", request(OWN))["strip"]
    assert len(re.findall('<li class="(?:good|bad)">', strip)) == len(GOALS) and "soon: " in strip
    run = respond(OWN, "run", request(OWN))
    assert "force, light" in run["table"] and "sign changes per s" in run["table"]
    assert run["strip"].count("<li") == run["table"].count('class="good"') + run["table"].count('class="bad"')
    assert (
        respond(OWN, "linear", request(OWN, values={"k_p": -9.0, "k_d": 1.0, "k_i": 1.0}))["html"].count("figure") > 10
    )
    with pytest.raises(InputError, match="is not known"):
        respond(OWN, "none", request(OWN))
    assert "is not a signal of the loop" in respond(OWN, "linear", request(OWN, opening="none"))["error"]


def test_a_region_is_proved_and_drawn_on_request():
    speed, force = Port("speed", (1,), "m/s", "of the sled"), Port("force", (1,), "m/s^2", "over the mass")
    sled = Plant("sled", Layout((speed,)), Layout((force,)), lambda x, f, d, p: f["force"] + x["speed"] ** 3)
    gain = Layout((Port("k", (1,), "1/s", "gain", 1.0),))
    brake = Controller(
        "brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -p["k"] * u["speed"], gains=gain
    )
    system = System(sled, brake)

    def problem(values):
        dynamics = continuous_dynamics(system, {"speed": (-2.0, 2.0)}, values=dict(values))
        return Problem(dynamics, "lyapunov", None, None, None)

    bench = SystemBench(system, "mine.py:build", 1.0, {"k": (0.5, 2.0)}, {"nominal": {}}, (), problem)
    found = respond(bench, "slow", request(bench))
    assert "surctl verify mine.py:build k=1</code>" in found["html"]
    assert (
        "proved" in found["html"] and "least level with a counterexample" in found["html"] and "<img" in found["html"]
    )


def test_the_page_of_the_robot_shows_its_run_goals_and_claims(tmp_path):
    need_compiler()
    values = {one.name: one.value for one in ROBOT.sliders}
    view = ROBOT.run(values, ROBOT.points)
    rows = {name: (text, mark) for _, text, name, mark in view.rows}
    run = ROBOT.simulate(values)
    assert rows["time_s"][0] == f"{run.metrics.time_s:.4g} s" and rows["outcome"] == ("reached", "good")
    assert rows["goal arrive"][1] == "good" and rows["goal delay margin"][0].startswith("met")
    assert ROBOT.points == ("0.05 m/s", "0.15 m/s", "0.22 m/s")
    assert "k_v" in values and '"k_v"' in page(ROBOT, nonce="n", token="t")
    assert all(panel.x == "time [s]" and not panel.log_x for panel in view.panels)
    thrust = next(panel for panel in view.panels if panel.title == "Run: force")
    assert {shade.y[0] for shade in thrust.shades} == {-ROBOT.vehicle.thrust_limit[0], ROBOT.vehicle.thrust_limit[0]}
    assert ROBOT.command(values, "run").startswith("surctl simulate pool-behind --sensing truth --vehicle sur")
    assert ROBOT.command(values, "decision").startswith("surctl verify region-cruise-20 --cruise 0.15 --cap 0.22 ")
    path = tmp_path / "gains.toml"
    assert ROBOT.save({**values, "k_v": 1.1}, str(path)).startswith("saved")
    assert load_gains(str(path))["k_v"] == 1.1 and "tuning page" in load_gains(str(path)).provenance
    assert ROBOT.load(str(path))["k_v"] == 1.1
    with pytest.raises(InputError, match=r"end the path in \.toml"):
        save_gains(ROBOT.base, "gains.txt")


def test_the_page_of_the_robot_says_which_region_does_not_apply(monkeypatch):
    """That the certified region is drawn with the falsified level is a check of `analysis/40_long_checks`."""
    monkeypatch.setattr(Bench, "verdicts", lambda self, values: ())  # claims have tests of their own
    monkeypatch.setattr(subjects, "DEFAULT_REGIONS", ("region-steered-20",))  # about craft without sway force
    values = {one.name: one.value for one in ROBOT.sliders}
    refused = ROBOT.decide(values)
    assert refused.picture is None and any("not applicable" in text for text, _ in refused.lines)
    assessment = assess(Mission(ROBOT.vehicle, ROBOT.gains(values), 0.15, 0.22, ROBOT.case.law), parts=["loop"])
    margin = assessment.figures["disk_margin"]
    assert any(text.startswith(f"disk_margin = {margin.value:.4g}: ") for text, _ in refused.lines)


def test_a_law_of_ones_own_is_linear_about_its_run():
    need_compiler()
    scenario = load_scenario(str(FILES / "wall.toml"))
    goal = Goal("g", "loop_goal", "1", 1.0, loop=Settling(name="g", source="y", end="y", at_most=30.0))
    bench = Bench(
        load_vehicle(scenario.vehicle), scenario, load_gains("default"), (goal,), law=f"{FILES / 'wall.py'}:wall"
    )
    assert bench.points[0] == "its own run" and {"k_wall", "stand_off"} <= {one.name for one in bench.sliders}
    start = {one.name: one.value for one in bench.sliders}
    slow, fast = (bench.loop({**start, "k_wall": k}, "its own run") for k in (0.2, 0.4))
    assert bench.version == 1  # of two gain sets, one is run; the other is linear about the same motion
    assert bench.goals[0].judge(slow).value > 1.5 * bench.goals[0].judge(fast).value
    moved = respond(bench, "run", request(bench, values={**start, "k_wall": 0.4}, points=["its own run"]))
    assert moved["moved"] and bench.version == 2


def test_a_cost_that_lasts_to_the_end_of_the_run_is_not_marked_as_met() -> None:
    costs = {how: Cost(lambda s: s.x["place"] + 9.0, how, "m", at_most=99.0) for how in ("last_time", "max")}
    bench = SystemBench(replace(SYSTEM, costs=costs), "mine.py:build", 1.0, RANGES, {"light": PLACES["light"]})
    marks = {name: mark for _, _, name, mark in bench.run({}, ["light"]).rows}
    assert marks["cost last_time light"] == "" and marks["cost max light"] == "good"


def test_activity_counts_signs_and_saturation():
    text = activity(np.array([2.0, 2.0, -2.0, 1.0]), 0.5, "N")
    assert text == "rms 1.803 N, 1 sign changes per s, 75 % of the time at 2"
    assert activity(np.zeros(3), 0.5, "N") == "none"


def test_a_panel_is_the_same_in_both_forms():
    x = np.array([0.1, 1.0, 10.0])
    panel = Panel("a & b", "w [rad/s]", "|L| [dB]", [Curve(x, np.array([20.0, np.nan, -20.0]), "one", 1)],
                  [Shade(x, np.zeros(3), "above")], log_x=True)  # fmt: skip
    html = panel_svg(panel)
    assert "a &amp; b" in html and html.count('class="miss"') == 1 and 'class="c1"' in html
    path = re.search(r'<path class="c1" stroke-dasharray="[^"]*" d="([^"]*)"/></svg>', html)[1]
    assert path.count("M") == 2 and "nan" not in html  # the line is interrupted
    time = np.arange(5000) * 0.01
    cut = panel_svg(Panel("step", "time [s]", "y", [Curve(time, np.sin(time), "", 0)], limits=((0.0, 2.0), None)))
    assert re.search(r'<path class="c0"[^>]* d="([^"]*)"', cut)[1].count("L") > 150  # of 200 shown points
    ax = draw_panel(panel, new_axes(4, 3))
    assert ax.get_xscale() == "log" and ax.get_title("left") == "a & b" and len(ax.collections) == 1


MISTAKES = {
    "no such scenario": (("--page", "--scenario", "pool-behin"), "pool-behind"),
    "no such law": (("--page", "--law", "gurded"), "--law = 'gurded'"),
    "a speed above the cap": (("--page", "--cruise", "0.1,0.9"), "--cruise = 0.9: is above the cap"),
    "a port without a page": (("--port", "8000"), "--page"),
    "a scenario without a page": (("--scenario", "pool-behind"), "study file"),
}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(tmp_path, what):
    words, problem = MISTAKES[what]
    done = surctl_here("tune", *words, cwd=tmp_path)
    assert done.status == 2 and problem in done.complaint
