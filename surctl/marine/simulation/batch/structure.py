"""The loop structure: the part of a simulation setup that is fixed in the compiled loop."""

from __future__ import annotations

from dataclasses import dataclass, field

from surctl.marine.control import CONTACT_SLOTS, Barrier, Movers
from surctl.marine.guidance import AvoidanceForm, Guidance
from surctl.marine.sensing import Equipment, Surfaces
from surctl.marine.simulation.batch.bodies import BodyKind
from surctl.marine.simulation.run import Sensing
from surctl.marine.vehicle import Actuators, PlantForm
from surctl.priority import Mode

__all__ = ["Structure"]


@dataclass(frozen=True)
class Structure:
    """The part of a simulation setup that is fixed in the compiled loop; every other number is a parameter of each run.

    Attributes:
        equipment: the sensors; the hull radius matters only if the mounting points of the sonars are stated.
        faults: number of scheduled sonar faults that a run can hold.
        chances: whether random sonar faults may occur.
        delays: whether one of the scheduled faults is a delay.
        optional: whether a run may leave obstacles out.
        heights: whether some obstacle ends above the floor or below the surface.
        depths: whether the mission allows other depths than the depth of the path.
        barrier, treats: the options `barrier` and `movers` of `build_law`.
        form: the optional terms of the vehicle's dynamics.
        actuators: the thrusters to which the law allocates its thrust; None: each axis has its own limit.
        points: number of waypoints that a run can hold if the path is fed to the law (`Path.fed`); 0: it is not fed.
        rises: whether the path changes its depth.
        surfaces: how each surface answers a sonar; None: all alike, as the `incidence_limit` of the sonars says.
    """

    law: str
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
    form: PlantForm = field(default_factory=PlantForm)
    actuators: Actuators | None = None
    points: int = 0
    rises: bool = False
    surfaces: Surfaces | None = None

    @property
    def may_fail(self) -> bool:
        """Whether a sonar can fail in a run."""
        return self.faults > 0 or self.chances

    @property
    def draws_echoes(self) -> bool:
        """Whether some echoes are detected with a probability."""
        return self.surfaces is not None and self.surfaces.weak

    @property
    def moving(self) -> bool:
        """Whether the obstacle points that the law receives may move."""
        return self.sensing == "sonar" or any(kind not in ("box", "disc") for kind in self.bodies)

    @property
    def movers(self) -> int:
        """Number of moving obstacles."""
        return self.bodies.count("mover")

    @property
    def slots(self) -> int:
        """Number of moving obstacles that a message of the base station contains."""
        return min(CONTACT_SLOTS, self.movers)

    @property
    def contacts(self) -> int:
        """Number of obstacle points that the law receives."""
        return min(CONTACT_SLOTS, self.movers if self.sensing == "sonar" else len(self.bodies))
