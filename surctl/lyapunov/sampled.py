"""Regions of attraction of sampled loops, with held commands, proved at the sampling instants and in between."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surctl.certcheck import PATIENCE, check_document, seal
from surctl.lyapunov.claims import Stability, every_digit, stated_number
from surctl.lyapunov.decide import Decision
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.rays import bounded
from surctl.lyapunov.sampled_search import Shapes, sampled_shapes
from surctl.lyapunov.slope_search import quadratic, relative_volume
from surctl.verification.formula import text_of

__all__ = ["SampledRegion", "SampledStability", "sampled_region"]

_LEVELS = (0.99, 0.95, 0.85, 0.7, 0.5)  # that are tried, relative to the proposed one
_SEARCH = 0.5  # share of the time for the search
_DIGITS = 9  # of an entry of a knot


@dataclass(frozen=True, eq=False)
class SampledStability(Stability):
    """The claim that V < level at the sampling instants is a region of attraction of a loop with held commands.

    Attributes:
        dynamics: the dynamics, with their sampling.
        function: V, an expression of the states.
        level: level of the region.
        rate: share of V that is lost at least in each period; None means any strict decrease.
    """

    @property
    def statement(self) -> str:
        """The claim in words."""
        sampling = self.dynamics.sampling
        assert sampling is not None
        pace = "" if self.rate is None else f" by at least {every_digit(self.rate)} of its value"
        return (
            f"sampled every {every_digit(sampling.period)} s with held commands, where V < {every_digit(self.level)}, "
            f"V decreases{pace} from instant to instant and every solution converges to the equilibrium"
        )

    def plain(self) -> dict[str, Any]:
        """Return the claim as plain data, as the certificate states it."""
        sampling = self.dynamics.sampling
        assert sampling is not None
        commands = [{"name": c.name, "unit": c.unit, "value": text_of(c.value)} for c in sampling.commands]
        claim = super().plain()
        rests = claim["equilibrium"] | {c.name: stated_number(c.rest) for c in sampling.commands}
        return claim | {
            "time": "sampled",
            "commands": commands,
            "dynamics": {name: text_of(node) for name, node in sampling.flow.items()},
            "next": {name: text_of(node) for name, node in sampling.next.items()},
            "period_s": float(sampling.period),
            "equilibrium": rests,
        }


@dataclass(frozen=True, eq=False)
class SampledRegion:
    """A region of a sampled loop.

    Attributes:
        decision: the proved claim with its certificate.
        volume: volume of the region relative to the box.
    """

    decision: Decision
    volume: float


def sampled_region(
    dynamics: Dynamics, rate: float | None, *, time_limit: float, progress: Callable[[str], None] | None = None
) -> SampledRegion | None:
    """Find and prove a region of attraction of a loop with held commands; return None if none is proved.

    Args:
        dynamics: the dynamics, with their sampling.
        rate: demanded decay rate of V [1/s]; None means any strict decrease.
        time_limit: limit of the processor time [s].
        progress: function that receives a line of progress from time to time.
    """
    assert dynamics.sampling is not None
    began, until = time.perf_counter(), time.process_time() + time_limit
    share = None if rate is None else float(f"{rate * dynamics.sampling.period:.12g}")  # 1 − r T < exp(−r T)
    if share is not None and share >= 1:
        return None
    shapes = sampled_shapes(dynamics, share or 0.0, seconds=_SEARCH * time_limit)
    if shapes is None:
        return None
    p = np.asarray(np.linalg.inv(shapes.inverse), dtype=float)
    function, volume = quadratic(dynamics, p), relative_volume(dynamics, p)
    for level in _LEVELS:
        left = until - time.process_time()
        if left <= 0:
            break
        widest = np.vstack([shapes.inverse[None], shapes.knots[:, : len(shapes.inverse), : len(shapes.inverse)]])
        far = np.sqrt(level * np.diagonal(widest, axis1=1, axis2=2).max(axis=0))
        claim = SampledStability(bounded(dynamics, np.array([far, far])), function, level, share)
        document = seal(claim.kind, claim.plain(), _evidence(shapes))
        checked = check_document(document, time_limit=min(left, PATIENCE))
        if progress:
            progress(f"sampled loop: level {level:g} {'proved' if checked.accepted else checked.reason}")
        if checked.accepted:
            decision = Decision(claim, "proved", document, "", {}, time.perf_counter() - began, checked.vacuous)
            return SampledRegion(decision, volume * level ** (len(far) / 2))
    return None


def _evidence(shapes: Shapes) -> Mapping[str, Any]:
    def row(numbers: Any) -> list[float]:
        return [float(f"{x:.{_DIGITS}e}") for x in numbers]

    return {
        "knots": [[row(line) for line in (knot + knot.T) / 2] for knot in shapes.knots],
        "feedbacks": [row(line) for line in shapes.feedbacks],
    }
