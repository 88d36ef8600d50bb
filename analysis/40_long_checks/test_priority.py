"""Priority: sizes, modes and settings of the compiled step beyond the suite's."""

from __future__ import annotations

import platform

from surctl.ir import compile_block
from surctl.priority import Settings, safe_step
from tests.priority.compiled import test_step
from tests.priority.solver import test_bounded
from tests.priority.solver.test_fallback import SMALL, small
from tests.tools import need_compiler

X86 = platform.machine().lower() in ("x86_64", "amd64")
FLAGS = ("-O2", *(["-march=x86-64"] if X86 else []))  # the others are compiled with -O0, and for this processor


def test_several_sweeps_of_a_stack_with_sets() -> None:
    test_step.test_it_is_the_law_in_numpy(test_step.SETS, Settings("projected", sweeps=3))


def test_compiled_and_replayed_are_the_same_bytes() -> None:
    for mode in test_step.MODES:
        test_step.test_compiled_and_replayed_are_the_same_bytes(mode)


def test_the_first_rung_of_one_task_row() -> None:
    test_bounded.test_what_the_first_rung_finds_in_few_iterations_is_the_exact_answer_to_the_last_bit((3, 1, 9))


def test_with_another_level_for_the_oldest_processor_it_gives_the_same_bytes() -> None:
    need_compiler()
    trials, outputs = small()
    for a, b in zip(compile_block(safe_step(*SMALL), flags=FLAGS)(*trials.arrays), outputs, strict=True):
        assert a.tobytes() == b.tobytes()
