"""Priority: sizes, modes and settings of the compiled step beyond the suite's."""

from __future__ import annotations

from surctl.priority import Settings
from tests.priority.compiled import test_step
from tests.priority.solver import test_bounded


def test_several_sweeps_of_a_stack_with_sets() -> None:
    test_step.test_it_is_the_law_in_numpy(test_step.SETS, Settings("projected", sweeps=3))


def test_compiled_and_replayed_are_the_same_bytes() -> None:
    for mode in test_step.MODES:
        test_step.test_compiled_and_replayed_are_the_same_bytes(mode)


def test_the_first_rung_of_one_task_row() -> None:
    test_bounded.test_what_the_first_rung_finds_in_few_iterations_is_the_exact_answer_to_the_last_bit((3, 1, 9))
