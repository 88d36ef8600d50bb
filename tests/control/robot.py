"""A robot among shapes that stand still, told by its senses alone: what `build_senses` makes, step by step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.ir import compile_block
from surctl.ir.native import Native
from surctl.marine.control import Gains, load_gains
from surctl.marine.control.perception import PerceptionStage, build_perception
from surctl.marine.control.ports import SECTORS, law_parameters, scan_inputs, sonar_inputs
from surctl.marine.guidance import Path
from surctl.marine.sensing import Equipment, LocalMap, SonarArray
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.world import Shape, site_walls
from tests.oracles.echoes import firing_samples, true_range

Array = NDArray[np.float64]
Wrong = Callable[[Array, int], Array | None]

DT, CONTACTS, HULL, SITE = 0.05, 2, 0.27, (0.0, 4.0, 0.0, 4.0)
EDGE = HULL / 4


@cache
def senses(equipment: Equipment) -> tuple[PerceptionStage, Native]:
    """What runs before the decision, and the same compiled."""
    made = build_perception(
        equipment,
        sonar_inputs(equipment, contacts=CONTACTS),
        scan_inputs(CONTACTS + SECTORS, sensors=equipment.array.size),
        dt=DT,
    )
    return made, compile_block(made.block)


PATH = Path(np.array([[0.5, 2.0], [3.5, 2.0]]))


@cache
def known() -> tuple[Gains, Vehicle]:
    """Gains and vehicle of every test here: the default ones."""
    return load_gains("default"), load_vehicle("sur540-flooded")


def parameters(
    walls: tuple[float, float, float, float] = SITE, *, launch: float = 0.0, path: Path = PATH, **gains: float
) -> Array:
    """Of the default vehicle, on a straight path along x unless told."""
    default, vehicle = known()
    return law_parameters(
        default.with_values(gains),
        vehicle,
        path=path,
        depth=-0.15,
        cruise=0.2,
        cap=0.22,
        walls=walls,
        launch=launch,
    )


class Robot:
    """Stands or turns in the site's four walls and what else there is.

    Attributes:
        wrong: by sensor, what it makes of its honest samples, given the number of the step; None: nothing arrives.
    """

    def __init__(
        self,
        equipment: Equipment,
        *,
        at: Sequence[float] = (2.0, 2.0, -0.15, 0.0),
        spin: float = 0.27,
        shapes: Sequence[Shape] = (),
        walls: tuple[float, float, float, float] = SITE,
        seed: int = 0,
        launch: float = 0.0,
    ) -> None:
        self.equipment, self.array, self.spin = equipment, equipment.array, spin
        self.made, self.run = senses(equipment)
        self.eta, self.nu = np.array(at, dtype=float), np.array([0.0, 0.0, 0.0, spin])
        self.shapes = [*site_walls(walls[3], walls[1]), *shapes]
        self.p, self.rng, self.tick = parameters(walls, launch=launch), np.random.default_rng(seed), 0
        self.x = self.made.state.pack()
        self.samples = np.full((self.array.size, self.array.samples), self.array.maximum)
        self.wrong: dict[int, Wrong] = {}
        self.chart = LocalMap(dt=DT, sectors=SECTORS)

    def fired(self) -> Array:
        """(n,) fresh flags; the samples are kept."""
        fresh = np.zeros(self.array.size)
        every = round(DT / self.array.firing_period)
        for k in (self.array.sensor_at(every * self.tick + i) for i in range(every)):
            away = true_range(self.array, k, position=self.eta[:2], heading=self.eta[3], shapes=self.shapes)
            honest = firing_samples(self.array, away, noise=self.rng.standard_normal(self.array.samples))
            told = self.wrong[k](honest, self.tick) if k in self.wrong else honest
            if told is not None:
                self.samples[k], fresh[k] = told, 1.0
        return fresh

    def inputs(self) -> dict[str, Any]:
        """What a perfect camera and IMU tell, or the truth, and no message."""
        given: dict[str, Any] = {"fresh": self.fired(), "samples": self.samples, "contacts": np.zeros((CONTACTS, 6))}
        given["contacts_fresh"] = 0.0
        if self.equipment.own is None:
            return {**given, "eta": self.eta, "nu": self.nu}
        return {**given, "fix": self.eta[:3], "fix_fresh": 1.0, "yaw": self.eta[3], "yaw_rate": self.nu[3]}

    def step(self, **other: object) -> Mapping[str, Array]:
        """One period; `other` replaces inputs. What it tells, by name."""
        u = self.made.inputs.pack({**self.inputs(), **other})
        after, told = self.run(self.x, u, self.p)
        self.x = np.concatenate([np.zeros(4), after])
        self.tick += 1
        self.eta[3] += self.spin * DT
        return self.made.outputs.unpack(told.copy())

    def steps(self, seconds: float, **other: object) -> Mapping[str, Array]:
        """The last of many."""
        for _ in range(round(seconds / DT)):
            told = self.step(**other)
        return told

    def state(self, name: str) -> Array:
        """One of the state's arrays."""
        return self.x[self.made.state.slice(name)].copy()


TRUTH = Equipment(own=None)


def exact(**array: Any) -> Equipment:
    """The true pose, and sonars without noise."""
    return Equipment(array=SonarArray(**{"noise_sd": 0.0, "bits": 16, "bias": 0.0, **array}), own=None)
