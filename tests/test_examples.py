"""Every exported function has an example in its docstring; it, and each other example, prints what it says."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

import surctl.marine
from tests.pictures import blank_pictures
from tests.tools import need, need_compiler, need_module

PACKAGES = sorted(
    module.name.removeprefix("surctl.")
    for package in (surctl, surctl.marine)
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    if module.name not in ("surctl.__main__", "surctl.marine")
)


def _exported() -> Iterator[tuple[str, FunctionType | type]]:
    for package in PACKAGES:
        module = importlib.import_module(f"surctl.{package}")
        for name in getattr(module, "__all__", []):
            thing = getattr(module, name)
            if inspect.isfunction(thing) or (inspect.isclass(thing) and ">>>" in (thing.__doc__ or "")):
                yield f"{package}.{name}", thing


EXPORTED = dict(_exported())


def _others() -> Iterator[str]:
    known = {(thing.__module__, thing.__name__) for thing in EXPORTED.values()}
    root = Path(surctl.__file__).parent
    for file in sorted(root.rglob("*.py")):
        module = ".".join(("surctl", *file.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        for node in ast.parse(text).body if ">>>" in (text := file.read_text(encoding="utf-8")) else []:
            if not isinstance(node, ast.FunctionDef | ast.ClassDef) or (module, node.name) in known:
                continue
            if ">>>" in (ast.get_docstring(node) or ""):
                yield f"{module}:{node.name}"


OTHERS = tuple(_others())
_BOARD = ("arm-none-eabi-gcc", "qemu-system-arm")
TOOLS = {  # beside a C compiler
    "export.check_builds": ("gcc",),
    "export.emulated": _BOARD,
    "export.emulated_target": _BOARD,
}


MCAP = ("marine.simulation.SceneFile",)
MUJOCO = tuple(f"marine.report.{name}" for name in ("film_frames", "film_pictures", "moment_of", "save_film"))

LONG = {"falsify", "prove_statement", "sensitivity", "simulate", "sweep", "tune"}
_KNOWN: dict[tuple[str, ...], Any] = {}


def computed_once(examples: list[doctest.Example]) -> None:
    """Change `x = tune(...)` and its like: where another example had the same lines up to there, x is that one's."""
    before: tuple[str, ...] = ()
    home: dict[str, str | None] = {}
    for example in examples:
        (line,) = ast.parse(example.source).body
        if isinstance(line, ast.ImportFrom):
            home |= {alias.asname or alias.name: line.module for alias in line.names}
            continue
        names = {node.id for node in ast.walk(line) if isinstance(node, ast.Name)}
        before = (*before, *(f"{name} of {home[name]}" for name in sorted(names & home.keys())), example.source)
        if isinstance(line, ast.Assign) and names & LONG:
            line.value = ast.parse(f"once({before!r}, lambda: {ast.unparse(line.value)})", mode="eval").body
            example.source = f"{ast.unparse(line)}\n"


def once(key: tuple[str, ...], compute: Callable[[], Any]) -> Any:
    """The value of these lines."""
    if key not in _KNOWN:
        _KNOWN[key] = compute()
    return _KNOWN[key]


@pytest.mark.parametrize("name", EXPORTED)
def test_its_example_prints_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    if name.startswith("marine.engine.") or name in MUJOCO:
        need_module("mujoco")
    if name.startswith(("marine.bridge.", "recorded_mcap.")) or name in MCAP:
        need_module("pymavlink")
        need_module("mcap")
    for tool in TOOLS.get(name, ()):
        need(tool)
    monkeypatch.chdir(tmp_path)  # what an example writes goes there
    monkeypatch.setenv("MPLBACKEND", "agg")
    blank_pictures(monkeypatch)
    prints_what_it_says(EXPORTED[name], name)


@pytest.mark.parametrize("name", OTHERS)
def test_an_example_of_a_module_prints_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.chdir(tmp_path)
    module, _, thing = name.partition(":")
    prints_what_it_says(getattr(importlib.import_module(module), thing), name)


def prints_what_it_says(thing: object, name: str) -> None:
    """Run the examples of a function or class."""
    (test,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={"once": once})
    assert test.examples, "no example"
    computed_once(test.examples)
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(test, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
