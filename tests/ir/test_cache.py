"""The compile cache: used when it can be trusted, and only then."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import time
from contextlib import nullcontext
from multiprocessing.synchronize import Event
from pathlib import Path

import casadi as ca
import pytest

from surctl.errors import SurctlError, ToolMissing
from surctl.ir import cache as module
from surctl.ir import compile_block, lower, native
from surctl.ir.cache import CacheUnused, cache_folder, cached_bytes, shared_library
from surctl.ir.native import Native
from tests.tools import need_compiler

PROCESSES = multiprocessing.get_context("forkserver")  # loads this module once, and not once a process
PROCESSES.set_forkserver_preload([__name__])
EVIL = hashlib.sha256(b"evil").digest() + b"evil"
SOURCE = "int answer(void);\nint answer(void) { return 42; }\n"


@pytest.fixture
def builds(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    need_compiler()
    seen: list[str] = []
    real = module._build

    def counted(source: str, flags: object, tuned: object) -> bytes:
        seen.append(source)
        return real(source, flags, tuned)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "_build", counted)
    return seen


def entry(folder: Path) -> Path:
    (library,) = folder.glob("*.so")
    return library


def test_the_second_time_nothing_is_compiled(builds: list[str], tmp_path: Path) -> None:
    first = shared_library(SOURCE, folder=tmp_path / "c")
    assert shared_library(SOURCE, folder=tmp_path / "c") == first
    assert len(builds) == 1
    shared_library(SOURCE, flags=("-O3",), folder=tmp_path / "c")
    shared_library(SOURCE.replace("42", "43"), folder=tmp_path / "c")
    assert len(builds) == 3


def test_a_source_with_an_identity_is_written_only_to_compile_it(builds: list[str], tmp_path: Path) -> None:
    written: list[str] = []

    def write() -> str:
        written.append(SOURCE)
        return SOURCE

    for identity, count in (("one", 1), ("one", 1), ("another", 2)):
        shared_library(write, folder=tmp_path, identity=identity)
        assert len(written) == len(builds) == count


def test_a_block_is_the_same_entry_only_with_the_same_operations_type_and_sources(
    builds: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    x = ca.SX.sym("x")
    half, third = (lower(ca.Function("part", [x], [x / k])) for k in (2, 3))
    compile_block(half)
    assert compile_block(half)([6.0]) == [3.0] and len(builds) == 1
    assert compile_block(third)([6.0]) == [2.0]
    assert compile_block(half, real="float32")([6.0]) == [3.0] and len(builds) == 3
    monkeypatch.setattr(native, "source_digest", lambda *_: "other sources")
    compile_block(half)
    assert len(builds) == 4
    monkeypatch.setattr(native, "source_digest", changed)
    for _ in range(2):
        assert compile_block(half)([6.0]) == [3.0] and len(builds) == 5  # by the C text


def changed(*_: str) -> str:
    raise SurctlError("surctl.ir was changed after this process began")


def test_another_compiler_is_another_entry(builds: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shared_library(SOURCE, folder=tmp_path)
    monkeypatch.setattr(module, "compiler_version", lambda: "another 1.0")
    shared_library(SOURCE, folder=tmp_path)
    assert len(builds) == 2


def test_other_flags_of_the_environment_are_another_entry(
    builds: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for count, flags in enumerate(("-O1", "-O2"), 1):
        monkeypatch.setenv("SURCTL_CFLAGS", flags)
        shared_library(SOURCE, folder=tmp_path)
        assert len(builds) == count


@pytest.mark.parametrize("spoil", ["flip", "empty", "cut", "note", "no note", "link", "group", "world", "open folder"])
def test_what_cannot_be_trusted_is_built_again(builds: list[str], tmp_path: Path, spoil: str) -> None:
    folder = tmp_path / "c"
    good = shared_library(SOURCE, folder=folder)
    library = entry(folder)
    whole = library.read_bytes()
    if spoil in ("flip", "note"):
        body = bytearray(whole)
        body[len(body) // 2 if spoil == "flip" else 0] ^= 1
        library.write_bytes(bytes(body))
    elif spoil == "empty":
        library.write_bytes(b"")
    elif spoil == "cut":
        library.write_bytes(whole[:-1])
    elif spoil == "no note":
        library.write_bytes(good)
    elif spoil == "link":
        library.rename(tmp_path / "elsewhere.so")
        library.symlink_to(tmp_path / "elsewhere.so")
    elif spoil in ("group", "world"):
        # somebody else could have written it, digest and all
        library.write_bytes(EVIL)
        library.chmod(0o620 if spoil == "group" else 0o602)
    else:
        folder.chmod(0o777)
        library.write_bytes(EVIL)
    with pytest.warns(CacheUnused, match="others may write") if spoil == "open folder" else nullcontext():
        assert shared_library(SOURCE, folder=folder) == good
    assert len(builds) == 2


def test_an_entry_of_another_user_is_built_again(
    builds: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared_library(SOURCE, folder=tmp_path)
    kept = entry(tmp_path).read_bytes()
    mine = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: mine + 1)
    with pytest.warns(CacheUnused, match=rf"{tmp_path} is not used: it belongs to another user.*set SURCTL_CACHE"):
        shared_library(SOURCE, folder=tmp_path)
    assert len(builds) == 2 and entry(tmp_path).read_bytes() == kept
    shared_library(SOURCE, folder=tmp_path)  # one warning a process: a second one would be an error


def test_any_bytes_are_stored_under_their_key_and_suffix(tmp_path: Path) -> None:
    entries = {("00", ".law"): b"", ("00", ".other"): b"\x00\xff", ("01", ".law"): b"third"}
    for (key, suffix), body in entries.items():
        assert cached_bytes(key, suffix, lambda body=body: body, folder=tmp_path) == body  # type: ignore[misc]
    for (key, suffix), body in entries.items():
        assert cached_bytes(key, suffix, lambda: b"built anew", folder=tmp_path) == body
    assert len(list(tmp_path.glob("*.*"))) == len(entries)


def test_what_cannot_be_built_leaves_nothing(tmp_path: Path) -> None:
    def build() -> bytes:
        raise SurctlError("no such law")

    with pytest.raises(SurctlError, match="no such law"):
        cached_bytes("00", ".law", build, folder=tmp_path / "c")
    assert not (tmp_path / "c").exists()
    assert cached_bytes("00", ".law", lambda: b"law", folder=tmp_path / "c") == b"law"


def test_processes_that_build_at_once_all_succeed(tmp_path: Path) -> None:
    """Each writes other bytes, over and over, and reads what any of them has written."""
    with PROCESSES.Pool(2) as pool:
        seen = pool.map(_written_and_read, [(tmp_path / "c", k) for k in range(4)], chunksize=1)
    assert sum(seen) > 0  # entries of another process were read, each of them whole
    assert len(list((tmp_path / "c").glob("*.law"))) == 40


def _written_and_read(task: tuple[Path, int]) -> int:
    folder, own = task
    others = 0
    for k in range(200):
        key = f"{k % 40:02x}"
        if k % 3 == 0:
            (folder / f"{key}.law").unlink(missing_ok=True)
        found = cached_bytes(key, ".law", lambda: bytes([own]) * 100_000, folder=folder)
        assert len(found) == 100_000 and len(set(found)) == 1
        others += found[0] != own
    return others


def test_of_processes_that_need_an_entry_at_once_one_builds_it_also_within_another(tmp_path: Path) -> None:
    built = tmp_path / "built"
    built.touch()
    with PROCESSES.Pool(2) as pool:
        assert set(pool.map(_slowly, [tmp_path] * 2, chunksize=1)) == {b"outer inner"}
    assert sorted(built.read_text().split()) == ["inner", "outer"]


def _slowly(folder: Path) -> bytes:
    def build(word: str, rest: bytes) -> bytes:
        with (folder / "built").open("a") as file:
            file.write(f"{word} ")
        return word.encode() + rest

    def outer() -> bytes:
        inner = cached_bytes("01", ".law", lambda: build("inner", b""), folder=folder)
        time.sleep(0.5)
        return build("outer", b" " + inner)

    (folder / f"ready {os.getpid()}").touch()
    while len(list(folder.glob("ready *"))) < 2:
        time.sleep(0.01)
    return cached_bytes("00", ".law", outer, folder=folder)


def test_an_entry_whose_owner_is_stopped_is_built_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_PATIENCE", 0.1)
    taken = PROCESSES.Event()
    owner = PROCESSES.Process(target=_taken, args=(tmp_path, taken))
    owner.start()
    taken.wait()
    assert cached_bytes("00", ".law", lambda: b"law", folder=tmp_path) == b"law"
    owner.kill()
    owner.join()


def _taken(folder: Path, taken: Event) -> None:
    with module._locked(folder, "00"):
        taken.set()
        time.sleep(100.0)


def test_without_a_place_to_write_it_works_and_leaves_nothing(builds: list[str], tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with pytest.warns(CacheUnused, match=r"cannot be written \(Not a directory\)"):
        assert shared_library(SOURCE, folder=blocked / "c") == shared_library(SOURCE, folder=blocked / "c")
    assert len(builds) == 2
    assert blocked.read_text() == "not a folder"


def test_where_the_cache_lies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    assert cache_folder() == tmp_path
    monkeypatch.delenv("SURCTL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "surctl"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the specification: ignore it
    assert cache_folder() == Path.home() / ".cache" / "surctl"


def test_a_folder_from_which_nothing_loads_is_told() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ToolMissing, match="TMPDIR"):
        Native(lower(ca.Function("twice", [x], [2 * x])), b"no library")
