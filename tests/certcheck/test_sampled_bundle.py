"""A certificate about a sampled loop is compared with the instruction lists of an exported controller."""

import json
from collections.abc import Callable
from typing import Any

import casadi as ca
import pytest

from surctl.certcheck.belonging import Belonging, compare
from surctl.certcheck.bundle import Manifest, read_manifest
from surctl.export.bundle import build_bundle
from surctl.export.supplement import PlantLists
from surctl.ir import Layout, Port
from surctl.lyapunov import sampled_dynamics
from surctl.lyapunov.sampled import SampledStability
from surctl.system import Action, Controller, Plant, System
from surctl.verification.formula import parse, variable

Claim = dict[str, Any]


def loop() -> System:
    place, speed = Port("place", (1,), "m", "of the cart"), Port("speed", (1,), "m/s", "of the cart")
    drive = Layout((Port("a", (1,), "1/s", "drive", 1.0),))
    plant = Plant("cart", Layout((place,)), Layout((speed,)), parameters=drive,
                  ode=lambda x, f, d, p: p["a"] * ca.sin(x["place"]) + f["speed"])  # fmt: skip

    def law(x: Any, u: Any, p: Any) -> Action:
        command = ca.fmax(-1, ca.fmin(1, -2 * u["place"] - x["sum"]))
        return Action(command, {"sum": x["sum"] + 0.05 * u["place"], "still": 1 * x["still"]})

    state = Layout((Port("sum", (1,), "m s", "integral"), Port("still", (1,), "1", "constant")))
    return System(plant, Controller("hold", 0.05, plant.state, plant.inputs, law, state=state))


@pytest.fixture(scope="module")
def manifest() -> Manifest:
    law, plant = loop().controller, loop().plant
    lists = PlantLists(plant, plant.parameters.pack())
    files = build_bundle(law, law.gains.unpack(law.gains.pack()), supplement=lists).files
    return read_manifest(json.loads(files["manifest.json"]), files)


def compared(manifest: Manifest, change: Callable[[Claim], object]) -> Belonging:
    within = {"place": (-1.0, 1.0), "controller.sum": (-1.0, 1.0)}
    dynamics = sampled_dynamics(loop(), within, ranges={"plant.a": (0.9, 1.1)})
    names = {name: variable(name) for name in dynamics.names}
    claim = SampledStability(dynamics, parse("place^2 + controller_sum^2", names), 0.1)
    plain: Claim = json.loads(json.dumps(claim.plain()))
    change(plain)
    return compare({"kind": "lyapunov", "claim": plain}, manifest)


def test_a_sampled_loop_belongs_to_its_controller(manifest: Manifest) -> None:
    good = compared(manifest, lambda c: None)
    assert good.belongs, good
    assert any(text.startswith("delay") for text in good.excludes)
    assert "jitter: each control period is assumed to last exactly 0.05 s" in good.excludes
    assert not any(text.startswith("sampling") for text in good.excludes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["dynamics"].update(place="plant_a*sin(place) + 1.001*speed"), "rate of place"),
        (lambda c: c["dynamics"].update(place="plant_a*sin(place) + max(-1, min(1, -2*place - controller_sum))"),
         "rate of place"),
        (lambda c: c["next"].update(controller_sum="1.001*controller_sum + 0.05*place"), "value of controller_sum"),
        (lambda c: c["commands"][0].update(value="max(-1, min(1.01, -2*place - controller_sum))"), "value of speed"),
        (lambda c: c["commands"][0].update(unit="m"), "speed: in m certified, in m/s exported"),
        (lambda c: c["commands"].clear(), "every command"),
        (lambda c: c.update(period_s=0.1), "period_s: 0.1 certified, 0.05 exported"),
        (lambda c: c["about"].update(period_s=0.1), "period: 0.1 s certified"),
        (lambda c: c.update(time="late"), "compared in continuous time, or sampled"),
        (lambda c: c.update(assumes=["calm water"]), "calm water"),
    ],
)  # fmt: skip
def test_another_loop_does_not_belong(manifest: Manifest, change: Callable[[Claim], object], message: str) -> None:
    result = compared(manifest, change)
    assert not result.belongs
    assert any(message in text for text in (*result.differs, *result.unbound))
