"""The units that a claim about a loop states are those of the exported controller and its plant."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from surctl.certcheck.belonging import compare
from surctl.certcheck.bundle import Manifest, read_bundle
from surctl.export.bundle import build_bundle, write_bundle
from surctl.export.supplement import PlantLists
from surctl.ir import Layout, Port
from surctl.lyapunov import Problem, continuous_dynamics, solve
from surctl.system import Controller, Plant, System
from surctl.verification.formula import parse, variable

Paired = tuple[dict[str, Any], Manifest]


@pytest.fixture(scope="module")
def paired(tmp_path_factory: pytest.TempPathFactory) -> Paired:
    place, goal = Port("place", (1,), "m", "of the cart"), Port("goal", (1,), "m", "reference")
    drive = Port("a", (1,), "1/s", "drive", 0.5)
    plant = Plant("cart", Layout((place,)), Layout((Port("speed", (1,), "m/s", "command"),)),
                  lambda x, f, d, p: p["a"] * x["place"] + f["speed"], parameters=Layout((drive,)))  # fmt: skip
    law = Controller("hold", 0.01, Layout((place, goal)), plant.inputs,
                     lambda x, u, p: p["k"] * (u["goal"] - u["place"]),
                     gains=Layout((Port("k", (1,), "1/s", "gain", 2.0),)))  # fmt: skip
    ranges = {"plant.a": (0.4, 0.6), "k": (1.9, 2.1)}
    dynamics = continuous_dynamics(System(plant, law), {"place": (-1.0, 1.0)}, ranges=ranges)
    document = solve(Problem(dynamics, "lyapunov", parse("place^2", {"place": variable("place")}), 0.2)).document
    folder = tmp_path_factory.mktemp("bundle") / "hold"
    lists = PlantLists(plant, plant.parameters.pack())
    write_bundle(build_bundle(law, law.gains.unpack(law.gains.pack()), supplement=lists), Path(folder))
    return json.loads(json.dumps(document)), read_bundle(folder)


def test_the_loop_belongs_with_its_own_units(paired: Paired) -> None:
    assert compare(*paired).belongs


@pytest.mark.parametrize(("group", "at"), [("states", 0), ("parameters", 0), ("parameters", 1)])
@pytest.mark.parametrize("unit", ["mm", "1/min", "", "1/s "])
def test_another_unit_does_not_belong(paired: Paired, group: str, at: int, unit: str) -> None:
    document, manifest = copy.deepcopy(paired[0]), paired[1]
    row = document["claim"][group][at]
    row["unit"] = unit
    (difference,) = compare(document, manifest).differs
    assert difference.startswith(f"{row['name']}: in {unit} certified, in ")


def test_a_parameter_that_is_no_number_of_the_loop_does_not_belong(paired: Paired) -> None:
    document, manifest = copy.deepcopy(paired[0]), paired[1]
    document["claim"]["parameters"].append({"name": "other", "unit": "m", "lower": 0.0, "upper": 1.0})
    assert compare(document, manifest).differs == ("other: in m certified, in no number exported",)
