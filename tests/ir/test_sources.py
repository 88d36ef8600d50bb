"""The digest of sources: another one for other code, and none where the code cannot be known."""

from __future__ import annotations

import importlib
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import SurctlError
from surctl.ir import cache
from surctl.ir.cache import source_digest

FILES = {
    "__init__.py": "",
    "law.py": "GAIN = 1.0\n",
    "inner/__init__.py": "",
    "inner/law.py": "GAIN = 2.0\n",
    "inner/table.toml": "gain = 1.0\n",
    "inner/notes.txt": "nothing\n",
}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package `dived`, as old as this process."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(cache, "_STARTED", 2**63)
    for name, text in FILES.items():
        (tmp_path / "dived" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "dived" / name).write_text(text)
    yield tmp_path / "dived"
    for name in [name for name in sys.modules if name.partition(".")[0] in ("dived", "zipped")]:
        del sys.modules[name]
    source_digest.cache_clear()


def digest(*packages: str) -> str:
    """As a fresh process computes it."""
    source_digest.cache_clear()
    importlib.invalidate_caches()
    return source_digest(*packages)


@pytest.mark.parametrize("name", [name for name in FILES if not name.endswith(".txt")])
def test_a_letter_of_any_source_counts(package: Path, name: str) -> None:
    before = digest("dived")
    assert digest("dived") == before
    with (package / name).open("a") as file:
        file.write("#")
    assert digest("dived") != before


def test_what_is_no_source_does_not_count(package: Path) -> None:
    before = digest("dived")
    (package / "inner" / "notes.txt").write_text("something")
    (package / "__pycache__").mkdir(exist_ok=True)
    (package / "__pycache__" / "law.py").write_text("")
    assert digest("dived") == before


def test_names_count_and_where_a_file_ends(package: Path) -> None:
    seen = {digest("dived")}
    (package / "law.py").rename(package / "laws.py")
    seen.add(digest("dived"))
    (package / "laws.py").write_text("GAIN =")
    (package / "inner" / "__init__.py").write_text("GAIN = 1.0\n")
    seen.add(digest("dived"))
    (package / "fresh.py").write_text("")
    seen.add(digest("dived"))
    assert len(seen) == 4


def test_packages_and_versions_count_but_not_the_order(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    both = digest("dived.inner", "dived.law")
    assert both == digest("dived.law", "dived.inner")
    assert len({both, digest("dived.inner"), digest("dived.law"), digest("dived")}) == 4
    monkeypatch.setattr(np, "__version__", "0.1")
    assert digest("dived.law", "dived.inner") != both


def test_it_is_read_once(package: Path) -> None:
    before = digest("dived")
    (package / "law.py").write_text("")
    assert source_digest("dived") == before


def test_a_module_alone_is_its_file(package: Path) -> None:
    before = digest("dived.law")
    (package / "inner" / "law.py").write_text("")
    assert digest("dived.law") == before
    (package / "law.py").write_text("")
    assert digest("dived.law") != before


def test_a_zip_file_is_read_as_well(package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = digest("dived"), digest("dived.law")
    with zipfile.ZipFile(tmp_path / "dived.zip", "w") as file:
        for name, text in FILES.items():
            file.writestr(f"zipped/{name}", text)
    monkeypatch.syspath_prepend(str(tmp_path / "dived.zip"))
    zipped = digest("zipped"), digest("zipped.law")
    assert zipped[0] not in plain and zipped[1] not in plain  # the package has another name
    assert len({*zipped, digest("zipped.inner")}) == 3
    assert [name for name, _ in sorted(cache._sources("zipped"))] == sorted(
        name for name in FILES if not name.endswith(".txt")
    )


def test_code_that_cannot_be_known_has_none(package: Path) -> None:
    with pytest.raises(SurctlError, match="no such package"):
        digest("dived.nowhere")
    with pytest.raises(SurctlError, match="nowhere"):
        digest("nowhere.inner")
    with pytest.raises(SurctlError, match="math has no source files"):
        digest("math")
    for name in ("__init__.py", "law.py"):
        (package / "inner" / name).unlink()
    with pytest.raises(SurctlError, match="has no source files"):
        digest("dived.inner")  # tables alone say nothing of its code


@pytest.mark.parametrize("name", ["dived", "dived.law"])
def test_sources_younger_than_the_process_have_none(package: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(cache, "_STARTED", (package / "law.py").stat().st_ctime_ns - 1)
    with pytest.raises(SurctlError, match=r"\.py was changed after this process began"):
        digest(name)
