"""A recorded run of a system is read back to the last bit from every format, with units and identity."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.recorded import read_recorded
from surctl.system import Controller, Cost, Plant, System, run_system, save_record
from tests.system.examples import pendulum


@pytest.mark.parametrize("kind", ["csv", "mat", "nc"])
def test_every_format_gives_the_numbers_of_the_run(tmp_path: Path, kind: str) -> None:
    record = run_system(pendulum(), 0.2)
    read = read_recorded(save_record(record, tmp_path / f"run.{kind}"))
    unit = " [N m]" if kind == "csv" else ""
    np.testing.assert_array_equal(read.numbers(f"torque{unit}"), np.asarray(record["torque"])[:, 0])
    np.testing.assert_array_equal(read.numbers("time [s]" if unit else "time"), record.time)


def test_matlab_gets_identifiers_units_and_identity(tmp_path: Path) -> None:
    pair, push = Port("time", (2,), "m, rad", "place"), Port("units", (1,), "m/s", "")
    plant = Plant("pair", Layout((pair,)), Layout((push,)), lambda x, f, d, p: {"time": [f["units"], 0]})
    gains = Layout((Port("k", (2,), "1", "", 0.5),))
    law = Controller("push", 0.1, Layout((pair,)), Layout((push,)), lambda x, u, p: p["k"][1], gains=gains)
    system = System(plant, law, costs={"far": Cost(lambda s: s.x["time"][0], "max", "m")})
    read = loadmat(
        save_record(run_system(system, 0.3), tmp_path / "run.mat", about={"author": "me"}), simplify_cells=True
    )
    assert read["units_"].tolist() == [0.5] * 3 and read["units"]["time_1"] == "rad"
    assert read["meaning"]["time_0"] == "time[0]: place"
    assert read["identity"]["system_sha256"] == system.digest() and read["identity"]["author"] == "me"
    assert json.loads(read["identity"]["gains"]) == {"k": [0.5, 0.5]}
    far = json.loads(read["identity"]["costs"])["far"]
    assert (far["value"], far["unit"], far["how"]) == (pytest.approx(0.1), "m", "max")


def test_a_signal_named_time_does_not_hide_the_time() -> None:
    clock, rate = Port("time", (1,), "s", "", 5.0), Port("rate", (1,), "1", "")
    plant = Plant("clock", Layout((clock,)), Layout((rate,)), lambda x, f, d, p: {"time": f["rate"]})
    law = Controller("run", 0.1, Layout((replace(clock, name="status"),)), Layout((rate,)), lambda x, u, p: 1)
    columns = run_system(System(plant, law), 0.2).columns()
    assert list(columns) == ["time", "time_", "rate", "status_", "status"]
    assert columns["time"].values[0] == 0 and columns["time_"].values[0] == 5


def test_an_unknown_format_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.txt: has no known format; end the name in \.csv, \.mat or \.nc"):
        save_record(run_system(pendulum(), 0.1), tmp_path / "run.txt")
