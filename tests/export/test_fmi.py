"""Units of FMI 2.0 and 3.0: initial outputs, communication steps of any length, saved states, missions, prefixes."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.export.fmu import description, unit_sources, write_fmu
from surctl.export.precision import Rounded, evaluated
from surctl.ir.cache import compile_program
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle
from surctl.marine.simulation import law_numbers, simulate
from surctl.marine.vehicle import load_vehicle
from tests.export.standin import Vector
from tests.export.test_check import Exact, exact
from tests.export.test_gains_in_c import guarded
from tests.export.test_missions import mission
from tests.tools import need, need_compiler

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed") if os.environ.get("CI") != "true" else None
if fmpy is None:
    import fmpy  # type: ignore[no-redef]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The unit of a small law for each version of FMI."""
    need_compiler()
    law = exact()
    folder = tmp_path_factory.mktemp("fmi")
    bundle = build_bundle(law, {})
    return {fmi: write_fmu(law, bundle, law.gains.pack(), folder / str(fmi), fmi=fmi).path for fmi in (2, 3)}


class Unit:
    """An instance of an FMU of either version."""

    def __init__(self, path: Path, fmi: int, folder: Path) -> None:
        from fmpy import extract, read_model_description
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        self.fmi, self.told = fmi, read_model_description(str(path))
        kind = FMU2Slave if fmi == 2 else FMU3Slave
        self.slave: Any = kind(
            guid=self.told.guid,
            unzipDirectory=extract(str(path), str(folder)),
            modelIdentifier=self.told.coSimulation.modelIdentifier,
            instanceName="robot",
        )
        self.slave.instantiate()
        self.references: dict[str, list[int]] = {"input": [], "parameter": [], "output": []}
        for variable in self.told.modelVariables:
            if variable.type in ("Real", "Float64") and variable.causality in self.references:
                self.references[variable.causality].append(variable.valueReference)
        self.status = [v.valueReference for v in self.told.modelVariables if v.name == "status"]
        self.now = 0.0

    def initialize(self, u: Vector) -> None:
        if self.fmi == 2:
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.put(u)

    def put(self, u: Vector) -> None:
        (self.slave.setReal if self.fmi == 2 else self.slave.setFloat64)(self.references["input"], list(map(float, u)))

    def outputs(self) -> tuple[int, Vector]:
        if self.fmi == 2:
            return self.slave.getInteger(self.status)[0], np.array(self.slave.getReal(self.references["output"]))
        return self.slave.getInt32(self.status)[0], np.array(self.slave.getFloat64(self.references["output"]))

    def step(self, length: float) -> Vector:
        self.slave.doStep(currentCommunicationPoint=self.now, communicationStepSize=length)
        self.now += length
        return self.outputs()[1]


@pytest.fixture(params=[2, 3])
def unit(files: dict[int, Path], tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Unit]:
    opened = Unit(files[request.param], request.param, tmp_path)
    yield opened
    opened.slave.terminate()
    opened.slave.freeInstance()


def expected(law: Exact, inputs: list[Vector]) -> list[Vector]:
    mine = Rounded(law, "float64")
    x, p, rows = mine.initial_state(), law.gains.pack(), []
    for u in inputs:
        step = evaluated(mine, x[None], u[None], p[None])
        rows.append(np.concatenate([step.tau[0], step.telemetry[0]]))
        x = step.state[0]
    return rows


def different(k: int) -> Vector:
    return exact().inputs.pack() + 0.1 * (k + 1)


def test_the_outputs_are_valid_after_initialization_and_the_first_step_is_still_to_come(unit: Unit) -> None:
    first, second = expected(exact(), [different(0), different(1)])
    unit.initialize(different(5))
    assert np.array_equal(unit.outputs()[1], expected(exact(), [different(5)])[0])
    unit.put(different(0))
    assert np.array_equal(unit.outputs()[1], first)
    unit.slave.exitInitializationMode()
    assert np.array_equal(unit.outputs()[1], first) and unit.outputs()[0] >= 0
    assert np.array_equal(unit.step(0.05), first)
    unit.put(different(1))
    assert np.array_equal(unit.outputs()[1], first) and np.array_equal(unit.step(0.05), second)


@pytest.mark.parametrize(
    ("lengths", "steps"),
    [
        ([0.05] * 6, [1, 2, 3, 4, 5, 6]),
        ([0.0125] * 9, [1, 1, 1, 1, 2, 2, 2, 2, 3]),  # a fraction of the period: a step at every fourth
        ([0.15, 0.15], [3, 6]),  # a multiple
        ([0.07] * 5, [2, 3, 5, 6, 7]),  # neither: steps at 0, 0.05, 0.1, ... s
        ([0.1 / 3] * 6, [1, 2, 2, 3, 4, 4]),
    ],
)
def test_steps_happen_at_multiples_of_the_period_whatever_the_communication_step_is(
    unit: Unit, lengths: list[float], steps: list[int]
) -> None:
    rows = expected(exact(), [different(0)] * max(steps))
    unit.initialize(different(0))
    unit.slave.exitInitializationMode()
    for length, count in zip(lengths, steps, strict=True):
        assert np.array_equal(unit.step(length), rows[count - 1])


def test_a_saved_state_is_restored_to_the_last_bit(unit: Unit) -> None:
    unit.initialize(different(0))
    unit.slave.exitInitializationMode()
    for k in range(4):
        unit.put(different(k))
        unit.step(0.05)
    get, put, free, store, load = (
        ("getFMUstate", "setFMUstate", "freeFMUstate", "serializeFMUstate", "deSerializeFMUstate")
        if unit.fmi == 2
        else ("getFMUState", "setFMUState", "freeFMUState", "serializeFMUState", "deserializeFMUState")
    )
    saved, now = getattr(unit.slave, get)(), unit.now
    stored = getattr(unit.slave, store)(saved)
    after = [unit.step(0.05) for _ in range(3)]
    getattr(unit.slave, put)(saved)
    unit.now = now
    assert all(np.array_equal(unit.step(0.05), row) for row in after) and not np.array_equal(after[0], after[2])
    again = getattr(unit.slave, load)(stored)
    getattr(unit.slave, put)(again)
    unit.now = now
    assert np.array_equal(unit.step(0.05), after[0])
    for state in (saved, again):
        getattr(unit.slave, free)(state)
    assert unit.told.coSimulation.canGetAndSetFMUstate and unit.told.coSimulation.canSerializeFMUstate


def test_fmpy_validates_and_simulates_fmi_3(files: dict[int, Path]) -> None:
    from fmpy import simulate_fmu
    from fmpy.validation import validate_fmu

    law = exact()
    assert validate_fmu(str(files[3])) == []
    fields = [(name, np.float64) for name in ("time", "eta[1]", "eta[2]")]
    table = np.array([(0.0, 1.0, 0.5), (1.0, 1.0, 0.5)], dtype=fields)
    run = simulate_fmu(str(files[3]), input=table, stop_time=0.5, output_interval=0.05, output=["tau[1]", "status"])
    rows = expected(law, [law.inputs.pack({"eta": [1.0, 0.5, 0.0, 0.0]})] * 10)
    assert [row["tau[1]"] for row in run][1:] == [row[0] for row in rows] and run["status"].dtype.kind == "i"
    with zipfile.ZipFile(files[3]) as archive:
        names = set(archive.namelist())
        build = archive.read("sources/buildDescription.xml").decode()
    assert {f"sources/{name}" for name in re.findall('SourceFile name="(.*?)"', build)} < names
    header = (Path(fmpy.__file__).parent / "c-code/fmi3FunctionTypes.h").read_text()
    library = next(name for name in names if name.endswith(".so"))
    with zipfile.ZipFile(files[3]) as archive:
        loaded = ctypes.CDLL(archive.extract(library, files[3].parent))
    assert all(hasattr(loaded, name) for name in set(re.findall(r"(fmi3\w+)TYPE", header)))


def test_every_number_has_unit_range_and_a_description_of_its_own(tmp_path: Path) -> None:
    from fmpy import read_model_description
    from fmpy.validation import validate_fmu

    law, bundle, p = guarded()
    for fmi in (2, 3):
        text = description(law, bundle, p, ["fmi2.c"], fmi=fmi)
        folder = tmp_path / str(fmi)
        folder.mkdir()
        (folder / "modelDescription.xml").write_bytes(text)
        assert validate_fmu(str(folder)) == []
        told = read_model_description(str(folder))
        found = {v.name: v for v in told.modelVariables}
        assert len({v.description for v in told.modelVariables if "[" in v.name}) == sum("[" in name for name in found)
        assert [found[f"eta[{k}]"].unit for k in (1, 2, 3, 4)] == ["m", "m", "m", "rad"]
        assert [found[f"contacts[1,{k}]"].unit for k in (3, 4, 6)] == ["m", "m/s", "1"]
        assert found["eta[4]"].description == f"[rad] psi: {law.inputs.port('eta').meaning}"
        assert found["linear_drag[4]"].unit == "N m s" and all(v.unit for v in found.values() if v.name not in LOOSE)
        within = bundle.envelope
        assert within is not None and within.commands is not None
        low, high = within.gains[law.gains.slice("k_v").start]
        assert (float(found["k_v"].min), float(found["k_v"].max)) == (low, high)
        assert float(found["tau[1]"].max) == within.commands[0, 1]
        units = {unit.name: unit.baseUnit for unit in told.unitDefinitions}
        assert (units["N s/m"].kg, units["N s/m"].m, units["N s/m"].s) == (1, 0, -1)


LOOSE = ("status", "time")


def test_a_unit_feeds_its_controller_with_a_long_mission(tmp_path: Path) -> None:
    scenario, law = mission(60, seconds=20.0), build_law("closed_form")
    vehicle, gains = load_vehicle("sur400"), load_gains("default")
    record = simulate(scenario, vehicle, gains=gains, law=law).record
    p = law_numbers(scenario, gains, vehicle)
    bundle = build_bundle(law, law.gains.unpack(p), mission=scenario.path.table())
    unit = Unit(write_fmu(law, bundle, p, tmp_path / "fmu", fmi=3).path, 3, tmp_path / "out")
    unit.initialize(record.law_input[0])
    unit.slave.exitInitializationMode()
    taus = []
    for u in record.law_input:
        unit.put(u)
        taus.append(unit.step(0.05)[:4])
    assert record.fed is not None and len(np.unique(record.fed[:, law.gains.slice("waypoints")], axis=0)) > 3
    assert np.array(taus).tobytes() == record.tau.tobytes()
    said = {v.name: v.description for v in unit.told.modelVariables}
    assert all(said[name].endswith("(written by the unit from its mission)") for name in ("depth", "waypoints[1,1]"))


def test_two_units_of_both_versions_link_into_one_program(tmp_path: Path) -> None:
    need_compiler()
    law, code, lines = exact(), [], []
    for name, fmi in (("near", 2), ("far", 3)):
        (tmp_path / name).mkdir()
        for file, text in unit_sources(law, build_bundle(law, {}, name=name), fmi=fmi).items():
            (tmp_path / name / file).write_text(text)
            code += [tmp_path / name / file] if file.endswith(".c") else []
        lines.append(f"const char *{name}_fmi{fmi}GetVersion(void);")
    (tmp_path / "main.c").write_text(
        "\n".join(
            [*lines, "int main(void) { return near_fmi2GetVersion()[0] - '2' + far_fmi3GetVersion()[0] - '3'; }\n"]
        )
    )
    program = compile_program([tmp_path / "main.c", *code], tmp_path / "main", flags=("-O0",))
    assert subprocess.run([program], check=False).returncode == 0


def test_a_unit_holds_a_library_for_windows_where_its_compiler_is_installed(files: dict[int, Path]) -> None:
    need("x86_64-w64-mingw32-gcc")
    for fmi, place in ((2, "win64"), (3, "x86_64-windows")):
        with zipfile.ZipFile(files[fmi]) as archive:
            name = f"binaries/{place}/{files[fmi].stem}.dll"
            assert archive.read(name)[:2] == b"MZ"
            library = files[fmi].parent / "unit.dll"
            library.write_bytes(archive.read(name))
        told = subprocess.run([need("objdump"), "-p", library], capture_output=True, text=True, check=True).stdout
        assert f"fmi{fmi}DoStep" in told
