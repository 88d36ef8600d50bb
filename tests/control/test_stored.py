"""A built law on disk: what is read is what was written, and nothing that another configuration or source made."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import SurctlError
from surctl.ir import replay
from surctl.ir.c99_routine import emit_parts
from surctl.marine.control import build, build_law, load_gains
from surctl.marine.control.build import law_bytes, law_from
from surctl.marine.control.law import Law
from surctl.marine.sensing import Equipment, SonarArray
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.vehicle import load_vehicle

CASES = [
    {"law": "closed_form"},
    {"guidance": "ilos", "barrier": "inertia", "movers": "barrier", "contacts": 3},
    {"law": "paper", "avoidance": "printed"},
    {"mode": "projected", "fallback": "bounded", "contacts": 1},
    {"law": "paper", "sonar": True, "equipment": Equipment(own=None)},
]


@pytest.mark.parametrize("options", CASES, ids=str)
def test_what_is_read_is_what_was_written(options: dict[str, object]) -> None:
    law = build_law(**options)  # type: ignore[arg-type]
    needed = ("closed",) if law.mode == "nsb" else ("pre", "post")
    expected = {name: getattr(law.stages, name) for name in needed}
    read = law_from(law_bytes(law), lambda name: pytest.fail(f"{name} is not stored"))
    for name in ("name", "avoidance", "mode", "dt", "levels", "rows", "guidance", "barrier", "movers", "fallback"):
        assert getattr(read, name) == getattr(law, name), name
    layouts = [(read, law, ("state", "inputs", "gains", "outputs"))]
    if law.perception is not None and read.perception is not None:
        layouts.append((read.perception, law.perception, ("state", "inputs", "outputs")))  # type: ignore[arg-type]
    assert (read.perception is None) == (law.perception is None)
    for a, b, names in layouts:
        for name in names:
            assert getattr(a, name).ports == getattr(b, name).ports, name
    pairs = [
        (read.block, law.block),
        *((getattr(read.stages, name), block) for name, block in expected.items()),
    ]
    assert all(a.digest() == b.digest() and a is not b for a, b in pairs)
    if law.perception is not None and read.perception is not None:
        assert read.perception.block.digest() == law.perception.block.digest()
    x, u = law.initial_state(), law.inputs.pack()
    p = law_numbers(load_scenario("pool-behind"), load_gains("default"), load_vehicle("sur400"))
    assert emit_parts(read.block, symbol="law", real="float64") == emit_parts(law.block, symbol="law", real="float64")
    for a, b in zip(replay(read.block, x, u, p), replay(law.block, x, u, p), strict=True):
        np.testing.assert_array_equal(a, b)


def count_builds(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Configurations that are built, as they come; each call is a process of its own to the cache in memory."""
    built: list[object] = []
    real = build._built

    def counted(chosen: object) -> Law:
        built.append(chosen)
        return real(chosen)  # type: ignore[arg-type]

    monkeypatch.setattr(build, "_built", counted)
    monkeypatch.setattr(build, "_cached_law", build._cached_law.__wrapped__)
    return built


def test_a_law_is_built_once_whatever_its_arguments_are_spelt_like(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    built = count_builds(monkeypatch)
    laws = [
        build_law("closed_form"),
        build_law("closed_form", mode="nsb"),
        build_law(law="closed_form", dt=0.05, contacts=8),
    ]
    assert len(built) == 1 and len({law.block.digest() for law in laws}) == 1
    build_law("closed_form", dt=0.1)
    assert len(built) == 2 and len(list(tmp_path.glob("*.law"))) == 2


def test_every_number_of_the_equipment_tells_laws_apart() -> None:
    def told(**changed: float) -> str:
        return repr(Equipment(array=SonarArray(**changed)))

    for name, value in {"noise_sd": 0.02, "bias": 0.01, "maximum": 4.0}.items():
        assert told(**{name: value}) != told(), name


def test_a_stage_that_the_mode_does_not_need_is_built_when_it_is_first_used_and_stored(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    built = count_builds(monkeypatch)
    own = build_law("closed_form").stages.pre.digest()
    assert {path.suffix for path in tmp_path.glob("*.*")} == {".law"}
    for count in (2, 2):
        law = build_law("closed_form")
        assert law.stages.closed and law.stages.pre.digest() == own and len(built) == count
    assert {path.suffix for path in tmp_path.glob("*.*")} == {".law", ".pre"}


def test_other_sources_make_another_law(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    built = count_builds(monkeypatch)
    build_law("closed_form")
    monkeypatch.setattr(build, "source_digest", lambda *_: "another")
    build_law("closed_form")
    assert len(built) == 2


def test_sources_that_changed_under_the_process_leave_the_cache_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def changed(*_: str) -> str:
        raise SurctlError("surctl.marine.control changed since this process began")

    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "source_digest", changed)
    monkeypatch.setattr(build, "_cached_law", build._cached_law.__wrapped__)
    assert build_law("closed_form").name == "surctl_closed_form" and not list(tmp_path.iterdir())


def test_an_altered_entry_is_built_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SURCTL_CACHE", str(tmp_path))
    built = count_builds(monkeypatch)
    digest = build_law("closed_form").block.digest()
    (entry,) = tmp_path.glob("*.law")
    body = entry.read_bytes()
    entry.write_bytes(body.replace(b"0x1.", b"0x2.", 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert build_law("closed_form").block.digest() == digest
    assert len(built) == 2 and entry.read_bytes() == body
