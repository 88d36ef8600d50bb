"""The tasks for FreeRTOS and Zephyr, run with stand-ins for both kernels: closed loop, lateness, watchdog."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from surctl.export import write_bundle
from surctl.export.process import compile_controller
from surctl.ir.cache import compile_program
from surctl.marine.control import Law, load_gains
from surctl.marine.simulation import load_scenario, simulate
from surctl.system import ControllerStep
from tests.export.closed_form import vehicle
from tests.export.standin import Vector
from tests.export.test_gains_in_c import guarded
from tests.tools import PATIENCE, need, need_compiler

STUBS = Path(__file__).parent / "stubs"
COLUMNS = 8  # status, sample, commanded, tau, feeds of the watchdog
BUSY = {"freertos": '#include "task.h"\n'}
BUSY["freertos"] += "#define BUSY(ms) (((ms) < 0.0) ? vTaskDelay((TickType_t)(-(ms))) : stub_busy((TickType_t)(ms)))\n"
BUSY["zephyr"] = "#include <zephyr/kernel.h>\n#define BUSY(ms) stub_busy((int64_t)(1000.0 * (ms)))\n"
SOURCES = {
    "freertos": ["freertos/main_example.c", "freertos/control_task.c", str(STUBS / "freertos/port.c")],
    "zephyr": ["zephyr/sample/src/main.c", str(STUBS / "zephyr/kernel.c")],
}
KERNELS = list(SOURCES)


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One program for each kernel, from the same objects of the controller, compiled without a warning."""
    need_compiler()
    _, bundle, _ = guarded()
    folder = tmp_path_factory.mktemp("rtos") / "b"
    write_bundle(bundle, folder)
    controller = compile_controller(bundle, folder, flags=("-O1",))
    built = {}
    for kernel, files in SOURCES.items():
        (folder / kernel / "busy.h").write_text(BUSY[kernel])
        code = [folder / "loop.c", STUBS / "board_pipe.c", *(folder / file for file in files)]
        flags = [
            "-O1",
            "-D_XOPEN_SOURCE=700",
            f"-DROW={guarded()[0].inputs.size}",
            f"-I{folder}",
            f"-I{folder / kernel}",
        ]
        flags += [f"-I{STUBS / kernel}", "-DCONFIG_CONTROLLER_SURCTL_CLOSED_FORM_WATCHDOG_MS=200"]
        built[kernel] = compile_program([*code, *controller], folder / kernel / "program", flags=flags)
    return built


@dataclass
class Running:
    process: subprocess.Popen[bytes]

    def period(self, u: Vector, *, busy: float = 0.0, measured: bool = True, armed: bool = True) -> Vector:
        """One period; returns (status, sample, 1 if commanded, tau (4), feeds of the watchdog before it)."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(np.concatenate([[busy, measured, armed], u]).tobytes())
        self.process.stdin.flush()
        return np.frombuffer(self.process.stdout.read(8 * COLUMNS))


@contextmanager
def running(program: Path, *, status: int = 0) -> Iterator[Running]:
    with subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        yield Running(process)
        _, said = process.communicate(timeout=PATIENCE)
        assert process.returncode == status and said.startswith(b"gains -11")  # stored gains of another length


@pytest.mark.parametrize(("kernel", "waited"), [("freertos", 1), ("zephyr", 4000)])
def test_a_task_controls_the_vehicle_to_the_last_bit_as_python(
    programs: dict[str, Path], kernel: str, waited: int
) -> None:
    """Also after 200 s without arming, in which the law's time without progress must not count."""
    law, _, _ = guarded()
    assert isinstance(law, Law)
    scenario, steps = load_scenario("pool-ahead"), iter(range(10**6))

    def python(x: Vector, u: Vector, p: Vector) -> ControllerStep:
        step = law.step(x, u, p)
        return ControllerStep(np.zeros(4) if next(steps) < 19 else step.tau, step.x_next, step.status, step.telemetry)

    expected = simulate(scenario, vehicle(), gains=load_gains("default"), law=law, stepper=python).record
    with running(programs[kernel]) as task:
        for _ in range(waited):
            task.period(expected.law_input[0], armed=False)

        def external(x: Vector, u: Vector, p: Vector) -> ControllerStep:
            status, _, _, *tau, _ = task.period(u)
            return ControllerStep(np.array(tau), x, int(status), np.zeros(law.outputs.size - 4))

        run = simulate(scenario, vehicle(), gains=load_gains("default"), law=law, stepper=external)
    assert run.metrics.stopped_because == "reached" and len(expected.tau) > 200
    assert run.record.law_input.tobytes() == expected.law_input.tobytes()
    assert run.record.tau.tobytes() == expected.tau.tobytes()


@pytest.mark.parametrize("kernel", KERNELS)
def test_missed_periods_count_and_statuses_are_reacted_to(programs: dict[str, Path], kernel: str) -> None:
    law, _, _ = guarded()
    u = law.inputs.pack({"eta": [1.0, 0.8, -0.15, 0.0], "nu": [0.05, 0.0, 0.0, 0.0]})
    bad = u.copy()
    bad[0] = np.nan
    with running(programs[kernel]) as task:
        task.period(u, armed=False)
        rows = [task.period(u) for _ in range(25)]
        rows += [task.period(u, busy=110.0)]
        rows += [task.period(u) for _ in range(4)]
        rows += [task.period(u, measured=False) for _ in range(2)]
        rows += [task.period(bad) for _ in range(22)]
        rows += [task.period(u) for _ in range(4)]
        rows += [task.period(u, armed=False), *(task.period(u) for _ in range(20))]
    status, sample, commanded, fed = (np.array(rows)[:, k] for k in (0, 1, 2, 7))
    assert not commanded[:19].any() and commanded[19:30].all()
    assert list(np.diff(sample)[[24, 25, 26]]) == [1, 2, 1]  # 110 ms later; what was missed is not caught up
    assert list(status[30:32]) == [-4, -4] and not commanded[30:32].any()
    assert set(status[32:54]) == {-2} and (status[54:] >= 0).all()  # SAFE: only the operator arms again
    assert not commanded[32:73].any() and commanded[73:].all()
    assert fed[-1] >= 14 and (np.diff(fed) >= 0).all()


def test_the_watchdog_is_not_fed_while_the_control_task_hangs(programs: dict[str, Path]) -> None:
    u = guarded()[0].inputs.pack({"eta": [1.0, 0.8, -0.15, 0.0]})
    with running(programs["freertos"]) as task:
        fed = [task.period(u)[-1] for _ in range(40)]
        fed += [task.period(u, busy=-2000.0)[-1]]  # it blocks for 2 s, and the supervisor runs on
    assert fed[-2] >= 9 and fed[-1] - fed[-2] <= 1
    with running(programs["zephyr"], status=8) as task:  # the stand-in's watchdog resets
        task.period(u, busy=300.0)


def test_the_module_is_read_by_cmake(programs: dict[str, Path], tmp_path: Path) -> None:
    folder = programs["zephyr"].parents[1]
    module = (folder / "zephyr/module.yml").read_text()
    assert "\nname: surctl_closed_form\nbuild:\n  cmake: zephyr\n  kconfig: zephyr/Kconfig\nsamples:\n" in module
    (tmp_path / "run.cmake").write_text(
        "\n".join(
            f"function({function})\nmessage(STATUS {function} ${{ARGN}})\nendfunction()"
            for function in (
                *("zephyr_library_named", "zephyr_library_sources", "zephyr_library_compile_options"),
                "zephyr_include_directories",
            )
        )
        + f'\nset(CONFIG_CONTROLLER_SURCTL_CLOSED_FORM 1)\ninclude("{folder}/zephyr/CMakeLists.txt")\n'
    )
    done = subprocess.run(
        [need("cmake"), "-P", str(tmp_path / "run.cmake")], capture_output=True, text=True, check=True
    )
    _, bundle, _ = guarded()
    assert all(f"/../{file}" in done.stdout for file in (*bundle.sources, bundle.selftest, "loop.c"))
    assert "zephyr_library_compile_options-ffp-contract=off" in done.stdout
    kconfig, config = ((folder / "zephyr" / name).read_text() for name in ("Kconfig", "sample/prj.conf"))
    assert "\nconfig CONTROLLER_SURCTL_CLOSED_FORM\n\tbool " in kconfig and kconfig.count("\nif ") == kconfig.count(
        "\nendif"
    )
    assert "CONFIG_CONTROLLER_SURCTL_CLOSED_FORM=y\n" in config and "CONFIG_TASK_WDT=y\n" in config
