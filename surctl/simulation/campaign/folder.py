"""A campaign's folder: what was asked, its finished chunks, its table, and its worst runs as files."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl import __version__
from surctl.errors import InputError
from surctl.files import prepare_folder, write_file
from surctl.simulation.batch import build_loop
from surctl.simulation.batch.pack import structure_of
from surctl.simulation.campaign.campaign import CHUNK, Campaign
from surctl.simulation.campaign.plan import Plan
from surctl.simulation.scenario_table import scenario_table
from surctl.simulation.store import ChunkStore, cannot_write
from surctl.simulation.toml_text import toml_text
from surctl.vehicle import Vehicle

__all__ = ["CampaignFolder"]


@dataclass(frozen=True)
class CampaignFolder:
    """Where campaigns are kept, so that a killed one continues and a finished one is not flown again.

    `campaign.json` says what was asked, `campaign.chunks` has finished runs, `NAME.csv` all of them, and `worst` files
    of the worst for `load_replay`. The number of runs is no part of the question: more may be asked for.

    Attributes:
        path: the folder.
        plans: of the campaigns, in their order.
    """

    path: Path
    plans: tuple[Plan, ...]

    def prepare(self, *, fresh: bool = False) -> None:
        """Make the folder, and note what is asked.

        Args:
            fresh: whether what is kept there of any campaign is thrown away first.

        Raises:
            InputError: it cannot be written, or holds a campaign of something else, which is named.
        """
        prepare_folder(self.path)
        note, requests = self.path / "campaign.json", [_request(plan) for plan in self.plans]
        if fresh:
            self._clear(note)
        if note.exists():
            _compare(note, requests)
        else:
            write_file(note, json.dumps({"kind": "campaign", "campaigns": requests}, indent=1) + "\n")

    def _clear(self, note: Path) -> None:
        """Take away what campaigns left here, and nothing else."""
        shutil.rmtree(self.path / "campaign.chunks", ignore_errors=True)
        left = [note, self.path / "summary.json"] if note.exists() else []
        with suppress(OSError, ValueError, KeyError, TypeError):  # a harmed note names nothing
            for one in json.loads(note.read_text(encoding="utf-8"))["campaigns"]:
                name = _file_name(one["scenario"]["name"])
                left += [self.path / f"{name}.csv", *(self.path / "worst").glob(f"{name}-worst-*.toml")]
        for path in left:
            path.unlink(missing_ok=True)

    @contextmanager
    def store(self, plan: Plan) -> Iterator[ChunkStore]:
        """The chunks of a campaign, held.

        Raises:
            InputError: another process holds them, or they cannot be written.
        """
        structure = structure_of(plan.case, plan.values(0, 1))
        digest = build_loop(structure).step.digest()
        text = json.dumps([_request(plan), digest, CHUNK], sort_keys=True)
        store = ChunkStore(
            self.path / "campaign.chunks" / _file_name(plan.name), hashlib.sha256(text.encode()).hexdigest()
        )
        with store.open():
            yield store

    def write(self, campaign: Campaign, *, worst: int) -> list[Path]:
        """Write the table and the worst runs; the paths of these.

        Raises:
            InputError: there is no room.
        """
        name, files = _file_name(campaign.plan.name), self.path / "worst"
        write_file(self.path / f"{name}.csv", campaign.table.to_csv())
        for old in files.glob(f"{name}-worst-*.toml"):
            try:
                old.unlink()
            except OSError as error:
                raise cannot_write(old, error) from None
        replays = campaign.worst(worst)
        return [write_file(files / f"{name}-worst-{k}.toml", one.to_toml()) for k, one in enumerate(replays, start=1)]


def _file_name(name: str) -> str:
    """A scenario's name without what means something in a path; one that has it is told apart by its digest."""
    plain = re.sub(r"[^A-Za-z0-9_-]", "-", name)
    return plain if plain == name else f"{plain}-{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def _request(plan: Plan) -> dict[str, Any]:
    case = plan.case
    return {
        "scenario": _entry(case.scenario.name, toml_text(scenario_table(case.scenario))),
        "vehicle": _entry(case.vehicle.name, _numbers(case.vehicle)),
        "model": None if case.model is None else _entry(case.model.name, _numbers(case.model)),
        "law": case.law,
        "avoidance": case.avoidance,
        "guidance": case.guidance,
        "priority mode": case.mode,
        "barrier": case.barrier,
        "movers": case.movers,
        "gains": _entry(case.gains.name, repr(sorted(case.gains.values.items()))),
        "sensing": case.sensing,
        **plan.settings(),
        "version": __version__,
    }


def _entry(name: str, text: str) -> dict[str, str]:
    return {"name": name, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def _numbers(vehicle: Vehicle) -> str:
    return repr(sorted((name, p.value, p.range) for name, p in vehicle.parameters.items()))


def _compare(note: Path, requests: Sequence[Mapping[str, Any]]) -> None:
    """InputError that names the first thing in which the folder's campaigns are others."""
    try:
        table = json.loads(note.read_text(encoding="utf-8"))
        stored = [dict(one) for one in table["campaigns"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise _other(note, "is no note of a campaign", None) from None
    if len(stored) != len(requests):
        raise _other(note, f"holds {len(stored)} campaigns where {len(requests)} are asked for", None)
    for old, new in zip(stored, requests, strict=True):
        for key, value in new.items():
            before = old.get(key)
            if before == value:
                continue
            if isinstance(before, dict) and isinstance(value, dict) and before.get("name") == value["name"]:
                raise _other(note, f"holds a campaign of a {key} of this name with other numbers", value["name"])
            shown = before.get("name") if isinstance(before, dict) else before
            raise _other(note, f"holds a campaign of another {key}", shown)


def _other(note: Path, problem: str, value: object) -> InputError:
    remedy = "name another folder, or start again with --fresh"
    return InputError(problem, file=note, key="--out", value=value, remedy=remedy)
