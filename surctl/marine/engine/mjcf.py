"""A vehicle in a scenario as MuJoCo model (`--target mjcf`); loading of MuJoCo, with its renderer (`MUJOCO_GL`)."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from math import cos, isfinite, pi, radians, sin, tan
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from surctl.errors import ToolMissing
from surctl.files import prepare_folder, write_file
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import shared_library
from surctl.ir.native import loaded
from surctl.marine.engine.fluid import Body, EngineOptions, body_of, environment, fluid_program
from surctl.marine.simulation.world import build_world
from surctl.marine.vehicle import WATER
from surctl.marine.vehicle.specs import AXES

if TYPE_CHECKING:
    from jinja2 import Template

    from surctl.marine.simulation import Obstacle, Scenario
    from surctl.marine.vehicle import Vehicle

# Load MuJoCo, which is optional, and the compiled force of the water


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
            problem, remedy = f"MuJoCo cannot be imported with this renderer ({error})", "set it to egl, osmesa or glfw"
            key = "environment variable MUJOCO_GL"
            raise ToolMissing(problem, key=key, value=renderer, remedy=f"{remedy}, or unset it") from None
        else:
            problem = f"the installation of mujoco is broken ({error})"
            remedy = "reinstall it: pip install --force-reinstall mujoco"
        raise ToolMissing(problem, key="--plant", value="mujoco", remedy=remedy) from None
    module: ModuleType = mujoco
    return module


_BOUND = files("surctl.marine.engine").joinpath("advance.c").read_text(encoding="utf-8")


def _callback_source(body: Body) -> str:
    """Return the C text that adds the force of the water in every evaluation of MuJoCo's integrator."""
    text = emit_block(fluid_program(body), symbol="surctl_fluid")
    return f"#include <math.h>\n\n{text}\n\n" + _BOUND.replace("DOF", str(body.options.dof))


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


HULL, OBSTACLE, THRUSTER = "hull", "obstacle/", "thruster/"
WALLS = ("wall/x0", "wall/x1", "wall/y0", "wall/y1")
_ACTUATORS = AXES[:4]

_TOP = 0.06  # [m] height of obstacles above the water, as that of the walls in the template


def mjcf(scenario: Scenario, vehicle: Vehicle, *, options: EngineOptions | None = None) -> str:
    """Return the MJCF model of a vehicle in a scenario as text.

    The model holds the hull as a sphere with mass, inertia and thrust, the walls and the floor of the site, and the
    obstacles as bodies that a program moves (mocap). Gravity is compensated on the hull. The force of the water is not
    part of the model: it is computed by `fluid_program`, which an exported model has beside it as `water.c`.

    The actuators `surge`, `sway`, `heave` and `yaw` are total forces [N] and the yaw moment [N m], in the point
    (xt, yt, zt) of the file. A vehicle with `[[thruster]]` tables has the actuators `thruster/NAME` after them: the
    force [N] of each thruster at its place; that of a swivelling thruster is two actuators, along `push` and, as
    `thruster/NAME/across`, at right angles to it. All actuators act together, so a program uses the ones or the others.

    Raises:
        InputError: the options need what the vehicle file does not state.

    Example:
        >>> from surctl.marine.engine import mjcf
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> text = mjcf(load_scenario("pool-behind"), load_vehicle("sur400"))
        >>> 'mass="50.0"' in text, 'name="obstacle/OM1"' in text
        (True, True)
    """
    body, radius = body_of(vehicle, options or EngineOptions()), vehicle["radius"]
    six, pose = body.options.dof == 6, scenario.start_pose.tolist()
    extent, down = max(0.55 * scenario.site[0] * 9 / 16, 0.56 * scenario.site[1]), radians(_DOWN)
    # MuJoCo's model has no factor 1/2: its coefficient of blunt drag is Cd / 2
    blunt = vehicle["Xuu"] / (WATER * pi * radius**2) if body.options.drag == "ellipsoid" else None
    return _scene().render(
        scenario=scenario, vehicle=vehicle, body=body, options=body.options, radius=radius, six=six, pose=pose,
        quat=(cos(pose[3] / 2), 0, 0, sin(pose[3] / 2)), density=WATER, blunt=blunt, lag=vehicle["thrust_lag"],
        extent=extent, high=extent / tan(radians(_OPENING / 2)), opening=_OPENING, down=(cos(down), sin(down)),
        obstacles=[_obstacle(one, scenario.site[2], radius) for one in scenario.obstacles],
        thrust=[vehicle.term(name) if six else 0.0 for name in ("xt", "yt", "zt")],
        thrusters=() if vehicle.actuators is None else vehicle.actuators.thrusters, actuators=_actuators(vehicle),
    )  # fmt: skip


@cache
def _scene() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # takes long

    environment = Environment(
        loader=PackageLoader("surctl.marine.engine", ""), undefined=StrictUndefined, finalize=_text, autoescape=False,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    return environment.get_template("scene.txt")


def _text(value: object) -> str:
    """Return a value of the template as the text of an attribute."""
    if isinstance(value, str):
        return escape(value, {'"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#09;"})
    if isinstance(value, Sequence):
        return " ".join(map(_text, value))
    return repr(float(value)) if isinstance(value, float) else str(value)


_OPENING = 48.0  # [deg] of the cameras, from top to bottom
_DOWN = 28.0  # [deg] by which the camera at the side looks down


def _obstacle(obstacle: Obstacle, depth: float, hull: float) -> tuple[str, Sequence[float], str, str, Sequence[float]]:
    # name, place, colour, shape and size
    low = obstacle.heights.bottom if isfinite(obstacle.heights.bottom) else -depth
    high = obstacle.heights.top if isfinite(obstacle.heights.top) else _TOP
    half = (high - low) / 2
    place, size = (*obstacle.centre_m, (low + high) / 2), (obstacle.radius_m or hull, half)
    colour = "0.8 0.3 0.22 1.0" if obstacle.shape == "moving" else "0.78 0.55 0.28 1.0"
    if obstacle.size_m is None:
        return f"{OBSTACLE}{obstacle.name}", place, colour, "cylinder", size
    edges = (obstacle.size_m[0] / 2, obstacle.size_m[1] / 2, half)
    return f"{OBSTACLE}{obstacle.name}", place, colour, "box", edges


def _actuators(vehicle: Vehicle) -> list[tuple[str, str, Sequence[float], Sequence[float]]]:
    # name, site, gear and limits; an axis without thrust has no gear, and neither it nor a fin has limits
    rows: list[tuple[str, str, Sequence[float], Sequence[float]]] = []
    for axis, (name, low, high) in enumerate(zip(_ACTUATORS, *vehicle.delivered_range.tolist(), strict=True)):
        gear = [int(low < high and place == (0, 1, 2, 5)[axis]) for place in range(6)]
        rows.append((name, "thrust", gear, (low, high) if low < high else ()))
    for one in () if vehicle.actuators is None else vehicle.actuators.thrusters:
        site = f"{THRUSTER}{one.name}"
        ends = zip(one.corners.min(axis=0).tolist(), one.corners.max(axis=0).tolist(), strict=True)
        for k, limits in enumerate(ends):
            gear = [*one.directions[:, k].tolist(), 0, 0, 0]
            # the limits of a fin grow with the speed
            rows.append((f"{site}/across" if k else site, site, gear, () if one.fin else limits))
    return rows


_TEXT = files("surctl.marine.engine").joinpath("water.txt").read_text(encoding="utf-8")


def write_mjcf(
    scenario: Scenario, vehicle: Vehicle, folder: Path, *, options: EngineOptions | None = None
) -> list[Path]:
    """Write the MuJoCo model `scene.xml` and the force of the water `water.c` to a folder, and return both paths."""
    build_world(scenario, vehicle, seed=0)  # refuses a start inside an obstacle
    prepare_folder(folder)
    body = body_of(vehicle, options or EngineOptions())
    lagged = vehicle["thrust_lag"] > 0
    text = _TEXT.format(
        vehicle=vehicle.name,
        scenario=scenario.name,
        block=emit_block(fluid_program(body), symbol="surctl_fluid"),
        parameters=_numbers(body.parameters.tolist()),
        environment=_numbers(environment(body, scenario, vehicle["radius"]).tolist()),
        joint="free" if body.options.dof == 6 else "x",
        actuator=_ACTUATORS[0],
        thrust="d->act + m->actuator_actadr[actuator]" if lagged else "d->ctrl + actuator",
        dof=body.options.dof,
    )
    model = mjcf(scenario, vehicle, options=body.options)
    return [write_file(folder / "scene.xml", model), write_file(folder / "water.c", text)]


def _numbers(values: list[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)
