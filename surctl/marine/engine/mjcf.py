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
from xml.etree import ElementTree

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

_THICK = 0.1  # [m] of walls and floor
_TOP = 0.06  # [m] height of walls above the water
_Node = ElementTree.Element


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
    body = body_of(vehicle, options or EngineOptions())
    root = ElementTree.Element("mujoco", model=f"{scenario.name}-{vehicle.name}")
    _node(root, "compiler", angle="radian", autolimits="false")
    water = {"density": str(WATER)} if body.options.drag == "ellipsoid" else {}
    _node(root, "option", timestep=body.options.step, integrator="RK4", gravity=(0, 0, -9.81), **water)
    _look(root, scenario)
    world = _node(root, "worldbody")
    _site(world, scenario)
    for obstacle in scenario.obstacles:
        _obstacle(world, obstacle, scenario, vehicle["radius"])
    _hull(world, scenario, vehicle, body)
    _thrusters(root, vehicle)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _node(parent: _Node, tag: str, **attributes: object) -> _Node:
    return ElementTree.SubElement(
        parent, tag, {key.rstrip("_"): _text(value) for key, value in attributes.items() if value is not None}
    )


def _text(value: object) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " ".join(map(_text, value))
    return repr(float(value)) if isinstance(value, float) else str(value)


def _look(root: _Node, scenario: Scenario) -> None:
    length, width, _ = scenario.site
    far = max(length, width)
    visual = _node(root, "visual")
    _node(visual, "global", offwidth=1280, offheight=720)
    _node(visual, "quality", shadowsize=0, offsamples=0)
    _node(visual, "headlight", ambient=(0.38, 0.42, 0.45), diffuse=(0.35, 0.38, 0.4), specular=(0.1, 0.1, 0.1))
    _node(visual, "map", znear=0.005, zfar=20.0, fogstart=0.35 * far, fogend=2.2 * far)
    _node(visual, "rgba", fog=(0.10, 0.30, 0.38, 1.0), haze=(0.10, 0.30, 0.38, 1.0))
    _node(root, "statistic", extent=far, center=(length / 2, width / 2, 0.0))
    asset = _node(root, "asset")
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": (0.55, 0.75, 0.82), "rgb2": (0.06, 0.20, 0.27)}
    _node(asset, "texture", name="water", width=64, height=64, **sky)
    tiles = {"type": "2d", "builtin": "checker", "rgb1": (0.20, 0.42, 0.50), "rgb2": (0.24, 0.47, 0.55)}
    _node(asset, "texture", name="tiles", width=256, height=256, **tiles)
    _node(asset, "material", name="tiles", texture="tiles", texrepeat=(2 * length, 2 * width), reflectance=0.0)


def _site(world: _Node, scenario: Scenario) -> None:
    length, width, depth = scenario.site
    half = (depth + _TOP) / 2
    middle = _TOP - half
    for x, y in ((0.25, 0.3), (0.75, 0.7)):
        place = {"pos": (x * length, y * width, 3.0), "dir": (0, 0, -1)}
        _node(world, "light", diffuse=(0.35, 0.4, 0.4), castshadow="false", **place)
    thick = _THICK / 2
    middles = ((-thick, width / 2), (length + thick, width / 2), (length / 2, -thick), (length / 2, width + thick))
    sizes = ((thick, width / 2 + _THICK), (thick, width / 2 + _THICK), (length / 2, thick), (length / 2, thick))
    for name, centre, size in zip(WALLS, middles, sizes, strict=True):
        box = {"pos": (*centre, middle), "size": (*size, half)}
        _node(world, "geom", name=name, type="box", rgba=(0.62, 0.76, 0.80, 0.30), **box)
    floor = {"pos": (length / 2, width / 2, -depth - thick), "size": (length / 2, width / 2, thick)}
    _node(world, "geom", name="floor", type="box", material="tiles", **floor)
    surface = {"pos": (length / 2, width / 2, 0.0), "size": (length / 2, width / 2, 0.1)}
    look = {"rgba": (0.55, 0.80, 0.95, 0.10), "contype": 0, "conaffinity": 0, "group": 3}
    _node(world, "geom", name="surface", type="plane", zaxis=(0, 0, -1), **surface, **look)
    # both cameras see the whole site in pictures of 16 to 9; without perspective, the view from above shows true gaps,
    # but MuJoCo takes no such picture that is higher than 180 m
    extent = max(0.55 * length * 9 / 16, 0.56 * width)
    high = extent / tan(radians(_OPENING / 2))
    above = (length / 2, width / 2, high)
    flat = {"projection": "orthographic", "fovy": 2 * extent} if extent < 90.0 else {"fovy": _OPENING}
    _node(world, "camera", name="above", pos=above, xyaxes=(1, 0, 0, 0, 1, 0), **flat)
    down, back = radians(_DOWN), 1.25 * high
    side = (length / 2, width / 2 - back * cos(down), back * sin(down))
    _node(world, "camera", name="side", pos=side, xyaxes=(1, 0, 0, 0, sin(down), cos(down)), fovy=_OPENING)


_OPENING = 48.0  # [deg] of the cameras, from top to bottom
_DOWN = 28.0  # [deg] by which the camera at the side looks down


def _obstacle(world: _Node, obstacle: Obstacle, scenario: Scenario, hull: float) -> None:
    low = obstacle.heights.bottom if isfinite(obstacle.heights.bottom) else -scenario.site[2]
    high = obstacle.heights.top if isfinite(obstacle.heights.top) else _TOP
    body = _node(
        world, "body", name=f"{OBSTACLE}{obstacle.name}", mocap="true", pos=(*obstacle.centre_m, (low + high) / 2)
    )
    half = (high - low) / 2
    if obstacle.size_m is not None:
        shape: dict[str, object] = {"type": "box", "size": (obstacle.size_m[0] / 2, obstacle.size_m[1] / 2, half)}
    else:
        shape = {"type": "cylinder", "size": (obstacle.radius_m or hull, half)}
    colour = (0.80, 0.30, 0.22, 1.0) if obstacle.shape == "moving" else (0.78, 0.55, 0.28, 1.0)
    _node(body, "geom", name=f"{OBSTACLE}{obstacle.name}", rgba=colour, **shape)


def _hull(world: _Node, scenario: Scenario, vehicle: Vehicle, body: Body) -> None:
    x, y, z, heading = (float(value) for value in scenario.start_pose)
    six = body.options.dof == 6
    place: dict[str, object] = {"pos": (x, y, z), "quat": (cos(heading / 2), 0, 0, sin(heading / 2))} if six else {}
    hull = _node(world, "body", name=HULL, gravcomp=1, **place)
    if six:
        _node(hull, "freejoint", name="free")
    else:
        for name, axis in zip("xyz", ((1, 0, 0), (0, 1, 0), (0, 0, 1)), strict=True):
            _node(hull, "joint", name=name, type="slide", axis=axis)
        _node(hull, "joint", name="heading", type="hinge", axis=(0, 0, 1))
    _node(hull, "inertial", pos=(0, 0, 0), mass=body.mass, diaginertia=body.inertia)
    radius = vehicle["radius"]
    fluid: dict[str, object] = {}
    if body.options.drag == "ellipsoid":
        # MuJoCo's model has no factor 1/2: its coefficient of blunt drag is Cd / 2
        blunt = vehicle["Xuu"] / (WATER * pi * radius**2)
        fluid = {"fluidshape": "ellipsoid", "fluidcoef": (blunt, 0.0, 0.0, 0.0, 0.0)}
    _node(hull, "geom", name=HULL, type="sphere", size=(radius,), rgba=(0.95, 0.80, 0.15, 1.0), **fluid)
    visual = {"contype": 0, "conaffinity": 0, "mass": 0}
    band = {"size": (1.004 * radius, 0.05 * radius), "rgba": (0.15, 0.15, 0.18, 1.0)}
    _node(hull, "geom", name="band", type="cylinder", **band, **visual)
    nose = {"pos": (0.97 * radius, 0, 0), "size": (0.16 * radius,), "rgba": (0.85, 0.20, 0.15, 1.0)}
    _node(hull, "geom", name="nose", type="sphere", **nose, **visual)
    names = ("xt", "yt", "zt")
    thrust = [vehicle[name] if six and name in vehicle.parameters else 0.0 for name in names]
    _node(hull, "site", name="thrust", pos=thrust, size=(0.05 * radius,))
    for one in () if vehicle.actuators is None else vehicle.actuators.thrusters:
        _node(hull, "site", name=f"{THRUSTER}{one.name}", pos=one.at, size=(0.05 * radius,))
    front = (1.15 * radius, 0, 0.25 * radius)
    _node(hull, "camera", name="nose", pos=front, xyaxes=(0, -1, 0, 0, 0, 1), fovy=75.0)


def _thrusters(root: _Node, vehicle: Vehicle) -> None:
    actuators = _node(root, "actuator")
    lag = vehicle["thrust_lag"]
    filtered: dict[str, object] = {"dyntype": "filter", "dynprm": (lag,)} if lag > 0 else {}
    for axis, (name, low, high) in enumerate(zip(_ACTUATORS, *vehicle.delivered_range, strict=True)):
        gear = [0] * 6
        gear[axis if axis < 3 else 5] = 1
        limits: dict[str, object] = {}
        if low < high:
            limits = {"ctrllimited": "true", "ctrlrange": (float(low), float(high))}
        else:
            gear = [0] * 6
        _node(actuators, "general", name=name, site="thrust", gear=gear, gainprm=(1,), **limits, **filtered)
    for one in () if vehicle.actuators is None else vehicle.actuators.thrusters:
        site, ends = f"{THRUSTER}{one.name}", zip(one.corners.min(axis=0), one.corners.max(axis=0), strict=True)
        for k, (low, high) in enumerate(ends):
            gear = [*one.directions[:, k].tolist(), 0, 0, 0]
            # the limits of a fin grow with the speed
            limits = {} if one.fin else {"ctrllimited": "true", "ctrlrange": (float(low), float(high))}
            name = f"{site}/across" if k else site
            _node(actuators, "general", name=name, site=site, gear=gear, gainprm=(1,), **limits, **filtered)


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
