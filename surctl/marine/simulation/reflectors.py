"""Echo models by name (`echoes`), tables `[reflectors.NAME]`, and the reflectors of walls, surface and floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from surctl.errors import InputError, nearest
from surctl.files import Strict
from surctl.marine.sensing import REFLECTORS, Reflector, Surfaces
from surctl.marine.simulation.toml_text import key_text

if TYPE_CHECKING:
    from surctl.marine.sensing import SonarArray
    from surctl.marine.simulation.obstacle import Obstacle

NotNegative = Annotated[float, Field(ge=0)]
Incidence = Annotated[float, Field(ge=0, lt=90)]

_WALLS = ("x0", "x1", "y0", "y1")


@dataclass(frozen=True)
class EchoModel:
    """Names of the reflectors of upright surfaces and of surface and floor, where they have none of their own."""

    upright: str
    level: str = "silent"


ECHOES: Mapping[str, EchoModel] = MappingProxyType(
    {
        "ideal": EchoModel("ideal"),
        "webots": EchoModel("webots"),
        "specular": EchoModel("specular", "specular"),
        "diffuse": EchoModel("diffuse", "diffuse"),
    }
)
"""Echo models by name; `REFLECTORS` defines the reflectors.

`ideal`: every surface answers; water surface and floor are silent. `webots`: the rule of the simulator of the paper for
sonar sensors: surfaces answer within 22.5 degrees of their normal. `specular`: smooth walls, obstacles, water surface
and floor. `diffuse`: rough ones, so that a beam receives echoes of the water surface and of the floor."""


class ReflectorTable(Strict):
    """A kind of reflector that a scenario file defines in a table `[reflectors.NAME]`; see `Reflector`."""

    incidence_limit_deg: Incidence | None = None
    edge_range_m: NotNegative = 0.0
    cylinder_range_m: NotNegative | None = None
    corners: bool = False

    def reflector(self) -> Reflector:
        """Return the reflector."""
        limit = None if self.incidence_limit_deg is None else self.incidence_limit_deg * pi / 180.0
        return Reflector(limit, self.edge_range_m, self.cylinder_range_m, self.corners)


class WallTable(Strict):
    """Names of the reflectors of single walls of the site."""

    x0: str | None = None
    x1: str | None = None
    y0: str | None = None
    y1: str | None = None


@dataclass(frozen=True)
class Reflectors:
    """The reflectors that a scenario file names for its site, and the kinds that it defines.

    Attributes:
        walls: (4,) names of the reflectors of the walls x = 0, x = length, y = 0, y = width; None: as the echo model.
        surface, floor: names of the reflectors of water surface and floor; None: as the echo model.
        kinds: the kinds that the file defines, by name.
    """

    walls: tuple[str | None, ...] = (None,) * 4
    surface: str | None = None
    floor: str | None = None
    kinds: Mapping[str, ReflectorTable] = field(default_factory=dict)

    def named(self, name: str, *, key: str) -> Reflector:
        """Return the reflector of a name; InputError with this key of the scenario file if there is none."""
        if name in self.kinds:
            return self.kinds[name].reflector()
        if name not in REFLECTORS:
            remedy = nearest(name, [*REFLECTORS, *self.kinds])
            if name:
                remedy += f", or define [reflectors.{key_text(name)}]"
            raise InputError("is not a known reflector", key=key, value=name, remedy=remedy)
        return REFLECTORS[name]

    def surfaces(
        self, obstacles: Sequence[Obstacle], array: SonarArray, *, echoes: str, depth: float
    ) -> Surfaces | None:
        """Return the reflectors of a scene; None if all upright surfaces answer as the array's `incidence_limit` says.

        `echoes` names the echo model, and is empty if this limit describes it; `depth` is that of the water [m].

        Raises:
            InputError: a name is unknown, or the file defines a kind by the name of a built-in one.
        """
        for name in self.kinds:
            if name in REFLECTORS:
                remedy = "choose another name, because echo models refer to the built-in kind"
                raise InputError("is the name of a built-in reflector", key=f"reflectors.{name}", remedy=remedy)
        model = ECHOES.get(echoes)
        usual = Reflector(array.incidence_limit) if model is None else REFLECTORS[model.upright]
        flat = REFLECTORS["silent" if model is None else model.level]

        def chosen(name: str | None, key: str, otherwise: Reflector = usual) -> Reflector:
            return otherwise if name is None else self.named(name, key=key)

        alike = len(set(self.walls)) == 1  # the file may name the reflector of all walls at once
        keys = ["site.walls" if alike else f"site.walls.{wall}" for wall in _WALLS]
        surfaces = Surfaces(
            tuple(chosen(o.reflector, f"obstacles.{o.name}.reflector") for o in obstacles),
            tuple(chosen(name, key) for name, key in zip(self.walls, keys, strict=True)),
            chosen(self.surface, "site.surface", flat),
            chosen(self.floor, "site.floor", flat),
            depth,
        )
        upright, level = {*surfaces.obstacles, *surfaces.walls}, {surfaces.surface, surfaces.floor}
        usually = model is None and upright == {usual} and level == {REFLECTORS["silent"]}
        return None if usually else surfaces

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the tables `site` and `reflectors` of a scenario file, without keys at their default."""
        site: dict[str, Any] = {}
        named = {wall: name for wall, name in zip(_WALLS, self.walls, strict=True) if name is not None}
        if named:
            site["walls"] = named
        site |= {key: name for key, name in (("surface", self.surface), ("floor", self.floor)) if name is not None}
        kinds = {name: kind.model_dump(exclude_none=True) for name, kind in self.kinds.items()}
        return {"site": site, **({"reflectors": kinds} if kinds else {})}
