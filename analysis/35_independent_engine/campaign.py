"""Runs of the study that are stored one by one, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from surctl.marine.engine import BatchCase
from surctl.marine.engine.physics import simulate_seeds
from surctl.marine.simulation import Case, Run
from surctl.marine.simulation.physics import PhysicsMaker

FIELDS = ("scenario", "seed", "ended", "time_s", "clearance_m", "path_error_m", "tilt_deg", "contacts")

Row = dict[str, str]


def stored_runs(
    file: Path, cases: Sequence[Case], physics: PhysicsMaker, seeds: int, *, stepper: type | None
) -> Iterator[list[Row]]:
    """Yield all rows of each case, which are at least those of the first seeds; a row is stored once its run ends."""
    header = ",".join(FIELDS)
    if not file.exists():
        file.write_text(header + "\n")
    known = {(row["scenario"], int(row["seed"])): row for row in csv.DictReader(file.read_text().splitlines())}
    for case in cases:
        name = case.scenario.name
        missing = [seed for seed in range(seeds) if (name, seed) not in known]
        batch_case = BatchCase(case, physics, stepper=stepper)
        for run in simulate_seeds(batch_case, missing) if missing else ():
            known[name, run.seed] = row = _row(name, run)
            with file.open("a", newline="") as out:
                csv.DictWriter(out, FIELDS, lineterminator="\n").writerow(row)
        yield [row for (scenario, _), row in sorted(known.items()) if scenario == name]


def good(row: Row) -> bool:
    """Return whether a run arrives without contact."""
    return row["ended"] == "reached" and float(row["clearance_m"]) > 0 and not row["contacts"]


def _row(name: str, run: Run) -> Row:
    metrics, tilt = run.metrics, run.record.tilt
    largest = 0.0 if tilt is None else float(np.rad2deg(np.abs(tilt).max()))
    return {
        "scenario": name,
        "seed": str(run.seed),
        "ended": metrics.stopped_because,
        "time_s": f"{metrics.time_s:.2f}",
        "clearance_m": f"{metrics.min_clearance_m:.5f}",
        "path_error_m": f"{metrics.path_error_m:.5f}",
        "tilt_deg": f"{largest:.2f}",
        "contacts": ";".join(contact.what for contact in run.contacts),
    }
