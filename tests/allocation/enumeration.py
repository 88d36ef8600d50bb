"""An exhaustive reference for the allocation of fixed thrusters: every set of active limits is tried."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle import Actuators

Array = NDArray[np.float64]

_FEASIBLE = 1e-10  # [N] allowed violation of a limit by rounding


class Enumeration:
    """The lexicographic optimum (yaw, force, effort) of one wrench, by all 3^n combinations of limits.

    With some thrusters at a limit and the others free, each level is a linear least-squares problem, whose solution is
    an affine function of the wrench. The optimum is the best of the solutions within all limits.
    """

    def __init__(self, actuators: Actuators, working: Array | None = None) -> None:
        self.B = actuators.matrix
        on = np.ones(len(actuators.thrusters)) if working is None else working
        self.low = -on * np.array([t.reverse for t in actuators.thrusters])
        self.high = on * np.array([t.forward for t in actuators.thrusters])
        choices = [(None, low, high) for low, high in zip(self.low, self.high, strict=True)]
        choices = [c if c[1] != c[2] else (c[1],) for c in choices]
        forces, efforts = [], []
        for limits in product(*choices):
            free = [k for k, limit in enumerate(limits) if limit is None]
            at = np.array([0.0 if limit is None else limit for limit in limits])
            forces.append(self._force_map(free, at))
            efforts.append(self._effort_map(free, at))
        self.force_maps = tuple(map(np.array, zip(*forces, strict=True)))
        self.effort_maps = tuple(map(np.array, zip(*efforts, strict=True)))

    def _force_map(self, free: list[int], at: Array) -> tuple[Array, Array]:
        """The forces (n,) as M (F_u, F_v, F_w, F_r) + c that give F_r exactly and (F_u, F_v, F_w) best."""
        n = len(at)
        M, c = np.zeros((n, 4)), at.copy()
        if free:
            row = self.B[3:, free]
            direct = np.linalg.pinv(row)  # of the yaw moment
            rest = np.eye(len(free)) - direct @ row
            rest[np.abs(rest) < 1e-12] = 0.0
            inverse = rest @ np.linalg.pinv(self.B[:3, free] @ rest, rcond=1e-9)
            own = np.zeros((len(free), 4))
            own[:, 3:] = direct
            wrench = np.zeros((3, 4))
            wrench[:, :3] = np.eye(3)
            own += inverse @ (wrench - self.B[:3, free] @ own)
            M[free] = own
            c[free] = -own @ (self.B @ at)
        return M, c

    def _effort_map(self, free: list[int], at: Array) -> tuple[Array, Array]:
        M, c = np.zeros((len(at), 4)), at.copy()
        if free:
            M[free] = np.linalg.pinv(self.B[:, free], rcond=1e-9)
            c[free] = -M[free] @ (self.B @ at)
        return M, c

    def _inside(self, forces: Array) -> NDArray[np.bool_]:
        return np.all((forces >= self.low - _FEASIBLE) & (forces <= self.high + _FEASIBLE), axis=1)

    def solve(self, wrench: Array) -> Array:
        """Return the optimal thruster forces (n,)."""
        yaw = self.B[3]
        most = float(np.maximum(yaw * self.low, yaw * self.high).sum())
        least = float(np.minimum(yaw * self.low, yaw * self.high).sum())
        goal = np.append(wrench[:3], np.clip(wrench[3], least, most))
        M, c = self.force_maps
        forces = M @ goal + c
        achieved = forces @ self.B.T
        good = self._inside(forces) & (np.abs(achieved[:, 3] - goal[3]) <= 1e-9)
        missed = np.where(good, ((achieved[:, :3] - goal[:3]) ** 2).sum(axis=1), np.inf)
        reached = achieved[np.argmin(missed)]
        M, c = self.effort_maps
        forces = M @ reached + c
        good = self._inside(forces) & (np.abs(forces @ self.B.T - reached).max(axis=1) <= 1e-9)
        effort = np.where(good, (forces**2).sum(axis=1), np.inf)
        return forces[np.argmin(effort)]
