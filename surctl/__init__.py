"""The package `surctl`: its version, and the way from and to systems of python-control.

Write a control law once, then simulate, tune and prove it, and export it as C: a toolkit in Python, with an underwater
robot as its reference application.
"""

from importlib import import_module
from typing import Any

__version__ = "1.0.0"

__all__ = ["__version__", "from_control", "to_control"]


def from_control(system: Any, controller: Any = None, *, dt: float | None = None) -> Any:
    """Return a python-control system as a plant or controller, or with a controller as a closed loop.

    See `surctl.system.from_control`.
    """
    return import_module("surctl.system").from_control(system, controller, dt=dt)


def to_control(part: Any) -> Any:
    """Return a plant, controller or linear loop as a python-control system; see `surctl.system.from_control`."""
    return import_module("surctl.system").to_control(part)
