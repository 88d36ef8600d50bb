"""Options of the robot: default vehicle, gains, law, sensing and speeds, refusals, and commands to suggest."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import click

from surctl.cli.options import changed, option
from surctl.errors import InputError, check_known
from surctl.marine.cli import lib

DEFAULT_VEHICLE = "sur540-flooded"
"""The vehicle of a command without `--vehicle` and without a scenario."""


class VehicleChoice(NamedTuple):
    """Name or file of a vehicle, and the origin of the choice: "--vehicle", "scenario NAME" or "default"."""

    word: str
    origin: str

    def line(self, name: str) -> str:
        """Return one line that names the vehicle and the origin of the choice; `name` is the name in its file."""
        return f"vehicle {name} (from {self.origin})" if self.origin != "default" else f"vehicle {name} (default)"


def choose_vehicle(option: str | None, scenario: tuple[str, str] | None = None) -> VehicleChoice:
    """Return the vehicle of the option `--vehicle`, else the vehicle of the scenario, else the default vehicle.

    Args:
        option: value of the option `--vehicle`; None if it is not given.
        scenario: name of the scenario and name or file of its vehicle; None if the command has no scenario.

    Raises:
        InputError: the scenario names a file that does not exist.
    """
    if option is not None:
        return VehicleChoice(option, "--vehicle")
    if scenario is not None:
        if scenario[1].endswith(".toml") and not Path(scenario[1]).is_file():
            key, remedy = f"vehicle of scenario {scenario[0]}", "correct the entry, or give --vehicle"
            raise InputError("no such file", key=key, value=scenario[1], remedy=remedy)
        return VehicleChoice(scenario[1], f"scenario {scenario[0]}")
    return VehicleChoice(DEFAULT_VEHICLE, "default")


def at_hand(scenario: lib.Scenario, vehicle: lib.Vehicle, gains: str) -> list[str]:
    """Return the command-line options that select the given mission, vehicle and gain file."""

    def word(source: str, library: Path) -> str:
        return Path(source).stem if Path(source).parent == library else source

    mission = word(scenario.source, lib.SCENARIOS) or scenario.name
    robot = word(vehicle.source, lib.VEHICLES) or vehicle.name
    return ["--scenario", mission, "--vehicle", robot, "--gains", gains]


class GainsChoice(NamedTuple):
    """The gains, lines that say how they were derived (empty for a named set), and the same as data (or None)."""

    gains: lib.Gains
    lines: list[str]
    data: dict[str, Any] | None

    @property
    def derived(self) -> bool:
        """Whether the gains were derived from the vehicle."""
        return self.data is not None


def choose_gains(
    word: str | None, vehicle: lib.Vehicle, *, cruise: float, own: Mapping[str, lib.GainSpec] | None = None
) -> GainsChoice:
    """Return the gains of the option `--gains`, or the default gains of the vehicle at a cruise speed [m/s]."""
    return choose_shared(word, [(vehicle, cruise)], own=own)


def _beyond(pairs: Sequence[tuple[lib.Vehicle, float]]) -> list[str]:
    # one line for each vehicle whose cruise speed needs more thrust than laws give

    said = [(f"{cruise:g} m/s {vehicle.name}", lib.beyond_law(vehicle, cruise)) for vehicle, cruise in pairs]
    return list(dict.fromkeys(f"  warning: at {who} {beyond}; {lib.WITHIN_LAW}" for who, beyond in said if beyond))


def choose_shared(
    word: str | None, pairs: Sequence[tuple[lib.Vehicle, float]], *, own: Mapping[str, lib.GainSpec] | None = None
) -> GainsChoice:
    """Return one gain set for several vehicles, each with its cruise speed [m/s]; see `tuning.shared_gains`."""
    gains, derivation = lib.shared_gains(word, pairs, own=own)
    if derivation is not None:
        return GainsChoice(gains, [*derivation.lines(), *_beyond(pairs)], derivation.to_dict())
    others = dict.fromkeys(one.name for one, _ in pairs if word is None and not lib.has_tuned(one))
    why = "different vehicles share one set; for gains of one vehicle: surctl gains derive"
    said = [f"gains default, not derived from {', '.join(others)}: {why}"] if others else []
    return GainsChoice(gains, [*said, *_beyond(pairs)], None)


def derive_words(
    vehicle: str, cruise: float, file: str, *, margin: float = math.nan, barrier: str = "simple", force: bool = False
) -> str:  # fmt: skip
    """Return the command that writes the derived gains of a vehicle to a file, if finite with this gain `margin`.

    The command judges the claim of no contact with `barrier`; with `force`, it replaces the file.
    """
    words = ["surctl", "gains", "derive", vehicle, "--cruise", f"{cruise:g}"]
    words += ["--margin", f"{margin:g}"] if math.isfinite(margin) else []
    words += ["--barrier", barrier] if barrier != "simple" else []
    return shlex.join([*words, "--out", file, *(["--force"] if force else [])])


def margin_short(contact: lib.SafetyClaim | lib.Inapplicable | None) -> float:
    """Return the gain `margin` [m] that a no-contact claim needs if it has too little; else a value not finite."""
    if contact is None or isinstance(contact, lib.Inapplicable) or contact["margin needed"] <= contact["margin"]:
        return math.nan
    return contact.least_margin


def margin_of_all(assessment: lib.Assessment) -> float:
    """Return the gain `margin` [m] that all no-contact claims of an assessment need; NaN if none has too little."""
    short = [margin_short(claim) for claim in assessment.sources.get("no contact") or ()]
    return max(filter(math.isfinite, short), default=math.nan)


def choose_law(law: str | None, vehicles: Sequence[lib.Vehicle]) -> tuple[str, list[str]]:
    """Return the reference of the law for the vehicles, and a line that says why, unless it is the usual default.

    Args:
        law: value of the option `--law`; None: the law that the forces of the vehicles allow.
        vehicles: all vehicles of the command.

    Raises:
        InputError: the law is unknown, a vehicle lacks a force that it needs, or the vehicles need different laws.
    """
    if law is not None:
        reference = lib.law_ref(law, key="--law")
        for vehicle in vehicles:
            lib.check_forces(reference, vehicle, key="--law")
        return reference, []
    chosen = {lib.default_law(vehicle): vehicle.name for vehicle in vehicles}
    if len(chosen) > 1:
        names = " and ".join(f"{name} for {vehicle}" for name, vehicle in chosen.items())
        raise InputError(f"the vehicles need different laws, {names}", key="--law", remedy="run them one by one")
    reference, name = next(iter(chosen.items()), (lib.LAW_NAMES[0], ""))
    if reference == lib.LAW_NAMES[0]:
        return reference, []
    return reference, [f"law {reference}, because {name} has no sway force (Fv_max = 0)"]


def choose_sensing(option: str | None, law: str) -> lib.Sensing:
    """Return the value of the option `--sensing`, by default sonar if the law can use it.

    Raises:
        InputError: the value is unknown, or the law does not support it.
    """
    supported = lib.law_source(law).sensing
    if option is None:
        return "sonar" if "sonar" in supported else "truth"
    check_known(option, lib.SENSING, key="--sensing")
    if option not in supported:
        problem = f"law {lib.label(law)} supports only {' and '.join(supported)}"
        raise InputError(problem, key="--sensing", value=option, remedy=f"set --sensing {supported[0]}")
    return cast("lib.Sensing", option)


def law_words(
    reference: str, form: lib.Case | lib.Mission | None = None, *, vehicle: lib.Vehicle | None = None
) -> list[str]:
    """Return the options of a suggested command that select this law, unless it is the default of `vehicle`, and its
    form in a case.
    """
    stated = {} if form is None else {_FORM[name]: value for name, value in vars(form).items() if name in _FORM}
    other = changed(RobotOptions(**stated)).items()
    law = [] if vehicle is not None and reference == lib.default_law(vehicle) else ["--law", lib.own_file(reference)]
    return [*law, *(word for option in other for word in option)]


# fields of a case that define the form of its law, and those of `RobotOptions`
_FORM = {name: name for name in ("avoidance", "guidance", "barrier", "movers")} | {"mode": "priority_mode"}

TRUST = "Permit running the Python law of a study or saved run."
"""Help of the option `--trust`."""


@dataclass(frozen=True, eq=False, repr=False)
class RobotOptions:
    """The options that select the robot and its law; those that a command does not have keep their defaults.

    The defaults of vehicle, gains and law are those that the scenario, the vehicle and its forces imply.
    """

    vehicle: str | None = option("--vehicle", "Vehicle: name or file (default: that of the scenario).", metavar="FILE")
    gains: str | None = option(
        "--gains", "Gain set: name or file (default: built-in for the vehicle, else derived).", metavar="FILE"
    )
    law: str | None = option(
        "--law",
        "Law: guarded (default), steered (default without sway thrust), calm, paper, closed_form or FILE.py:FUNCTION.",
        metavar="NAME",
    )
    avoidance: str = option(
        "--avoidance",
        "Equation (20) of --law paper: corrected (default), printed, or consistent (every angle counter-clockwise).",
        "corrected",
        metavar="NAME",
    )
    guidance: str = option(
        "--guidance", "Path guidance: los (default); for currents ilos or alos.", "los", metavar="NAME"
    )
    priority_mode: str = option(
        "--priority-mode",
        "Task priorities: nsb (default) clips results to limits; filter, projected, lexicographic solve within limits.",
        "nsb",
        metavar="M",
    )
    fallback: str = option(
        "--fallback", "Solver if limits conflict: exact (default), bounded (fast).", "exact", metavar="NAME"
    )
    sensing: str | None = option(
        "--sensing", "Obstacles: true positions (truth, default) or sonar.", "truth", metavar="NAME"
    )
    barrier: str = option(
        "--barrier", "Braking model near obstacles: simple (default), inertia.", "simple", metavar="NAME"
    )
    movers: str = option(
        "--movers", "Moving obstacles: predict (default), barrier (brakes only).", "predict", metavar="NAME"
    )

    def __post_init__(self) -> None:
        """Raise InputError if one of the options has an unknown value."""
        for key, value, known in (("barrier", self.barrier, lib.BARRIER_NAMES), ("movers", self.movers, lib.MOVERS)):
            check_known(value, known, key=key)

    def case(self, law: str, scenario: lib.Scenario, vehicle: lib.Vehicle, gains: lib.Gains) -> lib.Case:
        """Return the case of a scenario with a vehicle, gains and a law."""
        kind: dict[str, Any] = {"mode": self.priority_mode, "sensing": self.sensing or "truth"}
        kind |= {name: getattr(self, name) for name in ("avoidance", "guidance", "barrier", "movers")}
        return lib.Case(scenario, vehicle, gains, law, **kind)


@dataclass(frozen=True, eq=False, repr=False)
class ExportedRobot(RobotOptions):
    """The same with sonars by default, if the law can use them."""

    sensing: str | None = option(
        "--sensing", "Obstacles: sonar (default if the law allows it) or truth.", metavar="NAME"
    )


class Speeds(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """Cruise speeds [m/s], written like a sweep axis: one value, several values, or a range with a count."""

    name = "V1,V2,...|LOW..HIGH:COUNT"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Return the cruise speeds, slowest first; InputError if the text is not a list or range of speeds."""
        key, text = "--cruise", str(value)
        single = text.split(",")
        if ".." not in text:
            try:
                return lib.cruise_speeds([float(word) for word in single if word.strip() or len(single) > 1], key=key)
            except ValueError:
                pass
        else:
            try:
                axis = lib.parse_axis(f"cruise={text}")
            except InputError as error:
                raise InputError(error.problem, key=key, value=text, remedy=f"write {self.name}") from None
            if not isinstance(axis, lib.Span):
                return lib.cruise_speeds(axis.values, key=key)
        raise InputError("is not a list of speeds", key=key, value=text, remedy=f"write {self.name}, in m/s")


SPEEDS = Speeds()


MISSION = "pool-static"
"""The default scenario of an export."""

_TRIED = (MISSION, "tank-static")


def fitting_scenario(vehicle: lib.Vehicle, scenario: str | None = None) -> str | None:
    """Return the first of the tried scenarios for which `findings` reports no error with this hull, or None.

    If `scenario` is given, only this scenario is tried; otherwise first the default scenario of `surctl export`, then
    `tank-static`.
    """
    tried = _TRIED if scenario is None else (scenario,)
    return next((word for word in tried if _fits(lib.load_scenario(word), vehicle)), None)


def export_command(
    scenario: str | None,
    vehicle: str,
    gains: str | lib.Gains,
    certificates: Sequence[Path] = (),
    *,
    file: str | None = None,
    law: str = "guarded",
    form: lib.Case | lib.Mission | None = None,
    sensing: str = "sonar",
) -> list[str]:
    """Return the words of the export command, with the certificates that apply; empty if the vehicle fits no scenario.

    Args:
        scenario: name or file of the scenario; None takes a built-in scenario that fits the hull.
        vehicle: name or file of the vehicle.
        gains: name or file of the gains, or the gains.
        certificates: certificate files; the command carries those that concern this law.
        file: name or file of the gains in the command; None: `gains` itself.
        law: the law to export, a name or FILE.py:FUNCTION.
        form: the case or mission that has the form of the law; None: the defaults of the command.
        sensing: "sonar" or "truth".
    """
    robot = lib.load_vehicle(vehicle)
    chosen = fitting_scenario(robot, scenario)
    if chosen is None:
        return []
    travel: Sequence[Path] = ()
    if certificates:
        values = lib.load_gains(gains) if isinstance(gains, str) else gains
        numbers = lib.law_numbers(lib.load_scenario(chosen), values, robot)
        travel = lib.fitting_certificates(certificates, lib.vehicle_law(robot, law), robot, numbers)
    words = ["surctl", "export", "--scenario", chosen, "--vehicle", vehicle, "--gains", file or str(gains)]
    words += [*law_words(law, form), "--sensing", sensing]
    return [shlex.join([*words, *(word for file in travel for word in ("--certificate", str(file)))])]


def _fits(scenario: lib.Scenario, vehicle: lib.Vehicle) -> bool:
    try:
        return not any(finding.level == "error" for finding in lib.findings(scenario, vehicle))
    except InputError:  # the start lies inside an obstacle
        return False
