"""Numbers that nobody means well, given to the public functions about systems: one InputError, no other exception."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError, check_count, check_number
from surctl.export import software_in_the_loop
from surctl.ir import Layout, Port
from surctl.lyapunov import sampled_dynamics
from surctl.system import (
    Controller,
    Cost,
    System,
    every_combination,
    linearise,
    linearise_plant,
    run_system,
    simulate_system,
)
from surctl.testing import cart_system
from surctl.tuning import tune_system
from surctl.units import as_range, is_number

CART = cart_system()
SPEED = Port("speed", (1,), "m/s", "of the cart")
COSTLY = cart_system(costs={"way": Cost(lambda s: s.x["speed"], "integral", "m")})
HUGE = 10**400  # no double holds it
NO_NUMBERS = {
    "huge": HUGE, "text": "abc", "digits": "3", "none": None, "complex": 1j, "object": object(), "dict": {"a": 1},
    "bytes": b"3", "symbol": ca.SX.sym("z"), "ragged": [[1.0], [1.0, 2.0]],
}  # fmt: skip
ENTRIES: dict[str, Callable[[Any], object]] = {
    "default of a port": lambda v: Port("k", (1,), "1", "", v),
    "values of a layout": lambda v: Layout((SPEED,)).pack({"speed": v}),
    "control period": lambda v: Controller("c", v, Layout((SPEED,)), Layout((SPEED,)), lambda x, u, p: 0),
    "arguments of a step": lambda v: CART.controller.step([], v, [1.0]),
    "number of a run": lambda v: run_system(CART, 1.0, {"start.speed": v}),
    "numbers of runs": lambda v: simulate_system(CART, 1.0, {"k": v}),
    "numbers by name": lambda v: run_system(CART, 1.0, v if v is not None and not isinstance(v, dict) else [1.0]),
    "duration": lambda v: run_system(CART, v),
    "operating point": lambda v: linearise(CART, {"k": v}),
    "state of a plant": lambda v: linearise_plant(CART.plant, v),
    "combination": lambda v: every_combination({"k": v}),
    "limit of a plot": lambda v: System(CART.plant, CART.controller, limits={"speed": (v, 1.0)}),
    "bound of a box": lambda v: sampled_dynamics(CART, {"speed": (v, 1.0)}),
    "box": lambda v: sampled_dynamics(CART, {"speed": v}),
    "range of a gain": lambda v: tune_system(COSTLY, 1.0, {"k": (v, 4.0)}),
    "trials": lambda v: tune_system(COSTLY, 1.0, {"k": (1.0, 4.0)}, trials=-1 if v == HUGE else v),
    "least margin": lambda v: tune_system(COSTLY, 1.0, {"k": (1.0, 4.0)}, trials=1, least_disk_margin=v),
    "recorded step": lambda v: software_in_the_loop(CART.controller, [([], v, [1.0])]),
    "checked number": lambda v: check_number("latency", v, unit="s"),
    "checked count": lambda v: check_count("trials", -1 if isinstance(v, int) else v),
    "range": lambda v: as_range((v, 1.0), key="k"),
    "whole range": lambda v: as_range(v, key="k"),
}


@pytest.mark.parametrize("value", NO_NUMBERS)
@pytest.mark.parametrize("entry", ENTRIES)
def test_what_is_no_number(entry: str, value: str) -> None:
    with pytest.raises(InputError) as refused:
        ENTRIES[entry](NO_NUMBERS[value])
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 300


@pytest.mark.parametrize("name", [1.0, None, (1, 2), HUGE], ids=repr)
def test_a_name_that_is_no_text(name: Any) -> None:
    with pytest.raises(InputError):
        run_system(CART, 1.0, {name: 1.0})
    with pytest.raises(InputError):
        System(CART.plant, CART.controller, limits={name: (0.0, 1.0)})


def test_what_is_a_number() -> None:
    assert is_number(np.float32(2)) and is_number(np.int64(3)) and not is_number(HUGE)
    assert as_range(np.array([0, 2]), key="k") == (0.0, 2.0)
    assert run_system(CART, 1.0, {"start.speed": [np.float32(2.0)]})["speed"][0, 0] == 2.0
    assert Layout((SPEED,)).pack({"speed": ca.DM(2.0)}).tolist() == [2.0]
    check_count("trials", np.int64(3))
