"""What the page's player is given, and that the page lets nothing but it run."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from surctl.marine.report import render_page
from surctl.marine.report.animation import player, player_frames
from surctl.marine.simulation import Run
from surctl.report.document import Picture
from tests.report.data import run
from tests.report.reader import Reader
from tests.report.test_page import bare
from tests.report.test_plots import first_tick

STILL = Picture("data:,", 1, 1, "a run", "a run", "")


def flight(sensing: str = "truth", scenario: str = "pool-behind") -> Run:
    return run(scenario, sensing, 4.0)


def stretched(flown: Run, times: int) -> Run:
    """The same motion over and over, for so many times the time."""
    r = flown.record
    count = len(r.time) * times
    long = {k: np.resize(v, (count, *v.shape[1:])) for k, v in vars(r).items() if isinstance(v, np.ndarray)}
    long |= {"time": np.arange(count) * flown.law.dt, "law_parameters": r.law_parameters}
    return replace(flown, record=replace(r, **long, obstacles=list(r.obstacles) * times))


@pytest.mark.parametrize("sensing", ["truth", "sonar"])
def test_the_frames_are_the_records(sensing: str) -> None:
    flown = flight(sensing)
    r, frames = flown.record, json.loads(player_frames(flown))
    ticks = np.searchsorted(r.time, np.array(frames["time"]) - 1e-6)
    assert np.diff(frames["time"])[:-1].min() >= 0.1 - 1e-9
    assert frames["time"][0] == 0 and frames["time"][-1] == pytest.approx(r.time[-1])
    assert np.abs(np.array(frames["place"]) - r.eta[ticks, :2]).max() <= 5.01e-4
    assert np.abs(np.array(frames["heading"]) - r.eta[ticks, 3]).max() <= 5.01e-4
    assert np.abs(np.array(frames["clearance"]) - r.clearance[ticks]).max() <= 5.01e-4
    assert frames["clearance"][frames["closest"]] == min(frames["clearance"])
    (mover,) = frames["obstacles"]
    centres = [r.obstacles[k][0].shape.center for k in ticks]
    assert np.abs(np.array(mover["at"]) - centres).max() <= 5.01e-4
    if sensing == "truth":
        assert frames["beams"] == []
        return
    array = flown.scenario.sensors.array_on(flown.vehicle["radius"])
    ranges = flown.telemetry("ranges")[ticks]
    for k, beam in enumerate(frames["beams"]):
        assert np.abs(np.abs(beam["length"]) - ranges[:, k]).max() <= 5.01e-3
        assert ((np.array(beam["length"]) < 0) == (ranges[:, k] >= array.maximum - array.resolution)).all()
        out = [np.cos(beam["axis"]), np.sin(beam["axis"])]
        assert beam["apex"] == pytest.approx(flown.vehicle["radius"] * np.array(out), abs=1e-3)


def test_what_stands_still_is_told_once_and_what_is_gone_is_null() -> None:
    for obstacle in json.loads(player_frames(flight(scenario="tank-static")))["obstacles"]:
        assert len(obstacle["at"]) == 1
    flown = flight()
    gone = [bodies if k < 20 else [] for k, bodies in enumerate(flown.record.obstacles)]
    (mover,) = json.loads(player_frames(replace(flown, record=replace(flown.record, obstacles=gone))))["obstacles"]
    assert mover["at"][0] is not None and mover["at"][-1] is None


def test_what_is_not_finite_is_null_and_one_tick_is_one_frame() -> None:
    flown = flight()
    endless = np.full_like(flown.record.clearance, np.inf)
    frames = json.loads(player_frames(replace(flown, record=replace(flown.record, clearance=endless))))
    assert set(frames["clearance"]) == {None}
    assert json.loads(player_frames(first_tick(flown)))["time"] == [0.0]


def test_a_long_run_stays_small() -> None:
    long = stretched(flight("sonar"), 100)
    assert len(player_frames(long)) > 250_000
    assert 75_000 < len(player(long, STILL).frames) <= 150_000


def test_a_name_cannot_end_the_script() -> None:
    evil = "</script><script>alert(1)</script><!--"
    flown = flight()
    named = [[replace(body, name=evil) for body in bodies] for bodies in flown.record.obstacles]
    frames = player_frames(replace(flown, record=replace(flown.record, obstacles=named)))
    assert "<" not in frames and json.loads(frames)["obstacles"][0]["name"] == evil


@pytest.mark.usefixtures("blank")
def test_only_the_player_may_run_and_it_adds_less_than_200_kilobytes() -> None:
    flown = (flight("sonar"), flight())
    page = render_page(bare(runs=flown))
    (script,) = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(str(a["content"]) for a in Reader(page).all("meta") if "http-equiv" in a)
    assert policy == f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    (frames,) = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert frames == player_frames(flown[1])  # the run with true positions decides
    without = render_page(bare(runs=flown, deciding=(False, False)))
    fold = (files("surctl.report") / "templates" / "fold.js").read_text(encoding="utf-8")
    assert re.findall(r"<script[^>]*>(.*?)</script>", without, re.DOTALL) == [fold] and "data-player" not in without
    pictures, still = (sorted(Reader(text).all("img"), key=str) for text in (page, without))
    assert pictures == still  # they remain; the decisive run comes first
    assert 0 < len(page.encode()) - len(without.encode()) < 200_000


@pytest.mark.usefixtures("blank")
def test_the_run_that_fails_is_the_one_that_is_played() -> None:
    good, bad = flight(), flight(scenario="pool-static")
    arrived = replace(good, metrics=replace(good.metrics, reached=True))
    page = render_page(bare(runs=(arrived, bad), deciding=(True, True)))
    assert player_frames(bad) in page and player_frames(good) not in page
