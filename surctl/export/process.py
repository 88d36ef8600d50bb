"""Compile the bundle here and run it as a process, or call its C in this process (`ExportedController`)."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import subprocess
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError
from surctl.export.bundle import Bundle, write_bundle
from surctl.export.contract import Exportable, command_size
from surctl.export.envelope import Records, Rows
from surctl.export.precision import in_precision
from surctl.export.rendering import templates
from surctl.ir.cache import FLAGS, cached_bytes, compile_program, compiler_version, find_compiler, further_flags
from surctl.ir.native import loaded

Vector = NDArray[np.float64]

_TIMEOUT = 600.0  # s, time limit of any run of the compiled program
_STEP = 0.05  # s more per step: enough for a law with sonars and software floating point in the emulator


@dataclass(frozen=True)
class FaultResults:
    """Results for K invalid numbers: status codes (K,), commands (K, n_tau), numbers of changed states (K,)."""

    status: NDArray[np.int64]
    tau: Vector
    changed: NDArray[np.int64]


@dataclass(frozen=True)
class Controller:
    """A compiled bundle.

    Attributes:
        law: the law in Python, in the bundle's precision.
        bundle: the bundle that was compiled.
        command: command that runs the compiled program.
        code_bytes: size of the controller's code and constants, None without the `size` tool.
    """

    law: Exportable
    bundle: Bundle
    command: tuple[str, ...]
    code_bytes: int | None

    def run(self, records: Records, *, load: NDArray[np.bool_]) -> Rows:
        """Run one step for each record, from the previous state or, where `load` (T,) is True, the recorded state."""
        return self.parsed(self.output(self.stream(records, load=load), len(records)), len(records))

    def stream(self, records: Records, *, load: NDArray[np.bool_]) -> bytes:
        """Return the records as input bytes of the program; the bytes depend on the precision, not on the target."""
        fresh = np.ones(len(records), dtype=bool)  # gains that equal those of the previous step are not sent again
        fresh[1:] = (records.P[1:] != records.P[:-1]).any(axis=1)
        parts: list[NDArray[np.float64]] = []
        for k, (with_state, with_gains) in enumerate(zip(load, fresh, strict=True)):
            parts.append(np.array([with_state + 2.0 * with_gains]))
            parts += [records.X[k]] * bool(with_state) + [records.U[k]] + [records.P[k]] * bool(with_gains)
        with np.errstate(over="ignore"):
            return np.concatenate(parts).astype(self._dtype).tobytes()

    def output(self, stream: bytes, count: int) -> bytes:
        """Run the program on the records in `stream`; return the bytes that the program writes."""
        return self._output([], stream, count, sum(self._widths))

    def parsed(self, raw: bytes, count: int) -> Rows:
        """Return the step results that the program wrote as bytes."""
        rows = self._rows(raw, count, sum(self._widths))
        status, tau, state, telemetry = np.split(rows, np.cumsum(self._widths)[:-1], axis=1)
        return Rows(status[:, 0].astype(np.int64), tau, state, telemetry)

    @property
    def _widths(self) -> tuple[int, int, int, int]:
        n_tau = command_size(self.law)
        return 1, n_tau, self.law.state.size, self.law.outputs.size - n_tau

    @property
    def _dtype(self) -> np.dtype[np.floating[Any]]:
        return np.dtype(self.bundle.real)

    def run_faults(self, record: Vector, at: Vector, values: Vector) -> FaultResults:
        """Run K steps, each from `record` (state, input, gains in one vector) with entry `at[k]` set to `values[k]`."""
        numbers = np.concatenate([record, np.column_stack([at, values]).ravel()])
        n_tau = command_size(self.law)
        with np.errstate(over="ignore"):
            sent = numbers.astype(self._dtype).tobytes()
        rows = self._rows(self._output(["--faults"], sent, len(at), 2 + n_tau), len(at), 2 + n_tau)
        status, changed = rows[:, 0].astype(np.int64), rows[:, 1 + n_tau].astype(np.int64)
        return FaultResults(status, rows[:, 1 : 1 + n_tau], changed)

    def _output(self, options: list[str], sent: bytes, count: int, width: int) -> bytes:
        # `count` results of `width` numbers each
        raw = _run([*self.command, *options], sent, count)
        if len(raw) != self._dtype.itemsize * count * width:
            raise SurctlError(f"{Path(self.command[0]).name} returned {len(raw)} bytes for {count} records")
        return raw

    def _rows(self, raw: bytes, count: int, width: int) -> Vector:
        return np.frombuffer(raw, dtype=self._dtype).astype(np.float64).reshape(count, width)

    def self_test(self) -> bool:
        """Run the built-in self-test; return whether it passes."""
        # captured: the caller's stdout may have to hold one JSON object and nothing else
        command = [*self.command, "--selftest"]
        done = subprocess.run(command, capture_output=True, check=False, timeout=_TIMEOUT)
        return done.returncode == 0


def build_controller(law: Exportable, bundle: Bundle, directory: Path) -> Controller:
    """Write the bundle to `directory`, compile it there, and return the compiled controller.

    Raises:
        ToolMissing: there is no compiler.
        SurctlError: the compiler reports an error.
        InputError: the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.export import build_controller
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.testing import cart_system
        >>> law = cart_system().controller
        >>> controller = build_controller(law, build_bundle(law, {"k": 1.0}), Path("brake"))
        >>> controller.bundle.name, [Path(word).name for word in controller.command]
        ('brake', ['sil'])
    """
    write_bundle(bundle, directory)
    directory = directory.resolve()
    code = compile_controller(bundle, directory)
    program = compile_program([directory / "sil_main.c", *code], directory / "sil")
    return Controller(in_precision(law, bundle.real, bundle.envelope), bundle, (str(program),), code_bytes(code))


def compile_controller(
    bundle: Bundle, folder: Path, *, flags: Sequence[str] = (), compiler: str | None = None
) -> list[Path]:
    """Compile the controller's files in a folder; return the object files of `bundle.sources`, then of the self-test.

    Raises:
        SurctlError: the compiler reports an error.
    """

    def compiled(file: str) -> Path:
        source = folder / file
        return compile_program([source], source.with_suffix(".o"), flags=("-c", *flags), compiler=compiler)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compiled, (*bundle.sources, bundle.selftest)))


def _run(command: list[str], data: bytes, steps: int) -> bytes:
    limit = _TIMEOUT + _STEP * steps
    try:
        done = subprocess.run(command, input=data, capture_output=True, check=False, timeout=limit)
    except subprocess.TimeoutExpired:
        raise SurctlError(f"{Path(command[0]).name} did not end within {limit:.0f} s") from None
    except OSError as error:
        raise SurctlError(f"{command[0]} cannot be run ({error.strerror})") from None
    if done.returncode != 0:
        raise SurctlError(f"{Path(command[0]).name} ended with status {done.returncode}")
    return done.stdout


def code_bytes(code: Sequence[Path], tool: str = "size") -> int | None:
    """Return how many bytes of code and constants object files contain, according to `size` or a target's `size`."""
    if which(tool) is None:
        return None
    done = subprocess.run([tool, *map(str, code)], capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    lines = done.stdout.splitlines()[1:]
    return sum(int(line.split()[0]) for line in lines) if done.returncode == 0 and lines else None


# The exported C with its guard, compiled as a library and called in this process


class ExportedStep(NamedTuple):
    """Result of one step of the exported C.

    Attributes:
        status: status code; a negative code is a refused step, whose commands are 0.
        tau: commands (n_tau,), for a law of the robot the thrust [N, N m].
        telemetry: telemetry (k,).
    """

    status: int
    tau: Vector
    telemetry: Vector


class ExportedController:
    """An exported bundle in double precision, compiled here; its state, gains and guard are those of the C.

    Raises:
        InputError: the bundle has single precision.
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.export import ExportedController
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.testing import cart_system
        >>> law = cart_system().controller
        >>> controller = ExportedController(law, build_bundle(law, {"k": 2.0}))
        >>> controller.step([0.5], 1).tau.tolist(), controller.step([float("nan")], 2).tau.tolist()
        ([-1.0], [0.0])
    """

    def __init__(self, law: Exportable, bundle: Bundle) -> None:
        if bundle.real != "float64":
            raise InputError("cannot be called in this process", key="real", value=bundle.real, remedy="use float64")
        self.law, self.bundle = law, bundle
        self._library = loaded(cached_bytes(_key(bundle), ".so", lambda: _compiled(bundle)))
        self._library.surctl_unit.restype = ctypes.c_void_p
        for function in (self._library.surctl_start, self._library.surctl_step):
            function.argtypes = [ctypes.c_void_p] * (1 if function is self._library.surctl_start else 3)
        self._input = (ctypes.c_double * (law.inputs.size + 1))()
        self._output = (ctypes.c_double * law.outputs.size)()
        if (
            self._library.surctl_sizes(0) != 8 * len(self._input)
            or self._library.surctl_sizes(1) != 8 * law.outputs.size
        ):
            raise SurctlError(f"{bundle.name}: the compiler lays out structs of doubles with unexpected padding")
        self._sample = ctypes.c_uint32.from_buffer(self._input, 8 * law.inputs.size)
        self._unit = ctypes.c_void_p(self._library.surctl_unit())
        self.reset()

    def reset(self) -> None:
        """Set the initial state and the tuned gains."""
        status = self._library.surctl_start(self._unit)
        if status != 0:
            raise SurctlError(f"{self.bundle.name}_initialize returned {status}")

    def step(self, u: Vector, sample: int) -> ExportedStep:
        """Run one guarded step with inputs u (nu,); `sample` counts control periods from 1, and may have gaps."""
        np.ctypeslib.as_array(self._input)[: len(u)] = u
        self._sample.value = sample % 2**32
        status = self._library.surctl_step(self._unit, ctypes.byref(self._input), ctypes.byref(self._output))
        numbers = np.array(self._output)
        size = command_size(self.law)
        return ExportedStep(int(status), numbers[:size], numbers[size:])


def _key(bundle: Bundle) -> str:
    parts = [f"{name}\0{bundle.files[name]}" for name in (*bundle.sources, *bundle.headers)]
    parts += [_library(bundle), *FLAGS, *further_flags(), find_compiler(), compiler_version(), platform.platform()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _library(bundle: Bundle) -> str:
    return templates().get_template("library.c.j2").render(name=bundle.name)


def _compiled(bundle: Bundle) -> bytes:
    with tempfile.TemporaryDirectory(prefix="surctl-") as scratch:
        folder = Path(scratch)
        for name in (*bundle.sources, *bundle.headers):
            (folder / name).write_text(bundle.files[name], encoding="utf-8")
        (folder / "unit.c").write_text(_library(bundle), encoding="utf-8")
        code = [folder / name for name in ("unit.c", *bundle.sources)]
        return compile_program(code, folder / "unit.so", flags=("-shared", "-fPIC")).read_bytes()
