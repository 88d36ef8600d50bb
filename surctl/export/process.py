"""Build the exported bundle with the system's compiler, and run it as a process."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from shutil import which

import numpy as np
from numpy.typing import NDArray

from surctl.errors import SurctlError
from surctl.export.bundle import Bundle, write_bundle
from surctl.export.contract import Exportable, thrust
from surctl.export.records import Records
from surctl.ir import compile_program

__all__ = ["Controller", "FaultResults", "Results", "build_controller"]

Vector = NDArray[np.float64]

_TIMEOUT = 600.0  # s, for any run of the compiled program


@dataclass(frozen=True)
class Results:
    """What the compiled controller returned, row by row.

    Attributes:
        status: (T,).
        tau: (T, n_tau) [N, N m].
        state: state after each step (T, nx).
        telemetry: (T, k).
    """

    status: NDArray[np.int64]
    tau: Vector
    state: Vector
    telemetry: Vector


@dataclass(frozen=True)
class FaultResults:
    """What the compiled controller returned to one faulty number after the other.

    Attributes:
        status: (K,).
        tau: (K, n_tau) [N, N m].
        changed: numbers of the state that the step changed (K,).
    """

    status: NDArray[np.int64]
    tau: Vector
    changed: NDArray[np.int64]


@dataclass(frozen=True)
class Controller:
    """A compiled bundle.

    Attributes:
        law: the law it was made from.
        bundle: what was compiled.
        program: the executable.
        code_bytes: size of the controller's code and constants, None without the `size` tool.
    """

    law: Exportable
    bundle: Bundle
    program: Path
    code_bytes: int | None

    def run(self, records: Records, *, load: NDArray[np.bool_]) -> Results:
        """Step through the records; where `load` (T,) is set, the state is taken from the record."""
        rest = np.column_stack([load.astype(float), records.U, records.P]).astype(np.float64)
        loaded = [(row[:1], x, row[1:]) if at else (row,) for at, x, row in zip(load, records.X, rest, strict=True)]
        given = b"".join(np.asarray(part, dtype=np.float64).tobytes() for row in loaded for part in row)
        sizes = (1, thrust(self.law).size, self.law.state.size, self.law.outputs.size - thrust(self.law).size)
        rows = self._answer([], given, len(records), sum(sizes))
        status, tau, state, telemetry = np.split(rows, np.cumsum(sizes)[:-1], axis=1)
        return Results(status[:, 0].astype(np.int64), tau, state, telemetry)

    def run_faults(self, record: Vector, at: Vector, values: Vector) -> FaultResults:
        """A step from `record` (state, input, gains end to end) for each entry `at` (K,), with `values` (K,) there."""
        given = np.concatenate([record, np.column_stack([at, values]).ravel()]).astype(np.float64)
        n_tau = thrust(self.law).size
        rows = self._answer(["--faults"], given.tobytes(), len(at), 2 + n_tau)
        status, changed = rows[:, 0].astype(np.int64), rows[:, 1 + n_tau].astype(np.int64)
        return FaultResults(status, rows[:, 1 : 1 + n_tau], changed)

    def _answer(self, options: list[str], given: bytes, count: int, width: int) -> Vector:
        """`count` rows of `width` numbers from the program."""
        raw = _run([str(self.program), *options], given)
        if len(raw) != 8 * count * width:
            raise SurctlError(f"{self.program.name} returned {len(raw)} bytes for {count} records")
        return np.frombuffer(raw, dtype=np.float64).reshape(count, width)

    def self_test(self) -> bool:
        """Whether the built-in vectors pass."""
        # captured: the caller's stdout may have to hold one JSON object and nothing else
        command = [str(self.program), "--selftest"]
        done = subprocess.run(command, capture_output=True, check=False, timeout=_TIMEOUT)
        return done.returncode == 0


def build_controller(law: Exportable, bundle: Bundle, directory: Path) -> Controller:
    """Write the bundle to `directory` and compile it there.

    Raises:
        ToolMissing: there is no compiler.
        SurctlError: the compiler refuses the bundle.
        InputError: the folder cannot be written.
    """
    write_bundle(bundle, directory)
    directory = directory.resolve()
    code = directory / f"{bundle.name}.o"
    compile_program([directory / f"{bundle.name}.c"], code, flags=("-c",))
    program = compile_program([directory / "sil_main.c", code], directory / "sil")
    return Controller(law, bundle, program, _code_bytes(code))


def _run(command: list[str], data: bytes) -> bytes:
    try:
        done = subprocess.run(command, input=data, capture_output=True, check=False, timeout=_TIMEOUT)
    except subprocess.TimeoutExpired:
        raise SurctlError(f"{Path(command[0]).name} did not end within {_TIMEOUT:.0f} s") from None
    except OSError as error:
        raise SurctlError(f"{command[0]} cannot be run ({error.strerror})") from None
    if done.returncode != 0:
        raise SurctlError(f"{Path(command[0]).name} ended with status {done.returncode}")
    return done.stdout


def _code_bytes(code: Path) -> int | None:
    """The `text` column (code and constants) of the `size` tool."""
    tool = which("size")
    if tool is None:
        return None
    done = subprocess.run([tool, str(code)], capture_output=True, text=True, check=False, timeout=_TIMEOUT)
    lines = done.stdout.splitlines()
    return int(lines[1].split()[0]) if done.returncode == 0 and len(lines) > 1 else None
