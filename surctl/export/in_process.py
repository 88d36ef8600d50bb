"""The exported C with its guard, compiled as a library and called in this process."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError
from surctl.export.bundle import Bundle
from surctl.export.contract import Exportable, command_size
from surctl.ir import cached_bytes, compile_program, compiler_version, find_compiler
from surctl.ir.compiler import FLAGS, further_flags
from surctl.ir.native import loaded

__all__ = ["ExportedController", "ExportedStep"]

Vector = NDArray[np.float64]

_SHIM = """\
#include "{name}.h"
#include <stdlib.h>

typedef struct {{ {name}_state_t state; {name}_gains_t gains; }} surctl_unit_t;

void *surctl_unit(void);
int surctl_start(void *unit);
int surctl_step(void *unit, const void *input, void *output);
int surctl_sizes(int which);

void *surctl_unit(void) {{ return calloc(1, sizeof(surctl_unit_t)); }}
int surctl_start(void *unit)
{{
    surctl_unit_t *const one = (surctl_unit_t *)unit;
    return {name}_initialize(&one->state, &one->gains);
}}
int surctl_step(void *unit, const void *input, void *output)
{{
    surctl_unit_t *const one = (surctl_unit_t *)unit;
    return {name}_step(&one->state, &one->gains, (const {name}_input_t *)input, ({name}_output_t *)output);
}}
int surctl_sizes(int which) {{ return which ? (int)sizeof({name}_output_t) : (int)sizeof({name}_input_t); }}
"""


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
        >>> import numpy as np
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.export import ExportedController
        >>> from surctl.marine.export import build_bundle, operating_envelope
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> within = operating_envelope(law, mission, vehicle, law.gains, tuned=p)
        >>> controller = ExportedController(law, build_bundle(law, law.gains.unpack(p), envelope=within))
        >>> u = law.inputs.pack({"eta": [0.5, 1.0, -0.15, 0.0]})
        >>> float(controller.step(u, 1).tau[0]) > 1.0, controller.step(np.nan * u, 2).tau.tolist()
        (True, [0.0, 0.0, 0.0, 0.0])
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
        """Run one guarded step.

        Args:
            u: inputs of the law (nu,).
            sample: number of the control period, from 1; a gap is the time that has passed.
        """
        np.ctypeslib.as_array(self._input)[: len(u)] = u
        self._sample.value = sample % 2**32
        status = self._library.surctl_step(self._unit, ctypes.byref(self._input), ctypes.byref(self._output))
        numbers = np.array(self._output)
        size = command_size(self.law)
        return ExportedStep(int(status), numbers[:size], numbers[size:])


def _key(bundle: Bundle) -> str:
    parts = [f"{name}\0{bundle.files[name]}" for name in (*bundle.sources, *bundle.headers)]
    parts += [_SHIM, *FLAGS, *further_flags(), find_compiler(), compiler_version(), platform.platform()]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _compiled(bundle: Bundle) -> bytes:
    with tempfile.TemporaryDirectory(prefix="surctl-") as scratch:
        folder = Path(scratch)
        for name in (*bundle.sources, *bundle.headers):
            (folder / name).write_text(bundle.files[name], encoding="utf-8")
        (folder / "unit.c").write_text(_SHIM.format(name=bundle.name), encoding="utf-8")
        code = [folder / name for name in ("unit.c", *bundle.sources)]
        return compile_program(code, folder / "unit.so", flags=("-shared", "-fPIC")).read_bytes()
