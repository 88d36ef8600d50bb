"""Every function that a room exports has an example in its docstring, and the example prints what it says."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import pytest

import surctl
from tests.tools import need, need_compiler

ROOMS = sorted(module.name for module in pkgutil.iter_modules(surctl.__path__) if module.name != "__main__")


def _exported() -> Iterator[tuple[str, FunctionType]]:
    for room in ROOMS:
        module = importlib.import_module(f"surctl.{room}")
        for name in getattr(module, "__all__", []):
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                yield f"{room}.{name}", thing


FUNCTIONS = dict(_exported())
_BOARD = ("arm-none-eabi-gcc", "qemu-system-arm")
TOOLS = {  # beside a C compiler
    "export.check_builds": ("gcc",),
    "export.chosen_targets": ("gcc",),
    "export.emulated": _BOARD,
    "export.emulated_target": _BOARD,
    "export.prove_bundle": ("frama-c",),
    "export.with_proof": ("frama-c",),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_its_example_prints_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    for tool in TOOLS.get(name, ()):
        need(tool)
    monkeypatch.chdir(tmp_path)  # what an example writes goes there
    monkeypatch.setenv("MPLBACKEND", "agg")
    function = FUNCTIONS[name]
    (test,) = doctest.DocTestFinder(recurse=False).find(function, name, globs={})
    assert test.examples, "no example"
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(test, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
