"""Conduct a campaign in chunks that resume, with its files; simulate a run of it again from its file (`--from`)."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from surctl import __version__
from surctl.errors import InputError, mistakes_in, writing
from surctl.files import Strict, file_name, prepare_folder, read_toml, validate, write_file
from surctl.marine.control import Barrier, Gains, Law, Movers, law_options, law_ref, law_source, load_gains
from surctl.marine.guidance import AvoidanceForm, Guidance
from surctl.marine.simulation.batch.case import Case
from surctl.marine.simulation.batch.engines import simulate_batch, stored_loop, structure_of
from surctl.marine.simulation.batch.loop import build_loop
from surctl.marine.simulation.batch.structure import Structure
from surctl.marine.simulation.campaign.summary import RunTable, Summary, assumptions, summarise
from surctl.marine.simulation.campaign.worlds import Plan, SampledRun
from surctl.marine.simulation.metrics import METRICS
from surctl.marine.simulation.run import Run, Sensing
from surctl.marine.simulation.scenario import scenario_from_table, scenario_table
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.vehicle import Vehicle, write_vehicle
from surctl.marine.vehicle.parameters import vehicle_from_table
from surctl.priority import Mode
from surctl.recorded_write import write_csv
from surctl.store import RESUME, ChunkStore

T = TypeVar("T")

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
    mode: Mode = Field(alias="priority_mode")
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
            **case.options,
            "stopped_because": self.stopped_because,
            "broken_assumptions": list(self.broken),
            "figures": dict(self.figures),
            "draw": dict(run.draw),
            "gains": {"name": case.gains.name, "provenance": case.gains.provenance, "values": dict(case.gains.values)},
            "vehicle": tomllib.loads(write_vehicle(case.vehicle)),
            "scenario": scenario_table(case.scenario),
        }
        if case.model is not None:
            table["model"] = tomllib.loads(write_vehicle(case.model))
        return toml_text(table)

    def difference(self, run: Run) -> float:
        """Return the largest difference of any metric between this replay and another run.

        The difference is absolute in the metric's unit for values up to 1, and relative for larger values. The
        difference is inf if the two runs ended for different reasons, or if different metrics are finite.
        """
        m = run.metrics
        if m.stopped_because != self.stopped_because:
            return inf
        measured = {name: float(getattr(m, name)) for name in _FIGURES}
        if {name for name, value in measured.items() if isfinite(value)} != set(self.figures):
            return inf
        return max(
            (abs(measured[name] - value) / max(1.0, abs(value)) for name, value in self.figures.items()), default=0.0
        )


def load_replay(path: Path | str, *, trust: bool = False) -> Replay:
    """Read the file of a run; only if `trust` is true may the function run the Python file of a user's own law."""
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
    kind = {"sensing": file.sensing, "model": model, **law_options(file)}
    case = Case(scenario, vehicle, _gains(file.gains, law, path), law, **kind)
    run = SampledRun(case, file.seed, file.draw)
    return Replay(run, file.stopped_because, file.figures, file.campaign, file.broken_assumptions, file.version)


def _in_file(path: Path, key: str, load: Callable[..., T], table: Mapping[str, Any]) -> T:
    # errors name the key from the beginning of the file, which holds the table under `key`
    with mistakes_in(path, f"{key}."):
        return load(table, source=str(path))


def _gains(table: _GainTable, law: str, path: Path) -> Gains:
    base = replace(load_gains("default"), name=table.name, source=str(path)).with_own(law_source(law).gains)
    missing = [name for name in base.specs if name not in table.values]
    if missing:
        raise InputError("is missing", file=path, key=f"gains.values.{missing[0]}", remedy="add it")
    return base.with_values(table.values, provenance=table.provenance)


CHUNK = 128
"""Number of runs that are simulated and stored together."""

FASTEST = 0.15
"""Largest obstacle speed [m/s] for which a collision counts against the law (*chosen*)."""


@dataclass(frozen=True, eq=False)
class Campaign:
    """A finished campaign: its plan of runs, the table of results, and the summary."""

    plan: Plan
    table: RunTable
    summary: Summary

    def worst(self, count: int) -> list[Replay]:
        """Return the worst runs, the worst first, in a form that can be saved to files, see `RunTable.worst`."""
        return [self._replay(k) for k in self.table.worst(count)]

    def _replay(self, k: int) -> Replay:
        row = self.table.row(k)
        figures = {name: row[name] for name in _FIGURES if isfinite(row[name])}
        broken = tuple(row["broken_assumptions"])
        return Replay(self.plan.run(k), row["stopped_because"], figures, self.plan.name, broken)


def run_campaign(
    plan: Plan,
    *,
    runs: int,
    threads: int = 1,
    chunk: int = CHUNK,
    store: ChunkStore | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Campaign:
    """Simulate the first `runs` runs of a plan, in chunks of `chunk` runs by `threads` threads of the compiled loop.

    The result does not depend on threads and chunks. Finished chunks are read from the open `store`, and new ones
    written to it. `progress` receives one line of text after each chunk.
    """
    for key, value in (("runs", runs), ("chunk", chunk)):
        if value < 1:
            raise InputError("must be at least 1", key=key, value=value)
    parts, start, simulated = [], time.monotonic(), 0
    for index, first in enumerate(range(0, runs, chunk)):
        count = min(chunk, runs - first)
        shape = (count, 1 + len(METRICS) + len(plan.names))
        if store is not None and store.has(index, shape):
            parts.append(np.column_stack([store.column(index, shape, k) for k in range(shape[1])]))
        else:
            parts.append(_simulate_chunk(plan, first, count, threads))
            simulated += count
            if store is not None:
                store.write(index, parts[-1])
        rate = simulated / max(time.monotonic() - start, 1e-9)
        progress(
            f"{plan.name}: {first + count}/{runs} runs"
            + (f", {rate:.3g} per second" if simulated else ", from the store")
        )
    whole, wide = np.vstack(parts), 1 + len(METRICS)
    # with true positions the detection range is infinite
    detection = plan.case.scenario.sensors.equipment.array.maximum if plan.case.sensing == "sonar" else inf
    each = (plan.run(k) for k in range(runs))
    broken = tuple(assumptions(run.case, run.draw, detection=detection, fastest=FASTEST) for run in each)
    values = {name: whole[:, wide + k] for k, name in enumerate(plan.names)}
    table = RunTable(whole[:, 0].astype(np.int64), whole[:, 1:wide], values, broken)
    return Campaign(plan, table, summarise(table))


def _simulate_chunk(plan: Plan, first: int, count: int, threads: int) -> NDArray[np.float64]:
    # one line per run: seed, metrics, drawn values
    seeds, values = plan.seeds(first, count), plan.values(first, count)
    batch = simulate_batch(plan.case, values, seeds=seeds, threads=threads)
    return np.column_stack([seeds, batch.table, *(values[name] for name in plan.names)])


def law_of(plan: Plan) -> Law:
    """Return the law of the compiled loop that simulates the runs of a plan."""
    return build_loop(_structure(plan)).law


def _structure(plan: Plan) -> Structure:
    return structure_of(plan.case, plan.values(0, 1))


@dataclass(frozen=True)
class CampaignFolder:
    """A folder of campaigns; an interrupted campaign resumes from it, and a finished campaign does not run again.

    `campaign.json` describes the request, `campaign.chunks` holds finished runs, `NAME.csv` holds all runs, and `worst`
    holds files of the worst runs for `load_replay`. The number of runs is not part of the request, so a later command
    may add runs.
    """

    path: Path
    plans: tuple[Plan, ...]

    def prepare(self, *, fresh: bool = False) -> None:
        """Create the folder and write `campaign.json`; with `fresh`, delete all earlier campaigns in it first."""
        prepare_folder(self.path)
        note, requests = self.path / "campaign.json", [_request(plan) for plan in self.plans]
        if fresh:
            self._clear(note)
        if note.exists():
            _compare(note, requests)
        else:
            write_file(note, json.dumps({"kind": "campaign", "campaigns": requests}, indent=1) + "\n")

    def _clear(self, note: Path) -> None:
        # deletes files of earlier campaigns, and nothing else
        shutil.rmtree(self.path / "campaign.chunks", ignore_errors=True)
        left = [note, self.path / "summary.json"] if note.exists() else []
        with suppress(OSError, ValueError, KeyError, TypeError):  # a damaged file names no campaigns
            for one in json.loads(note.read_text(encoding="utf-8"))["campaigns"]:
                name = file_name(one["scenario"]["name"])
                left += [self.path / f"{name}.csv", *(self.path / "worst").glob(f"{name}-worst-*.toml")]
        for path in left:
            path.unlink(missing_ok=True)

    @contextmanager
    def store(self, plan: Plan) -> Iterator[ChunkStore]:
        """Open and lock the chunk store of a campaign."""
        digest = stored_loop(_structure(plan)).digest
        text = json.dumps([_request(plan), digest, CHUNK], sort_keys=True)
        store = ChunkStore(
            self.path / "campaign.chunks" / file_name(plan.name), hashlib.sha256(text.encode()).hexdigest()
        )
        with store.open():
            yield store

    def write(self, campaign: Campaign, *, worst: int) -> list[Path]:
        """Write the table of runs and the files of the worst runs; return the paths of the worst runs."""
        name, files = file_name(campaign.plan.name), self.path / "worst"
        write_csv(self.path / f"{name}.csv", campaign.table.columns())
        for old in files.glob(f"{name}-worst-*.toml"):
            with writing(old, **RESUME):
                old.unlink()
        replays = campaign.worst(worst)
        return [write_file(files / f"{name}-worst-{k}.toml", one.to_toml()) for k, one in enumerate(replays, start=1)]


def _request(plan: Plan) -> dict[str, Any]:
    case = plan.case
    return {
        "scenario": _entry(case.scenario.name, toml_text(scenario_table(case.scenario))),
        "vehicle": _entry(case.vehicle.name, _numbers(case.vehicle)),
        "model": None if case.model is None else _entry(case.model.name, _numbers(case.model)),
        "law": case.law,
        **{name.replace("_", " "): option for name, option in case.options.items()},
        "gains": _entry(case.gains.name, repr(sorted(case.gains.values.items()))),
        **plan.settings(),
        "version": __version__,
    }


def _entry(name: str, text: str) -> dict[str, str]:
    return {"name": name, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def _numbers(vehicle: Vehicle) -> str:
    return f"{vehicle.digest()} {sorted((name, p.range) for name, p in vehicle.parameters.items())!r}"


def _compare(note: Path, requests: Sequence[Mapping[str, Any]]) -> None:
    try:
        table = json.loads(note.read_text(encoding="utf-8"))
        stored = [dict(one) for one in table["campaigns"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise _other(note, "does not describe a campaign", None) from None
    if len(stored) != len(requests):
        raise _other(note, f"describes {len(stored)} campaigns, but {len(requests)} are requested", None)
    for old, new in zip(stored, requests, strict=True):
        for key, value in new.items():
            before = old.get(key)
            if before == value:
                continue
            if isinstance(before, dict) and isinstance(value, dict) and before.get("name") == value["name"]:
                raise _other(
                    note, f"belongs to a campaign that has other numbers in the {key} of this name", value["name"]
                )
            shown = before.get("name") if isinstance(before, dict) else before
            raise _other(note, f"belongs to a campaign with another {key}", shown)


def _other(note: Path, problem: str, value: object) -> InputError:
    remedy = "name another folder, or start again with --fresh"
    return InputError(problem, file=note, key="--out", value=value, remedy=remedy)
