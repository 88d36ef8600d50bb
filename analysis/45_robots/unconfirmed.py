"""Why steps at 1 kHz are not shown to be optimal: some of them, solved again in Python, with the state of the search.

python analysis/45_robots/unconfirmed.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from reach import drawn_targets, reach
from robots import CASES, DAMPING, Case, subject

from surctl.ir.procedure import _Memory
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.shapes import StackShape
from surctl.priority.solver.fallback import UNCONFIRMED

Array: TypeAlias = NDArray[np.float64]

EVERY, DT = 12, 1e-3  # every 12th such step is solved again
ROBOT, TARGETS = CASES[1], (4, 19)


class _Watched(_Memory):
    """Memory of the solver that notes, when it finds no proof, how far a limit is from depending on the others."""

    def __setattr__(self: Any, name: str, value: Any) -> None:
        super().__setattr__(name, value)
        if name == "sure" and value == 0 and self.reached and not hasattr(self, "distance"):
            super().__setattr__("distance", min(abs(self.L[i * self.x + i]) for i in range(self.f, self.w)))
            super().__setattr__("multiplier", max(abs(self.lam[i]) for i in range(self.f, self.w)))


def main() -> None:
    """Print a row for each target."""
    columns = ("robot", "target", "unconfirmed", "solved again: not shown, search ended, shown")
    print("| " + " | ".join((*columns, "distance: median, least", "multiplier: median, most")) + " |")
    print("|---|---|---|---|---|---|")
    for number in TARGETS:
        print(_row(ROBOT, number), flush=True)


def _row(case: Case, number: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        robot = subject(case, Path(folder))
        control = robot.controller(DT)
    law = control.controller
    assembly = control._assembly
    solver = hierarchy(StackShape(robot.robot.nv, assembly.shapes), len(assembly.limits), damped=True)
    count, ended, shown, distances, multipliers = 0, 0, 0, [], []

    def step(q: Array, _: Array, poses: list[Array]) -> tuple[Array, str]:
        nonlocal count, ended, shown
        v = control.step(q, **{f"tool{k}": pose for k, pose in enumerate(poses)})
        if control.stage == "unconfirmed":
            count += 1
            if count % EVERY == 0:
                x, u, p = np.split(control._before()[0], np.cumsum([law.state.size, law.inputs.size]))
                values = {**law.inputs.unpack(u), **law.gains.unpack(p), "v": x, "dt": DT}
                problem = [np.array(part).reshape(-1) for part in assembly.function.call(assembly._checked(values))]
                arrays = [list(map(float, array)) for array in (*problem[:-1], [DAMPING])]
                s: Any = _Watched({**dict(solver.sizes), **solver._space(arrays)})
                solver._entry(s)
                if hasattr(s, "distance"):
                    distances.append(s.distance)
                    multipliers.append(s.multiplier)
                elif s.status[0] == UNCONFIRMED:
                    ended += 1
                else:
                    shown += 1  # the last bits of the problem decide
        return v, control.stage

    reach(robot, [drawn_targets(robot, number + 1, 45)[number]], step, DT, control.reset)
    small = f"{np.median(distances):.0e}, {min(distances):.0e}" if distances else ""
    large = f"{np.median(multipliers):.0e}, {max(multipliers):.0e}" if multipliers else ""
    return f"| {case.name} | {number} | {count} | {len(distances)}, {ended}, {shown} | {small} | {large} |"


if __name__ == "__main__":
    main()
