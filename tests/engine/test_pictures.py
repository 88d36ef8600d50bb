"""Pictures and films of MuJoCo's scene, and the options of the command line for it."""

from __future__ import annotations

import builtins
import sys
from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from surctl.cli.app import app
from surctl.errors import InputError, ToolMissing
from surctl.marine.control import build_law, load_gains
from surctl.marine.engine import CAMERAS, EngineOptions, Moment, Scene, mujoco_physics, physics
from surctl.marine.engine.fluid import parse_plant
from surctl.marine.engine.mjcf import mujoco_library
from surctl.marine.export import CompiledLaw
from surctl.marine.report import render_page, save_film
from surctl.marine.report.animation import film_frames, film_pictures
from surctl.marine.reproduction import Simulations
from surctl.marine.reproduction.scenarios import _arrivals
from surctl.marine.simulation import load_scenario, simulate
from surctl.marine.simulation.world import build_world
from tests.engine.tools import load_vehicle
from tests.pictures import blank_pictures
from tests.report.test_page import bare
from tests.tools import _without

POOL = load_scenario("pool-behind")
BOAT = load_vehicle("sur400-tilting")


def scene(size: tuple[int, int] = (320, 180)) -> Scene:
    try:
        return Scene(POOL, BOAT, size=size)
    except ToolMissing as reason:
        _without(str(reason))
        raise


def test_each_camera_shows_hull_and_obstacle() -> None:
    bodies = build_world(POOL, BOAT, seed=0).bodies(2.0)
    beams = [(0.7, 0.6, 0.5, 0.6, 0.8, True)]
    with scene() as opened:
        shown = {c: opened.picture(c, Moment(POOL.start_pose, (0.1, 0.0), bodies, None, beams)) for c in CAMERAS}
        empty = opened.picture("above", Moment(POOL.start_pose))
        with pytest.raises(InputError, match="camera"):
            opened.picture("below", Moment(POOL.start_pose))
    yellow = {c: np.sum((p[..., 0] > 120) & (p[..., 2] < 80) & (p[..., 1] > 90)) for c, p in shown.items()}
    assert yellow["above"] > 300 and yellow["side"] > 300
    assert np.mean(np.any(shown["above"] != empty, axis=2)) > 0.02  # obstacle and beam
    assert all(np.std(p) > 5 for p in shown.values())


def test_the_view_from_above_has_no_perspective() -> None:
    cylinder = build_world(POOL, BOAT, seed=0).bodies(0.0)
    with scene() as opened:
        near, far = (
            opened.picture("above", Moment((*POOL.start_pose[:2], z, 0.0), bodies=cylinder)) for z in (-0.3, -1.0)
        )
    hulls = [np.sum((p[..., 0] > 120) & (p[..., 2] < 80) & (p[..., 1] > 90)) for p in (near, far)]
    assert hulls[1] == pytest.approx(hulls[0], rel=0.1)


def test_a_film_has_all_frames_and_is_repeatable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene().close()
    short = replace(POOL, time_limit=0.2)
    run = simulate(short, BOAT, gains=load_gains("default"), law=build_law("closed_form"), physics=mujoco_physics())
    frames, again = list(film_frames(run)), next(film_frames(run))
    assert frames[0].tobytes() == again.tobytes()
    monkeypatch.setattr("surctl.marine.report.animation.film_frames", lambda *_, **__: iter(frames))
    with Image.open(save_film(run, tmp_path / "run.gif")) as film:
        assert film.size == (640, 540) and getattr(film, "n_frames", 1) == 3


def test_a_picture_does_not_depend_on_what_is_in_memory() -> None:
    with scene() as boat:
        moment = Moment(POOL.start_pose, beams=[(0.6, 1.0, 0.0, 0.5, 1.0, False)])
        plain = boat.picture("above", moment)
        drawn = boat._renderer.scene
        for k in range(drawn.ngeom + 20):
            drawn.geoms[k].objtype, drawn.geoms[k].objid = int(mujoco_library().mjtObj.mjOBJ_GEOM), 3
        assert np.array_equal(boat.picture("above", moment), plain)


def test_the_report_shows_the_scene_beside_the_plan_view(monkeypatch: pytest.MonkeyPatch) -> None:
    scene().close()
    blank_pictures(monkeypatch)
    short = replace(POOL, time_limit=0.2)
    run = simulate(short, BOAT, gains=load_gains("default"), law=build_law("closed_form"))
    steps, pictures = film_pictures(run)
    with Image.open(BytesIO(b64decode(pictures[0].partition(",")[2]))) as first:
        assert first.size == (480, 405) and steps == [0, 2, 3]
    page = render_page(replace(bare(runs=(run,)), film=True))
    assert all(page.count(f'<img src="{uri}"') == 1 for uri in pictures)
    assert '"filmed":[0.0,0.1,0.15]' in page and "filmed" not in render_page(bare(runs=(run,))).split("<script>")[0]


def invoke(*words: str) -> str:
    done = CliRunner().invoke(app, ["simulate", "pool-behind", *words])
    assert isinstance(done.exception, InputError), done.output
    return str(done.exception)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--plant mujco", "did you mean 'mujoco'"),
        ("--plant own:dof=4", "has no options"),
        ("--plant own:", "has no options"),
        ("--plant mujoco:", "is empty"),
        ("--plant mujoco:dof=4,", "is empty"),
        ("--plant mujoco --film=", "--film = '': is empty"),
        ("--plant mujoco --film x.gif --animate ./x.gif", "name two files"),
        ("--plant mujoco:dof=5", "--plant mujoco:dof = '5': input should be 0, 4 or 6"),
        ("--plant mujoco:count=four", "mujoco:count = 'four': input should be a valid integer"),
        ("--plant mujoco:drag=cubic", "mujoco:drag = 'cubic': input should be 'axis', 'speed' or 'ellipsoid'"),
        ("--plant mujoco:floor=maybe", "mujoco:floor = 'maybe': input should be a valid boolean"),
        ("--plant mujoco:surface", "has no value; write --plant"),
        ("--plant mujoco:surfce=1", "did you mean 'surface'"),
        ("--plant mujoco:dof=4,dof=6", "--plant mujoco:dof = '6': is there twice; write it once"),
        ("--plant mujoco:surface=2", "mujoco:surface = '2': input should be less than or equal to 1"),
        ("--plant mujoco:box=1x2", "mujoco:box = '1x2': is not a box; write LENGTHxWIDTHxHEIGHT"),
        ("--plant mujoco:box=1x2x0.3", "add surface=1.0"),
        ("--plant mujoco:surface=1,box=axb", "such as 1.2x0.6x0.4"),
        ("--plant mujoco:surface=1,box=0.001x0.001x0.001", "is not plausible in m"),
        ("--plant mujoco:surface=1,box=120x60x40", "whose file has a diameter of"),
        ("--plant mujoco:ballast=none", "--plant mujoco: ballast needs a water surface; add surface=1.0"),
        ("--plant mujoco:count=300", "mujoco:count: has no effect with true positions"),
        ("--plant mujoco --view --threads 2", "--view: opens one window"),
        ("--plant mujoco:dof=6", "add [attitude]"),
        ("--plant mujoco --monte-carlo", "--runs N with --threads N"),
        ("--plant mujoco --runs 2 --film run.gif", "shows one run, not 2"),
        ("--plant mujoco --film run.avi", "end the name in .gif or .mp4"),
        ("--plant mujoco --threads 2 --controller tcp://127.0.0.1:9", "has one connection"),
        ("--film run.gif", "add --plant mujoco"),
        ("--view", "add --plant mujoco"),
        ("--threads 2", "applies only to a campaign"),
    ],
)
def test_a_mistake_is_told_in_one_line(words: str, said: str) -> None:
    text = invoke(*words.split())
    assert said in text and "\n" not in text


def test_no_model_begins_inside_an_obstacle(tmp_path: Path) -> None:
    words = ("--target", "mjcf", "--scenario", "pool-static", "--vehicle", "girona500", "--out", str(tmp_path))
    done = CliRunner().invoke(app, ["export", *words])
    assert isinstance(done.exception, InputError) and "m inside obstacle 'Obstacle1'" in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_window_needs_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "use --film" in invoke("--plant", "mujoco", "--view")


def test_without_mujoco_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def refuse(name: str, *rest: Any) -> Any:
        if name == "mujoco":
            raise ModuleNotFoundError(name, name=name)
        return found(name, *rest)

    mujoco_library.cache_clear()
    monkeypatch.setattr(builtins, "__import__", refuse)
    try:
        assert "pip install 'surctl[mujoco]'" in invoke("--plant", "mujoco")
    finally:
        mujoco_library.cache_clear()


@pytest.mark.parametrize(
    ("renderer", "said"), [("nonsense", "MUJOCO_GL = 'nonsense'"), ("", "installation of mujoco is broken")]
)
def test_a_renderer_or_an_installation_that_fails(monkeypatch: pytest.MonkeyPatch, renderer: str, said: str) -> None:
    found = builtins.__import__

    def fails(name: str, *rest: Any) -> Any:
        if name == "mujoco":
            raise RuntimeError("invalid value")
        return found(name, *rest)

    mujoco_library.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", renderer)
    if renderer:
        monkeypatch.delitem(sys.modules, "mujoco", raising=False)
        monkeypatch.setattr(builtins, "__import__", fails)
    else:
        monkeypatch.setitem(sys.modules, "mujoco", ModuleType("mujoco"))
    try:
        assert said in invoke("--plant", "mujoco")
    finally:
        mujoco_library.cache_clear()


def test_the_controller_of_the_options_is_that_of_every_process(monkeypatch: pytest.MonkeyPatch) -> None:
    requested = []
    monkeypatch.setattr(physics, "simulate_with_steppers", lambda case, *_, **__: requested.append(case.stepper) or [])
    for words in ([], ["--controller", "c"]):
        CliRunner().invoke(
            app, ["simulate", "pool-behind", "--law", "closed_form", "--plant", "mujoco", "--threads", "2", *words]
        )
    assert requested == [None, CompiledLaw]


def test_the_options_are_written_as_they_are_read() -> None:
    options = EngineOptions(dof=4, surface=0.5, floor=True, drag="speed", box=(1.2, 0.6, 0.4))
    assert parse_plant(f"mujoco:{options.text()}") == options


def test_the_column_of_the_reproduction(monkeypatch: pytest.MonkeyPatch) -> None:
    from surctl.marine.reproduction import scenarios
    from surctl.marine.reproduction.row import agrees

    monkeypatch.setattr(scenarios, "_simulated", lambda *_: agrees("all arrived"))
    result = _arrivals(Simulations(1, independent=True), "pool-behind", "truth")
    assert result.safe and result.independent.startswith("mujoco, 6 DoF, seed 0: reached at 11.")
    assert not _arrivals(Simulations(1), "pool-behind", "truth").independent
