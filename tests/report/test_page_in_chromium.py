"""The report as a reader has it: opened in Chromium from a file, played, scrubbed, printed, in light and dark."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.assessment import Line
from surctl.files import write_file
from surctl.marine.report import render_page
from surctl.marine.simulation import Run
from tests.browser import WIDTHS, Opened, open_page
from tests.report.data import run, said, verdict
from tests.report.test_page import bare
from tests.tools import need

# of each element with a text of its own: colour over the grounds behind it, contrast by WCAG 2.1
CONTRAST = """() => {
  const parts = (c) => [...c.match(/[\\d.]+/g).map(Number), 1].slice(0, 4);
  const over = (top, ground) => top.slice(0, 3).map((v, k) => v * top[3] + ground[k] * (1 - top[3]));
  const light = (c) => { const [r, g, b] = c.map((v) => v / 255).map(
      (v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = (e) => { const chain = []; for (let at = e; at; at = at.parentElement) chain.unshift(at);
      return chain.reduce((c, at) => over(parts(getComputedStyle(at).backgroundColor), c), [255, 255, 255]); };
  const found = [];
  for (const e of document.querySelectorAll("body *")) {
    if (e.closest("script, svg, .skip") || !e.getClientRects().length) continue;
    const own = [...e.childNodes].filter((n) => n.nodeType === 3 && n.textContent.trim());
    if (!own.length) continue;
    const behind = ground(e), style = getComputedStyle(e);
    const pair = [light(over(parts(style.color), behind)), light(behind)].sort((a, b) => b - a);
    found.push([(pair[0] + 0.05) / (pair[1] + 0.05), e.tagName + " " + own[0].textContent.trim().slice(0, 40)]);
  }
  return found;
}"""
HULL = """() => {
  const plan = document.querySelector(".plan"), hull = plan.querySelector(".hull circle");
  const drawn = plan.querySelector("g").getScreenCTM().inverse().multiply(hull.getScreenCTM());
  return [Number(plan.dataset.time), drawn.e, drawn.f, drawn.a, drawn.b];
}"""
INSIDE = """(points) => [...document.querySelectorAll(".plan .beam")].map((beam, k) => points[k].map(
    (p) => beam.isPointInFill(new DOMPoint(...p))))"""
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
RANGES = (0.5, 0.8, 4.5, 1.0)  # [m]; the third is the maximum: no echo
PLAYED = "from => Number(document.querySelector('.plan').dataset.time) > from"


def heard() -> Run:
    """The run with true positions, as if its four sonars had read `RANGES` all the time."""
    told = run()
    telemetry = told.record.telemetry.copy()
    telemetry[:, told.law.telemetry_slice("ranges")] = RANGES
    return replace(told, sensing="sonar", record=replace(told.record, telemetry=telemetry))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("chromium")
    data = bare(
        runs=(heard(),),
        deciding=(True,),
        verdicts=(verdict("v1-printed"),),
        seconds={"sweep": 1.5},
        assessment=said(
            Line(True, "margins suffice"),
            Line(False, "a claim is open", "claims-v1-printed"),
            Line(None, "sonar does not decide", counts=False),
        ),
    )
    return write_file(tmp_path_factory.mktemp("report") / "report.html", render_page(data))


@pytest.fixture(scope="module")
def window(page: Path) -> Iterator[Opened]:
    with open_page(page.as_uri()) as found:
        yield found


@pytest.fixture
def opened(window: Opened, page: Path) -> Iterator[Opened]:
    window.page.emulate_media(media="screen", color_scheme="light", reduced_motion="no-preference")
    window.page.goto(page.as_uri())
    yield window
    assert window.errors == [] and window.outside == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_is_legible_and_nothing_sticks_out(opened: Opened, scheme: str) -> None:
    opened.page.emulate_media(color_scheme=scheme)
    opened.page.evaluate(UNFOLD)
    shown = opened.page.evaluate(CONTRAST)
    assert len(shown) > 200
    assert [text for ratio, text in shown if ratio < 4.5] == []
    ground = opened.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (ground == "rgb(255, 255, 255)") == (scheme == "light")
    assert opened.overflow(min(WIDTHS)) == 0
    broad = (
        "[...document.querySelectorAll('caption')].filter((e) => e.offsetWidth > innerWidth).map((e) => e.innerText)"
    )
    assert opened.page.evaluate(broad) == [], "a wide table's title must not be cut off on a telephone"
    assert [opened.overflow(width) for width in (max(WIDTHS), 1280)] == [0, 0]


def test_a_line_of_the_summary_leads_to_what_it_is_about(opened: Opened) -> None:
    first = opened.page.locator(".checks li").first
    assert "bad" in str(first.get_attribute("class"))
    first.locator("a").click()
    opened.page.wait_for_function("() => document.getElementById('claims-v1-printed').getBoundingClientRect().top < 50")
    loose = "() => [...document.images].filter(i => !i.alt || !i.closest('figure').querySelector('figcaption code'))"
    assert opened.page.evaluate(f"({loose})().length") == 0


def place(opened: Opened) -> tuple[float, ...]:
    """Time [s] that is shown, where the hull is drawn in {E} [m], and cos and sin of its heading."""
    return tuple(opened.page.evaluate(HULL))


def assert_where_it_was(opened: Opened) -> None:
    """The hull of the plan is where the record has it, and the text tells the same instant."""
    time, *drawn = place(opened)
    x, y, _, heading = (np.interp(time, run().record.time, one) for one in run().record.eta.T)
    assert drawn == pytest.approx([x, y, np.cos(heading), np.sin(heading)], abs=2e-3)
    assert opened.page.inner_text(".readout").startswith(f"{time:.1f} of")


def test_play_moves_the_time_and_stops_at_the_end(opened: Opened) -> None:
    page = opened.page
    assert not page.is_visible(".player > img") and page.is_visible(".stage")
    assert place(opened)[0] == 0
    page.wait_for_timeout(150)
    assert place(opened)[0] == 0  # nothing moves unasked
    page.select_option(".pace", "10")
    page.click(".play")
    page.wait_for_function(PLAYED, arg=1.0)
    assert page.inner_text(".play") == "Pause"
    page.wait_for_function("() => document.querySelector('.play').textContent === 'Play'")
    assert place(opened)[0] == pytest.approx(run().record.time[-1], abs=0.01)
    assert_where_it_was(opened)


def test_scrub_and_keys_move_the_vehicle(opened: Opened) -> None:
    page = opened.page
    end = float(run().record.time[-1])
    page.locator(".scrub").scroll_into_view_if_needed()
    box = page.locator(".scrub").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    time, x, *_ = place(opened)
    assert time == pytest.approx(end / 2, abs=0.05 * end) and x > run().record.eta[0, 0] + 0.2
    assert_where_it_was(opened)
    page.keyboard.press("ArrowRight")
    assert place(opened)[0] == pytest.approx(time + 0.1, abs=0.06)
    page.keyboard.press("End")
    assert place(opened)[0] == pytest.approx(end, abs=0.01)
    page.keyboard.press("Home")
    assert place(opened)[0] == 0
    page.keyboard.press("Tab")
    page.keyboard.press("Space")  # the button after it
    page.wait_for_function(PLAYED, arg=0.2)
    page.keyboard.press("Space")
    stopped = place(opened)
    page.wait_for_timeout(150)
    assert place(opened) == stopped
    page.click(".closest")
    record = run().record
    assert place(opened)[0] == pytest.approx(record.time[int(np.argmin(record.clearance))], abs=0.11)


def test_beams_reach_from_the_hull_as_far_as_the_sonars_read(opened: Opened) -> None:
    opened.page.click(".closest")
    _, x, y, *turn = place(opened)
    heading, radius = np.arctan2(turn[1], turn[0]), run().vehicle["radius"]
    array = run().scenario.sensors.array_on(radius)
    points = []
    for reach, azimuth in zip(RANGES, array.azimuths, strict=True):
        axis = heading + azimuth
        apex = np.array([x + radius * np.cos(axis), y + radius * np.sin(axis)])
        around = [(0.97, 0.0), (1.03, 0.0), (0.5, 0.93), (0.5, -0.93), (0.5, 1.07), (0.5, -1.07), (-0.1, 0.0)]
        ways = [(far * reach, axis + aside * array.half_angle) for far, aside in around]
        points.append([(apex + far * np.array([np.cos(way), np.sin(way)])).tolist() for far, way in ways])
    inside = opened.page.evaluate(INSIDE, points)
    assert inside == [[True, False, True, True, False, False, False]] * 4
    silent = opened.page.locator(".plan .beam").evaluate_all("(all) => all.map((b) => b.classList.contains('silent'))")
    assert silent == [False, False, True, False]


def test_with_reduced_motion_it_goes_by_whole_seconds(opened: Opened) -> None:
    page = opened.page
    page.emulate_media(reduced_motion="reduce")
    page.click(".play")
    page.wait_for_function(PLAYED, arg=0.5)
    assert place(opened)[0] == 1.0


def test_paper_has_the_still_picture(opened: Opened) -> None:
    page = opened.page
    page.emulate_media(media="print", color_scheme="dark")
    assert page.is_visible(".player > img") and not page.is_visible(".stage")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"


def test_details_are_closed_on_the_screen_and_open_on_paper(opened: Opened) -> None:
    page = opened.page
    inside = page.locator("#claims figure").first
    assert not inside.is_visible()
    page.emulate_media(media="print")
    assert inside.is_visible()  # by the style alone
    page.emulate_media(media="screen")
    assert not inside.is_visible()
    count = "() => document.querySelectorAll('details[open]').length"
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(count) == page.locator("details").count() > 3
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(count) == 0


def test_verdict_and_run_fit_the_first_screen(opened: Opened) -> None:
    assert opened.page.evaluate("document.querySelector('.play').getBoundingClientRect().bottom") < 900
    heads = "[...document.querySelectorAll('h1, h2, caption, th')].filter((e) => e.scrollWidth > e.clientWidth + 1)"
    opened.page.evaluate(UNFOLD)
    assert opened.page.evaluate(f"{heads}.map((e) => e.textContent)") == []


def test_another_script_is_not_run(window: Opened, page: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.html"
    text = page.read_text(encoding="utf-8")
    other.write_text(text.replace('"use strict";', '"use strict"; document.title = "run";'), encoding="utf-8")
    window.page.goto(other.as_uri())
    assert window.page.title() != "run"
    assert window.page.is_visible(".player > img") and not window.page.is_visible(".stage")
    assert any("Content Security Policy" in error for error in window.errors)
    window.errors.clear()
