"""A rate without a finite value or derivative at rest: the message names the operation, where it is, and the states."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system import Controller, Parts, Plant, System, find_equilibrium, linearise, run_system

STATES = Layout((Port("pos", (1,), "m", ""), Port("vel", (1,), "m/s", "")))
FORCE = Layout((Port("f", (1,), "m/s^2", ""),))
SINGULAR: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "sqrt(0)": lambda a, b: ca.sqrt(a**2 + b**2),
    "acos(1)": lambda a, b: ca.acos(1 - a**2 - b**2),
    "atan2(0, 0)": lambda a, b: ca.atan2(a, b),
    "0/0": lambda a, b: a**2 / b,
}


def system(*, plant: Callable[..., ca.SX], law: Callable[..., ca.SX]) -> System:
    cart = Plant("cart", STATES, FORCE, lambda x, f, d, p: {"pos": x["vel"], "vel": f["f"] + plant(x["pos"], x["vel"])})
    pd = Controller("pd", 0.01, STATES, FORCE, lambda x, u, p: -u["pos"] - u["vel"] + law(u["pos"], u["vel"]))
    return System(cart, pd)


def nothing(a: ca.SX, b: ca.SX) -> ca.SX:
    return 0 * a


@pytest.mark.parametrize("operation", SINGULAR)
@pytest.mark.parametrize("part", ["plant", "law"])
def test_the_operation_is_named(operation: str, part: str) -> None:
    parts = {"plant": nothing, "law": nothing} | {part: SINGULAR[operation]}
    with pytest.raises(InputError) as caught:
        linearise(system(**parts))
    text = str(caught.value)
    assert text.startswith("cart: the ") and f"because of {operation} of the {part}; write it smoothly there" in text
    assert "rate of `vel`" in text and "(pos = 0, vel = 0)" in text and "still moves" not in text


def test_a_smooth_form_and_another_start_help() -> None:
    smooth = system(plant=lambda a, b: ca.sqrt(a**2 + 1e-6) - 1e-3, law=nothing)
    assert find_equilibrium(smooth).x == pytest.approx([0, 0], abs=1e-9)
    far = system(plant=lambda a, b: 2 * ca.sqrt(a) + 0 * b, law=nothing)
    assert find_equilibrium(far, {"start.pos": 3.0}).x == pytest.approx([4, 0], abs=1e-6)


def test_what_is_not_finite_itself_is_named_before_what_has_no_derivative() -> None:
    """The number by which a plant divides, although a square root is at 0 too; also for a run."""

    def ode(x: Parts, f: Parts, d: Parts, p: Parts) -> Parts:
        return {"pos": x["vel"], "vel": (f["f"] - ca.sqrt(x["pos"] ** 2)) / p["mass"]}

    cart = Plant("cart", STATES, FORCE, ode, parameters=Layout((Port("mass", (1,), "kg", "", 1.0),)))
    push = Controller("push", 0.01, STATES, FORCE, lambda x, u, p: 1 - u["pos"])
    with pytest.raises(InputError, match=r"because of 1/0 of the plant \(mass = 0\)"):
        linearise(System(cart, push), {"plant.mass": 0.0})
    record = run_system(System(cart, push), 1.0, {"plant.mass": 0.0})
    assert record.lost == "state pos at 0.01 s, because of 1/0 of the plant (mass = 0)"


@pytest.mark.parametrize("part", ["plant", "law"])
def test_the_operation_that_ends_a_run_is_named(part: str) -> None:
    """An operation that a result does not need, or whose operand has grown without bound, is not the cause."""
    parts = {"plant": nothing, "law": nothing} | {part: lambda a, b: ca.fmin(0, 1 / b) + ca.sqrt(a)}
    record = run_system(system(**parts), 1.0, {"start.pos": -0.25, "start.vel": 1.0})
    assert record.stopped == "not finite" and record.lost.endswith(f", because of sqrt(-0.25) of the {part}")
    unused = {"plant": nothing, "law": nothing} | {part: lambda a, b: ca.if_else(b > 0, 0, 1 / b) + ca.sqrt(a)}
    record = run_system(system(**unused), 1.0, {"start.pos": -0.25, "start.vel": 1.0})
    assert record.lost.endswith(f", because of sqrt(-0.25) of the {part}")
    grown = Controller("grow", 0.01, STATES, FORCE, lambda x, u, p: 1e160 * u["pos"] ** 2)
    record = run_system(System(system(plant=nothing, law=nothing).plant, grown), 9.0, {"start.pos": 1.0})
    assert record.stopped == "not finite" and "because" not in record.lost
