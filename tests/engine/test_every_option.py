"""Each option of `surctl simulate` with `--plant mujoco`: it reaches the run as with the own plant, or is refused."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

import surctl.marine.control
from surctl.cli.app import app
from surctl.errors import InputError
from surctl.marine.cli.run_options import ControllerOptions, PlantOptions
from surctl.marine.control import load_gains, write_gains
from surctl.marine.engine.mjcf import mujoco_library

SAME = (
    "--vehicle sur540-flooded",
    "--gains other.toml",
    "--law paper",
    "--avoidance printed",
    "--guidance ilos",
    "--priority-mode filter",
    "--priority-mode filter --fallback bounded",
    "--sensing sonar",
    "--barrier inertia",
    "--movers barrier",
    "--fault dropout:2 --sensing sonar",
    "--vehicle sur540-jets --fault thruster:j1",
    "--chance dropout=0.1 --sensing sonar",
    "--echoes webots --sensing sonar",
    "--controller c",
    "--controller tcp://127.0.0.1:9 --link-loss 0.1",
    "--controller tcp://127.0.0.1:9 --link-delay 0.1",
    "--controller tcp://127.0.0.1:9 --link-deadline 0.5",
    "--controller tcp://127.0.0.1:9 --link-timeout 2",
    "--controller tcp://127.0.0.1:9 --link-compact",
    "--seed 3",
    "--runs 3",
)
"""Words of which MuJoCo's run gets the same as that of the own plant."""

AFTER = ("--explain", "--animate", "--save", "--frame", "--out", "--json", "--verbose", "--film")
"""Options for what is written of a finished run, of whatever plant."""

REFUSED = {
    "--seconds 9": "--seconds",
    "--monte-carlo": "--plant",
    "--random-worlds 2": "--plant",
    "--worst 3": "--worst",
    "--fresh": "--fresh",
    "--from saved.toml": "saved.toml",
    "--trust": "--trust",
    "--view --runs 2": "--view",
    "--view --threads 2": "--view",
}

PROCESSES = "--threads"
"""Of MuJoCo's runs only: tests/engine/test_runs.py."""


def test_the_lists_name_every_option() -> None:
    words = " ".join([*SAME, *AFTER, *REFUSED, PROCESSES, "--plant", "--help"]).split()
    known = {name for parameter in app.commands["simulate"].params for name in parameter.opts if name.startswith("-")}
    assert {word for word in words if word.startswith("-")} - {"--help"} == known - {"-h", "--help", "-v"}


@pytest.fixture
def reached(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Any]:
    """What each command gives to its runs; no law is built, and nothing simulated."""
    found: list[Any] = []
    monkeypatch.chdir(tmp_path)
    default = load_gains("default")
    other = write_gains(default.with_values({"k_v": 1.1 * default.values["k_v"]}))
    Path("other.toml").write_text(other, encoding="utf-8")

    def runs(_: PlantOptions, __: object, case: Any, law: Any, seeds: Any, **rest: Any) -> Iterator[Any]:
        found.append(
            (case.to_dict() if hasattr(case, "to_dict") else repr(case), law, list(seeds), repr(rest["faults"]))
        )
        found.append((rest["fallback"], rest["compiled"]))
        return iter(())

    @contextmanager
    def opened(self: ControllerOptions, *_: object) -> Iterator[None]:
        found.append(self)
        yield None

    importlib.import_module("surctl.marine.study.conduct")  # modules that are loaded now keep the true `build_law`
    monkeypatch.setattr(surctl.marine.control, "build_law", lambda name, **words: SimpleNamespace(name=name, **words))
    monkeypatch.setattr(PlantOptions, "runs", runs)
    monkeypatch.setattr(ControllerOptions, "opened", opened)
    return found


def command(words: str) -> BaseException | None:
    return CliRunner().invoke(app, ["simulate", "pool-behind", *words.split()]).exception


@pytest.mark.parametrize("words", SAME)
def test_the_option_reaches_the_run_as_with_the_own_plant(reached: list[Any], words: str) -> None:
    mujoco_library()
    assert command(words) is None
    own = reached.copy()
    reached.clear()
    assert command(f"{words} --plant mujoco") is None
    assert reached == own and len(own) == 3
    reached.clear()
    assert command("--plant mujoco") is None
    assert reached != own or words == "--vehicle sur540-flooded"


@pytest.mark.parametrize(("words", "named"), REFUSED.items())
def test_the_option_is_refused_by_name(words: str, named: str) -> None:
    mistake = command(f"{words} --plant mujoco")
    assert isinstance(mistake, InputError), mistake
    assert named in str(mistake) and "\n" not in str(mistake)
