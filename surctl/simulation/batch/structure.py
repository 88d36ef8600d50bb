"""What of a case is compiled into its loop."""

from __future__ import annotations

from dataclasses import dataclass, field

from surctl.control import CONTACT_SLOTS, Barrier, LawName, Movers
from surctl.guidance import AvoidanceForm, Guidance
from surctl.priority import Mode
from surctl.sensing import Equipment
from surctl.simulation.batch.bodies import BodyKind
from surctl.simulation.run import Sensing

__all__ = ["Structure"]


@dataclass(frozen=True)
class Structure:
    """What of a case is fixed in the compiled loop; everything else is a number of a run.

    Attributes:
        equipment: what is sensed with; the sonars' hull counts only if they have mounts.
        faults: number of slots for told faults; `delays` if one of them may be a delay.
        chances: whether faults may strike by chance.
        optional: whether a run may leave obstacles out.
        heights: whether an obstacle ends above the floor or below the surface.
        depths: whether the mission allows other depths than the path's.
        barrier, treats: of the law, `barrier` and `movers` of `build_law`.
    """

    law: LawName
    avoidance: AvoidanceForm
    mode: Mode
    sensing: Sensing
    bodies: tuple[BodyKind, ...]
    equipment: Equipment = field(default_factory=Equipment)
    faults: int = 0
    chances: bool = False
    delays: bool = False
    optional: bool = False
    guidance: Guidance = "los"
    barrier: Barrier = "simple"
    treats: Movers = "predict"
    heights: bool = False
    depths: bool = False

    @property
    def may_fail(self) -> bool:
        """Whether a sonar may fail."""
        return self.faults > 0 or self.chances

    @property
    def moving(self) -> bool:
        """Whether what the law is told of may move."""
        return self.sensing == "sonar" or any(kind not in ("box", "disc") for kind in self.bodies)

    @property
    def movers(self) -> int:
        """Number of moving obstacles."""
        return self.bodies.count("mover")

    @property
    def slots(self) -> int:
        """Moving obstacles that a message of the base station holds."""
        return min(CONTACT_SLOTS, self.movers)

    @property
    def contacts(self) -> int:
        """Number of obstacles that the law is told of."""
        return min(CONTACT_SLOTS, self.movers if self.sensing == "sonar" else len(self.bodies))
