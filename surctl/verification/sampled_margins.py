"""Margins of sampled linear loops: one loop at a time, all loops at once, and the worst corner of ranges."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop, System, find_equilibrium, linearise
from surctl.system.linear import idle_commands
from surctl.system.linear_loop import independent
from surctl.system.values import checked_ranges
from surctl.verification.linear import (
    LEAST_DISK_MARGIN,
    DiskMargin,
    OpenLoop,
    disk_margin,
    margin_text,
    quick_disk_margin,
    screened_peaks,
    short_margins,
    stored_disk_margin,
)
from surctl.verification.loops import (
    LEAST_DELAY_MARGIN,
    BrokenLoop,
    LeastDelay,
    LoopMargins,
    crossings_of,
    delays_of,
)

Array = NDArray[np.float64]

_SINGULAR = 1e12  # condition number from which z counts as a pole
_POINTS = 160  # number of angles towards each end of (0, π)
_NEAR = np.geomspace(1e-3, 30.0, 16)  # distances from a pole's angle, in distances of the pole from the unit circle
_APART = 2.0  # ratio of two distances: those of a pole, of its conjugate and of an equal pole lie between each other
_NAMED = 6  # largest number of states in a message
_INWARDS = 1e-6  # relative move of the poles of a loop that has one at z = -1
_UNSTABLE = {
    "gain_margin": 1.0, "phase_margin_deg": 0.0, "delay_margin_s": 0.0, "disk_margin": 0.0, "crossover_rad_s": np.nan,
    "least_gain": 1.0, "sensitivity_peak": np.inf, "rejection_rad_s": 0.0,
}  # fmt: skip


def margins_of(loops: LinearLoop, openings: Iterable[str]) -> dict[str, dict[str, Array]]:
    """Return the margins (n,) of n loops by signal and name (`LoopMargins`), each opened at one signal alone.

    The leading axis of the matrices of `loops` holds the n loops.
    """
    stable = loops.decays
    return {
        opening: {name: np.where(stable, value, _UNSTABLE[name]) for name, value in crossings_of(*broken).items()}
        for opening, broken in _broken(loops, openings)
    }


def delays_at(loops: LinearLoop, openings: Iterable[str]) -> Array:
    """Return the delay margins (signals, n) [s] of n loops, as `margins_of`."""
    return np.array([np.where(loops.decays, delays_of(*broken), 0.0) for _, broken in _broken(loops, openings)])


def _broken(loops: LinearLoop, openings: Iterable[str]) -> Iterator[tuple[str, tuple[BrokenLoop, Array]]]:
    # each signal with the loops opened there and frequencies (n, m) [rad/s]; only the states on which it acts count
    closed, dt = loops.transition, loops.dt
    blocks = independent((closed != 0).any(axis=0))
    for opening in openings:
        A, b, *_ = loops.opened(opening)
        acted = [block for block in blocks if np.any(b[:, block] != 0)]
        block = np.concatenate(acted) if acted else np.zeros(0, dtype=int)
        poles = [np.linalg.eigvals(m[:, block[:, None], block]).astype(complex) for m in (closed, A)]
        yield opening, (BrokenLoop(poles[0], poles[1], dt), _angles(*poles) / dt)


def _angles(closed: NDArray[np.complex128], opened: NDArray[np.complex128]) -> Array:
    """Return angles (n, m) of z [rad] in (0, π), dense towards both ends and around each of the poles (n, k)."""
    poles = np.concatenate([closed, opened], axis=1)
    between = 0.5 * (poles.imag < 0) + 0.25 * (np.arange(poles.shape[1]) >= closed.shape[1])
    ends = np.pi * np.geomspace(1e-8, 1.0, _POINTS)
    width = np.maximum(np.abs(1 - np.abs(poles)), 1e-6) * _APART**between
    near = np.abs(np.angle(poles))[..., None] + width[..., None] * np.concatenate([-_NEAR, _NEAR])
    both = np.tile(np.concatenate([ends, np.pi - ends / 2]), (len(poles), 1))
    angles = np.concatenate([both, near.reshape(len(poles), -1)], axis=1)
    return np.sort(np.clip(angles, 1e-9, np.pi * (1 - 1e-9)), axis=1)


def system_margins(linear: LinearLoop, *openings: str) -> tuple[LoopMargins, ...]:
    """Return the margins of every loop of a linearised system; one loop is opened at a time, all others stay closed.

    Args:
        linear: the linear loop, see `surctl.system.linearise`.
        openings: labels of the signals at which a loop is opened, commands or measured outputs; by default every
            command, then every measured output.

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
    table = margins_of(linear[None], openings or linear.channels())
    return tuple(
        LoopMargins(opening, linear.stable, **{name: float(value[0]) for name, value in row.items()})
        for opening, row in table.items()
    )


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
    return disk_margin(open_loop(linear, *chosen), ", ".join(chosen))


def open_loop(linear: LinearLoop, *openings: str) -> OpenLoop:
    """Return the loop, or several, opened at several signals at once, in continuous form.

    A pole at z = -1 changes the frequency response by 1e-6.
    """
    A, B, C, D = linear.opened(*openings)
    # the transform maps a pole at z = -1 to infinity
    at_end = A.size > 0 and np.linalg.cond(A + np.eye(A.shape[-1])) > _SINGULAR
    A = A * (1 - _INWARDS * np.asarray(at_end)[..., None, None])
    return OpenLoop.of_sampled(A, B, C, D, linear.dt)


# What is read from a sampled linear loop of any law or system: poles, margins, disk margin, the worst corner


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """Poles and margins of a linear loop; all loops are opened at once at each of its `places`."""

    linear: LinearLoop

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles z of the closed loop, largest first."""
        return self.linear.poles()

    @cached_property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Margins of each loop alone: those at signals of the places, then at all others that the controller uses."""
        used = [name for names in self.linear.used.values() for name in names]
        return system_margins(self.linear, *dict.fromkeys([*_signals(self.linear), *used]))

    @property
    def judged(self) -> tuple[LoopMargins, ...]:
        """The margins at signals of the places."""
        return self.margins[: len(_signals(self.linear))]

    @cached_property
    def disks(self) -> tuple[DiskMargin, ...]:
        """Disk margins of all loops at once, at each place."""
        return tuple(
            stored_disk_margin(open_loop(self.linear, *signals), place) for place, signals in self.linear.places.items()
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
        return float(self.linear.slowest_per_s)

    @property
    def least_damping(self) -> float:
        """The least damping ratio of the poles; 1 if all are real."""
        rates = self.linear.rates[self.linear.rates.imag != 0]
        return float(np.min(-rates.real / np.abs(rates), initial=1.0))

    def to_dict(self) -> dict[str, Any]:
        """Return poles and disk margins as plain data for JSON."""
        return {
            "stable": self.stable, "disk_margin": self.disk, "disk_margins": [each.to_dict() for each in self.disks],
            "poles": [[float(pole.real), float(pole.imag)] for pole in self.poles],
            "slowest_per_s": self.slowest_per_s, "least_damping": self.least_damping,
        }  # fmt: skip


def _signals(linear: LinearLoop) -> list[str]:
    return list(dict.fromkeys(name for place in linear.places.values() for name in place))


@dataclass(frozen=True, eq=False)
class LoopCorners:
    """A loop with nominal numbers, and at the worst corner of its uncertain numbers.

    Attributes:
        nominal: the loop with nominal numbers.
        worst: the loop with the least disk margin; the fastest growing one, if one is unstable.
        corner: the numbers of the worst corner, as text.
        disk: least disk margin of all loops at once, over places and corners; 0 if unstable, NaN if unknown.
        disks: disk margins at each place, least over the corners; empty if they were not proved.
        slowest_per_s: largest real part [1/s] of a pole over all corners.
        delay: least delay margin of one loop alone over all corners.
        lost: corners at which there is no loop, as text.
        count: number of corners.
        of: what the corners are, as text.
        stable: whether the loop is stable at every corner, and exists there if it must.
        idle: commands that do not respond to their inputs, nominally or at a corner, see `idle_commands`.
    """

    nominal: SampledLoop
    worst: SampledLoop
    corner: str
    disk: float
    disks: tuple[DiskMargin, ...]
    slowest_per_s: float
    delay: LeastDelay
    lost: tuple[str, ...] = ()
    count: int = 0
    of: str = ""
    stable: bool = field(default=True, kw_only=True)
    idle: tuple[str, ...] = ()

    @property
    def weakest(self) -> str:
        """The corner at which the smaller of the shares is."""
        disk, delay = self.shares
        return self.corner if disk <= delay else self.delay.corner

    @property
    def shares(self) -> tuple[float, float]:
        """Disk margin and delay margin over the least sufficient ones; 0 for a margin that is not determined."""
        disk, delay = self.disk / LEAST_DISK_MARGIN, self.delay.delay_s / LEAST_DELAY_MARGIN
        return float(np.nan_to_num(disk)), delay

    @property
    def enough(self) -> bool:
        """Whether both margins suffice."""
        return min(self.shares) >= 1.0

    @property
    def short(self) -> str:
        """The margins that do not suffice, with their corners, as text; empty if both do."""
        return short_margins((self.disk, f"at {self.corner}"), (self.delay.delay_s, f"in {self.delay.where}"))

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

    def lines(self) -> list[str]:
        """Return lines of text: the nominal loop, each loop alone, then the worst corner."""
        nominal = self.nominal
        lines = [f"  nominal: {_text(nominal.stable, nominal)}"]
        if nominal.stable:
            lines += [f"  loop {margin.line()}" for margin in nominal.margins]
            lines += [f"  {disk.line()}" for disk in nominal.disks]
        if not self.count:
            return lines
        word = "no equilibrium" if self.corner in self.lost else _text(self.stable, self.worst)
        lines.append(f"  worst of {self.of}: {word}, at {self.corner}")
        if self.stable:
            disks = ", ".join(f"{margin_text(disk.guaranteed, 0.0)} ({disk.place})" for disk in self.disks)
            lines.append(f"  least disk margin of all loops at once: {disks}")
            lines.append(f"  least delay margin of one loop alone: {self.delay.delay_s:.4g} s ({self.delay.where})")
            lines.append(f"  slowest pole of all corners: {self.slowest_per_s:.3g} 1/s")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return both loops as plain data for JSON."""
        worst = {
            **self.worst.to_dict(), "stable": self.stable, "disk_margin": self.disk,
            "disk_margins": [each.to_dict() for each in self.disks], "slowest_per_s": self.slowest_per_s,
            "corner": self.corner, "delay_margin": self.delay._asdict(), "corners": self.count, "of": self.of,
            "lost": list(self.lost),
        }  # fmt: skip
        return {"nominal": self.nominal.to_dict(), "worst": worst}


def _text(stable: bool, loop: SampledLoop) -> str:
    poles = f"slowest pole {loop.slowest_per_s:.3g} 1/s, least damping {loop.least_damping:.2f}"
    return f"{f'stable, disk margin {margin_text(loop.disk, 0.0)}' if stable else loop.linear.stability}, {poles}"


def corners_of(
    nominal: SampledLoop,
    corners: Iterable[tuple[str, LinearLoop | None]],
    *,
    name: str = "nominal",
    of: str = "",
    proved: bool = True,
    required: bool = False,
) -> LoopCorners:
    """Return the nominal and the worst loop.

    A coarse grid of frequencies selects the loop with the least disk margin at each place; its margin is then computed.

    Args:
        nominal: the nominal loop.
        corners: text of each corner, and its loop, or None if it has none.
        name: name of the nominal loop.
        of: what the corners are, as text.
        proved: whether the disk margin is proved between frequencies, in ten times the time.
        required: whether a corner without a loop counts as unstable.
    """
    known = list(corners)
    lost = tuple(label for label, loop in known if loop is None)
    every = [(name, nominal.linear), *((label, loop) for label, loop in known if loop is not None)]
    labels, loops = [label for label, _ in every], [loop for _, loop in every]
    kinds = dict.fromkeys(loop.names for loop in loops)
    groups = [np.array([k for k, loop in enumerate(loops) if loop.names == kind]) for kind in kinds]
    stacks = [LinearLoop.stacked([loops[k] for k in group]) for group in groups]
    slowest, stable, delays = np.zeros(len(loops)), np.zeros(len(loops), dtype=bool), list[LeastDelay]()
    for group, stack in zip(groups, stacks, strict=True):
        slowest[group], stable[group] = stack.slowest_per_s, stack.decays
        signals = _signals(stack)
        late = delays_at(stack, signals)
        row, column = np.unravel_index(int(np.argmin(late)), late.shape)
        delays.append(LeastDelay(float(late[row, column]), signals[row], labels[group[column]]))
    delay, worst = min(delays), int(np.argmax(slowest))
    good, disk, disks = bool(stable.all()), 0.0, list[DiskMargin]()
    margins = []
    for place in nominal.linear.places if good else ():
        peaks, opened = np.zeros(len(loops)), dict[int, OpenLoop]()
        for group, stack in zip(groups, stacks, strict=True):
            if opening := stack.places.get(place, ()):
                every_one = open_loop(stack, *opening)
                peaks[group] = screened_peaks(every_one)
                k = int(np.argmax(peaks[group]))
                opened[int(group[k])] = every_one[np.asarray(k)]
        at = max(opened, key=lambda k: float(peaks[k]))
        if proved:
            disks.append(stored_disk_margin(opened[at], place))
        margins.append((disks[-1].guaranteed if proved else quick_disk_margin(opened[at]), at))
    if good:
        disk, worst = min(margins)
        disk = float("nan") if np.isnan([margin for margin, _ in margins]).any() else disk
    elif proved:
        disks = [DiskMargin.unstable(place) for place in nominal.linear.places]
    corner = labels[worst]
    if required and lost:
        good, disk, corner, delay = False, 0.0, lost[0], delay._replace(delay_s=0.0, corner=lost[0])
    loop = nominal if worst == 0 else SampledLoop(loops[worst])
    return LoopCorners(
        nominal, loop, corner, disk, tuple(disks), float(slowest.max()), delay, lost, len(known), of, stable=good
    )


def system_corners(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> LoopCorners:
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
        (True, 1.64, 1.33, 'plant.mass = 1')
    """
    bounds = checked_ranges(system, system.ranges if ranges is None else ranges)
    numbers = dict(values or {})
    nominal = SampledLoop(linearise(system, numbers, at=find_equilibrium(system, numbers)))
    corners = [dict(zip(bounds, ends, strict=True)) for ends in product(*bounds.values())] if bounds else []

    def at(corner: Mapping[str, float]) -> LinearLoop | None:
        try:
            return linearise(system, {**numbers, **corner})
        except InputError:
            return None

    named = [(", ".join(f"{name} = {end:g}" for name, end in corner.items()), at(corner)) for corner in corners]
    of = f"the {len(corners)} corners of the ranges"
    result = corners_of(nominal, named, name="the nominal system", of=of, required=True)
    loops = [nominal.linear, *(loop for _, loop in named if loop is not None)]
    return replace(result, idle=tuple(dict.fromkeys(name for one in loops for name in idle_commands(system, one))))
