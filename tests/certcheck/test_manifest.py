"""The manifest of a small bundle with one false entry, and its folder with one file too many or too few."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import bundle
from surctl.certcheck.bundle import manifest_seal, read_bundle, read_manifest
from surctl.errors import InputError
from surctl.export.bundle import build_bundle
from tests.certcheck.test_bundle import loop, parts

NOT_ITS_ID = "the id does not match law, ports, period, precision, gains and initial state"


@cache
def files() -> dict[str, str]:
    law = loop().controller
    return dict(build_bundle(law, law.gains.unpack(law.gains.pack())).files)


def table() -> dict[str, Any]:
    return dict(json.loads(files()["manifest.json"]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in files().items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def rewritten(folder: Path, **changes: Any) -> Path:
    """The folder with a changed manifest, sealed again."""
    changed = table() | changes
    (folder / "manifest.json").write_text(json.dumps(changed | {"seal": manifest_seal(changed)}))
    return folder


def refuses(says: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(InputError, match=says):
        call(*words)


def test_every_listed_file_is_compared(folder: Path) -> None:
    assert read_bundle(folder).wrong == ()
    names = list(table()["sha256"])
    for name in names:
        (folder / name).write_text(files()[name] + " ")
    assert read_bundle(folder).wrong == tuple(f"{name} was altered" for name in names)
    for name in names:
        (folder / name).unlink()
    assert read_bundle(folder).wrong == tuple(f"{name} is missing" for name in names)


def test_what_is_a_link_is_not_missing_too(folder: Path) -> None:
    names = list(table()["sha256"])[:3]
    for name in names:
        (folder / name).unlink()
        (folder / name).symlink_to("/dev/zero")
    assert sorted(read_bundle(folder).wrong) == sorted(f"{name} is a link" for name in names)


def test_an_entry_of_the_folder_that_is_no_file_of_the_export(folder: Path) -> None:
    for name in ("a.txt", "z.txt", "deeper/a.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("")
        assert read_bundle(folder).wrong == (
            f"{name} is not part of the export: remove it, or build in another folder",
        )
        (folder / name).unlink()
    (folder / "z.o").write_text("")
    assert read_bundle(folder).extra == ("z.o",)


def test_the_manifest_lists_the_source_and_the_law(folder: Path) -> None:
    stated = table()["sha256"]
    for name in (f"{table()['name']}.c", "law.txt"):
        wrong = read_bundle(rewritten(folder, sha256={k: v for k, v in stated.items() if k != name})).wrong
        assert f"the manifest does not list {name}" in wrong


def test_names_order_and_units_of_the_ports_are_part_of_the_ids(folder: Path) -> None:
    law = table()["lists"]["law.txt"]
    for vector, ports in law.items():
        for k, port in enumerate(ports if vector in ("inputs", "gains", "commands") else ()):
            lists = table()["lists"] | {"law.txt": law | {vector: [*ports[:k], f"{port} other", *ports[k + 1 :]]}}
            wrong = read_bundle(rewritten(folder, lists=lists)).wrong
            assert NOT_ITS_ID in wrong
            assert "the stated id of law and gains is wrong" in wrong


@pytest.mark.parametrize("name", ["../a", "a/..", "a/../b", ".a", "a/.b", "/a", "a//b", "a/", "ä", "a b"])
def test_a_listed_name_does_not_lead_out_of_the_folder(folder: Path, name: str) -> None:
    refuses("is not the manifest", read_bundle, rewritten(folder, sha256={**table()["sha256"], name: "0" * 64}))


def test_a_manifest_that_was_changed(folder: Path) -> None:
    changed = table() | {"dt_s": 0.5}
    (folder / "manifest.json").write_text(json.dumps(changed))
    assert "the manifest was altered: its seal does not match" in read_bundle(folder).wrong
    other = "0" * 64
    assert (
        f"{table()['name']}.c returns an id that is not the manifest's"
        in read_bundle(rewritten(folder, id=other)).wrong
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [('{"a": NaN}', "NaN is not a JSON number"), ('{"a": 1e999}', "it is too large for a double"),
     ('{"a": 1, "a": 1}', "the key 'a' occurs 2 times"), ("{", "is not JSON"), ("[1]", "is not the manifest"),
     ('{"gains": 1, "seal": 1}', "format_version = 'none'"), ('{"gains": 1, "format_version": 1}', "reads format"),
     ("{}", "is not the manifest")],
)  # fmt: skip
def test_what_is_no_manifest(folder: Path, text: str, says: str) -> None:
    (folder / "manifest.json").write_text(text)
    refuses(says, read_bundle, folder)


def test_folders_are_limited(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuses("cannot be read", read_bundle, folder / "none")
    deep = folder / "/".join("abcdefg")
    deep.mkdir(parents=True)
    refuses("has more than 6 folders inside one another", read_bundle, folder)
    deep.rmdir()
    read_bundle(folder)
    monkeypatch.setattr(bundle, "_MOST", 3)
    refuses("has more than 3 files", read_bundle, folder)


# entries


def wrong(change: Callable[[dict[str, Any]], Any]) -> tuple[str, ...]:
    text, own = parts(())
    changed = json.loads(text)
    change(changed)
    return read_manifest(changed, own).wrong


def renamed(t: dict[str, Any]) -> None:
    t["lists"]["law.txt"]["gains"][0] = t["lists"]["law.txt"]["gains"][0].replace("[", "_[")


def begun(t: dict[str, Any]) -> None:
    t["lists"]["law.txt"]["initial_state"][0] = 7.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t["vehicle"]["values"].update(m11=1.0), "the stated hash of the vehicle is wrong"),
        (lambda t: t["vehicle"].update(sha256="0" * 64), "the stated hash of the vehicle is wrong"),
        (lambda t: t["gains"].update(id="00000000"), "the stated id of law and gains is wrong"),
        (lambda t: t["gains"].update(sha256="0" * 64), "the stated hash of the gains is wrong"),
        (lambda t: t.update(id="0" * 64), NOT_ITS_ID),
        (lambda t: t["law"].update(sha256="0" * 64), "the digest of the law is not that of law.txt"),
        (lambda t: t["lists"]["law.txt"].update(sha256="0" * 64), "the stated digest of law.txt is wrong"),
        (renamed, "the gains are not those of law.txt"),
        (begun, "the stated hash of the initial state is wrong"),
    ],
)
def test_a_false_entry_is_named(change: Callable[[dict[str, Any]], Any], says: str) -> None:
    assert wrong(lambda _: None) == ()
    assert says in wrong(change)


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.update(dt_s=True),
        lambda t: t.update(dt_s="0.05"),
        lambda t: t.update(name=3, id=3),
        lambda t: t["vehicle"]["ranges"].update(m11=[2.0, 1.0]),
        lambda t: t["gains"]["values"][0].update(values="12"),
        lambda t: t["lists"]["law.txt"]["gains"].append("k"),
        lambda t: t["lists"]["law.txt"]["initial_state"].append(1.0),
    ],
)
def test_an_entry_of_another_form_is_refused(change: Callable[[dict[str, Any]], Any]) -> None:
    refuses("is not the manifest of an export", wrong, change)


def test_numbers_texts_rows_ports_and_ranges() -> None:
    assert bundle._number(2) == 2.0 and bundle._numbers([1, 2.5]) == (1.0, 2.5) and bundle._text("a") == "a"
    for value in (True, "1", None, float("nan"), float("inf")):
        with pytest.raises(TypeError):
            bundle._number(value)
    for value in ("12", {1: 2}, 3):
        with pytest.raises(TypeError):
            bundle._numbers(value)
    with pytest.raises(TypeError):
        bundle._text(3)
    assert bundle._row([1, 2], 2) == (1.0, 2.0) and bundle._row(3, 2) == (3.0, 3.0)
    with pytest.raises(ValueError, match="another number of values"):
        bundle._row([1, 2], 3)
    for text in ("k", "k[x] m", "k[1]", "k[12345678] m", "k l[1] m", "k[１] m", "κ[1] m"):
        with pytest.raises(ValueError):
            bundle._port(text)
    assert bundle._ranges(None) is None and bundle._ranges({"a": [1, 1]}) == {"a": (1.0, 1.0)}
    for ranges in ({"a": [2, 1], "b": [1, 2]}, {"a": [1, 2], "b": [2, 1]}, {"a": [2, 1]}):
        with pytest.raises(ValueError, match="exceeds its upper end"):
            bundle._ranges(ranges)


@pytest.mark.parametrize(("real", "kind"), [("float64", "<f8"), ("float32", "<f4")])
def test_the_id_of_the_gains_is_the_checksum_of_what_the_robot_stores(real: str, kind: str) -> None:
    words, numbers = ("law", "ports", "0.05", real, "state"), [0.1, -3.0, 1e-9]
    key = hashlib.sha256("\n".join(words).encode()).digest()[:8]
    width = np.dtype(kind).itemsize
    head = b"SURG" + bytes([1, 0, width, 0, 3, 0, 0, 0])
    stored = head + key + np.array(numbers).astype(kind).tobytes()
    assert bundle._gains_id(words, numbers, real) == f"{zlib.crc32(stored):08x}"
