"""The options of `surctl simulate` that change a scenario's sensors: read, checked, and laid over its tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, isfinite, radians
from typing import TYPE_CHECKING, Any, NoReturn

import click

from surctl.cli.output import together

if TYPE_CHECKING:
    from surctl.sensing import Fault, FaultChances, SonarArray
    from surctl.simulation import Scenario
    from surctl.simulation.sensors import Sensors

__all__ = ["SensorOptions", "parse_chances", "parse_fault", "sensor_data", "sensor_options"]

FORM = "KIND:SENSOR[:START[:DURATION]]"
OWN_STATES = ("measured", "truth")

_PARTS = {
    "sensor": ("sensor", "count them from 0"),
    "start_s": ("start", "give s, at least 0"),
    "duration_s": ("duration", "give s, greater than 0"),
    "delay_s": ("delay", "give 0.1 to 0.8 s"),
}
sensor_options = together(
    click.option(
        "--fault",
        "faults",
        multiple=True,
        metavar="FAULT",
        help="KIND:SENSOR[:START[:DURATION]]; repeatable.",
    ),
    click.option(
        "--chance",
        "chances",
        multiple=True,
        metavar="KIND=P",
        help="Fault probability per firing; repeatable.",
    ),
    click.option("--beam", type=float, metavar="DEG", help="Full opening angle of each sonar beam."),
    click.option("--own-state", help="Own position: measured or truth."),
)
"""Give a command the options; it takes them as `faults`, `chances`, `beam`, `own_state`."""


@dataclass(frozen=True)
class SensorOptions:
    """The options as they were typed; what is not given is as the scenario has it, what is given replaces it.

    Attributes:
        faults: each as `parse_fault` reads it; any takes the place of all faults of the scenario.
        chances: each as `parse_chances` reads it; any takes the place of all chances of the scenario.
        beam: full opening angle of the sonars [°].
        own_state: `measured` or `truth`.
    """

    faults: Sequence[str] = ()
    chances: Sequence[str] = ()
    beam: float | None = None
    own_state: str | None = None

    def check(self, *, law: str, sensing: str) -> None:
        """InputError for an option that would have no effect on these flights, or none that is known."""
        from surctl.errors import InputError, nearest

        options = {"--fault": self.faults, "--chance": self.chances, "--beam": self.beam, "--own-state": self.own_state}
        for key, value in options.items():
            if value is not None and value != () and sensing == "truth":
                text = value if key in ("--beam", "--own-state") else " ".join(value)  # type: ignore[arg-type]
                raise InputError(
                    "has no effect with true positions", key=key, value=text, remedy="add --sensing sonar, or drop it"
                )
        if self.beam is not None and law == "paper":
            raise InputError(
                "law paper has the four sonars of the paper", key="--beam", value=self.beam, remedy="fly law guarded"
            )
        if self.own_state is not None and self.own_state not in OWN_STATES:
            remedy = nearest(self.own_state, OWN_STATES)
            raise InputError("is not known", key="--own-state", value=self.own_state, remedy=remedy)

    def over(self, scenario: Scenario) -> Scenario:
        """The scenario with these sensors.

        Raises:
            InputError: an option that says nothing, or what the scenario's sonars cannot have.
        """
        return replace(scenario, sensors=self._sensors(scenario.sensors))

    def _sensors(self, old: Sensors) -> Sensors:
        from surctl.sensing import OwnState

        array, own = old.equipment.array, old.equipment.own
        if self.beam is not None:
            array = _widened(array, self.beam)
        faults = tuple(_checked(array, text) for text in self.faults) or old.faults
        chances = _possible(array, self.chances) if self.chances else old.chances
        if self.own_state is not None:
            own = None if self.own_state == "truth" else own or OwnState()
        return replace(old, equipment=replace(old.equipment, array=array, own=own), faults=faults, chances=chances)


def parse_fault(text: str) -> Fault:
    """A fault from KIND:SENSOR[:START[:DURATION]], times in s; of a delay KIND is `delay=SECONDS`.

    Raises:
        InputError: an unknown kind, a part that is missing, too much, no number or out of its range.
    """
    from surctl.errors import InputError, nearest
    from surctl.files import validate
    from surctl.sensing import FAULT_KINDS
    from surctl.simulation.sensors import SonarTable

    head, *rest = text.split(":")
    kind, equals, delay = head.partition("=")
    if kind not in FAULT_KINDS:
        _refuse("no such fault", text, f"{nearest(kind, FAULT_KINDS)}; write {FORM}")
    if not 1 <= len(rest) <= 3:
        _refuse("names no sensor" if not rest else "has too many parts", text, f"write {FORM}")
    if kind == "delay" and not equals:
        _refuse("a delay needs its length", text, "write delay=SECONDS:SENSOR")
    if kind != "delay" and equals:
        _refuse(f"a {kind} fault takes no number", text, f"write {kind}:SENSOR")
    if kind == "dead" and len(rest) == 3:
        _refuse("a dead sensor stays dead", text, "write dropout for one that comes back")
    if not (rest[0].isascii() and rest[0].isdecimal() and len(rest[0]) < 10):
        _refuse(f"sensor {rest[0]!r} is no whole number", text, _PARTS["sensor"][1])
    table: dict[str, object] = {"kind": kind, "sensor": int(rest[0])}
    for key, part in (("delay_s", [delay] if equals else []), ("start_s", rest[1:2]), ("duration_s", rest[2:3])):
        if part:
            table[key] = _number(part[0], text, key)
    try:
        return validate({"faults": [table]}, SonarTable, file=None).faults[0]
    except InputError as error:
        which, remedy = _PARTS[(error.key or "").rpartition(".")[2]]
        _refuse(f"{which}: {error.problem}", text, remedy)


def parse_chances(texts: Sequence[str]) -> FaultChances:
    """The chances of several KIND=P.

    Raises:
        InputError: an unknown kind, one that does not strike by chance, a kind twice, P that is no number in [0, 1],
            or chances that add up to more than 1.
    """
    from surctl.errors import InputError, nearest
    from surctl.sensing import FAULT_KINDS, FaultChances

    chances: dict[str, float] = {}
    for text in texts:
        kind, equals, number = text.partition("=")
        if kind in FAULT_KINDS and kind not in FaultChances.kinds():
            _refuse(f"{kind} does not strike by chance", text, f"write --fault {kind}:SENSOR", key="--chance")
        if kind not in FaultChances.kinds():
            _refuse("no such fault", text, nearest(kind, FaultChances.kinds()), key="--chance")
        if not equals:
            _refuse("has no number", text, f"write {kind}=P", key="--chance")
        if kind in chances:
            _refuse(f"{kind} is given twice", text, "give each kind once", key="--chance")
        chance = _float(number)
        if not 0 <= chance <= 1:
            _refuse("is no chance", text, "give a number from 0 to 1", key="--chance")
        chances[kind] = chance
    total = sum(chances.values())
    if total > 1.0 + 1e-12:
        raise InputError(
            f"the chances of one firing add up to {total:g}",
            key="--chance",
            value=" ".join(texts),
            remedy="at most one fault strikes: keep the sum to 1",
        )
    return FaultChances(**chances)


def sensor_data(scenario: Scenario) -> dict[str, Any]:
    """What of a scenario's sensors the options may change, as plain data."""
    sensors = scenario.sensors
    return {
        "beam_deg": degrees(sensors.equipment.array.beam_angle),
        "own_state": "truth" if sensors.equipment.own is None else "measured",
        "faults": [fault.model_dump(exclude_none=True) for fault in sensors.faults],
        "chances": sensors.chances.model_dump(exclude_defaults=True),
    }


def _checked(array: SonarArray, text: str) -> Fault:
    from surctl.errors import InputError
    from surctl.sensing import check_faults

    fault = parse_fault(text)
    try:
        check_faults(array, [fault])
    except InputError as error:
        _refuse(error.problem, text, error.remedy or "name another")
    return fault


def _possible(array: SonarArray, texts: Sequence[str]) -> FaultChances:
    from surctl.errors import InputError
    from surctl.sensing import check_faults

    chances = parse_chances(texts)
    try:
        check_faults(array, [], chances)
    except InputError as error:
        _refuse(error.problem, " ".join(texts), error.remedy or "drop it", key="--chance")
    return chances


def _widened(array: SonarArray, beam: float) -> SonarArray:
    from surctl.errors import InputError

    if not 0 < beam < 180:
        raise InputError("is no opening angle", key="--beam", value=beam, remedy="give degrees between 0 and 180")
    try:
        return replace(array, beam_angle=radians(beam))
    except InputError as error:
        now = f"the scenario has {degrees(array.beam_angle):g}"
        raise InputError(error.problem, key="--beam", value=beam, remedy=error.remedy or now) from None


def _number(part: str, text: str, key: str) -> float:
    name, remedy = _PARTS[key]
    value = _float(part)
    if not isfinite(value):
        _refuse(f"{name} {part!r} is no number", text, remedy)
    return value


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _refuse(problem: str, text: str, remedy: str, *, key: str = "--fault") -> NoReturn:
    from surctl.errors import InputError

    raise InputError(problem, key=key, value=text, remedy=remedy)
