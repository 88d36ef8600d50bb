"""The functional mock-up unit: valid by fmpy, the same numbers as Python to the last bit, the same bytes each time."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from collections.abc import Iterator
from ctypes import c_double
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.export import REALS, Records
from surctl.export.envelope import as_records
from surctl.export.fmu import write_fmu
from surctl.export.precision import Rounded, evaluated
from surctl.ir import Real
from surctl.marine.export import build_bundle
from tests.export.standin import recorded
from tests.export.test_check import Exact, exact
from tests.tools import need_compiler

fmpy = pytest.importorskip("fmpy", reason="fmpy is not installed") if os.environ.get("CI") != "true" else None
if fmpy is None:
    import fmpy  # type: ignore[no-redef]


@pytest.fixture
def law() -> Exact:
    need_compiler()
    return exact()


def made(law: Exact, folder: Path, real: Real = "float64") -> Path:
    return write_fmu(law, build_bundle(law, {}, real=real), law.gains.pack(), folder).path


class Unit:
    """An instance of an FMU, stepped by fmpy."""

    def __init__(self, path: Path, folder: Path) -> None:
        from fmpy import extract, read_model_description
        from fmpy.fmi2 import FMU2Slave

        self.told = read_model_description(str(path))
        where = extract(str(path), str(folder))
        self.slave = FMU2Slave(
            guid=self.told.guid,
            unzipDirectory=where,
            modelIdentifier=self.told.coSimulation.modelIdentifier,
            instanceName="robot",
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
        self.references: dict[str, list[int]] = {"input": [], "parameter": [], "output": []}
        for variable in self.told.modelVariables:
            if variable.type == "Real":
                self.references[variable.causality].append(variable.valueReference)

    def step(self, k: int, u: np.ndarray) -> tuple[int, np.ndarray]:
        self.slave.setReal(self.references["input"], list(map(float, u)))
        self.slave.doStep(currentCommunicationPoint=0.05 * k, communicationStepSize=0.05)
        return self.slave.getInteger([0])[0], np.array(self.slave.getReal(self.references["output"]))

    def close(self) -> None:
        self.slave.terminate()
        self.slave.freeInstance()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[Real, Path]:
    need_compiler()
    folder = tmp_path_factory.mktemp("fmu")
    return {real: made(exact(), folder / real, real) for real in REALS}


@pytest.fixture
def unit(files: dict[Real, Path], tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Unit]:
    opened = Unit(files[getattr(request, "param", "float64")], tmp_path / "out")
    yield opened
    opened.close()


@pytest.mark.parametrize("real", ["float64", "float32"])
def test_fmpy_finds_no_problem(files: dict[Real, Path], real: Real) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(files[real])) == []


def test_it_tells_the_start_values_of_inputs_and_gains(law: Exact, tmp_path: Path) -> None:
    from fmpy import read_model_description

    gains = np.arange(1.0, law.gains.size + 1)
    path = write_fmu(law, build_bundle(law, law.gains.unpack(gains)), gains, tmp_path).path
    told: dict[str, list[float]] = {"input": [], "parameter": []}
    for variable in read_model_description(str(path)).modelVariables:
        if variable.causality in told:
            told[variable.causality].append(float(variable.start))
    assert told == {"input": law.inputs.pack().tolist(), "parameter": gains.tolist()}
    with zipfile.ZipFile(path) as unit:
        listed = re.findall(r'<File name="(.*?)" />', unit.read("modelDescription.xml").decode())
        assert listed == ["fmi2.c", "standin.c", "standin_law.c"]
        assert {f"sources/{file}" for file in listed} <= set(unit.namelist())


@pytest.mark.parametrize(("unit", "real"), [("float64", "float64"), ("float32", "float32")], indirect=["unit"])
def test_it_steps_as_python_to_the_last_bit(law: Exact, unit: Unit, real: Real) -> None:
    run = as_records(law, recorded(law, steps=60))
    mine = Rounded(law, real)
    x = mine.initial_state()
    for k, u in enumerate(run.U):
        status, y = unit.step(k, u)
        want = evaluated(mine, x[None], u[None], run.P[:1])
        assert status == want.status[0]
        assert np.array_equal(y, np.concatenate([want.tau[0], want.telemetry[0]]))
        x = want.state[0]
    assert isinstance(run, Records)


def test_what_is_not_finite_gives_a_warning_and_no_thrust(law: Exact, unit: Unit) -> None:
    u = law.inputs.pack()
    before = unit.step(0, u + 0.5)
    u[0] = np.nan
    status, y = unit.step(1, u)
    assert before[0] >= 0 and before[1].any()
    assert status == -2 and not y.any()
    assert unit.slave.dll.fmi2DoStep(unit.slave.component, c_double(0.1), c_double(0.05), 0) == 1  # fmi2Warning


def test_a_wrong_step_size_or_reference_is_refused(unit: Unit) -> None:
    for call in (
        lambda: unit.slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.0),
        lambda: unit.slave.getReal([10**6]),
        lambda: unit.slave.setReal(unit.references["output"][:1], [1.0]),
        lambda: unit.slave.setBoolean([0], [True]),
    ):
        with pytest.raises(Exception, match="status 3"):
            call()


def test_every_step_is_done_however_late_the_clock_is(unit: Unit) -> None:
    for start in (0.0, 1e6, 1e8, 1.7e9, -1.7e9):
        now = start
        for k in range(1, 22):
            then = start + 0.05 * k  # the master's clock, and the step that it can tell
            unit.slave.doStep(currentCommunicationPoint=now, communicationStepSize=then - now)
            now = then
    for now, step in ((0.0, -0.05), (0.0, 1e7), (1e20, 1.0), (1e20, -1.0), (np.inf, 0.05), (0.0, np.nan)):
        with pytest.raises(Exception, match="status 3"):
            unit.slave.doStep(currentCommunicationPoint=now, communicationStepSize=step)


def test_reset_starts_anew(law: Exact, unit: Unit) -> None:
    u = law.inputs.pack() + 0.3
    first = unit.step(0, u)[1]
    second = unit.step(1, u)[1]
    assert not np.array_equal(first, second)
    unit.slave.reset()
    unit.slave.setupExperiment(startTime=0.0)
    unit.slave.enterInitializationMode()
    unit.slave.exitInitializationMode()
    assert np.array_equal(unit.step(0, u)[1], first)


def test_the_same_bytes_wherever_it_is_made(law: Exact, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = made(law, tmp_path / "a").read_bytes()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "elsewhere"))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert made(law, tmp_path / "a b'c").read_bytes() == here
    with zipfile.ZipFile(tmp_path / "a" / "standin.fmu") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert str(tmp_path).encode() not in b"".join(archive.read(n) for n in archive.namelist())


def test_a_folder_that_cannot_be_written_is_named(law: Exact, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        made(law, tmp_path / "file")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    shutil.rmtree(tmp_path / "file", ignore_errors=True)
