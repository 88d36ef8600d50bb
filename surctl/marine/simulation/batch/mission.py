"""A path that is fed to the law, in the compiled loop: the window of the law, and the segments around the robot.

The parameters of a run contain the mission's table. Each control step copies from it the rows around the target point
and the rows around the robot, so the time of a step does not depend on the number of waypoints.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.ir import Call, Gather, Layout, Port, Program, Step, lower_named
from surctl.marine.control import ARC_LENGTHS, Law
from surctl.marine.guidance import AHEAD, ROW, SKIPS, Path, follow_on, window_next, window_values

__all__ = ["Mission", "capacity_for", "mission_table"]

_LEAST = 16  # waypoints: paths of similar length use the same compiled loop
_AROUND = SKIPS + 4  # rows around the robot: from the waypoint before its segment on


def capacity_for(path: Path) -> int:
    """Return the number of waypoints in the parameters of a run: a power of two if the path is fed, else 0."""
    if not path.fed:
        return 0
    return max(_LEAST, 1 << (len(path.waypoints) - 1).bit_length())


def mission_table(path: Path, capacity: int, *, visits: bool) -> NDArray[np.float64]:
    """Return `Path.table` with `capacity` rows (capacity, 5); the last waypoint fills the remaining rows."""
    table = path.table(visits=visits)
    return table[np.minimum(np.arange(capacity), len(table) - 1)]


class Mission:
    """The steps of a compiled loop that feed the law, and the expressions for the robot's progress.

    Args:
        law: the law of the loop.
        capacity: number of waypoints in the parameters, see `capacity_for`.
        rises: whether the path changes its depth.
    """

    def __init__(self, law: Law, capacity: int, *, rises: bool) -> None:
        self.law, self.capacity, self.rises = law, capacity, rises

    @staticmethod
    def state() -> Port:
        """Return the state that a run needs for the law's window: the number of the first waypoint in it."""
        return Port("first", (1,), "1", "number of the first waypoint in a row in the law's window", 1.0)

    def parameters(self, before: Layout) -> tuple[Port, ...]:
        """Return the entries that the mission adds to the parameters of a run, after the entries `before`."""
        return (
            Port("alignment", (-before.size % ROW,), "1", "not used: the table begins at a whole number of rows"),
            Port("mission", (self.capacity, ROW), "m, m/s, 1", "one waypoint per row, see Path.table"),
        )

    @property
    def around(self) -> tuple[str, ...]:
        """Names of the rows around the robot, which the end of the control step reads."""
        return tuple(f"around{k}" for k in range(_AROUND))

    @property
    def _window(self) -> tuple[str, ...]:
        return ("start", *(f"row{k}" for k in range(AHEAD + 1)), "end")

    def steps(self, state: Layout, parameters: Layout) -> tuple[Step, ...]:
        """Return the steps that read state `s` and parameters `w` and write `x`, `p`, `first_next` and the rows."""
        names = (*self._window, *self.around)
        return (
            Call(self._places(state, parameters), ("s", "w"), tuple(f"at_{name}" for name in names)),
            *(Gather("w", f"at_{name}", ROW, name) for name in names),
            Call(self._feed(state, parameters), ("s", "w", *self._window), ("x", "p", "first_next")),
        )

    def _places(self, state: Layout, parameters: Layout) -> Program:
        # numbers of the pieces of w
        s, old = state.symbols("s")
        w, known = parameters.symbols("w")
        base = parameters.slice("mission").start // ROW
        numbers = [ca.SX(0), *(old["first"] + k for k in range(AHEAD + 1)), known["legs"]]
        numbers += [old["leg"] - 1 + k for k in range(_AROUND)]
        names = (*self._window, *self.around)
        places = {
            f"at_{name}": base + ca.fmin(ca.fmax(number, 0), known["legs"])
            for name, number in zip(names, numbers, strict=True)
        }
        return lower_named("places", {"s": s, "w": w}, places)

    def _feed(self, state: Layout, parameters: Layout) -> Program:
        law = self.law
        s, old = state.symbols("s")
        w, known = parameters.symbols("w")
        rows = {name: ca.SX.sym(name, ROW) for name in self._window}
        x = law.state.split(old["law"])
        table = ca.vertcat(*(rows[f"row{k}"].T for k in range(AHEAD + 1)))
        last = ca.fmax(1, known["legs"] - AHEAD)
        first, shift = window_next(old["first"], x["progress"], table, rows["start"][:2], last)
        moved = first > old["first"]
        ahead = ca.if_else(moved, table[1:, :], table[:-1, :])
        window = ca.vertcat(rows["start"].T, ahead, rows["end"].T)
        x |= {name: x[name] + shift for name in ARC_LENGTHS if name in law.state}
        depth, cruise, visit = window_values(
            window, x["progress"], depth=known["depth"], cruise=known["cruise"], visit=known["visit"]
        )
        fed = {"waypoints": window[:, :2], "depth": depth, "cruise": cruise, "visit": visit}
        p = law.gains.join({port.name: fed.get(port.name, known[port.name]) for port in law.gains})
        outputs = {"x": law.state.join(x), "p": p, "first_next": first}
        return lower_named("feed", {"s": s, "w": w, **rows}, outputs)

    def progress(
        self, old: Mapping[str, ca.SX], w: Mapping[str, ca.SX], rows: Mapping[str, ca.SX]
    ) -> tuple[dict[str, ca.SX], ca.SX, ca.SX, ca.SX]:
        """Return the robot's progress as expressions: state of `follow_on`, segments near it, its own, z of the path.

        Args:
            old: state of the run.
            w: parameters of the run.
            rows: the rows around the robot by name.

        Returns:
            Next state of `follow_on`; waypoints around the robot (k, 2) [m]; number of its segment among them; z [m].
        """
        table = ca.vertcat(*(rows[name].T for name in self.around))
        following, moved = follow_on(old, table[1 : SKIPS + 3, :], w["legs"], old["plant"][:2], visit=w["visited"])
        a, b = table[1, :], table[2, :]
        for k in range(1, SKIPS + 1):
            a, b = ca.if_else(moved == k, table[k + 1, :], a), ca.if_else(moved == k, table[k + 2, :], b)
        length = ca.sqrt(ca.sumsqr(b[:2] - a[:2]))
        rise = a[2] + (b[2] - a[2]) * (following["along"] / ca.fmax(length, 1e-12))
        return following, table[:, :2], 1 + moved, w["depth"] + rise
