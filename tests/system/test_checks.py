"""The public check of laws, and mistakes in systems: what is wrong is named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import pytest

from surctl.errors import InputError
from surctl.marine.control import Decision, LawSource
from surctl.marine.testing import check_law
from surctl.system import Cost
from surctl.tasks import depth_task
from surctl.testing import CheckFailed
from tests.system.examples import pendulum


def test_a_result_that_is_not_finite_is_named_with_its_point() -> None:
    with pytest.raises(CheckFailed, match=r"law sinking: command tau\[2\] is not finite"):
        check_law(LawSource("sinking", lambda s: Decision([depth_task(s.eta, ca.sqrt(-s.eta[0]), gain=0.4)])))


def test_a_law_that_draws_numbers_is_named() -> None:
    count = iter(range(10))

    def decide(s: Any) -> Decision:
        return Decision([depth_task(s.eta, s.p["depth"] + next(count), gain=0.4)])

    with pytest.raises(CheckFailed, match="two builds give different instructions"):
        check_law(LawSource("drawing", decide))


@pytest.mark.parametrize(("wrong", "remedy"), [(None, "give a surctl"), (lambda: 3, "give what the function returns")])
def test_a_wrong_object_is_one_line(wrong: Any, remedy: str) -> None:
    with pytest.raises(InputError, match=f"^check_law: got .*, not .*; {remedy}"):
        check_law(wrong)


def test_one_message_names_all_entries_of_a_system_that_are_wrong() -> None:
    cost = Cost(lambda s: s.x["angle"], "final", "rad")
    with pytest.raises(
        InputError, match=r"costs\.angle: .* \(also wrong: costs\.late\.how, limits\.no, limits\.torque\)"
    ):
        replace(
            pendulum(), costs={"angle": cost, "late": replace(cost, how="finl")},  # type: ignore[arg-type]
            limits={"no": (-1.0, 1.0), "torque": (1.0, -1.0), "rate": (-1.0, 1.0)},
        )  # fmt: skip
