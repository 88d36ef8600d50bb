"""The sampled loop of a system at its equilibrium, for nominal numbers and at the corners of the declared ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from surctl.system import Operating, System, find_equilibrium, linearise
from surctl.system.linear import Linearisation
from surctl.system.values import checked_ranges
from surctl.verification.sampled_loop import SampledLoop, worst_loop

__all__ = ["SystemCorners", "SystemLoop", "system_corners"]


@dataclass(frozen=True, eq=False)
class SystemLoop(SampledLoop):
    """The linear loop of a system about its equilibrium."""

    linear: Linearisation

    @cached_property
    def places(self) -> dict[str, tuple[str, ...]]:
        """The commands that the plant takes, and the measurements that the law uses."""
        names, (_, by_y, _, _, d_y, _) = self.linear.names, self.linear.law
        used = np.abs(np.vstack([by_y, d_y])).max(axis=0, initial=0.0) > 0
        commands = tuple(name for name in names.commands if name in names.inputs) or names.commands
        measured = tuple(name for name, use in zip(names.outputs, used, strict=True) if use)
        return {what: labels for what, labels in (("commands", commands), ("measurements", measured)) if labels}

    @property
    def at(self) -> Operating:
        """The equilibrium."""
        return self.linear.at


@dataclass(frozen=True, eq=False)
class SystemCorners:
    """The loop of a system with nominal numbers and at the worst corner of its ranges.

    Attributes:
        nominal: the loop with nominal numbers.
        worst: the loop with the least disk margin, or an unstable one.
        corner: the numbers of the worst corner, as text.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        lost: corners at which the loop has no equilibrium, as text.
        count: number of corners.
    """

    nominal: SystemLoop
    worst: SystemLoop
    corner: str
    slowest_per_s: float
    lost: tuple[str, ...] = ()
    count: int = 0

    @property
    def stable(self) -> bool:
        """Whether the loop has an equilibrium at every corner and is stable there."""
        return not self.lost and self.nominal.stable and self.worst.stable

    @property
    def disk(self) -> float:
        """The disk margin at the worst corner; 0 if one is unstable or has no equilibrium."""
        return self.worst.disk if self.stable else 0.0


def system_corners(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> SystemCorners:
    """Return the loop of a system about its equilibrium, nominal and at the worst corner of ranges of its numbers.

    A linear loop is usually worst at a corner, but this is no proof for the numbers between the corners.

    Args:
        system: the closed loop.
        values: nominal numbers by name, see `run_numbers`.
        ranges: lower and upper bound of single numbers, by the same names; None: those that the system declares.

    Raises:
        InputError: the loop has no equilibrium with nominal numbers, or a range is not valid.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System
        >>> from surctl.verification import system_corners
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart"), Port("force", (1,), "N", "drive")
        >>> mass = Layout((Port("mass", (1,), "kg", "of the cart", 2.0),))
        >>> cart = Plant(
        ...     "cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"] / p["mass"]},
        ...     parameters=mass,
        ... )
        >>> hold = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -4 * u["speed"])
        >>> loop = system_corners(System(cart, hold, ranges={"plant.mass": (1.0, 4.0)}))
        >>> loop.stable, round(loop.nominal.disk, 2), round(loop.disk, 2), loop.corner
        (True, 1.63, 1.33, 'plant.mass = 1')
    """
    bounds = checked_ranges(system, system.ranges if ranges is None else ranges)
    numbers = dict(values or {})
    nominal = SystemLoop(linearise(system, numbers, at=find_equilibrium(system, numbers)))
    corners = [dict(zip(bounds, ends, strict=True)) for ends in product(*bounds.values())] if bounds else []

    def at(corner: Mapping[str, float]) -> SystemLoop:
        return SystemLoop(linearise(system, {**numbers, **corner}))

    labels = (", ".join(f"{name} = {end:g}" for name, end in corner.items()) for corner in corners)
    worst = worst_loop(nominal, "the nominal system", zip(labels, (partial(at, c) for c in corners), strict=True))
    corner = worst.lost[0] if worst.lost else worst.corner
    return SystemCorners(nominal, worst.loop, corner, worst.slowest_per_s, worst.lost, len(corners))
