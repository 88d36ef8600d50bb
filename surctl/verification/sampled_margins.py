"""Margins of sampled linear systems: one loop at a time, all loops at once, and the worst corner of ranges."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop, Operating, System, find_equilibrium, linearise
from surctl.system.linear import Linearisation
from surctl.system.values import checked_ranges
from surctl.verification.linear import DiskMargin, OpenLoop, disk_margin
from surctl.verification.loops import BrokenLoop, LeastDelay, LoopMargins, crossings_of, delays_of, margins_from

Array = NDArray[np.float64]

_SINGULAR = 1e12  # condition number from which z counts as a pole
_POINTS, _FEW = 1500, 150  # number of angles towards each end of (0, π)
_NEAR = np.geomspace(1e-3, 30.0, 24)  # distances from a pole's angle, in distances of the pole from the unit circle
_NAMED = 6  # largest number of states in a message
_INWARDS = 1e-6  # relative move of the poles of a loop that has one at z = -1


def system_margins(linear: LinearLoop, *openings: str, quick: bool = False) -> tuple[LoopMargins, ...]:
    """Return the margins of every loop of a linearised system; one loop is opened at a time, all others stay closed.

    Args:
        linear: the linear loop, see `surctl.system.linearise`.
        openings: labels of the signals at which a loop is opened, commands or measured outputs; by default every
            command, then every measured output.
        quick: a tenth of the time, for searches and pages: crossings are searched on fewer frequencies, and the disk
            margin is the least radius on these frequencies, refined.

    Raises:
        InputError: an entry of `openings` is not the label of a command or of a measured output.

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.verification import system_margins
        >>> (margins,) = system_margins(linearise(cart_system(2.0)), "force")
        >>> f"{margins.gain_margin:.1f}, {margins.phase_margin_deg:.1f} deg, {margins.delay_margin_s:.2f} s"
        '10.0, 84.3 deg, 0.73 s'
    """
    return tuple(_margins(linear, name, quick=quick) for name in openings or linear.channels())


def system_disk_margin(linear: LinearLoop, *openings: str) -> DiskMargin:
    """Return the disk margin of a linearised system that is opened at several signals at once.

    The frequency in the result lies below the Nyquist frequency π/dt.

    Args:
        linear: the linear loop, see `surctl.system.linearise`.
        openings: labels of the signals at which the loops are opened, commands or measured outputs; by default all of
            them.

    Raises:
        InputError: an entry of `openings` is not the label of a command or of a measured output.

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.verification import system_disk_margin
        >>> margin = system_disk_margin(linearise(cart_system(2.0)), "force", "speed")
        >>> margin.stable, round(margin.guaranteed, 2)
        (True, 0.76)
    """
    chosen = openings or linear.channels()
    place = ", ".join(chosen)
    if not linear.stable:
        return DiskMargin.unstable(place)
    margin = disk_margin(_continuous(linear, *chosen), place)
    return replace(margin, frequency_rad_s=2.0 * margin.frequency_rad_s / linear.dt)


def _margins(linear: LinearLoop, opening: str, *, quick: bool) -> LoopMargins:
    """Compute the margins of one loop from the crossings of its frequency response; without a crossing, inf."""
    if not linear.stable:
        return LoopMargins.unstable(opening)
    loop, grid = _broken(linear, opening, points=_FEW if quick else _POINTS)
    margins = margins_from(opening, crossings_of(loop, grid=grid))
    disk = min(margins.disk_margin, 2.0) if quick else disk_margin(_continuous(linear, opening)).guaranteed
    return replace(margins, disk_margin=disk)


def _broken(linear: LinearLoop, opening: str, *, points: int) -> tuple[BrokenLoop, Array]:
    # one loop that is opened, and frequencies [rad/s]
    closed, opened = linear.poles(), np.linalg.eigvals(linear.opened(opening)[0]).astype(complex)
    grid = _angles(np.concatenate([opened, closed]), points=points) / linear.dt
    return BrokenLoop(closed[None], opened[None], linear.dt), grid


def _angles(poles: NDArray[np.complex128], *, points: int) -> Array:
    """Return angles of z [rad] in (0, π), dense towards both ends and around each of the poles."""
    ends = np.geomspace(1e-8, 1.0, points)
    width = np.maximum(np.abs(1 - np.abs(poles)), 1e-6)
    near = np.abs(np.angle(poles))[:, None] + width[:, None] * np.concatenate([-_NEAR, _NEAR])
    angles = np.unique(np.concatenate([np.pi * ends, np.pi * (1 - ends / 2), near.ravel()]))
    return angles[(angles > 1e-9) & (angles < np.pi * (1 - 1e-9))]


def _continuous(linear: LinearLoop, *openings: str) -> OpenLoop:
    """Return the open loop in continuous form; a pole at z = -1 changes its frequency response by 1e-6."""
    A, B, C, D = linear.opened(*openings)
    if np.linalg.cond(A + np.eye(len(A))) > _SINGULAR:  # a pole at z = -1, which the transform maps to infinity
        A = A * (1 - _INWARDS)
    return OpenLoop.of_sampled(A, B, C, D, 2.0)  # frequencies per period: the grid of a search fits any period


# What is read from a sampled linear loop of any law or system: poles, margins, disk margin, the worst corner


class SampledLoop(ABC):
    """Poles and margins of `linear`; a subclass has it as attribute and says where its loops are opened."""

    linear: LinearLoop

    @property
    @abstractmethod
    def places(self) -> dict[str, tuple[str, ...]]:
        """Labels of the signals at which all loops are opened at once, by name of the place; no entry is empty."""

    @cached_property
    def poles(self) -> NDArray[np.complex128]:
        """Poles z of the closed loop, largest first."""
        return self.linear.poles()

    @cached_property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Margins of each loop alone, opened at one signal of the places."""
        return system_margins(self.linear, *self._signals)

    @property
    def _signals(self) -> list[str]:
        return list(dict.fromkeys(name for place in self.places.values() for name in place))

    def least_delay(self, corner: str) -> LeastDelay:
        """Return the least delay margin of one loop alone, 0 if the loop is unstable; `corner` is its name."""
        if not self.stable:
            return LeastDelay(0.0, self._signals[0], corner)
        loops = {name: _broken(self.linear, name, points=_POINTS) for name in self._signals}
        delays = {name: float(delays_of(loop, grid=grid)[0]) for name, (loop, grid) in loops.items()}
        loop = min(delays, key=lambda name: delays[name])
        return LeastDelay(delays[loop], loop, corner)

    @cached_property
    def disks(self) -> tuple[DiskMargin, ...]:
        """Disk margins of all loops at once, at each place."""
        return tuple(
            replace(system_disk_margin(self.linear, *signals), place=place) for place, signals in self.places.items()
        )

    @property
    def disk(self) -> float:
        """All loops at once, the lesser disk margin of commands and measurements; 0 if unstable, NaN if unknown."""
        return float(np.min([each.guaranteed for each in self.disks])) if self.stable else 0.0

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return self.linear.stable

    @property
    def slowest_per_s(self) -> float:
        """Continuous rate [1/s] of the slowest pole, negative if it decays; -inf for a loop without memory."""
        size = float(np.abs(self.poles).max(initial=0.0))
        return float(np.log(size) / self.linear.dt) if size > 0 else -np.inf

    @property
    def severity(self) -> float:
        """A number that is larger for a worse loop; 1 for a marginal one, beyond 1 for an unstable one."""
        if self.stable or self.linear.marginal:
            return 1.0 - self.disk / 2
        return 1.0 + float(np.abs(self.poles).max())


L = TypeVar("L", bound=SampledLoop)


@dataclass(frozen=True, eq=False)
class LoopCorners(Generic[L]):
    """A loop with nominal numbers, and at the worst corner of its uncertain numbers.

    Attributes:
        nominal: the loop with nominal numbers.
        worst: the loop with the least disk margin, or an unstable one.
        corner: the numbers of the worst corner, as text; of the first corner that is lost, if there is one.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        delay: least delay margin of one loop alone over all corners.
        nominal_delay: the same of the nominal loop.
        lost: corners at which there is no loop, as text.
        count: number of corners.
    """

    nominal: L
    worst: L
    corner: str
    slowest_per_s: float
    delay: LeastDelay
    nominal_delay: LeastDelay
    lost: tuple[str, ...] = ()
    count: int = 0

    @property
    def stable(self) -> bool:
        """Whether the loop exists and is stable at every corner."""
        return not self.lost and self.nominal.stable and self.worst.stable

    @property
    def marginal(self) -> str:
        """Which states of the nominal or the worst loop do not return, as text; empty if a loop is unstable."""
        loops = [loop.linear for loop in (self.nominal, self.worst) if not loop.stable]
        if not loops or not all(linear.marginal for linear in loops):
            return ""
        states = list(dict.fromkeys(label for linear in loops for label in linear.marginal))
        more = f" and {len(states) - _NAMED} more" if len(states) > _NAMED else ""
        return (
            f"{f' at the corner {self.corner}' * self.nominal.stable}: nothing returns {', '.join(states[:_NAMED])}"
            f"{more} after a disturbance; unless that is intended, add a task or feedback, "
            "or judge another equilibrium (start.…, reference.…)"
        )

    @property
    def disk(self) -> float:
        """The disk margin at the worst corner; 0 if the loop is unstable or does not exist at one."""
        return self.worst.disk if self.stable else 0.0


def corners_of(nominal: L, name: str, corners: Iterable[tuple[str, Callable[[], L]]]) -> LoopCorners[L]:
    """Return the nominal and the worst loop.

    Args:
        nominal: the nominal loop.
        name: its name.
        corners: text of each corner, and a function that returns its loop, or raises InputError if it has none.
    """
    worst, corner, slowest, lost, count = nominal, name, nominal.slowest_per_s, list[str](), 0
    delays = [nominal.least_delay(name)]
    for label, linearised in corners:
        count += 1
        try:
            loop = linearised()
        except InputError:
            lost.append(label)
            continue
        slowest = max(slowest, loop.slowest_per_s)
        delays.append(loop.least_delay(label))
        if loop.severity > worst.severity:
            worst, corner = loop, label
    return LoopCorners(nominal, worst, corner, slowest, min(delays), delays[0], tuple(lost), count)


# The sampled loop of a system at its equilibrium, for nominal numbers and at the corners of the declared ranges


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


def system_corners(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> LoopCorners[SystemLoop]:
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
    result = corners_of(nominal, "the nominal system", zip(labels, (partial(at, c) for c in corners), strict=True))
    if not result.lost:
        return result
    return replace(result, corner=result.lost[0], delay=result.delay._replace(delay_s=0.0, corner=result.lost[0]))
