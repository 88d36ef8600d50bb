"""What is read from a sampled linear loop of any law or system: poles, margins and the one disk margin."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surctl.system import LinearLoop
from surctl.verification.linear.disk import DiskMargin
from surctl.verification.margins import LoopMargins
from surctl.verification.sampled_margins import is_stable, system_disk_margin, system_margins

__all__ = ["SampledLoop"]


class SampledLoop:
    """Poles and margins of `linear`; a subclass has it as attribute and says where its loops are opened."""

    linear: LinearLoop

    @property
    def places(self) -> dict[str, tuple[str, ...]]:
        """Labels of the signals at which all loops are opened at once, by name of the place; no entry is empty."""
        raise NotImplementedError

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
