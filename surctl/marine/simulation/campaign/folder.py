"""The folder of a campaign: requested runs, finished chunks, table of runs, files of the worst runs."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surctl import __version__
from surctl.errors import InputError
from surctl.files import file_name, prepare_folder, write_file
from surctl.marine.simulation.batch.pack import structure_of
from surctl.marine.simulation.batch.stored import stored_loop
from surctl.marine.simulation.campaign.campaign import CHUNK, Campaign
from surctl.marine.simulation.campaign.plan import Plan
from surctl.marine.simulation.scenario_table import scenario_table
from surctl.marine.simulation.store import ChunkStore, cannot_write
from surctl.marine.simulation.toml_text import toml_text
from surctl.marine.vehicle import Vehicle

__all__ = ["CampaignFolder"]


@dataclass(frozen=True)
class CampaignFolder:
    """A folder of campaigns; an interrupted campaign resumes from it, and a finished campaign does not run again.

    `campaign.json` describes the request, `campaign.chunks` holds finished runs, `NAME.csv` holds all runs, and `worst`
    holds files of the worst runs for `load_replay`. The number of runs is not part of the request in `campaign.json`,
    so that a later command may add runs.

    Attributes:
        path: the folder.
        plans: plans of the campaigns, in their order.
    """

    path: Path
    plans: tuple[Plan, ...]

    def prepare(self, *, fresh: bool = False) -> None:
        """Create the folder and write the description of the requested runs to `campaign.json`.

        Args:
            fresh: whether to delete all earlier campaigns in the folder first.

        Raises:
            InputError: the folder cannot be written, or it belongs to a different campaign; the error names the
                difference.
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
        """Open and lock the chunk store of a campaign.

        Raises:
            InputError: another process has locked the store, or the store cannot be written.
        """
        structure = structure_of(plan.case, plan.values(0, 1))
        digest = stored_loop(structure).digest
        text = json.dumps([_request(plan), digest, CHUNK], sort_keys=True)
        store = ChunkStore(
            self.path / "campaign.chunks" / file_name(plan.name), hashlib.sha256(text.encode()).hexdigest()
        )
        with store.open():
            yield store

    def write(self, campaign: Campaign, *, worst: int) -> list[Path]:
        """Write the table of runs and the files of the worst runs; return the paths of the worst runs.

        Raises:
            InputError: a file cannot be written, for instance because the disk is full.
        """
        name, files = file_name(campaign.plan.name), self.path / "worst"
        write_file(self.path / f"{name}.csv", campaign.table.to_csv())
        for old in files.glob(f"{name}-worst-*.toml"):
            try:
                old.unlink()
            except OSError as error:
                raise cannot_write(old, error) from None
        replays = campaign.worst(worst)
        return [write_file(files / f"{name}-worst-{k}.toml", one.to_toml()) for k, one in enumerate(replays, start=1)]


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
