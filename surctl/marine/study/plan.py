"""The plan of a study and of `tune --vehicle`: keys of its file, cruise speeds, missions scaled or left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from surctl.errors import InputError, mistakes_in
from surctl.files import Strict, file_name, pick, read_toml, validate, write_file
from surctl.marine.control import SONARLESS, Gains, check_forces, default_law, law_ref, law_source, load_gains
from surctl.marine.guidance import Guidance
from surctl.marine.simulation import Case, PaperFigure, Scenario, findings, load_scenario
from surctl.marine.simulation.scaling import disturbed, mission_size, scaled_scenario, straight_mission, two_leg_mission
from surctl.marine.simulation.scenario import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.tuning import Derivation, Goal, default_cruise, gains_for, load_goals
from surctl.marine.tuning.derived import shared_gains
from surctl.marine.tuning.goals import goals_from_tables
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.marine.verification.library import applicable_claims
from surctl.marine.verification.speeds import check_held, cruise_speeds
from surctl.tuning import Axis, GoalTable

_TANK = "tank-static"
"""The built-in scenario whose obstacles are scaled to the vehicle."""

_SHARE = 0.02  # waves and drift as a share of the surge thrust, so that seeds differ and an unstable loop shows
_OWN = {"sideslip": (0.75, 1.0, 1.5), "foresight": (0.8, 1.0, 1.4)}  # factors of the sweep on gains of law `steered`
_SHARED = {"lookahead": (0.7, 1.0, 1.4), "k_v": (0.8, 1.0, 1.2)}


def scaled_missions(vehicle: Vehicle) -> tuple[tuple[Scenario, ...], Gains, Derivation | None]:
    """Return three missions scaled to a vehicle, the gains for them, and their derivation.

    The missions are a straight path, two legs with a corner of 90°, and the obstacles of `tank-static`. They have waves
    and drift of 2 % of the surge thrust. The cruise speed is 35 % of the top speed, or the largest at which derived
    gains have the required disk margin.

    Example:
        >>> from surctl.marine.study import scaled_missions
        >>> from surctl.marine.vehicle import load_vehicle
        >>> missions, gains, _ = scaled_missions(load_vehicle("girona500"))
        >>> [mission.name for mission in missions], gains.name
        (['straight-girona500', 'two-legs-girona500', 'tank-static-girona500'], 'derived')
    """
    own = law_source(default_law(vehicle)).gains
    speed = default_cruise(vehicle)
    gains, derivation = gains_for(None, vehicle, cruise=speed, own=own)
    if derivation is not None and not derivation.reached and derivation.bearable > 0:
        speed = derivation.bearable
        gains, derivation = gains_for(None, vehicle, cruise=speed, own=own)
    size = mission_size(vehicle, gains, cruise=speed)
    missions = (
        straight_mission(vehicle, cruise=speed, size=size),
        two_leg_mission(vehicle, cruise=speed, size=size),
        scaled_scenario(load_scenario(_TANK), vehicle, cruise=speed, size=size),
    )
    return tuple(disturbed(mission, vehicle, share=_SHARE) for mission in missions), gains, derivation


def write_missions(missions: Sequence[Scenario], folder: Path) -> tuple[Scenario, ...]:
    """Write missions that no file contains as scenario files, and return them with the names of their files."""
    written = []
    for mission in missions:
        path = folder / f"{file_name(mission.name)}.toml"
        if not mission.source:
            folder.mkdir(parents=True, exist_ok=True)
            write_file(path, toml_text(scenario_table(mission)))
        written.append(mission if mission.source else replace(mission, source=str(path)))
    return tuple(written)


def _scaled_axes(gains: Gains) -> tuple[Axis, ...]:
    """Return the axes of the sweep: factors about derived gains.

    For law `steered`, they are gains that plan turns and do not change the margins of the loop.
    """
    factors = _OWN if "sideslip" in gains.own else _SHARED
    return tuple(
        Axis(name, tuple(float(f"{factor * gains[name]:.3g}") for factor in row)) for name, row in factors.items()
    )


LIBRARY = Path(__file__).parent / "library"
_DEFAULT = LIBRARY / "default.toml"

_CRUISE = "cruise_m_per_s"
_SCALED_SEEDS = (0, 1)
_Seed = Annotated[int, Field(ge=0)]


class _Run(Strict):
    scenario: str
    vehicle: str | None = None
    cruise_m_per_s: Annotated[float, Field(gt=0)] | None = None

    def mission(self, near: Callable[[str], str] = str) -> Scenario:
        """Return the scenario at the cruise speed of this run; another speed than the file's is another mission."""
        scenario, speed = load_scenario(near(self.scenario)), self.cruise_m_per_s
        if speed is None or speed == scenario.cruise:
            return scenario
        if speed > scenario.cap:
            problem = f"is above the speed cap of {scenario.cap:g} m/s of {scenario.name}"
            raise InputError(problem, key=f"runs: {_CRUISE}", value=speed, remedy="lower it")
        return replace(scenario, name=f"{scenario.name}-{speed:g}", source="", cruise=speed, paper=PaperFigure())


class _Axis(Strict):
    gain: str
    values: tuple[float, ...]


class _Sweep(Strict):
    axes: tuple[_Axis, ...] = Field(min_length=1)
    seeds: tuple[_Seed, ...] = Field((0,), min_length=1)


class _StudyFile(Strict):
    kind: Literal["study"]
    name: str = Field(min_length=1)
    note: str = ""
    vehicle: str
    gains: str | None = None
    law: str | None = None
    guidance: Guidance = "los"
    seed: _Seed = 0
    runs: tuple[_Run, ...] = Field(min_length=1)
    sweep: _Sweep | None = None
    cruise_m_per_s: tuple[float, ...] | None = None
    claims: tuple[str, ...] | None = None
    goals: tuple[GoalTable, ...] = ()


@dataclass(frozen=True)
class Leg:
    """One mission of a study: a scenario with its vehicle.

    Attributes:
        exclusion: reason why the scenario cannot be simulated with this vehicle, or None.
        misfit: reason why the hull does not fit the site, or None; a mission with such a reason is simulated and shown,
            but does not count towards the result.
    """

    scenario: Scenario
    vehicle: Vehicle
    exclusion: str | None
    misfit: str | None

    @property
    def left_out(self) -> str | None:
        """Reason why the mission does not count towards a result, or None."""
        return self.exclusion or self.misfit


@dataclass(frozen=True)
class Plan:
    """A loaded and checked study; it has the built-in goals unless its file defines goals or names a goals file.

    `cruise` holds the speeds [m/s] at which the linear loops are judged; if it is empty, the largest cruise speed of
    the scenarios is used. `axes` is empty if the study file has no `[sweep]` table; such a study keeps its
    gains. `named` is false if the study names no gains; they are then the default gains of its vehicles
    (`tuning.derived`). `derivation` says how they were derived from the vehicle, if they were. `unheard` is the
    reason why the study simulates no sonars, and exports the law that takes obstacle positions; empty if it does.
    """

    name: str
    note: str
    source: str
    vehicle: Vehicle
    gains: Gains
    law: str
    guidance: Guidance
    seed: int
    legs: tuple[Leg, ...]
    axes: tuple[Axis, ...]
    sweep_seeds: tuple[int, ...]
    claims: tuple[str, ...] | None
    goals: tuple[Goal, ...]
    cruise: tuple[float, ...] = ()
    named: bool = True
    derivation: Derivation | None = None
    unheard: str = ""

    @property
    def deciding(self) -> tuple[Leg, ...]:
        """The missions whose runs with true positions count towards the result of the study."""
        return tuple(leg for leg in self.legs if leg.left_out is None)

    @property
    def left_out(self) -> tuple[Leg, ...]:
        """The missions that do not count towards the result, because the vehicle does not fit the scenario."""
        return tuple(leg for leg in self.legs if leg.left_out is not None)

    def by(self, vehicles: Sequence[Vehicle]) -> Plan:
        """Return the plan in which every scenario is simulated with each of the vehicles; all other settings stay.

        One vehicle that fits none of the scenarios of a built-in study gets missions scaled to it.

        Raises:
            InputError: no vehicle fits a scenario.

        Example:
            >>> from surctl.marine.study import load_plan
            >>> from surctl.marine.vehicle import load_vehicle
            >>> plan = load_plan().by([load_vehicle("sur540-flooded")])
            >>> [leg.scenario.name for leg in plan.deciding], [leg.scenario.name for leg in plan.left_out]
            (['tank-static-0.1', 'tank-moving-0.1'], ['pool-static', 'pool-behind'])
        """
        scenarios = list({leg.scenario.name: leg.scenario for leg in self.legs}.values())
        built_in = Path(self.source).parent == LIBRARY
        if built_in and self.vehicle not in vehicles:  # the speeds of its runs are about its own vehicle
            scenarios = [load_scenario(run.scenario) for run in _built_in().runs]
        legs = tuple(_leg(scenario, vehicle, lenient=True) for vehicle in vehicles for scenario in scenarios)
        plan = replace(self, vehicle=vehicles[0], legs=legs)
        if len(vehicles) == 1 and built_in and _needs_own(vehicles[0], legs):
            return _about_vehicle(vehicles[0], vehicles[0].source or vehicles[0].name)
        plan = _with_mission(plan)
        if self.named:
            return plan
        gains, derivation = shared_gains(None, _about(plan.deciding), own=law_source(self.law).gains)
        axes = _axes(_built_in(), gains, scaled=derivation is not None) if built_in else self.axes
        return replace(plan, gains=_stated(gains, axes), axes=axes, derivation=derivation)

    def written(self, folder: Path) -> Plan:
        """Return the plan with its missions in files; those that are in no file are written to `folder`."""
        missions = write_missions([leg.scenario for leg in self.legs], folder)
        return replace(self, legs=tuple(replace(leg, scenario=m) for leg, m in zip(self.legs, missions, strict=True)))

    @property
    def grid(self) -> tuple[Axis, ...]:
        """The axes of the sweep; without any, the gains of the plan as a single point."""
        name = next(iter(self.gains.values))
        return self.axes or (Axis(name, (self.gains[name],)),)

    def with_gains(self, file: str) -> Plan:
        """Return the plan with the gains of a file (name or path), and without a sweep."""
        gains = load_gains(file, own=law_source(self.law).gains)
        return replace(self, gains=gains, axes=(), named=True, derivation=None)

    def at_speeds(self, cruise: Sequence[float], *, key: str) -> Plan:
        """Return the plan whose linear loops are judged at these speeds [m/s]; InputError of `key` for a wrong one."""
        if not has_cruise_loop(self.law, "los"):
            problem = f"does not apply to law {self.law}, whose margins are judged at the cruise speeds of the missions"
            raise InputError(problem, key=key, remedy="drop it; surctl verify --cruise takes other speeds")
        cruise = cruise_speeds(cruise, key=key)
        for leg in self.deciding:
            check_held(cruise, leg.vehicle, cap=leg.scenario.cap, key=key)
        return replace(self, cruise=cruise)

    def with_law(self, law: str) -> Plan:
        """Return the plan with another law; raise InputError if it does not suit a vehicle of the plan."""
        law = law_ref(law)
        for leg in self.legs:
            check_forces(law, leg.vehicle)
        return replace(self, law=law, gains=self.gains.with_own(law_source(law).gains))

    @property
    def sweep_cases(self) -> tuple[Case, ...]:
        """The setups (scenario, vehicle, law) that the sweep simulates at every point of its grid."""
        return tuple(
            Case(leg.scenario, leg.vehicle, self.gains, self.law, guidance=self.guidance) for leg in self.deciding
        )


def load_plan(file: str | None = None, *, vehicle: str | None = None, trust: bool = False) -> Plan:
    """Load the built-in study, a study file, or the built-in study with another vehicle.

    A vehicle that has no sway force, or fits none of the built-in scenarios, gets missions that are scaled to it
    (`scaled_missions`), without sonars.

    Args:
        file: a study file or a vehicle file; None: the built-in study.
        vehicle: name or file of the vehicle of the built-in study, in place of `file`.
        trust: whether the code of a user's own law may be executed.

    A name inside a study file is a built-in name or a path relative to the study file. If the study file names a user's
    own law, FILE.py:FUNCTION, this Python file runs only if `trust` is true.

    Raises:
        InputError: a file, a key or a value is wrong, or the vehicle fits no scenario of the study.

    Example:
        >>> from surctl.marine.study import load_plan
        >>> plan = load_plan()
        >>> plan.vehicle.name, [leg.scenario.name for leg in plan.legs]
        ('sur540-flooded', ['tank-static-0.1', 'tank-moving-0.1', 'pool-ahead-0.15', 'pool-behind'])
        >>> [(axis.name, axis.values) for axis in plan.axes[:3]]
        [('lookahead', (0.5, 0.8, 1.2)), ('k_v', (1.0, 1.5, 2.0)), ('margin', (0.065,))]
    """
    if vehicle is not None:
        if file is not None:
            problem = "has its own vehicle, so --vehicle does not go with it"
            raise InputError(problem, key="FILE", value=file, remedy="give one of them")
        return _about_vehicle(load_vehicle(vehicle), vehicle)
    if file is None:
        return _plan(_built_in(), _DEFAULT)
    path = pick(file, LIBRARY, what="study")
    table = read_toml(path)
    if table.get("kind") == "vehicle":
        return _about_vehicle(load_vehicle(str(path)), str(path.resolve()))
    if table.get("kind") != "study":
        problem = "is neither a study nor a vehicle"
        remedy = 'write kind = "study" or kind = "vehicle"'
        raise InputError(problem, file=path, key="kind", value=table.get("kind", "(missing)"), remedy=remedy)
    named = table.pop("goals") if isinstance(table.get("goals"), str) else None
    return _plan(_study(table, path), path, goals=named, trust=trust)


def _about_vehicle(vehicle: Vehicle, word: str) -> Plan:
    """Return the built-in study with one vehicle, or with missions scaled to it; see `load_plan`."""
    study = _built_in()
    own = tuple(run.model_copy(update={"vehicle": None, _CRUISE: None}) for run in study.runs)
    legs = [_leg(run.mission(), vehicle, lenient=True) for run in own]
    name = Path(word).stem
    if not _needs_own(vehicle, legs):
        return _plan(
            study.model_copy(update={"runs": own, "vehicle": word, "name": name, "note": ""}), _DEFAULT, lenient=True
        )
    missions, gains, derivation = scaled_missions(vehicle)
    law = default_law(vehicle)
    plan = Plan(
        name,
        f"The missions are scaled to {vehicle.name}, because it does not fit the built-in scenarios.",
        vehicle.source or str(_DEFAULT),
        vehicle,
        gains,
        law,
        "los",
        0,
        tuple(_leg(mission, vehicle, lenient=True) for mission in missions),
        _scaled_axes(gains),
        _SCALED_SEEDS,
        None,
        tuple(goal for goal in load_goals() if goal.kind == "hard"),  # the others have lengths and times of the tank
        (),
        False,
        derivation,
        _unheard(law) or "the missions are scaled to the vehicle, but sonars are not",
    )
    return _with_mission(plan)


def _unheard(law: str) -> str:
    # why a study with this law simulates no sonars; empty if the law can use them
    source = law_source(law)
    why = "" if source.steering is None else f": {SONARLESS}"
    return "" if "sonar" in source.sensing else f"law {law} takes obstacle positions{why}"


def _needs_own(vehicle: Vehicle, legs: Sequence[Leg]) -> bool:
    # missions scaled to it
    return vehicle["Fv_max"] == 0 or all(leg.left_out is not None for leg in legs)


def _study(table: dict[str, Any], path: Path) -> _StudyFile:
    return validate(table, _StudyFile, file=path)


@cache
def _built_in() -> _StudyFile:
    return _study(read_toml(_DEFAULT), _DEFAULT)


def _own_goals(study: _StudyFile, path: Path, named: str | None) -> tuple[Goal, ...]:
    if named is None:
        return goals_from_tables(study.goals, file=path) if study.goals else load_goals()
    with mistakes_in(path):
        return load_goals(named)


def _plan(
    study: _StudyFile, path: Path, *, lenient: bool = False, goals: str | None = None, trust: bool = False
) -> Plan:
    def near(name: str) -> str:
        beside = path.parent / name
        return str(beside) if beside.suffix == ".toml" and beside.exists() else name

    vehicle = load_vehicle(near(study.vehicle))
    legs = []
    for run in study.runs:
        leg_vehicle = vehicle if run.vehicle is None else load_vehicle(near(run.vehicle))
        with mistakes_in(path):
            legs.append(_leg(run.mission(near), leg_vehicle, lenient=lenient))
    vehicles = [leg.vehicle for leg in legs] or [vehicle]
    law = default_law(vehicles[0]) if study.law is None else study.law
    law = law_ref(law, file=path, folder=path.parent, trust=trust)
    named = None if study.gains is None else near(study.gains)
    gains, derivation = shared_gains(named, _about(legs), own=law_source(law).gains)
    with mistakes_in(path):
        for robot in vehicles:
            check_forces(law, robot)
        axes = _axes(study, gains, scaled=lenient and derivation is not None)
        gains = _stated(gains, axes)
        applicable_claims(gains.values, study.claims, vehicle=vehicle)
    plan = Plan(
        study.name,
        study.note,
        str(path),
        vehicle,
        gains,
        law,
        study.guidance,
        study.seed,
        tuple(legs),
        axes,
        (0,) if study.sweep is None else study.sweep.seeds,
        study.claims,
        _own_goals(study, path, None if goals is None else near(goals)),
        (),
        named is not None,
        derivation,
        _unheard(law),
    )
    plan = _with_mission(plan)
    with mistakes_in(path):
        return plan if study.cruise_m_per_s is None else plan.at_speeds(study.cruise_m_per_s, key=_CRUISE)


def _with_mission(plan: Plan) -> Plan:
    """Return the plan; raise InputError if no mission of the plan counts towards the result (`Leg.left_out`)."""
    if not plan.deciding:
        reasons = "; ".join(f"{leg.scenario.name}: {leg.left_out}" for leg in plan.legs)
        remedy = "add a scenario with a larger site"
        raise InputError(f"the vehicle fits no scenario ({reasons})", file=plan.source, key="runs", remedy=remedy)
    return plan


def _axes(study: _StudyFile, gains: Gains, *, scaled: bool) -> tuple[Axis, ...]:
    axes = () if study.sweep is None else tuple(_gain_axis(axis, gains) for axis in study.sweep.axes)
    return tuple(_scaled(axis, gains) for axis in axes) if scaled else axes


def _gain_axis(axis: _Axis, gains: Gains) -> Axis:
    # InputError if the parameter is not a gain, because a study chooses only gains
    for value in axis.values:
        gains.with_values({axis.gain: value})
    return Axis(axis.gain, axis.values)


def _stated(gains: Gains, axes: Sequence[Axis]) -> Gains:
    # an axis with one value states a gain, also where the grid is not swept
    return gains.with_values({axis.name: axis.values[0] for axis in axes if len(axis.values) == 1})


def _scaled(axis: Axis, gains: Gains) -> Axis:
    # the built-in values are about the set `default`
    factor = gains[axis.name] / load_gains("default")[axis.name]
    return Axis(axis.name, tuple(float(f"{factor * value:.3g}") for value in axis.values))


def _about(legs: Sequence[Leg]) -> list[tuple[Vehicle, float]]:
    # vehicles and cruise speeds; those that count towards the result if there are any
    chosen = [leg for leg in legs if leg.left_out is None] or list(legs)
    return [(leg.vehicle, leg.scenario.cruise) for leg in chosen]


def _leg(scenario: Scenario, vehicle: Vehicle, *, lenient: bool) -> Leg:
    try:
        errors = [f.text for f in findings(scenario, vehicle) if f.level == "error"]
    except InputError as error:
        if not lenient:
            raise
        return Leg(scenario, vehicle, error.problem, None)
    return Leg(scenario, vehicle, None, errors[0] if errors else None)
