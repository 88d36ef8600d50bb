"""Priority: sizes, modes and settings of the compiled step beyond the suite's."""

from __future__ import annotations

import platform

import casadi as ca
import numpy as np
import pytest

from surctl.ir import compile_block
from surctl.priority import Mode, Settings, safe_step
from surctl.priority.solver.fallback import MET
from tests.priority.compiled import test_step
from tests.priority.solver import test_bounded
from tests.priority.solver.test_fallback import SMALL, has, machine, small
from tests.tools import need_compiler

X86 = platform.machine().lower() in ("x86_64", "amd64")
FLAGS = ("-O2", *(["-march=x86-64"] if X86 else []))  # the others are compiled with -O0, and for this processor


@pytest.mark.parametrize("chosen", [*test_step.SETTINGS[3:5]])
def test_stacks_with_sets(chosen: Settings) -> None:
    test_step.test_solve_runs_the_step_and_agrees_with_the_reference(test_step.SETS, chosen)


def test_damping() -> None:
    test_step.test_solve_runs_the_step_and_agrees_with_the_reference(
        test_step.VALUES, Settings("projected", damping=0.1)
    )


def test_compiled_and_replayed_are_the_same_bytes() -> None:
    for mode in test_step.MODES:
        test_step.test_compiled_and_replayed_are_the_same_bytes(mode)


@pytest.mark.parametrize("sizes", [(3, 1, 9), (2, 2, 8)])
def test_a_bounded_ladder_of_other_sizes(sizes: tuple[int, int, int]) -> None:
    test_bounded.test_what_the_first_rung_finds_in_few_iterations_is_the_exact_answer_to_the_last_bit(sizes)


def test_the_work_of_as_many_task_rows_as_velocities() -> None:
    test_bounded.test_elsewhere_it_is_no_worse_than_the_target_in_the_box_or_standing_still((2, 2, 8))


def test_with_another_level_for_the_oldest_processor_it_gives_the_same_bytes() -> None:
    need_compiler()
    trials, outputs = small()
    for a, b in zip(compile_block(safe_step(*SMALL), flags=FLAGS)(*trials.arrays), outputs, strict=True):
        assert a.tobytes() == b.tobytes()


def test_the_derivative_is_the_projector_of_the_active_rows() -> None:
    (n, p, _), (trials, (_, active, _, _, status, _)) = SMALL, small()
    given = [ca.MX.sym(f"a{i}", array.shape[1]) for i, array in enumerate(trials.arrays)]
    slope, seen = ca.Function("slope", given, [ca.jacobian(machine()(*given)[0], given[0])]), set()
    for k in np.flatnonzero((status[:, 0] == MET) & has(trials, "plain"))[:6]:
        A = trials[np.array([k])].unit()[0][0]
        used = np.abs(active[k][active[k] != 0]).astype(int) - 1
        seen.add(len(used))
        held = np.vstack([A[used], trials.J[k].reshape(p, n)])
        want = np.eye(n) - np.linalg.pinv(held) @ held
        np.testing.assert_allclose(np.asarray(slope(*(a[k] for a in trials.arrays))), want, atol=1e-9)
    assert len(seen) > 1


@pytest.mark.parametrize("mode", ["filter", "nsb"])
def test_a_set_based_level_makes_no_jump(mode: Mode) -> None:
    test_step.test_a_set_based_level_makes_no_jump(mode)


def test_no_level_of_a_stack_with_sets_is_served_worse_than_by_daqp_s_hierarchy() -> None:
    test_step.test_no_level_is_served_worse_than_by_daqp_s_hierarchy(test_step.SETS)
