"""Load MuJoCo, which is optional, and the compiled force of the water."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing
from surctl.ir import emit_block, shared_library
from surctl.ir.native import loaded
from surctl.marine.engine.fluid import Body, fluid_program

__all__ = ["mujoco_library", "no_renderer", "stepper"]

_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def _choose_renderer() -> None:
    """Let MuJoCo render without a screen where there is none; it reads MUJOCO_GL when it is first imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if "mujoco" in sys.modules or os.environ.get("MUJOCO_GL") or screen or not sys.platform.startswith("linux"):
        return
    for name, library in _LIBRARIES.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        os.environ["MUJOCO_GL"] = name
        return


def no_renderer(why: str) -> ToolMissing:
    """Return the error that nothing renders without a screen."""
    return ToolMissing(
        f"MuJoCo cannot render here ({why})",
        key="--film",
        remedy="install Mesa (Debian: apt install libegl1 libgl1-mesa-dri) and set MUJOCO_GL=egl",
    )


def _wrong_renderer(value: str, why: str) -> ToolMissing:
    """Return the error that MuJoCo cannot be imported with a value of the environment variable MUJOCO_GL."""
    return ToolMissing(
        f"MuJoCo cannot be imported with this renderer ({why})",
        key="environment variable MUJOCO_GL",
        value=value,
        remedy="set it to egl, osmesa or glfw, or unset it",
    )


Array = NDArray[np.float64]


@cache
def mujoco_library() -> ModuleType:
    """Return the module `mujoco`.

    Raises:
        ToolMissing: it is not installed, its installation is broken, or MUJOCO_GL names no renderer of it.
    """

    renderer = os.environ.get("MUJOCO_GL", "")
    _choose_renderer()
    try:
        import mujoco

        mujoco.MjModel.from_xml_string  # noqa: B018  # an empty package has none
    except Exception as error:  # MuJoCo and PyOpenGL raise errors of many classes
        if isinstance(error, ModuleNotFoundError) and error.name == "mujoco":
            problem, remedy = "needs MuJoCo, which is not installed", "pip install 'surctl[mujoco]'"
        elif renderer and "mujoco" not in sys.modules:
            raise _wrong_renderer(renderer, str(error)) from None
        else:
            problem = f"the installation of mujoco is broken ({error})"
            remedy = "reinstall it: pip install --force-reinstall mujoco"
        raise ToolMissing(problem, key="--plant", value="mujoco", remedy=remedy) from None
    module: ModuleType = mujoco
    return module


_BOUND = """
typedef void (*callback)(const void *model, void *data);
typedef void (*listener)(const char *text);
static const double *now_q, *now_v, *now_thrust, *now_p, *now_e;
static double *now_force;

static void water(const void *model, void *data)
{
    double force[DOF];
    (void)model;
    (void)data;
    surctl_fluid(now_q, now_v, now_thrust, now_p, now_e, force);
    for (int k = 0; k < DOF; ++k) {
        now_force[k] += force[k];
    }
}

static void quiet(const char *text)
{
    (void)text;
}

void surctl_advance(callback step, callback *slot, listener *warned, const void *model, void *data, long count,
                    const double *q, const double *v, const double *thrust, const double *p, const double *e,
                    double *force);
void surctl_advance(callback step, callback *slot, listener *warned, const void *model, void *data, long count,
                    const double *q, const double *v, const double *thrust, const double *p, const double *e,
                    double *force)
{
    const callback before = *slot;
    const listener usual = *warned;
    now_q = q;
    now_v = v;
    now_thrust = thrust;
    now_p = p;
    now_e = e;
    now_force = force;
    *slot = water;
    *warned = quiet;  /* MuJoCo would write to MUJOCO_LOG.TXT; the number of warnings is in the data */
    for (long k = 0; k < count; ++k) {
        step(model, data);
    }
    *slot = before;
    *warned = usual;
}
"""


def _callback_source(body: Body) -> str:
    """Return the C text that adds the force of the water in every evaluation of MuJoCo's integrator."""
    text = emit_block(fluid_program(body), symbol="surctl_fluid")
    return f"#include <math.h>\n\n{text}\n" + _BOUND.replace("DOF", str(body.options.dof))


def stepper(body: Body) -> Callable[..., Callable[[], None]]:
    """Return the compiled function that steps MuJoCo with the force of the water.

    Called with model, data, number of steps, and the arrays `thrust`, `parameters` and `environment`, it returns the
    function without arguments that steps this model. The arrays are read at every step.

    Raises:
        ToolMissing: MuJoCo or a C compiler is not installed.
    """
    mujoco = mujoco_library()
    library = loaded(shared_library(_callback_source(body)))
    engine = _engine(str(mujoco.__file__))
    function = library.surctl_advance
    function.restype = None
    function.argtypes = [*[ctypes.c_void_p] * 5, ctypes.c_long, *[ctypes.c_void_p] * 6]
    step = ctypes.cast(engine.mj_step, ctypes.c_void_p).value
    slot = ctypes.addressof(ctypes.c_void_p.in_dll(engine, "mjcb_passive"))
    warned = ctypes.addressof(ctypes.c_void_p.in_dll(engine, "mju_user_warning"))

    def bound(
        model: Any, data: Any, count: int, *, thrust: Array, parameters: Array, environment: Array
    ) -> Callable[[], None]:
        places = (data.qpos, data.qvel, thrust, parameters, environment, data.qfrc_passive)
        addresses = [one.ctypes.data for one in places]
        references = library, model, data, places  # as long as the function is used

        def run() -> None:
            function(step, slot, warned, references[1]._address, references[2]._address, count, *addresses)

        return run

    return bound


@cache
def _engine(module: str) -> ctypes.CDLL:
    # the shared library that the Python module has loaded: libmujoco.so.VERSION, libmujoco.VERSION.dylib, mujoco.dll
    files = [file for file in Path(module).parent.iterdir() if "mujoco" in file.name and file.is_file()]
    return ctypes.CDLL(str(next(file for file in files if {".so", ".dylib", ".dll"} & set(file.suffixes))))
