"""Evidence of an exported controller: what was run, compared, measured and proved, in the manifest and the README."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.assessment import Assessment
from surctl.export.bundle import Bundle, ExportedFile, manifest_with, write_bundle
from surctl.export.check import CheckReport
from surctl.export.contract import STATUS
from surctl.export.envelope import AnyRecord
from surctl.export.prove import ProofReport
from surctl.export.rendering import templates
from surctl.export.sil import SilReport

_MARK = "## Evidence\n"


@dataclass(frozen=True)
class ReplayedRun:
    """A simulated run that the exported C repeats.

    Attributes:
        about: scenario, vehicle, sensing and seed of the run, its result, and `failure` (None if it arrived without
            contact); of a system of the user's own, `system`, `text`, `failure` and `reference` (at the start).
        record: the run as the exported step takes it.
        statuses: status (n,) of each step of a run of a robot, or None.
        period: time between two steps [s].
    """

    about: Mapping[str, Any]
    record: AnyRecord
    statuses: NDArray[np.int_] | None = None
    period: float = 0.05

    def to_dict(self, sil: SilReport) -> dict[str, Any]:
        """Return the run and its comparison of C with Python as plain data."""
        bits = {} if self.statuses is None else _bits(self.statuses, self.period)
        return {"run": {**self.about, "bits": bits}, "sil": sil.to_dict()}


def write_evidence(
    bundle: Bundle,
    out: Path,
    replays: Sequence[ReplayedRun],
    sil: Sequence[SilReport],
    assessment: Assessment,
    *,
    command: str,
    check: CheckReport | None = None,
    proof: ProofReport | None = None,
    binaries: Mapping[str, bytes] | None = None,
) -> Sequence[ExportedFile]:
    """Write the bundle with what is known of it in its manifest and README; every export and study ends here.

    Args:
        bundle: the exported controller.
        out: folder of the bundle.
        replays: the simulated runs; that of the default mission comes first.
        sil: comparison of C and Python in each of them.
        assessment: what is assessed of the controller.
        command: command line that writes the bundle, without the options about its output on the terminal.
        check, proof: builds for several processors, and proof of the C code, or None.
        binaries: further files by name, such as an FMU.
    """
    first, *further = (replay.to_dict(report) for replay, report in zip(replays, sil, strict=True))
    evidence = first | {
        "command": command,
        "check": None if check is None else check.to_dict(),
        "proof": None if proof is None else {k: v for k, v in proof.to_dict().items() if k != "alarms"},
        "instruction_bound": None,  # instructions are measured; no bound of them is proved
        # JSON has no NaN and no infinity
        "assessment": json.loads(json.dumps(assessment.to_dict()), parse_constant=lambda _: None),
    }
    evidence |= {"further_runs": further} if further else {}
    return write_bundle(_with_evidence(bundle, evidence, binaries=binaries), out)


def _bits(statuses: NDArray[np.int_], period: float) -> dict[str, dict[str, float]]:
    # how often, and how long in a row, a healthy run has these bits
    result = {}
    for name, code, _ in STATUS:
        if name in ("SATURATED", "DEGRADED"):
            on = (statuses > 0) & (statuses & code > 0)
            longest = max((len(list(same)) for value, same in groupby(on) if value), default=0)
            result[name] = {"share": float(on.mean()), "longest_s": longest * period}
    return result


def _with_evidence(bundle: Bundle, evidence: Mapping[str, Any], *, binaries: Mapping[str, bytes] | None) -> Bundle:
    files = {name: text for name, text in bundle.files.items() if name != "manifest.json"}
    head, mark, _ = files["README.md"].rpartition(_MARK)
    replays = (evidence, *evidence.get("further_runs", ()))
    files["README.md"] = (
        head + mark + templates().get_template("evidence.md.j2").render(**evidence, replays=replays, json=json.dumps)
    )
    table = json.loads(bundle.files["manifest.json"])
    whole = MappingProxyType({**bundle.binaries, **(binaries or {})})
    table["evidence"] = dict(evidence)
    manifest = manifest_with(table, files, proof=table["proof"], binaries=whole)
    return replace(bundle, files=MappingProxyType({**files, "manifest.json": manifest}), binaries=whole)
