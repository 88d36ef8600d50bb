"""Allocation of one force and yaw moment, explained: which level lacks what, which thrusters bind or failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.ir.native import runnable
from surctl.marine.allocation.program import allocation_block
from surctl.marine.vehicle import Actuators
from surctl.units import as_numbers

Array = NDArray[np.float64]

_MISSED = 1e-8  # smallest share of the largest thruster force (or of its yaw moment) that a level reports as given up
_AT_LIMIT = 1e-9
_RANK = 1e-9


@dataclass(frozen=True, eq=False)
class Allocation:
    """The forces of all thrusters for one desired force and yaw moment.

    Attributes:
        actuators: the thrusters.
        desired, achieved: (4,) F_u, F_v, F_w [N] and F_r [N m] in {B}.
        forces: (n,) [N] along its direction; for a swivelling thruster, the magnitude.
        commands: (n,) in [−1, 1].
        angles: joint angle [rad] of each swivelling thruster by name.
        roll, pitch: moments [N m] of all thrusters, which the allocation does not control.
        gave_up: distance between desired and achieved value of each level that is not reached [N, N m].
        binding: for each such level, the thrusters whose limits or failure prevent it.
        failed: names of the thrusters that give no force.
    """

    actuators: Actuators
    desired: Array
    achieved: Array
    forces: Array
    commands: Array
    angles: Mapping[str, float]
    roll: float
    pitch: float
    gave_up: Mapping[str, float]
    binding: Mapping[str, tuple[str, ...]]
    failed: tuple[str, ...] = ()

    def explain(self) -> str:
        """Return a sentence for each level that gave something up."""
        lines = []
        for level, missed in self.gave_up.items():
            unit = "N m" if level == "yaw" else "N"
            lost = [name for name in self.binding[level] if name in self.failed]
            names = [name for name in self.binding[level] if name not in self.failed]
            causes = [f"{_listed(lost)} failed"] if lost else []
            causes += [f"{_listed(names)} {'bind' if len(names) > 1 else 'binds'}"] if names else []
            why = f"because {' and '.join(causes)}" if causes else "beside the higher levels"
            lines.append(f"`{level}` gave up {missed:.4g} {unit} {why}.")
        return " ".join(lines) or "Every level is reached."


def allocate(actuators: Actuators, wrench: ArrayLike, *, failed: Sequence[str] = (), speed: float = 1.0) -> Allocation:
    """Return the thruster forces for a desired force and yaw moment, by strict priorities within all limits.

    Each level of `actuators.order` is met as well as the limits and the higher levels allow; the last level, `effort`,
    then chooses the smallest sum of squared forces. The numbers come from the instruction list that the control law and
    the exported C contain.

    Args:
        wrench: (4,) F_u, F_v, F_w [N] and F_r [N m] in {B}.
        speed: forward speed [m/s] through the water, on which the limits of fins depend.

    Raises:
        InputError: the wrench is not four finite numbers, or a name is unknown.

    Example:
        >>> from surctl.marine.allocation import allocate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> thrusters = load_vehicle("bluerov2-heavy").actuators
        >>> allocate(thrusters, [40.0, 0.0, 0.0, 0.0]).forces.round(2).tolist()[:4]
        [-14.14, -14.14, 14.14, 14.14]
        >>> print(allocate(thrusters, [100.0, 60.0, 0.0, 0.0]).explain())
        `force` gave up 34.34 N because `T1` and `T4` bind.
    """
    desired = as_numbers(wrench, key="wrench", size=4)
    working = working_flags(actuators, failed, speed=speed)
    achieved, components, commands, *angles = _runner(actuators)(desired, working)
    roll, pitch = actuators.moments(components)
    gave_up, binding = _lacks(actuators, desired, achieved, components, working)
    joints = dict(zip((actuators.names[k] for k in actuators.swivels), angles[0] if angles else (), strict=True))
    return Allocation(
        actuators=actuators,
        desired=desired,
        achieved=achieved,
        forces=actuators.magnitudes(components),
        commands=commands,
        angles={name: float(angle) for name, angle in joints.items()},
        roll=roll,
        pitch=pitch,
        gave_up=gave_up,
        binding=binding,
        failed=tuple(failed),
    )


def _listed(names: Sequence[str]) -> str:
    quoted = [f"`{name}`" for name in names]
    return " and ".join([", ".join(quoted[:-1]), quoted[-1]] if len(quoted) > 1 else quoted)


def working_flags(actuators: Actuators, failed: Sequence[str] = (), *, speed: float = 1.0) -> Array:
    """Return (n,): 1 for each thruster that works, 0 for the failed ones; InputError for an unknown name.

    The number of a fin is the share of its limits at 1 m/s that it has at a forward speed [m/s].

    Example:
        >>> from surctl.marine.allocation import working_flags
        >>> from surctl.marine.vehicle import load_vehicle
        >>> working_flags(load_vehicle("bluerov2-thrusters").actuators, ["T2"]).tolist()
        [1.0, 0.0, 1.0, 1.0, 1.0, 1.0]
    """
    flags = actuators.shares(speed)
    for name in failed:
        flags[actuators.index(name)] = 0.0
    return flags


@lru_cache(maxsize=16)
def _runner(actuators: Actuators) -> Callable[..., list[Array]]:
    return runnable(allocation_block(actuators))


def _lacks(
    actuators: Actuators, desired: Array, achieved: Array, components: Array, working: Array
) -> tuple[dict[str, float], dict[str, tuple[str, ...]]]:
    """Return how much each level lacks, and the thrusters whose limits or failure keep it from more."""
    unit = actuators.largest * np.array([1.0, 1.0, 1.0, actuators.lever])
    held = [_sides(actuators, k, components, on) for k, on in enumerate(working)]
    gave_up, binding, known = dict[str, float](), dict[str, tuple[str, ...]](), list[int]()
    for name, axes in actuators.levels:
        lack = np.zeros(4)
        lack[list(axes)] = (desired - achieved)[list(axes)]
        if float(np.abs(lack / unit).max()) > _MISSED:
            pull = _pull(actuators, lack, known, held)
            gave_up[name] = float(np.linalg.norm(lack))
            parts = zip(actuators.names, held, actuators.slices, strict=True)
            binding[name] = tuple(one for one, sides, where in parts if (sides @ pull[where] > 0).any())
        known += axes
    return gave_up, binding


def _sides(actuators: Actuators, index: int, components: Array, on: float) -> Array:
    """Return the outward normals (s, k) of the limits at which a thruster is; all its normals after a failure."""
    normals, bounds = actuators.thrusters[index].sides
    near = normals @ components[actuators.slices[index]] >= on * bounds - _AT_LIMIT * actuators.largest
    return normals[near]


def _pull(actuators: Actuators, lack: Array, known: list[int], held: Sequence[Array]) -> Array:
    """Return the gradient (N,) of a level that lacks something, within the values of the higher levels.

    It is 0 for the thrusters that are at no limit.
    """
    B = actuators.matrix
    pull: Array = B.T @ lack
    loose = [where for where, sides in zip(actuators.slices, held, strict=True) if not len(sides)]
    free = [k for where in loose for k in range(where.start, where.stop)]
    if known and free:
        weights = np.linalg.lstsq(B[np.ix_(known, free)].T, pull[free], rcond=_RANK)[0]
        pull = pull - B[known].T @ weights
    pull[np.abs(pull) <= 1e-6 * np.abs(pull).max(initial=0.0)] = 0.0
    return pull
