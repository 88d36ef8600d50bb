"""Public checks of plants, controllers and laws: what is right passes, what is wrong is named with the point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.marine.control import Decision, LawSource
from surctl.marine.testing import check_law
from surctl.system import Action, Controller, Cost, Plant
from surctl.tasks import depth_task
from surctl.testing import CheckFailed, check_controller, check_plant
from tests.system.examples import pendulum

ANGLE, RATE = Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "of the angle")
TORQUE = Port("torque", (1,), "N m", "at the pivot")


def plant(ode: Callable[..., Any]) -> Plant:
    return Plant("pendulum", Layout((ANGLE, RATE)), Layout((TORQUE,)), ode)


def controller(law: Callable[..., Any]) -> Controller:
    return Controller("feedback", 0.02, Layout((ANGLE, RATE)), Layout((TORQUE,)), law)


def test_a_pendulum_passes() -> None:
    report = check_plant(plant(lambda x, f, d, p: {"angle": x["rate"], "rate": ca.sin(x["angle"]) + f["torque"]}))
    assert 0 < report.form_error < 1e-12  # the sine is a polynomial in the instruction list
    assert report.derivative_error < 1e-6
    assert check_controller(controller(lambda x, u, p: -u["angle"])).form_error == 0


def test_a_result_that_is_not_finite_is_named_with_its_point() -> None:
    with pytest.raises(CheckFailed, match=r"plant pendulum: derivative of rate is not finite, at angle = \[-"):
        check_plant(plant(lambda x, f, d, p: {"angle": x["rate"], "rate": ca.sqrt(x["angle"])}))
    passes = plant(lambda x, f, d, p: {"angle": x["rate"], "rate": ca.sqrt(x["angle"])})
    check_plant(passes, ranges={"angle": (0.1, 1.0)})
    with pytest.raises(CheckFailed, match="controller feedback: command torque is not finite"):
        check_controller(controller(lambda x, u, p: 1 / ca.fmax(u["angle"], 0)))
    with pytest.raises(CheckFailed, match=r"law sinking: command tau\[2\] is not finite"):
        check_law(LawSource("sinking", lambda s: Decision([depth_task(s.eta, ca.sqrt(-s.eta[0]), gain=0.4)])))


def test_a_negative_status_is_named() -> None:
    with pytest.raises(CheckFailed, match="the status is -1"):
        check_controller(controller(lambda x, u, p: Action(-u["angle"], status=ca.if_else(u["angle"] > 9, 1, -1))))


def test_a_law_that_draws_numbers_is_named() -> None:
    count = iter(range(10))

    def decide(s: Any) -> Decision:
        return Decision([depth_task(s.eta, s.p["depth"] + next(count), gain=0.4)])

    with pytest.raises(CheckFailed, match="two builds give different instructions"):
        check_law(LawSource("drawing", decide))


@pytest.mark.parametrize("ranges", [{"angel": (0, 1)}, {"angle": (1, 0)}, {"angle": (0, float("nan"))}])
def test_a_wrong_range_is_one_line(ranges: dict[str, tuple[float, float]]) -> None:
    with pytest.raises(InputError, match=r"^ranges\.ang"):
        check_controller(controller(lambda x, u, p: -u["angle"]), ranges=ranges)


@pytest.mark.parametrize("check", [check_law, check_plant, check_controller])
@pytest.mark.parametrize(("wrong", "remedy"), [(None, "give a surctl"), (lambda: 3, "give what the function returns")])
def test_a_wrong_object_is_one_line(check: Callable[[Any], object], wrong: object, remedy: str) -> None:
    with pytest.raises(InputError, match=f"^{check.__name__}: got .*, not .*; {remedy}"):
        check(wrong)


def test_one_message_names_all_entries_of_a_system_that_are_wrong() -> None:
    cost = Cost(lambda s: s.x["angle"], "final", "rad")
    with pytest.raises(
        InputError, match=r"costs\.angle: .* \(also wrong: costs\.late\.how, limits\.no, limits\.torque\)"
    ):
        replace(
            pendulum(), costs={"angle": cost, "late": replace(cost, how="finl")},  # type: ignore[arg-type]
            limits={"no": (-1.0, 1.0), "torque": (1.0, -1.0), "rate": (-1.0, 1.0)},
        )  # fmt: skip
