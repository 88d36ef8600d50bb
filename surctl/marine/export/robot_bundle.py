"""The bundle of a law of the robot: origin and certificates, wiring of its sensors, and missions as C data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.export import bundle as core
from surctl.export.contract import DATA, MISSION_FILES, Exportable
from surctl.export.envelope import Envelope
from surctl.export.listed import Listed
from surctl.export.supplement import Supplement
from surctl.ir import Real
from surctl.marine.control import FED
from surctl.marine.export.missions import data_rows, is_fed, mission_values
from surctl.marine.export.origin import Origin, check_belonging, origin_entries
from surctl.marine.export.robot_wiring import robot_wiring

__all__ = ["build_bundle"]

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Robot(Supplement):
    origin: Origin | None
    mission: Vector | None

    @property
    def files(self) -> dict[str, str]:
        return {} if self.origin is None else self.origin.files

    def fed(self, law: Exportable) -> tuple[str, ...]:
        return () if self.mission is None or not is_fed(law) else tuple(FED)

    def templates(self, law: Exportable) -> dict[str, str]:
        names = (*(MISSION_FILES if is_fed(law) else ()), *(() if self.mission is None else (DATA,)))
        return {name: f"{name}.j2" for name in names}

    def values(self, law: Exportable, real: Real) -> dict[str, Any]:
        fed = {"fed": True, **mission_values(law, real)} if is_fed(law) else {}
        rows = {} if self.mission is None else {"rows": data_rows(law, self.mission, real)}
        return robot_wiring(law, self.origin) | fed | rows

    def entries(self, law: Exportable, p: Vector) -> dict[str, Any]:
        return {} if self.origin is None else origin_entries(law, p, self.origin)

    def lists(self, law: Exportable) -> dict[str, Listed]:
        return {} if self.origin is None else self.origin.lists(law)

    def check(self, manifest: Mapping[str, Any], files: Mapping[str, str]) -> None:
        if self.origin is not None:
            check_belonging(manifest, files, self.origin)


def build_bundle(
    law: Exportable,
    gains: Mapping[str, Vector],
    *,
    name: str | None = None,
    real: Real = "float64",
    envelope: Envelope | None = None,
    origin: Origin | None = None,
    mission: Vector | None = None,
) -> core.Bundle:
    """Return the C bundle of a control law with tuned gains.

    Args:
        law: the control law.
        gains: values of the gains by name; a gain without a value has its default.
        name: prefix of file names and C symbols; by default the name of the law.
        real: "float32" for a processor with a single-precision unit; every number in the C text is then a float.
        envelope: ranges that the input check of the exported C accepts; None accepts any finite number.
        origin: vehicle and certificates to record in the bundle.
        mission: waypoints (n, 5) of a mission for the file `mission_data.h`, see `guidance.Path.table`; None: no file.

    Raises:
        InputError: a name is not a valid C identifier, a gain is unknown or not finite, the sizes that the law declares
            differ from those of its code, a certificate is about another controller, or a float32 law calls functions
            of the C library such as sin.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import build_bundle
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> bundle = build_bundle(law, law.gains.unpack(p), real="float32")
        >>> bundle.name, bundle.real, len(bundle.sources)
        ('surctl_closed_form', 'float32', 3)
    """
    added = _Robot(origin, mission)
    return core.build_bundle(law, gains, name=name, real=real, envelope=envelope, supplement=added)
