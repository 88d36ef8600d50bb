"""Blocks on disk: what is read is what was written, and nothing else is read."""

from __future__ import annotations

import gc
import hashlib
import math
import re
import time
from collections.abc import Callable

import casadi as ca
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.ir import Block, Call, Gather, Instruction, Loop, Program, Routine, lower
from surctl.ir.c99_routine import emit_block
from surctl.ir.program import OPERATIONS
from surctl.ir.routine import nested
from surctl.ir.stored import read_block, write_block
from surctl.marine.control import build_law
from tests.ir.expressions import EXACT, grown, picks
from tests.ir.routines import random_routine
from tests.ir.test_routine import grid, growth


def halve(name: str = "halve") -> Program:
    x = ca.SX.sym("x")
    return lower(ca.Function(name, [x], [x / 2], ["x"], ["y"]))


def everything() -> Program:
    """Each operation once, on inputs and on the odd constants."""
    code = [Instruction("input", (k, e)) for k, e in ((0, 0), (0, 2), (2, 0))]
    numbers = (0.1, -0.0, 0.0, math.inf, -math.inf, 5e-324, 1.7976931348623157e308)
    code += [Instruction("const", (), value) for value in numbers]
    code += [Instruction(op.name, tuple(range(op.arity))) for op in OPERATIONS.values()]
    last = len(code) - 1
    outputs = (("all", len(code)), ("none", 0), ("one", 1))
    return Program(
        "everything", (("x", 3), ("unused", 0), ("y", 1)), outputs, tuple(code), (tuple(range(last + 1)), (), (last,))
    )


def every_step() -> Routine:
    """Calls, gathers and each field of a loop, over programs of which two are run twice."""
    x, y, flag, k = (ca.SX.sym(name) for name in ("x", "y", "flag", "k"))
    both = lower(ca.Function("both", [x, y], [x + y, x - y]))
    lane = lower(ca.Function("lane", [k, x, y, flag], [x + k, y * flag]))
    last = lower(ca.Function("last", [x, flag], [2 * x, x > 9]))
    steps = (
        Call(both, ("a", "a"), ("b", "c")),
        Loop(lane, 3, ("pair",), ("pair_last", "trace"), (), ("b",), True, None, ("six",), 2),
        Loop(last, 5, ("b", "c"), ("b_last", "c_last"), until=1),
        Loop(both, 6, (), ("sums", "differences"), sliced=("six", "trace")),
        Gather("six", "b", 3, "piece"),
        Gather("trace", "c", 1, "side", 2),
        Call(halve(), ("a",), ("half",)),
        Loop(halve(), 2, (), ("halves",), sliced=("pair",)),
    )
    inputs = (("a", 1), ("pair", 2), ("six", 6))
    return Routine("every_step", inputs, steps, ("pair_last", "b_last", "sums", "piece", "side", "halves"))


def same(block: Block) -> Block:
    found = read_block(write_block(block))
    assert found == block and found.digest() == block.digest() and found.text() == block.text()
    return found


BODY = every_step().text()
WORDS = (
    "\n",
    "\n\n",
    " ",
    "=",
    "v0",
    "v1",
    "v2",
    "in",
    "in0",
    "out0 y v0",
    "const ",
    "0",
    "1",
    "-",
    "sliced",
    "lanes",
    "a",
)


@pytest.mark.parametrize("make", [halve, everything, every_step, grid, growth])
def test_what_is_written_is_read(make: Callable[[], Block]) -> None:
    block = make()
    assert text_anew(same(block)) == block.text()


def test_a_zero_has_its_sign() -> None:
    block = everything()
    found = same(block)
    assert isinstance(found, Program)
    signs = [[math.copysign(1, i.value) for i in p.instructions if i.value is not None] for p in (block, found)]
    assert signs[0] == signs[1] and -1 in signs[0]


def test_a_block_that_is_run_twice_is_one_object() -> None:
    found = same(every_step())
    assert isinstance(found, Routine)
    both, *_, call, loop = (step.block for step in found.steps if not isinstance(step, Gather))
    assert call is loop  # two equal ones before
    assert found.steps[3].block is both  # type: ignore[union-attr]


@settings(max_examples=25, deadline=None, derandomize=True)
@given(steps=picks)
def test_random_programs(steps: list[tuple[str, int, int, int]]) -> None:
    same(lower(grown(steps, EXACT)))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_routines(seed: int) -> None:
    same(random_routine(seed))


@pytest.mark.parametrize("sonar", [False])  # with sonars: study 40
def test_a_law(sonar: bool) -> None:
    block = build_law("guarded" if sonar else "closed_form", sonar=sonar).block
    found = same(block)
    assert text_anew(found) == block.text()
    assert len(nested(found)) == len({b.digest() for b in nested(block).values()})
    assert emit_block(found, symbol="law") == emit_block(block, symbol="law")
    text = write_block(block)
    start = time.process_time()
    read_block(text)
    size = sum(len(b.instructions) for b in nested(block).values() if isinstance(b, Program))
    assert time.process_time() - start < 0.1 + 30e-6 * size  # many times what it takes


def test_the_search_for_garbage_goes_on_afterwards() -> None:
    text = write_block(halve())
    assert gc.isenabled()
    read_block(text)
    with pytest.raises(InputError):
        read_block(sealed(text.replace("div v0 v1", "div v0 v9")))
    assert gc.isenabled()
    gc.disable()
    try:
        read_block(text)
        assert not gc.isenabled()
    finally:
        gc.enable()


def sealed(text: str) -> str:
    """With the digest that an honest writer would add."""
    body = text.rpartition("\nsha256 ")[0]
    return f"{body}\nsha256 {hashlib.sha256(body.encode()).hexdigest()}\n"


def refused(text: str) -> str:
    start = time.process_time()
    with pytest.raises(InputError, match=r"line [0-9]+") as caught:
        read_block(text)
    assert time.process_time() - start < 1
    assert "\n" not in str(caught.value)
    return str(caught.value)


def text_anew(block: Block) -> str:
    """Of what is in it, not of what it was read from."""
    for inner in nested(block).values():
        for key in ("_text", "_digest"):
            inner.__dict__.pop(key, None)
    return block.text()


def refused_or_exact(body: str) -> bool:
    """Whether the sealed body is refused; if not, it is the text of the block that was read."""
    try:
        block = read_block(sealed(f"{body}\nsha256 "))
    except InputError as error:
        assert re.search("line [0-9]+", str(error)) and "\n" not in str(error)
        return True
    assert text_anew(block) == body
    return False


def test_what_is_cut_off_is_refused() -> None:
    text = write_block(every_step())
    for end in range(len(text)):
        assert "cut off" in refused(text[:end])
        refused_or_exact(text[:end])
    assert "altered" in refused(text.replace("v0", "v1", 1))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(at=st.integers(0, 10**6), length=st.integers(0, 6), by=st.sampled_from(WORDS) | st.text(max_size=4))
def test_a_changed_text_is_refused_or_another_block(at: int, length: int, by: str) -> None:
    at %= len(BODY)
    refused_or_exact(BODY[:at] + by + BODY[at + length :])


@settings(max_examples=25, deadline=None, derandomize=True)
@given(one=st.integers(0, 10**6), other=st.integers(0, 10**6))
def test_exchanged_lines_are_refused_or_another_block(one: int, other: int) -> None:
    lines = BODY.split("\n")
    one, other = one % len(lines), other % len(lines)
    lines[one], lines[other] = lines[other], lines[one]
    refused_or_exact("\n".join(lines))


PROGRAM = (
    ("div v0 v1", "div v0 v2", "line 5.*earlier values"),
    ("div v0 v1", "div v0 v-1", "line 5.*earlier values"),
    ("div v0 v1", "div v0 v00", "line 5.*earlier values"),
    ("div v0 v1", "div v0", "line 5.*2 operands"),
    ("div v0 v1", "div v0 v1 v1", "line 5.*2 operands"),
    ("div v0 v1", "div v0  v1", "line 5.*earlier values"),
    ("div v0 v1", "pow v0 v1", "line 5"),
    ("div v0 v1", "__import__('os').abort() v0 v1", "line 5"),
    ("v2 = div", "v3 = div", "line 5.*assign v2"),
    ("v2 = div", "v2 == div", "line 5.*assign v2"),
    ("v0 = in0[0]", "v0 = in0[1]", "line 3"),
    ("v0 = in0[0]", "v0 = in1[0]", "line 3"),
    ("v0 = in0[0]", "v0 = in-1[0]", "line 3"),
    ("v0 = in0[0]", "v0 = in0[-1]", "line 3"),
    ("v0 = in0[0]", "v0 = in0[00]", "line 3"),
    ("v0 = in0[0]", "v0 = in0[0] v0", "line 3.*input with an operand"),
    ("v0 = in0[0]", f"v0 = in0[{'9' * 5000}]", "line 3"),
    ("v0 = in0[0]", "v0", "line 3"),
    ("const 0x1.0000000000000p+1", "const nan", "line 4.*number"),
    ("const 0x1.0000000000000p+1", "const 0.5", "line 4.*number"),
    ("const 0x1.0000000000000p+1", "const 0x1p99999", "line 4"),
    ("const 0x1.0000000000000p+1", "const", "line 4"),
    ("const 0x1.0000000000000p+1", "const half", "line 4"),
    ("in0 x 1", "in0 x -1", "line 2.*size"),
    ("in0 x 1", "in0 x one", "line 2.*size"),
    ("in0 x 1", "in0 x 1_0", "line 2.*size"),
    ("in0 x 1", f"in0 x {'9' * 5000}", "line 2.*size"),
    ("in0 x 1", "in0 x 1\nin0 x 1", "line 3"),
    ("in0 x 1", "in0 x 1 1", "line 2"),
    ("out0 y v2", "out0 y v3", "line 6.*output"),
    ("out0 y v2", "out1 y v2", "line 6.*output"),
    ("out0 y v2", "out0", "line 6.*output"),
    ("out0 y v2", "out0 y v2\nout0 y v2", "line 7.*output"),
    ("out0 y v2", "", "line"),
    ("program halve", "program", "line 1.*first line"),
    ("program halve", "program halve it", "line 1.*first line"),
    ("program halve", "pickle halve", "line 1.*first line"),
    ("program halve", "\n\nprogram halve", "line 1.*first line"),
)


@pytest.mark.parametrize(("good", "bad", "message"), PROGRAM)
def test_a_program_that_is_none_is_refused_by_line(good: str, bad: str, message: str) -> None:
    text = write_block(halve())
    assert text.count(good) == 1
    assert re.search(message, refused(sealed(text.replace(good, bad))))


ROUTINE = (
    ("in a 1", "in a 2", "line 42: every_step.*entries"),
    ("in six 6", "in six 6\nin six 6", "exists already"),
    ("in six 6", f"in six {10**30}", "equal pieces"),
    ("count 3", "count 0", "one iteration"),
    ("count 3", f"count {10**30}", "equal pieces"),
    ("count 3", "count 03", "should be"),
    ("count 3", "count three", "not a step"),
    ("count 3", f"count {'9' * 5000}", "not a step"),
    ("spread six lanes 2", "spread six lanes -2", "in several lanes"),
    ("width 3 lanes 1", "width -3 lanes -1", "pieces"),
    ("width 3 lanes 1", "width 3 lanes 1 lanes 1", "should be"),
    ("index 1", "index 2", "should be"),
    ("until 1", "until 7", "flag"),
    ("until 1", "until", "not a step"),
    ("carried pair", "carried nobody", "not written"),
    ("carried pair", "carried  pair", "should be"),
    ("carried pair sliced", "carried pair", "not a step"),
    ("b c = call", "b = call", "names 1 results"),
    ("b c = call", "b b = call", "exists already"),
    ("b c = call", "b c = run", "not a step"),
    ("b c = call", "b c call", "not a step"),
    ("half = call halve:", "half = call halved:", "not a step"),
    ("out pair_last", "out nobody", "not written"),
    ("out pair_last", "exit pair_last", "should be"),
    ("routine every_step", "routine every step", "first line"),
    ("routine every_step", "routine ", "first line"),
)


@pytest.mark.parametrize(("good", "bad", "message"), ROUTINE)
def test_a_routine_that_is_none_is_refused_by_line(good: str, bad: str, message: str) -> None:
    text = write_block(every_step())
    assert text.count(good) == 1
    assert re.search(message, refused(sealed(text.replace(good, bad))))


def test_blocks_that_do_not_belong_together_are_refused() -> None:
    x = ca.SX.sym("x")
    other = lower(ca.Function("other", [x], [3 * x]))
    one = Routine("one", (("x", 1),), (Call(halve(), ("x",), ("y",)),), ("y",)).text()
    for body, message in (
        (f"{halve().text()}\n{one}", "has the name and digest of another block"),
        (f"{other.text()}\n{one}", "does not run"),
        (one[one.index("routine") :], "does not precede"),
        (halve().text().replace("halve", "\ud800"), "invalid Unicode"),
        ("", "cut off"),
        ("\n", "first line"),
    ):
        text = f"{body}\nsha256 {hashlib.sha256(body.encode(errors='replace')).hexdigest()}\n"
        assert message in refused(text)


def test_blocks_inside_one_another_have_an_end() -> None:
    body, call = halve().text(), f"halve:{halve().digest()[:16]}"
    for depth in range(400):
        inner = f"routine r{depth}\nin x 1\ny = call {call} x\nout y\n"
        body = f"{body}\n{inner}"
        call = f"r{depth}:{hashlib.sha256(body.encode()).hexdigest()[:16]}"
    assert "nested blocks" in refused(sealed(f"{body}\nsha256 "))


def test_what_a_text_cannot_tell_apart_is_not_written() -> None:
    nan = Program("f", (), (("y", 1),), (Instruction("const", (), math.nan),), ((0,),))
    blank = Program("f", (("x", 1), ("y z", 1)), (("y", 1),), (Instruction("input", (0, 0)),), ((0,),))
    loop = Loop(halve(), 1, ("sliced",), ("y",))
    for block in (
        nan,
        blank,
        Program("f\n", (), (), (), ()),
        Program("f", (), (("y v0", 0),), (Instruction("const", (), 1.0),), ((),)),
        Routine("r", (("sliced", 1),), (loop,), ("y",)),
    ):
        with pytest.raises(InputError):
            write_block(block)
