"""Instruction lists with one wrong word, each of which would be a list if that word were not compared."""

from __future__ import annotations

import numpy as np
import pytest

from surctl.certcheck.document import Rejected
from surctl.certcheck.instructions import evaluate, read_list

SQUARE = "program sq\nin0 x 1\nv0 = in0[0]\nv1 = sq v0\nout0 y v1\n"
CALL = "routine r\nin a 2\nin b 1\nc = call {0} b\nout c\n"
GATHER = "routine g\nin a 4\nin at 1\nc = gather a at width 2 lanes 1\nout c\n"
BODY = """program body
in0 s 1
in1 t 1
in2 a 1
in3 b 1
v0 = in0[0]
v1 = in1[0]
v2 = in2[0]
v3 = in3[0]
v4 = add v0 v2
v5 = add v1 v3
out0 s v4
out1 t v5
"""
LOOP = """routine l
in s 2
in t 2
in a 6
in b 6
u v = loop {0} count 3 index 0 until None carried s t sliced a fixed spread b lanes 2
out u v
"""
UNTIL = (
    "routine l\nin s 1\nin t 1\nu = loop {0} count 3 index 0 until 0 carried s sliced fixed t spread lanes 1\nout u\n"
)
STEP = "program step\nin0 s 1\nin1 t 1\nv0 = in0[0]\nv1 = in1[0]\nv2 = add v0 v1\nout0 s v2\n"
NUMBERS = "program k\nv0 = const 0x1.8000000000000p+1\nv1 = const 0x1.0000000000000p+0\nout0 y v0 v1\n"


def listing(routine: str, *programs: str) -> str:
    return "\n".join([*programs, routine.format(*(read_list(program).key for program in programs))])


@pytest.mark.parametrize(
    ("old", "new"),
    [("v0 =", "v1 ="), ("v0 =", "v0 :="), ("sq v0", "sq v0 v0"), ("sq v0", "sq v1"), ("in0[0]", "in0[0] v0"),
     ("in0[0]", "in0[1]"), ("in0[0]", "in1[0]"), ("in0[0]", "in0[x]"), ("out0", "out1"), ("program sq", "prog sq"),
     ("program sq", "program a b"), ("program sq", "program "), ("x 1", "x 1.0"), ("x 1", "x 1_0"), ("x 1", "x ١"),
     ("x 1", "x 60001"), ("in0[0]", "const nan"), ("in0[0]", "const 0x1p0"), ("out0 y v1\n", "out0 y v1\nmore")],
)  # fmt: skip
def test_a_program_with_a_wrong_word(old: str, new: str) -> None:
    read_list(SQUARE)
    with pytest.raises(Rejected, match="not an instruction list"):
        read_list(SQUARE.replace(old, new, 1))


@pytest.mark.parametrize(
    ("routine", "program", "old", "new"),
    [(CALL, SQUARE, "out c", "outs c"), (CALL, SQUARE, "in a 2", "in b 1"),
     (CALL, SQUARE, "c = call {0} b\nout c", "a = call {0} b\nout a"),

     (CALL, SQUARE, "c = call", "c d = call"), (CALL, SQUARE, "{0} b", "{0} a"),
     *((GATHER, "", old, new) for old, new in (
         ("width 2", "wide 2"), ("lanes 1", "lane 1"), ("in at 1", "in at 2"), ("in a 4", "in a 3"),
         ("width 2", "width 4000"), ("lanes 1", "lanes 65"))),
     *((LOOP, BODY, f"in {name} {size}", f"in {name} {size + 1}") for name, size in
       (("s", 2), ("t", 2), ("a", 6), ("b", 6))),
     (LOOP, BODY, "in a 6", "in a 12"), (LOOP, BODY, "until None", "until 0"), (LOOP, BODY, "index 0", "index 1"),
     (LOOP, BODY.replace("out0 s v4", "out0 s v4 v4"), "", ""),
     (UNTIL, STEP, "until 0", "until 1"), (UNTIL, f"{STEP}out1 more v2\n", "u =", "u w ="),
     (UNTIL, STEP.replace("in0 s 1", "in0 s 2").replace("out0 s v2", "out0 s v2 v2"), "in s 1", "in s 2")],
)  # fmt: skip
def test_a_routine_with_a_wrong_word(routine: str, program: str, old: str, new: str) -> None:
    programs = [program] if program else []
    good = {CALL: SQUARE, LOOP: BODY, UNTIL: STEP}.get(routine)
    read_list(listing(routine, *[good] if good else []))
    with pytest.raises(Rejected, match="not an instruction list"):
        read_list(listing(routine.replace(old, new, 1), *programs))


def test_a_list_is_not_too_large() -> None:
    with pytest.raises(Rejected, match="more than 60000 numbers"):
        read_list("routine r\nin a 60000\nin b 1\nout a\n")
    loop = "loop {0} count 60000 index 0 until None carried s sliced fixed spread lanes 1"
    repeat = f"routine {{1}}\nin s 1\nu = {loop}\nout u\n"
    once = f"{SQUARE}\n{repeat.format(read_list(SQUARE).key, 'once')}"
    with pytest.raises(Rejected, match="twice is too large"):
        read_list(f"{once}\n{repeat.format(read_list(once).key, 'twice')}")
    text = SQUARE
    for depth in range(2, 52):
        deeper = f"{text}\nroutine r{depth}\nin a 1\nb = call {read_list(text).key} a\nout b\n"
        if depth == 51:
            with pytest.raises(Rejected, match="r51 is too large"):
                read_list(deeper)
        text = deeper


def test_the_vectors_have_the_sizes_of_the_list() -> None:
    block = read_list(listing(CALL, SQUARE))
    assert evaluate(block, np.ones((2, 3)), 2 * np.ones((1, 3)))[0].tolist() == [[4, 4, 4]]
    for vectors in ([np.ones((2, 3)), np.ones((2, 3))], [np.ones((2, 3))], [np.ones((2, 3))] * 3):
        with pytest.raises(Rejected, match="takes vectors of"):
            evaluate(block, *vectors)


@pytest.mark.parametrize(
    ("routine", "expected"),
    [("d = gather c b width 1 lanes 1", [[3, 1, 1]]), ("k = call {1} b\nd = gather k b width 1 lanes 1", [[0, 1, 4]]),
     ("e f = call {2} c\nd = gather x f width 1 lanes 1", [[1, 2, 3]]), ("d = call {3} c b", [[3, 4, 5]]),
     ("e f = call {2} c\n"
      "u d = loop {4} count 2 index 0 until None carried f sliced fixed b spread lanes 1", [[1, 1, 1], [1, 2, 3]])],
)  # fmt: skip
def test_numbers_of_a_list_are_the_same_at_all_points(routine: str, expected: list[list[float]]) -> None:
    """A block without inputs computes one number, which goes with the numbers of all points."""
    pair = "program p\nin0 k 2\nv0 = in0[0]\nv1 = in0[1]\nout0 e v0\nout1 f v1\n"
    both = "program s\nin0 k 2\nin1 b 1\nv0 = in0[0]\nv1 = in1[0]\nv2 = add v0 v1\nout0 y v2\n"
    body = listing("routine body\nin s 1\nin b 1\nt = call {0} s b\nout t s\n", STEP)
    programs = [NUMBERS, SQUARE, pair, both, body]
    used = [NUMBERS, *(p for k, p in enumerate(programs[1:], 1) if f"{{{k}}}" in routine)]
    keys = [read_list(program).key for program in programs]
    text = f"routine r\nin x 2\nin b 1\nc = call {{0}}\n{routine}\nout d\n".format(*keys)
    x, b = np.array([[7.0, 8.0, 9.0], [1.0, 2.0, 3.0]]), np.array([[0.0, 1.0, 2.0]])
    assert evaluate(read_list("\n".join([*used, text])), x, b)[0].tolist() == expected


PROCEDURE = "procedure p\nin x 1\nout y 1\nsize n 2\nwhole k 0\ndef f(s):\n    s.k = s.n\n    s.y[0] = s.k * s.x[0]\n"


def test_the_memory_of_a_procedure_is_declared() -> None:
    assert evaluate(read_list(PROCEDURE), np.array([[1.5, 2.0]]))[0].tolist() == [[3.0, 4.0]]
    for bad in ("", "hole k 0\n", "whole k -1\n", "note 1 2\nwhole k 0\n"):
        with pytest.raises(Rejected, match="not an instruction list"):
            read_list(PROCEDURE.replace("whole k 0\n", bad))
