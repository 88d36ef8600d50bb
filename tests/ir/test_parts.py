"""A block as C in several files: each compiles alone, together they compute what the block does."""

from __future__ import annotations

import ctypes
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Call, Loop, Program, Routine, c99_routine, lower, replay
from surctl.ir.c99_program import PRAGMA
from surctl.ir.c99_routine import emit_block, emit_parts
from surctl.ir.cache import compile_program
from tests.ir.expressions import caller
from tests.ir.routines import random_routine
from tests.tools import need_compiler

TRIED = range(1000, 1004)


def test_files_that_compile_alone_compute_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    monkeypatch.setattr(c99_routine, "_LEAST", 0)
    monkeypatch.setattr(c99_routine, "_MOST", 1500)
    routines = [random_routine(seed) for seed in TRIED]
    sources, several = list[Path](), 0
    for at, routine in enumerate(routines):
        parts = emit_parts(routine, symbol=f"f{at}")
        several += len(parts.files) > 1
        for k, text in enumerate(parts.files.values()):
            sources.append(tmp_path / f"f{at}_{k}.c")
            sources[-1].write_text("\n".join([PRAGMA, "#include <math.h>", *parts.prototypes, text]))
    assert several >= 2
    flags = ("-shared", "-fPIC", "-O0", "-Wmissing-prototypes")
    library = ctypes.CDLL(str(compile_program(sources, tmp_path / "all.so", flags=flags)))
    for at, routine in enumerate(routines):
        native, rng = caller(getattr(library, f"f{at}"), routine), np.random.default_rng(at)
        inputs = [np.round(rng.normal(size=size), 3) for _, size in routine.inputs]
        want, have = replay(routine, *inputs), native(*inputs)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(have, want, strict=True)), routine.text()


def chain(name: str, operations: int) -> Program:
    x = ca.SX.sym("x", 1)
    y = 0.3 * x
    for k in range(operations):
        y = y * x + k
    return lower(ca.Function(name, [x], [y]))


def looped(name: str, inner: Program) -> Routine:
    return Routine(name, (("x", 1),), (Loop(inner, 3, ("x",), ("last",)),), ("last",))


def test_what_one_function_alone_calls_stands_with_it_and_what_two_call_with_the_first() -> None:
    """Sums of 15 characters an operation: the map is 33 kB, the rest 42."""
    shared = chain("shared", 60)
    cells = Routine(
        "cells",
        (("x", 1),),
        (Loop(chain("draw", 1100), 3, ("x",), ("drawn",)), Call(shared, ("drawn",), ("seen",))),
        ("seen",),
    )
    law = looped("law", chain("steer", 1300))
    steps = (Call(cells, ("x",), ("a",)), Call(shared, ("a",), ("b",)), Call(law, ("b",), ("c",)))
    parts = emit_parts(Routine("law", (("x", 1),), steps, ("c",)), symbol="robot_law")
    assert list(parts.files) == ["", "cells"]
    assert re.findall(r"^(.*?void \w+)\(", parts.files["cells"], flags=re.MULTILINE) == [
        "static void robot_law_draw",
        "void robot_law_cells",
    ]
    assert [re.findall(r"\w+(?=\()", text)[0] for text in parts.prototypes] == [
        "robot_law_shared",
        "robot_law_cells",
        "robot_law",
    ]
    assert "static void robot_law_steer(" in parts.files[""] and "\nvoid robot_law_shared(" in parts.files[""]


def test_a_small_block_stays_whole_and_is_that_of_emit_block() -> None:
    block = looped("dive", chain("sink", 3))
    parts = emit_parts(block, symbol="law")
    assert list(parts.files) == [""]
    whole = emit_block(block, symbol="law")
    assert whole == f"{PRAGMA}\n\n" + parts.files[""].replace("\nvoid law(", "\nstatic void law(")
