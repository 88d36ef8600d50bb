"""The moving picture of a run, read back picture by picture."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from surctl.cli.app import app
from surctl.errors import InputError, ToolMissing
from surctl.marine.cli.run_options import check_animate
from surctl.marine.report import save_animation
from surctl.marine.report.animation import check_animation, frame_steps, frames, gif
from surctl.marine.report.plan_view import INSTANT, beams_at
from surctl.marine.simulation import Run
from surctl.report.theme import ROBOT
from tests.report.data import run
from tests.report.test_player import stretched
from tests.report.test_plots import first_tick
from tests.tools import need_module


def flight(sensing: str = "truth") -> Run:
    """The first seconds of a run."""
    return run(sensing=sensing, limit=4.0)


@cache
def slow() -> Run:
    """Every sixteenth tick of them: a picture each."""
    flown = flight()
    few = {k: v[::16] for k, v in vars(flown.record).items() if k != "law_parameters" and v is not None}
    return replace(flown, record=replace(flown.record, **few))


@cache
def pictures() -> list[np.ndarray]:
    return list(frames(slow()))


def middle_of(picture: np.ndarray, colour: str, most: float = 12.0) -> tuple[np.ndarray, int]:
    """Mean (column, row) of the pixels of about that colour, and how many there are."""
    rows, columns = np.nonzero(np.abs(picture.astype(float) - 255 * np.array(to_rgb(colour))).max(axis=-1) < most)
    return np.array([columns.mean(), rows.mean()]) if len(rows) else np.full(2, np.nan), len(rows)


def test_ticks_are_evenly_apart_and_end_with_the_run() -> None:
    time = flight().record.time
    for apart in (0.05, 0.1, 0.23, 1.0, 1e3):
        ticks = frame_steps(flight(), apart=apart)
        assert ticks[0] == 0 and ticks[-1] == len(time) - 1 and len(set(ticks)) == len(ticks)
        assert all(b - a >= apart - 1e-9 for a, b in zip(time[ticks[:-2]], time[ticks[1:-1]], strict=True))
    assert frame_steps(first_tick(flight()), apart=0.1) == [0]


def test_the_hull_moves_as_it_was_flown_and_the_file_has_every_picture(tmp_path: Path) -> None:
    flown = slow()
    path = save_animation(flown, tmp_path / "new" / "run.gif")
    assert path.read_bytes() == gif(pictures())
    ticks = frame_steps(flown, apart=0.1)
    drawn = pictures()
    still = (np.max(drawn, axis=0) == np.min(drawn, axis=0)).all(axis=-1)
    assert still.mean() > 0.5  # the ground does not flicker
    with Image.open(path) as read:
        assert read.n_frames == len(ticks) == len(drawn)
        assert read.info["loop"] == 0 and read.info["duration"] == 100
        for k in (0, len(ticks) // 2, len(ticks) - 1):
            read.seek(k)
            shown = np.asarray(read.convert("RGB"), dtype=float)
            assert np.abs(shown - drawn[k]).mean() < 1.0 and (shown[0, 0] == 255).all()
    # what is new in a picture, without the strip below, is about the hull, and goes as far as it went
    blue = [np.where(still[..., None], 255, p)[:480] for p in (drawn[0], drawn[-1])]
    (first, few), (last, more) = (middle_of(p, ROBOT) for p in blue)
    assert 300 < few < more < 1.6 * few  # one hull and its way: nothing of an earlier picture is left
    way = flown.record.eta[[0, -1], :2] @ np.diag([1, -1])
    moved, flew = last - first, way[1] - way[0]
    assert moved @ flew > 0.9 * np.hypot(*moved) * np.hypot(*flew)


def test_beams_are_drawn_where_sensing_is_sonar() -> None:
    heard, told = flight("sonar"), flight()
    assert beams_at(told, 5) == ()
    ranges = heard.telemetry("ranges")[5]
    assert [beam.length for beam in beams_at(heard, 5)] == ranges.tolist()
    (_, of_sonar), (_, of_truth) = (
        middle_of(next(iter(frames(flown)))[:480], _over_white(INSTANT, 0.22)) for flown in (heard, told)
    )
    assert of_sonar > 1000 and of_truth < 50


def _over_white(colour: str, alpha: float) -> tuple[float, ...]:
    return tuple(1 - alpha + alpha * c for c in to_rgb(colour))


def test_a_run_of_one_tick_is_one_picture(tmp_path: Path) -> None:
    with Image.open(save_animation(first_tick(flight()), tmp_path / "short.gif")) as read:
        assert getattr(read, "n_frames", 1) == 1


def test_a_long_run_is_played_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[list[int]] = []

    def two(flown: Run, *, apart: float) -> list[int]:
        told.append(frame_steps(flown, apart=apart))
        return told[-1][:2]

    monkeypatch.setattr("surctl.marine.report.animation.frame_steps", two)
    assert len(list(frames(stretched(flight(), 20)))) == 2  # 80 s
    assert 15 < len(told[0]) <= 152


@pytest.mark.parametrize("name", ["run.webm", "run", "folder.gif"])
def test_a_name_that_is_no_moving_picture_is_told(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder.gif").mkdir()
    with pytest.raises(InputError, match="--animate"):
        check_animation(tmp_path / name)


def test_mp4_without_pyav_is_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surctl.marine.report.animation.find_spec", lambda name: None)
    with pytest.raises(ToolMissing, match=r"not installed; pip install 'surctl\[film\]'.*\.gif"):
        check_animation("run.mp4")


def test_pyav_writes_the_film(tmp_path: Path) -> None:
    need_module("av")
    import av

    with av.open(str(save_animation(first_tick(flight()), tmp_path / "run.mp4"))) as film:
        assert film.streams.video[0].codec_context.name == "h264" and film.streams.video[0].average_rate == 10
        (shown,) = [frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0)]
    drawn = next(frames(first_tick(flight()))).astype(int)
    assert shown.shape == drawn.shape and np.abs(shown - drawn).mean() < 6


def test_a_broken_pyav_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("surctl.marine.report.animation.find_spec", lambda name: object())
    monkeypatch.setitem(sys.modules, "av", ModuleType("av"))
    with pytest.raises(InputError, match=r"--animate: PyAV failed \(.*; end the name in .gif"):
        save_animation(first_tick(flight()), tmp_path / "run.mp4")


def test_several_runs_and_campaigns_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    target = tmp_path / "new" / "run.gif"
    for flights, campaign in ((2, False), (1, True)):
        with pytest.raises(InputError, match="shows one run, not"):
            check_animate(target, runs=flights, campaign=campaign)
    assert not target.parent.exists()
    check_animate(target, runs=1, campaign=False)
    assert target.parent.is_dir() and not target.exists()


def test_the_command_writes_the_file_and_refuses_before_it_flies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("surctl.marine.report.animation.frame_steps", lambda run, apart: [0, len(run.record.time) - 1])

    def command(*words: str) -> int:
        return int(app.main(["simulate", "pool-behind", *words], standalone_mode=False))

    target = tmp_path / "run.gif"
    assert command("--animate", str(target), "--json") == 0
    assert json.loads(capsys.readouterr().out)["runs"][0]["animation"] == str(target)
    assert target.read_bytes().startswith(b"GIF89a")
    with pytest.raises(InputError, match="--animate"):
        command("--runs", "2", "--animate", str(tmp_path / "two.gif"))
    with pytest.raises(InputError, match="--animate"):
        command("--monte-carlo", "--animate", str(tmp_path / "many.gif"))
    assert capsys.readouterr().out == "" and list(tmp_path.iterdir()) == [target]


def test_white_stays_white_and_a_colour_that_comes_later_is_shown() -> None:
    ground = np.full((8, 8, 3), 255, np.uint8)
    ground[0, 0] = 200, 0, 0
    later = ground.copy()
    later[4:, 4:] = 190, 10, 10
    with Image.open(BytesIO(gif([ground, later]))) as read:
        read.seek(1)
        shown = np.asarray(read.convert("RGB")).astype(int)
    assert (shown[1:4] == 255).all() and (shown[4:, 4:] == later[4:, 4:]).all()
