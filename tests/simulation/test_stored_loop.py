"""Closed loops on disk: another process takes the C text of the same loop, and of no other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from surctl.errors import SurctlError
from surctl.marine.simulation.batch import engines
from surctl.marine.simulation.batch.loop import Loop, build_loop
from surctl.marine.simulation.batch.structure import Structure

PLAIN = Structure("closed_form", "corrected", "nsb", "truth", ("disc",))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    return tmp_path


def begin() -> None:
    """As in another process: nothing is known but what lies on disk."""
    engines.stored_loop.cache_clear()
    build_loop.cache_clear()


def test_a_stored_loop_is_the_loop_and_is_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    begin()
    first, other = engines.stored_loop(PLAIN), engines.stored_loop(replace(PLAIN, optional=True))
    assert first.digest == build_loop(PLAIN).step.digest() != other.digest
    assert first.source.startswith("#") and first.source != other.source
    begin()
    monkeypatch.setattr(Loop, "step", property(lambda _: pytest.fail("it is built again")))
    assert engines.stored_loop(PLAIN) == first and engines.stored_loop(replace(PLAIN, optional=True)) == other


def test_other_sources_or_none_build_it_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begin()
    first = engines.stored_loop(PLAIN)
    before = {path.name for path in folder.glob("*.loop")}
    begin()
    monkeypatch.setattr(engines, "source_digest", lambda *_: "other sources")
    assert engines.stored_loop(PLAIN) == first and len(list(folder.glob("*.loop"))) == 2 * len(before) == 2

    def unknown(*_: str) -> str:
        raise SurctlError("a source was changed")

    begin()
    monkeypatch.setattr(engines, "source_digest", unknown)
    assert engines.stored_loop(PLAIN) == first and len(list(folder.glob("*.loop"))) == 2
