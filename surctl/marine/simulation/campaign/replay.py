"""One run as a file: all data that are needed to repeat the run, and its results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field

from surctl import __version__
from surctl.errors import InputError
from surctl.files import Strict, read_toml, validate
from surctl.marine.control import Barrier, Gains, Movers, law_ref, law_source, load_gains
from surctl.marine.guidance import AvoidanceForm, Guidance
from surctl.marine.simulation.batch import Case
from surctl.marine.simulation.campaign.plan import SampledRun
from surctl.marine.simulation.metrics import METRICS
from surctl.marine.simulation.run import Run, Sensing
from surctl.marine.simulation.scenario import scenario_from_table
from surctl.marine.simulation.scenario_table import scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.vehicle import Vehicle, parameter_spec
from surctl.marine.vehicle.parameters import vehicle_from_table
from surctl.priority import Mode

__all__ = ["Replay", "load_replay", "replay_of"]

T = TypeVar("T")

_FIRST, _ALWAYS = "crab_angle_deg", "wasted_share"  # first of the metrics added later, and one that is always finite
_FIGURES = tuple(name for name in METRICS if name not in ("reached", "collided", "stopped"))


class _GainTable(Strict):
    name: str = Field(min_length=1)
    provenance: str = Field(min_length=1)
    values: dict[str, float]


class _RunFile(Strict):
    kind: Literal["run"]
    campaign: str
    version: str
    seed: Annotated[int, Field(ge=0)]
    law: str
    avoidance: AvoidanceForm
    guidance: Guidance = "los"
    priority_mode: Mode
    barrier: Barrier = "simple"
    movers: Movers = "predict"
    sensing: Sensing
    stopped_because: Literal["time limit", "reached", "collision", "fault", "standstill", "dead end"]
    broken_assumptions: tuple[str, ...] = ()
    figures: dict[str, float]
    draw: dict[str, float] = Field(default_factory=dict)
    gains: _GainTable
    vehicle: dict[str, Any]
    model: dict[str, Any] | None = None
    scenario: dict[str, Any]


@dataclass(frozen=True)
class Replay:
    """A run of a campaign, with its results, that can be simulated again.

    Attributes:
        run: the random run, with its setup (scenario, vehicle, law), seed and drawn values.
        stopped_because: reason why the run ended, one of `STOPS`.
        figures: values of the finite metrics of the run, by name.
        campaign: name of the campaign.
        broken: names of the violated assumptions of the safety claim.
        version: version of the toolkit that simulated the run.
    """

    run: SampledRun
    stopped_because: str
    figures: Mapping[str, float]
    campaign: str
    broken: tuple[str, ...] = ()
    version: str = __version__

    def to_toml(self) -> str:
        """Return the text of the replay file.

        Raises:
            InputError: the scenario has sonars that a file cannot describe.
        """
        run, case = self.run, self.run.case
        table: dict[str, Any] = {
            "kind": "run",
            "campaign": self.campaign,
            "version": self.version,
            "seed": run.seed,
            "law": case.law,
            "avoidance": case.avoidance,
            "guidance": case.guidance,
            "priority_mode": case.mode,
            "barrier": case.barrier,
            "movers": case.movers,
            "sensing": case.sensing,
            "stopped_because": self.stopped_because,
            "broken_assumptions": list(self.broken),
            "figures": dict(self.figures),
            "draw": dict(run.draw),
            "gains": {
                "name": case.gains.name,
                "provenance": case.gains.provenance,
                "values": dict(case.gains.values),
            },
            "vehicle": _vehicle_table(case.vehicle),
            "scenario": scenario_table(case.scenario),
        }
        if case.model is not None:
            table["model"] = _vehicle_table(case.model)
        return toml_text(table)

    def difference(self, run: Run) -> float:
        """Return the largest difference of any metric between this replay and another run.

        The difference is absolute in the metric's unit for values up to 1, and relative for larger values. The
        difference is inf if the two runs ended for different reasons, or if different metrics are finite.
        """
        m = run.metrics
        if m.stopped_because != self.stopped_because:
            return inf
        # a file of an earlier version has no metrics of attitude and thrust activity
        names = _FIGURES if _ALWAYS in self.figures else _FIGURES[: _FIGURES.index(_FIRST)]
        measured = {name: float(getattr(m, name)) for name in names}
        if {name for name, value in measured.items() if isfinite(value)} != set(self.figures):
            return inf
        return max(
            (abs(measured[name] - value) / max(1.0, abs(value)) for name, value in self.figures.items()), default=0.0
        )


def replay_of(run: SampledRun, row: Mapping[str, Any], *, campaign: str) -> Replay:
    """Return the replay data of a run of a campaign, from the run and its results (`RunTable.row`)."""
    figures = {name: row[name] for name in _FIGURES if isfinite(row[name])}
    return Replay(run, row["stopped_because"], figures, campaign, tuple(row["broken_assumptions"]))


def load_replay(path: Path | str, *, trust: bool = False) -> Replay:
    """Read the file of a run; only if `trust` is true may the function run the Python file of a user's own law.

    Raises:
        InputError: the file does not exist, or does not describe a run that can be simulated.
    """
    path = Path(path)
    file = validate(read_toml(path), _RunFile, file=path)
    unknown = [name for name in file.figures if name not in _FIGURES]
    if unknown:
        raise InputError("no such metric", file=path, key=f"figures.{unknown[0]}", remedy="remove it")
    scenario = _in_file(path, "scenario", scenario_from_table, file.scenario)
    vehicle = _in_file(path, "vehicle", vehicle_from_table, file.vehicle)
    model = None if file.model is None else _in_file(path, "model", vehicle_from_table, file.model)
    for name in file.draw:
        if name not in vehicle.parameters:
            raise InputError("no such vehicle parameter", file=path, key=f"draw.{name}", remedy="remove it")
    vehicle.with_values(file.draw)
    law = law_ref(file.law, file=path, folder=path.parent, trust=trust)
    case = Case(
        scenario,
        vehicle,
        _gains(file.gains, law, path),
        law,
        file.priority_mode,
        file.sensing,
        model,
        file.avoidance,
        file.guidance,
        file.barrier,
        file.movers,
    )
    run = SampledRun(case, file.seed, file.draw)
    return Replay(run, file.stopped_because, file.figures, file.campaign, file.broken_assumptions, file.version)


def _in_file(path: Path, key: str, load: Callable[..., T], table: Mapping[str, Any]) -> T:
    # errors name the key from the beginning of the file, which holds the table under `key`
    try:
        return load(table, source=str(path))
    except InputError as error:
        raise error.inside(path, f"{key}.{error.key}" if error.key else key) from None


def _gains(table: _GainTable, law: str, path: Path) -> Gains:
    base = replace(load_gains("default"), name=table.name, source=str(path)).with_own(law_source(law).gains)
    missing = [name for name in base.specs if name not in table.values]
    if missing:
        raise InputError("is missing", file=path, key=f"gains.values.{missing[0]}", remedy="add it")
    return base.with_values(table.values, provenance=table.provenance)


def _vehicle_table(vehicle: Vehicle) -> dict[str, Any]:
    table: dict[str, Any] = {"kind": "vehicle", "name": vehicle.name, "note": vehicle.note}
    for name, known in vehicle.parameters.items():
        spec = parameter_spec(name)
        assert spec is not None  # a vehicle has no other parameters
        entry: dict[str, Any] = {"value": float(known.value), "unit": known.unit, "provenance": known.provenance}
        if known.range is not None:
            entry["range"] = list(known.range)
        table.setdefault(spec.table, {})[name] = entry
    return table
