"""Feed a law with the window of its mission before each control step: waypoints, depth, speed, corners to visit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.marine.guidance import Window

Vector = NDArray[np.float64]

ARC_LENGTHS = ("progress", "furthest", "beyond")
"""Entries of a law's state that are arc lengths of its path, and so change when the window moves."""

FED = ("waypoints", "depth", "cruise", "visit")
"""Parameters of a law that its host feeds during a mission."""


class Feeder:
    """The host of a law during one mission: it moves the window and writes the law's parameters.

    Args:
        table: (n, 5) one row for each waypoint, see `Path.table`.
        state: layout of the law's state.
        parameters: layout of the law's parameters.
        p: parameters of the mission; `depth`, `cruise` and `visit` are the mission's own, see `guidance.Window`.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.control import Feeder, build_law
        >>> from surctl.marine.guidance import Path
        >>> law, path = build_law("closed_form"), Path([[k // 2, (k + 1) // 2] for k in range(12)])
        >>> p = law.gains.pack({"waypoints": path.slots, "depth": -1.0, "cruise": 0.2})
        >>> feeder = Feeder(path.table(), law.state, law.gains, p)
        >>> x, fed = feeder.feed(law.state.pack({"progress": 3.5}))
        >>> float(x[law.state.slice("progress")][0]), fed[law.gains.slice("waypoints")][2:4].tolist()
        (2.914213562373095, [1.0, 1.0])
    """

    def __init__(self, table: Vector, state: Layout, parameters: Layout, p: Vector) -> None:
        def number(name: str) -> float:
            return float(p[parameters.slice(name)][0])

        self._window = Window(table, depth=number("depth"), cruise=number("cruise"), visit=number("visit"))
        self._progress = state.slice("progress").start
        self._arcs = [state.slice(name).start for name in ARC_LENGTHS if name in state]
        self._slices = {name: parameters.slice(name) for name in FED}
        self._base, self._waypoints = p, self._window.waypoints().ravel()

    def feed(self, x: Vector) -> tuple[Vector, Vector]:
        """Return the state of the law and its parameters for the next control step."""
        first, shift = self._window.first, self._window.move(float(x[self._progress]))
        if self._window.first != first:  # the shift is 0 where the path goes straight on
            x = x.copy()
            x[self._arcs] += shift
            self._waypoints = self._window.waypoints().ravel()
        p = self._base.copy()
        p[self._slices["waypoints"]] = self._waypoints
        values = self._window.values(float(x[self._progress]))
        for name, value in zip(FED[1:], values, strict=True):
            p[self._slices[name]] = value
        return x, p
