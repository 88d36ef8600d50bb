"""The system of the examples: a cart that is braked."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.ir import Layout, Port
from surctl.system import Controller, Cost, Plant, System

_SPEED, _FORCE = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
_COSTS: Mapping[str, Cost] = {"way": Cost(lambda s: s.x["speed"], "integral", "m")}


def cart_system(k: float = 1.0, *, costs: Mapping[str, Cost] = _COSTS) -> System:
    """Return the system of the examples: a cart that rolls at 1 m/s and is braked at 10 Hz with the gain k [1/s].

    The plant has the state `speed` and the command `force` over its mass; the gain `k` can be changed.

    Example:
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> round(run_system(cart_system(), 2.0).figures["way"], 2)
        0.88
    """
    cart = Plant("cart", Layout((_SPEED,)), Layout((_FORCE,)), lambda x, f, d, p: {"speed": f["force"]})
    gains = Layout((Port("k", (1,), "1/s", "gain", k),))
    brake = Controller(
        "brake", 0.1, Layout((_SPEED,)), Layout((_FORCE,)), lambda x, u, p: -p["k"] * u["speed"], gains=gains
    )
    return System(cart, brake, costs=costs)
