"""Choose what renders MuJoCo's pictures where there is no screen."""

from __future__ import annotations

import ctypes
import os
import sys

from surctl.errors import ToolMissing

__all__ = ["choose_renderer", "no_renderer", "wrong_renderer"]

_LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}


def choose_renderer() -> None:
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


def wrong_renderer(value: str, why: str) -> ToolMissing:
    """Return the error that MuJoCo cannot be imported with a value of the environment variable MUJOCO_GL."""
    return ToolMissing(
        f"MuJoCo cannot be imported with this renderer ({why})",
        key="environment variable MUJOCO_GL",
        value=value,
        remedy="set it to egl, osmesa or glfw, or unset it",
    )
