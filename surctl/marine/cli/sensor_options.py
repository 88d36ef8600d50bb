"""Options of sensors and failures (--fault, --chance, --echoes) of `simulate` and `export`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import degrees, inf, isfinite
from typing import Any, NoReturn

from surctl.cli.options import changed, option
from surctl.errors import InputError, check_known, nearest
from surctl.marine.cli import lib

FORM = "KIND:SENSOR[:START[:DURATION]]"

_PARTS = {
    "sensor": ("sensor", "count sensors from 0, in whole numbers"),
    "start_s": ("start", "give seconds, at least 0"),
    "duration_s": ("duration", "give seconds, greater than 0"),
    "delay_s": ("delay", "give 0.1 to 0.8 s"),
}


@dataclass(frozen=True, eq=False, repr=False)
class SensorOptions:
    """The sensor options of the command line; an option that is not given leaves the scenario's value unchanged.

    Faults have the form of `parse_fault` or `parse_thruster_fault`, probabilities that of `parse_chances`; they replace
    all of the scenario.
    """

    faults: Sequence[str] = option(
        "--fault", "Such as stuck:0:5:2 (sonar 0 at 5 s for 2 s), thruster:T2.", (), metavar="FAULT"
    )
    chances: Sequence[str] = option(
        "--chance", "Probability P that a ping has the fault KIND; repeatable.", (), metavar="KIND=P"
    )
    echoes: str | None = option("--echoes", "Sonar echoes: ideal (default), webots, specular, diffuse.", metavar="NAME")

    def check(self, *, sensing: str) -> None:
        """Raise InputError for an option that has no effect on the runs, or for an unknown value."""
        check_known(sensing, lib.SENSING, key="--sensing")
        for key, value in changed(self).items() if sensing == "truth" else ():
            text = value if key == "--echoes" else " ".join(value)
            remedy = "add --sensing sonar, or drop this option"
            raise InputError("has no effect with true positions", key=key, value=text, remedy=remedy)
        if self.echoes is not None:
            check_known(self.echoes, lib.ECHOES, key="--echoes")

    def over(self, scenario: lib.Scenario) -> lib.Scenario:
        """Return the scenario with these sensor options.

        Raises:
            InputError: an option cannot be read, or the scenario's sonars do not support it.
        """
        return replace(scenario, sensors=self._sensors(scenario.sensors))

    def _sensors(self, old: lib.Sensors) -> lib.Sensors:
        if self.echoes is not None:
            old = old.hearing(self.echoes)
        array = old.equipment.array
        faults = tuple(_checked(array, text) for text in self.faults) or old.faults
        chances = _possible(array, self.chances) if self.chances else old.chances
        return replace(old, faults=faults, chances=chances)


def parse_fault(text: str) -> lib.Fault:
    """Return the fault written as KIND:SENSOR[:START[:DURATION]], times in s; for a delay, KIND is `delay=SECONDS`.

    Raises:
        InputError: the kind is unknown, or a part is missing, superfluous, not a number or out of range.
    """
    head, *rest = text.split(":")
    kind, equals, delay = head.partition("=")
    if kind not in lib.FAULT_KINDS:
        _refuse("is not a known fault", text, f"{nearest(kind, lib.FAULT_KINDS)}; write {FORM}")
    if not 1 <= len(rest) <= 3:
        _refuse("names no sensor" if not rest else "has too many parts", text, f"write {FORM}")
    if kind == "delay" and not equals:
        _refuse("does not give the length of the delay", text, "write delay=SECONDS:SENSOR")
    if kind != "delay" and equals:
        _refuse(f"a {kind} fault takes no number", text, f"write {kind}:SENSOR")
    if kind == "dead" and len(rest) == 3:
        _refuse("a dead sensor stays dead", text, "use dropout for a fault that ends")
    if not (rest[0].isascii() and rest[0].isdecimal() and len(rest[0]) < 10):
        _refuse(f"sensor {rest[0]!r} is not a whole number", text, _PARTS["sensor"][1])
    parts = dict(zip(("sensor", "start_s", "duration_s"), rest, strict=False)) | ({"delay_s": delay} if equals else {})
    try:
        return lib.validate({"faults": [{"kind": kind, **parts}]}, lib.SonarTable, file=None).faults[0]
    except InputError as error:
        name = (error.key or "").rpartition(".")[2]
        which, remedy = _PARTS[name]
        _refuse(f"{which} {parts[name]!r} is not valid", text, remedy)


def parse_chances(texts: Sequence[str]) -> lib.FaultChances:
    """Return the fault probabilities written as several texts KIND=P.

    Raises:
        InputError: a kind is unknown, does not occur at random or is given twice, P is not a number in [0, 1], or the
            probabilities add up to more than 1.
    """
    chances: dict[str, float] = {}
    for text in texts:
        kind, equals, number = text.partition("=")
        if kind in lib.FAULT_KINDS and kind not in lib.FaultChances.kinds():
            _refuse(f"{kind} does not occur at random", text, f"write --fault {kind}:SENSOR", key="--chance")
        if kind not in lib.FaultChances.kinds():
            _refuse("is not a known fault", text, nearest(kind, lib.FaultChances.kinds()), key="--chance")
        if not equals:
            _refuse("has no probability", text, f"write {kind}=P", key="--chance")
        if kind in chances:
            _refuse(f"{kind} is given twice", text, "give each kind once", key="--chance")
        chance = _float(number)
        if not 0 <= chance <= 1:
            _refuse("is not a probability", text, "give a number from 0 to 1", key="--chance")
        chances[kind] = chance
    total = sum(chances.values())
    if total > 1.0 + 1e-12:
        problem = f"the fault probabilities of one firing add up to {total:g}"
        remedy = "reduce them to a sum of at most 1, because at most one fault occurs"
        raise InputError(problem, key="--chance", value=" ".join(texts), remedy=remedy)
    return lib.FaultChances(**chances)


def sensor_data(scenario: lib.Scenario) -> dict[str, Any]:
    """Return the sensor settings that the options may change, and the scenario's own reflectors, as plain data."""
    sensors = scenario.sensors
    own = {o.name: o.reflector for o in scenario.obstacles if o.reflector is not None}
    reflectors = scenario.reflectors.tables() | ({"obstacles": own} if own else {})
    return {
        "beam_deg": degrees(sensors.equipment.array.beam_angle),
        "pitch_deg": degrees(sensors.equipment.array.elevation),
        "echoes": sensors.echo_model,
        "reflectors": {name: table for name, table in reflectors.items() if table},
        "own_state": "truth" if sensors.equipment.own is None else "measured",
        "faults": [fault.model_dump(exclude_none=True) for fault in sensors.faults],
        "chances": sensors.chances.model_dump(exclude_defaults=True),
    }


def _checked(array: lib.SonarArray, text: str) -> lib.Fault:
    fault = parse_fault(text)
    try:
        lib.check_faults(array, [fault])
    except InputError as error:
        _refuse(error.problem, text, error.remedy or "choose another fault")
    return fault


def _possible(array: lib.SonarArray, texts: Sequence[str]) -> lib.FaultChances:
    chances = parse_chances(texts)
    try:
        lib.check_faults(array, [], chances)
    except InputError as error:
        _refuse(error.problem, " ".join(texts), error.remedy or "drop this option", key="--chance")
    return chances


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _refuse(problem: str, text: str, remedy: str, *, key: str = "--fault") -> NoReturn:
    raise InputError(problem, key=key, value=text, remedy=remedy)


THRUSTER_FORM = "thruster:NAME[:START[:DURATION]]"
_KIND = "thruster:"


def split_faults(
    texts: Sequence[str], *, refused: str | None = None
) -> tuple[tuple[str, ...], list[lib.ThrusterFault]]:
    """Return the texts of sensor faults, and the thruster faults.

    `refused` says why a command accepts no thruster faults; None: it accepts them.

    Raises:
        InputError: a thruster fault cannot be read, or `refused` is given and there is one.
    """
    mine = [text for text in texts if text.startswith(_KIND)]
    if mine and refused is not None:
        raise InputError("is not for this command", key="--fault", value=mine[0], remedy=refused)
    return tuple(text for text in texts if text not in mine), [parse_thruster_fault(text) for text in mine]


def parse_thruster_fault(text: str) -> lib.ThrusterFault:
    """Return the fault written as thruster:NAME[:START[:DURATION]], times in s.

    Raises:
        InputError: a part is missing, superfluous, not a number or out of range.
    """
    name, *times = text.removeprefix(_KIND).split(":")
    numbers = [_float(part) for part in times]
    start = numbers[0] if numbers else 0.0
    duration = numbers[1] if len(numbers) > 1 else inf
    good = name and len(numbers) <= 2 and isfinite(start) and start >= 0 and duration > 0
    if not good:
        raise InputError(
            "is not a thruster fault", key="--fault", value=text, remedy=f"write {THRUSTER_FORM}, times in s"
        )
    return lib.ThrusterFault(name, start, duration)
