"""Arrays that share memory: whatever a routine hands on, joins or changes in place, its numbers are the replay's."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from surctl.ir import Call, Loop, Program, Routine, c99_routine, lower, memory, replay
from surctl.ir.c99_routine import emit_block
from surctl.ir.routine import Gather, Step
from tests.ir.expressions import compiled
from tests.ir.routines import random_routine
from tests.tools import need_compiler

COUNT = 9  # of each variant; every variant has routines of its own


@pytest.mark.parametrize(("first", "few"), [(0, 8), (COUNT, 8), (2 * COUNT, 0)])
def test_random_routines_bit_for_bit_and_their_inputs_stay(
    tmp_path: Path, first: int, few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_compiler()
    monkeypatch.setattr(c99_routine, "_FEW", few)  # 0: no array is so small that what a loop leaves is copied
    wrong = []
    routines = [random_routine(seed) for seed in range(first, first + COUNT)]
    natives = compiled(routines, tmp_path, flags=("-O1",))
    for seed, (routine, native) in enumerate(zip(routines, natives, strict=True), first):
        rng = np.random.default_rng(seed)
        for _ in range(3):
            inputs = [np.round(rng.normal(size=size), 3) for _, size in routine.inputs]
            kept = [x.copy() for x in inputs]
            want, have = replay(routine, *inputs), native(*inputs)
            same = all(a.tobytes() == b.tobytes() for a, b in zip([*have, *inputs], [*want, *kept], strict=True))
            if not same:
                wrong.append(seed)
    assert not wrong, f"{len(wrong)}: {random_routine(wrong[0]).text()}"


def mixed(name: str, *sizes: int) -> Program:
    """An array of every size, each number out of the first input's first and last."""
    x = ca.SX.sym("x", sizes[0])
    return lower(ca.Function(name, [x], [ca.vertcat(*(x[0] * k + x[-1] for k in range(n))) for n in sizes[1:]]))


def moved(name: str, sizes: Sequence[int], make: Callable[..., list[ca.SX]]) -> Program:
    x = [ca.SX.sym(f"x{k}", size) for k, size in enumerate(sizes)]
    return lower(ca.Function(name, x, make(*x)))


SPLIT = moved("split", [100], lambda x: [x[:40], x[40:]])
HEAD = moved("head", [40], lambda x: [x[:30]])
ENDS = moved("ends", [40], lambda a: [a[0] + a[-1]])
JOIN = moved("join", [40, 60], lambda a, b: [ca.vertcat(a, b)])
TURN = moved("turn", [40], lambda a: [2.5 * a])

KEPT = {
    "a piece is a pointer": (
        100,
        (Call(SPLIT, ("x",), ("p", "q")), Call(mixed("m", 60, 7), ("q",), ("y",))),
        "y",
        0,
    ),
    "what is joined is written where it stands": (
        3,
        (Call(mixed("m", 3, 40, 60), ("x",), ("p", "q")), Call(JOIN, ("p", "q"), ("y",))),
        "y",
        0,
    ),
    "a loop changes the piece of a join in place": (
        3,
        (
            Call(mixed("m", 3, 40, 60), ("x",), ("p", "q")),
            Loop(TURN, 5, ("p",), ("r",)),
            Call(JOIN, ("r", "q"), ("y",)),
        ),
        "y",
        0,
    ),
    "one loop after the other changes it in place": (
        3,
        (Call(mixed("m", 3, 40), ("x",), ("p",)), Loop(TURN, 5, ("p",), ("r",)), Loop(TURN, 2, ("r",), ("y",))),
        "y",
        0,
    ),
    "an array of another name is written where that stands": (
        3,
        (Call(mixed("m", 3, 40), ("x",), ("p",)), Call(moved("copy", [40], lambda a: [a]), ("p",), ("y",))),
        "y",
        0,
    ),
    "what a loop starts from stands where it is joined": (
        3,
        (
            Call(mixed("m", 3, 40, 60), ("x",), ("p", "q")),
            Loop(TURN, 5, ("p",), ("r",)),
            Call(moved("three", [40, 60, 40], lambda a, b, c: [ca.vertcat(a, b, c)]), ("p", "q", "r"), ("y",)),
        ),
        "y",
        0,
    ),
    "an array that is still read is not changed": (
        3,
        (
            Call(mixed("m", 3, 100), ("x",), ("w",)),
            Call(SPLIT, ("w",), ("p", "q")),
            Loop(TURN, 5, ("p",), ("r",)),
            Call(JOIN, ("r", "q"), ("y",)),
        ),
        "y",
        100,
    ),
}


@pytest.mark.parametrize("case", KEPT)
def test_memory_is_kept_only_where_a_number_would_be_lost(case: str) -> None:
    size, steps, result, own = KEPT[case]
    routine = Routine("r", (("x", size),), steps, (result,))
    assert memory(routine) == size + routine.sizes()[result] + own
    text = emit_block(routine, symbol="f").split("static void f(")[1]
    assert sum(int(n) for n in re.findall(r"double \w+\[(\d+)\];", text)) == own


def test_what_a_loop_carries_is_its_result_in_one_array() -> None:
    """The body writes its result over what it was given, and keeps that only while it is read."""
    piece = Routine("body", (("a", 40),), (Loop(TURN, 3, ("a",), ("b",)),), ("b",))
    assert memory(Routine("r", (("x", 40),), (Loop(piece, 2, ("x",), ("y",)),), ("y",))) == 80
    steps: tuple[Step, ...] = (
        Call(SPLIT, ("s",), ("p", "q")),
        Call(mixed("m", 100, 60), ("a",), ("t",)),
        Call(mixed("n", 60, 60), ("t",), ("u",)),
        Call(JOIN, ("p", "u"), ("c",)),
    )
    late = Routine("body", (("a", 100), ("s", 100)), steps, ("c",))
    routine = Routine("r", (("x", 100), ("s", 100)), (Loop(late, 2, ("x",), ("y",), fixed=("s",)),), ("y",))
    assert memory(routine) == 300 + 60
    add = moved("add", [40, 40], lambda a, b: [a[::-1] + b])
    steps = (Loop(TURN, 3, ("a",), ("b",)), Call(add, ("a", "b"), ("c",)))
    both = Routine("body", (("a", 40),), steps, ("c",))
    assert memory(Routine("r", (("x", 40),), (Loop(both, 2, ("x",), ("y",)),), ("y",))) == 80 + 80


def stays(how: str) -> Routine:
    """A loop of one turn at most, with a flag, over an input; what comes out is read in every way that there is."""
    done = ca.SX.sym("done")
    double = moved("double", [40], lambda a: [2.5 * a[::-1]])
    raised = lower(ca.Function("raised", [done], [ca.SX.ones(1)]))
    turn = Routine(
        "turn",
        (("a", 40), ("done", 1)),
        (Call(double, ("a",), ("b",)), Call(raised, ("done",), ("yes",))),
        ("b", "yes"),
    )
    plus = moved("plus", [1, 10, 40], lambda s, a, b: [s + a[3] - b[7]])
    again = Loop(TURN, 2, ("now",), ("turned",))
    steps: tuple[Step, ...] = (
        Loop(turn, 1, ("x", "flag"), ("now", "known"), until=1),
        *([] if how == "changed in place" else [again]),
        Call(ENDS, ("now",), ("s",)),
        Loop(plus, 4, ("s",), ("sum",), sliced=("now",), fixed=("now",)),
        Gather("now", "sum", 5, "piece"),
        *([again] if how == "changed in place" else []),
        *([Call(HEAD, ("now",), ("p",))] if how == "cut" else []),
        Call(ENDS, ("turned",), ("t",)),
    )
    results = ("sum", "piece", "t", *(("p",) if how == "cut" else ()))
    return Routine("r", (("x", 40), ("flag", 1)), steps, results)


@pytest.mark.parametrize("how", ["read", "cut", "changed in place"])
def test_an_input_that_a_flagged_loop_leaves_is_only_read_where_it_stands(tmp_path: Path, how: str) -> None:
    need_compiler()
    routine = stays(how)
    (native,) = compiled([routine], tmp_path, flags=("-O1",))
    x = np.random.default_rng(3).normal(size=40)
    for flag in (0.0, 1.0, np.nan):
        kept = x.copy()
        want, have = replay(routine, x, np.array([flag])), native(x, np.array([flag]))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(have, want, strict=True))
        assert x.tobytes() == kept.tobytes()
    text = emit_block(routine, symbol="f").split("static void f(")[1]
    assert ("_now = in0;" in text) is (how == "read")  # it is copied where others have to find it, or change it


def written_early() -> Routine:
    """The state's memory is that of an array that is written before the state is read for the last time."""
    add = moved("add", [40, 40], lambda a, b: [a[::-1] + b])
    steps = (Call(mixed("m", 40, 40), ("s",), ("x",)), Call(add, ("a", "x"), ("c",)), Loop(TURN, 3, ("x",), ("z",)))
    body = Routine("body", (("a", 40), ("s", 40)), steps, ("z", "c"))
    loop = Loop(body, 2, ("x",), ("x_last", "c"), fixed=("s",))
    return Routine("r", (("x", 40), ("s", 40)), (loop,), ("x_last", "c"))


def one_body_twice(read: str, *, index_first: bool) -> Routine:
    """The same body carries its first input in one loop, and its second in another; one is read after the result."""
    less = moved("less", [1, 1], lambda p, q: [q - 3 * p])
    more = moved("more", [1], lambda s: [2.5 * s])
    steps = (Call(less, ("p", "q"), ("s",)), Call(more, ("s",), ("r",)), Call(less, (read, "s"), ("c",)))
    body = Routine("body", (("p", 1), ("q", 1)), steps, ("r", "c"))
    loops = (
        Loop(body, 3, ("x",), ("y", "c"), index=True),
        Loop(body, 3, ("x",), ("z", "d"), fixed=("f",)),
    )
    inputs = (("x", 1), ("f", 1))
    return Routine("r", inputs, loops if index_first else loops[::-1], ("y", "c", "z", "d"))


def views_outlive() -> Routine:
    """An array is changed by a loop while pieces of it, and of what it is joined into, are still read."""
    add = moved("add", [40, 40], lambda a, b: [a[::-1] + b])
    steps = (
        Call(mixed("m", 3, 100), ("x",), ("w",)),
        Call(SPLIT, ("w",), ("p", "q")),
        Loop(moved("turn_all", [100], lambda a: [2.5 * a[::-1]]), 3, ("w",), ("v",)),
        Call(SPLIT, ("v",), ("s", "t")),
        Call(add, ("p", "s"), ("y",)),
        Call(mixed("n", 3, 40, 60), ("x",), ("g", "h")),
        Call(JOIN, ("g", "h"), ("j",)),
        Loop(moved("turn_all", [100], lambda a: [2.5 * a[::-1]]), 3, ("j",), ("k",), fixed=()),
        Call(add, ("g", "y"), ("z",)),
        Call(mixed("o", 3, 100), ("x",), ("e",)),
        Call(SPLIT, ("e",), ("e_p", "e_q")),
        Loop(moved("with", [100, 40], lambda a, b: [a[::-1] + b[0]]), 3, ("e",), ("e_last",), fixed=("e_p",)),
    )
    return Routine("r", (("x", 3),), steps, ("y", "z", "k", "e_last"))


def test_what_is_still_read_is_not_written_over(tmp_path: Path) -> None:
    need_compiler()
    routines = [written_early(), views_outlive()]
    routines += [one_body_twice(read, index_first=first) for read in "pq" for first in (False, True)]
    natives = compiled(routines, tmp_path, flags=("-O1",))
    for routine, native in zip(routines, natives, strict=True):
        inputs = [np.random.default_rng(3).normal(size=size) for _, size in routine.inputs]
        for have, want in zip(native(*inputs), replay(routine, *inputs), strict=True):
            np.testing.assert_array_equal(have, want, err_msg=routine.text())
