"""Warnings about what works, but is hardly meant: a misspelt input, a range without the nominal value."""

from __future__ import annotations

import pytest

from surctl.ir import Layout, Port
from surctl.system import Controller, System
from surctl.system.values import checked_ranges
from surctl.testing import cart_system

CART = cart_system()


@pytest.mark.parametrize(
    ("name", "unit", "warned"), [("sped", "m/s", True), ("sped", "m", False), ("goal", "m/s", False)]
)
def test_a_reference_with_nearly_the_name_of_a_measured_output(name: str, unit: str, warned: bool) -> None:
    inputs = Layout((Port(name, (1,), unit, ""),))
    law = Controller("law", 0.1, inputs, CART.controller.command, lambda x, u, p: -u[name])
    if not warned:
        assert [port.name for port in System(CART.plant, law).references] == [name]
        return
    with pytest.warns(UserWarning, match=r"law\.inputs\.sped: is a reference, .*did you mean 'speed'\?"):
        System(CART.plant, law)


def test_a_reference_beside_the_output_that_it_resembles() -> None:
    inputs = Layout((Port("speed", (1,), "m/s", ""), Port("speed_0", (1,), "m/s", "desired")))
    law = Controller("law", 0.1, inputs, CART.controller.command, lambda x, u, p: u["speed_0"] - u["speed"])
    assert [port.name for port in System(CART.plant, law).references] == ["speed_0"]


def test_a_range_without_the_nominal_value() -> None:
    k = float(CART.controller.gains.pack()[0])
    assert checked_ranges(CART, {"k": (k, 2 * k)}) == {"k": (k, 2 * k)}
    with pytest.warns(UserWarning, match=rf"ranges\.k = .*: leaves out the nominal value, {k:g} 1/s"):
        checked_ranges(CART, {"k": (2 * k, 3 * k)})
