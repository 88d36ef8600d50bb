"""How MuJoCo simulates a vehicle: degrees of freedom, drag model, water surface, and rays of the sonars."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from surctl.errors import InputError, nearest
from surctl.marine.vehicle import Vehicle

__all__ = ["EngineOptions", "parse_plant"]

_PLANTS = ("own", "mujoco")
_FORM = "write --plant mujoco or --plant mujoco:KEY=VALUE,..."
_BOX = "write LENGTHxWIDTHxHEIGHT in m, such as 1.2x0.6x0.4"
_UNLIKE = 20.0  # largest ratio of a side of a box to the diameter in the vehicle file, and of this to a side
_WORDS = {"drag": ("axis", "speed", "ellipsoid"), "rays": ("cone", "fan"), "ballast": ("path", "none")}
_SWITCHES = ("floor", "surface_echo")


@dataclass(frozen=True)
class EngineOptions:
    """The choices of a simulation in MuJoCo that a vehicle file does not make.

    Attributes:
        dof: degrees of freedom: 6, or 4 without roll and pitch. 0: 6 for a vehicle file with `[attitude]`, else 4.
        drag: `axis`: the drag of the vehicle file; `speed`: its quadratic drag on each axis of translation grows with
            the speed |v| instead of that axis' own velocity; `ellipsoid`: MuJoCo's fluid model of a sphere instead of
            the quadratic drag of the file.
        surface: share in [0, 1] of the displacement of the part of the hull above the water that is missing as
            buoyancy: 1 if the hull keeps its water, the dry mass over the displaced mass if it drains, 0 without a
            surface.
        box: length, width and height [m] of a hull that is a box about its centre; None: a sphere with the radius of
            the file. It decides the missing buoyancy and, with six degrees of freedom, the righting moment of the
            water surface; contacts remain those of the sphere.
        ballast: `path`: the vehicle is ballasted to float at the depth of the path; `none`: it is not.
        rays: `cone`: rays in a cone in space, which rolls and pitches with the hull; `fan`: rays in a horizontal fan.
        count: number of rays of a sonar.
        floor, surface_echo: whether the sonars receive echoes from the floor and from the water surface.
        step: longest step of the integration [s].

    Example:
        >>> from surctl.marine.engine import EngineOptions
        >>> EngineOptions(surface=1.0).text()
        'surface=1.0'
    """

    dof: int = 0
    drag: str = "axis"
    surface: float = 0.0
    box: tuple[float, float, float] | None = None
    ballast: str = "path"
    rays: str = "cone"
    count: int = 200
    floor: bool = False
    surface_echo: bool = False
    step: float = 0.0125

    def __post_init__(self) -> None:
        """Raise InputError for a value that is not possible."""
        if self.dof not in (0, 4, 6):
            raise InputError("is not possible", key="dof", value=self.dof, remedy="use 4 or 6")
        for key, known in _WORDS.items():
            if getattr(self, key) not in known:
                raise InputError(
                    "is not known", key=key, value=getattr(self, key), remedy=nearest(getattr(self, key), known)
                )
        for key, low, high in (("surface", 0.0, 1.0), ("count", 8, 100_000), ("step", 1e-4, 0.025)):
            if not low <= getattr(self, key) <= high:
                raise InputError(
                    "is not possible", key=key, value=getattr(self, key), remedy=f"give {low:g} to {high:g}"
                )

        if self.box is not None and (len(self.box) != 3 or not all(1e-3 <= side <= 1e3 for side in self.box)):
            raise InputError("is not a box", key="box", value=_written(self.box), remedy=_BOX)
        for key in ("box", "ballast") if self.surface == 0 else ():
            if (value := getattr(self, key)) not in (None, "path"):
                remedy = f"add surface=1.0, or drop {key}"
                raise InputError("needs a water surface", key=key, value=_written(value), remedy=remedy)

    def of(self, vehicle: Vehicle) -> EngineOptions:
        """Return the options for a vehicle, with its degrees of freedom.

        Raises:
            InputError: the vehicle has no roll and pitch, but `dof` is 6; or the sides of the box are not in m.
        """
        if self.dof == 6 and not vehicle.form.tilts:
            raise InputError(
                f"needs weight, buoyancy and inertia of roll and pitch, which {vehicle.name} does not state",
                key="dof",
                value=6,
                remedy="add [attitude], mpp and mqq to the file, use sur540-tilting or sur400-tilting, or dof=4",
            )
        width = 2 * vehicle["radius"]
        if self.box is not None and not all(width / _UNLIKE <= side <= width * _UNLIKE for side in self.box):
            problem = f"is not plausible in m for {vehicle.name}, whose file has a diameter of {width:g} m"
            raise InputError(problem, key="--plant mujoco:box", value=_written(self.box), remedy=_BOX)
        return replace(self, dof=self.dof or (6 if vehicle.form.tilts else 4))

    @property
    def unheard(self) -> tuple[str, ...]:
        """Names of the options that are not the default and concern sonars only."""
        usual = EngineOptions()
        return tuple(key for key in ("rays", "count", *_SWITCHES) if getattr(self, key) != getattr(usual, key))

    def text(self) -> str:
        """Return all options that differ from their defaults as one text, which `parse_plant` reads."""
        usual = EngineOptions()
        pairs = [(f.name, getattr(self, f.name)) for f in fields(self)]
        return ",".join(f"{key}={_written(value)}" for key, value in pairs if value != getattr(usual, key))

    def to_dict(self) -> dict[str, Any]:
        """Return the options as plain data for JSON."""
        return asdict(self)


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return "x".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def parse_plant(text: str) -> EngineOptions | None:
    """Return the options of a plant on the command line: `mujoco`, `mujoco:KEY=VALUE,…`; None for `own`.

    Raises:
        InputError: the plant, a key or a value is unknown.

    Example:
        >>> from surctl.marine.engine import parse_plant
        >>> parse_plant("mujoco:dof=4,surface=0.1").surface
        0.1
        >>> parse_plant("own") is None
        True
    """
    name, colon, rest = text.partition(":")
    if name not in _PLANTS:
        raise InputError("is not known", key="--plant", value=text, remedy=nearest(name, _PLANTS))
    if name == "own":
        if colon:
            raise InputError("has no options", key="--plant", value=text, remedy="write --plant own")
        return None
    values: dict[str, Any] = {}
    known = [f.name for f in fields(EngineOptions)]
    for part in rest.split(",") if colon else ():
        if not part:
            raise InputError("has an option that is empty", key="--plant", value=text, remedy=_FORM)
        key, equals, value = part.partition("=")
        if key not in known:
            raise InputError("is not an option of this plant", key="--plant", value=part, remedy=nearest(key, known))
        if not equals:
            raise InputError("has no value", key="--plant", value=part, remedy=_FORM)
        if key in values:
            raise InputError("is there twice", key=f"--plant mujoco:{key}", value=value, remedy="write it once")
        values[key] = _value(key, value)
    try:
        return EngineOptions(**values)
    except InputError as error:
        raise error.inside(None, f"--plant mujoco:{error.key}") from None


def _value(key: str, text: str) -> Any:
    if key in _WORDS:
        return text
    if key == "box":
        try:
            return tuple(map(float, text.split("x")))
        except ValueError:
            raise InputError("is not a box", key=f"--plant mujoco:{key}", value=text, remedy=_BOX) from None
    if key in _SWITCHES:
        if text not in ("true", "false"):
            raise InputError("is neither true nor false", key=f"--plant mujoco:{key}", value=text, remedy="use true")
        return text == "true"
    try:
        return int(text) if key in ("dof", "count") else float(text)
    except ValueError:
        remedy = "give a whole number" if key in ("dof", "count") else "give a number"
        raise InputError("is not a number", key=f"--plant mujoco:{key}", value=text, remedy=remedy) from None
