"""What is read from a sampled linear loop of any law or system: poles, margins, disk margin, the worst corner."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop
from surctl.verification.linear.disk import DiskMargin
from surctl.verification.margins import LoopMargins
from surctl.verification.sampled_margins import is_stable, system_disk_margin, system_margins

__all__ = ["SampledLoop", "Worst", "worst_loop"]


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
        return system_margins(self.linear, *dict.fromkeys(name for place in self.places.values() for name in place))

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
        return is_stable(self.linear)

    @property
    def slowest_per_s(self) -> float:
        """Continuous rate [1/s] of the slowest pole, negative if it decays; -inf for a loop without memory."""
        size = float(np.abs(self.poles).max(initial=0.0))
        return float(np.log(size) / self.linear.dt) if size > 0 else -np.inf

    @property
    def severity(self) -> float:
        """A number that is larger for a worse loop; beyond 1 for an unstable one, which has no disk margin."""
        return 1.0 - self.disk / 2 if self.stable else 1.0 + float(np.abs(self.poles).max())


L = TypeVar("L", bound=SampledLoop)


@dataclass(frozen=True, eq=False)
class Worst(Generic[L]):
    """The worst of the loops at the corners of uncertain numbers and the nominal loop.

    Attributes:
        loop: the loop with the least disk margin, or an unstable one.
        corner: where it is, as text.
        slowest_per_s: largest real part [1/s] of a pole of all loops.
        lost: corners at which there is no loop, as text.
    """

    loop: L
    corner: str
    slowest_per_s: float
    lost: tuple[str, ...]


def worst_loop(nominal: L, name: str, corners: Iterable[tuple[str, Callable[[], L]]]) -> Worst[L]:
    """Return the worst loop.

    Args:
        nominal: the nominal loop.
        name: its name.
        corners: text of each corner, and a function that returns its loop, or raises InputError if it has none.
    """
    worst, corner, slowest, lost = nominal, name, nominal.slowest_per_s, list[str]()
    for label, linearised in corners:
        try:
            loop = linearised()
        except InputError:
            lost.append(label)
            continue
        slowest = max(slowest, loop.slowest_per_s)
        if loop.severity > worst.severity:
            worst, corner = loop, label
    return Worst(worst, corner, slowest, tuple(lost))
