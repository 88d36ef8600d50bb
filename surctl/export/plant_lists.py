"""The instruction lists of the plant that a controller was designed for, in the bundle of the controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.listed import Listed
from surctl.export.supplement import Supplement
from surctl.system import Plant

__all__ = ["PlantLists"]

Vector = NDArray[np.float64]

_PLANT, _MEASURED = "plant.txt", "plant_measured.txt"


@dataclass(frozen=True, eq=False)
class PlantLists(Supplement):
    """The instruction lists of the plant that a controller was designed for, with its parameters (np,).

    Example:
        >>> import numpy as np
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.export.plant_lists import PlantLists
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant
        >>> level, flow = Port("level", (1,), "m", "of the water"), Port("flow", (1,), "m/s", "inflow over the area")
        >>> tank = Plant("tank", Layout((level,)), Layout((flow,)), lambda x, f, d, p: f["flow"] - 0.1 * x["level"])
        >>> law = Controller("held", 0.1, tank.state, tank.inputs, lambda x, u, p: -u["level"])
        >>> bundle = build_bundle(law, {}, supplement=PlantLists(tank, np.zeros(0)))
        >>> [name for name in bundle.files if name.startswith(("law", "plant"))]
        ['law.txt', 'plant.txt', 'plant_measured.txt']
    """

    plant: Plant
    parameters: Vector

    def lists(self, law: Exportable) -> dict[str, Listed]:
        """Return the lists of x' from x, f, d and p, and of y from x, d and p."""
        del law
        plant = self.plant
        vectors = {"state": plant.state, "inputs": plant.inputs, "disturbances": plant.disturbances}
        flow = Listed(
            plant.block, vectors | {"parameters": plant.parameters}, {"values": ("parameters", self.parameters)}
        )
        return {_PLANT: flow, _MEASURED: Listed(plant.measured, {"outputs": plant.measurements})}
