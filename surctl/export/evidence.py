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
    files["README.md"] = head + mark + "\n".join(_lines(evidence)) + "\n"
    table = json.loads(bundle.files["manifest.json"])
    whole = MappingProxyType({**bundle.binaries, **(binaries or {})})
    table["evidence"] = dict(evidence)
    manifest = manifest_with(table, files, proof=table["proof"], binaries=whole)
    return replace(bundle, files=MappingProxyType({**files, "manifest.json": manifest}), binaries=whole)


def _lines(evidence: Mapping[str, Any]) -> list[str]:
    check, proof, own = evidence["check"], evidence["proof"], "system" in evidence["run"]
    lines = [line for one in (evidence, *evidence.get("further_runs", ())) for line in _replay_lines(**one)]
    if check is None:
        lines.append("- Other compilers and processors: not tried (`surctl export --check`).")
    else:
        verdict = "same bytes as Python" if check["passed"] else "DIFFERENT from Python"
        steps = check["simulated_steps"] + check["single_steps"]
        lines += [f"- Compilers and processors, {steps} steps each: {verdict}.", "", *_builds(check), ""]
        lines.append("  Instructions are measured over these steps; they are not a proved bound.")
    claim = "not tried (`surctl export --prove`)" if proof is None else f"{proof['status']}: {proof['claim']}"
    what = "No run-time error" if own else "No run-time error, thrust within its limits"
    return [*lines, f"- {what}: {claim}."]


def _replay_lines(run: Mapping[str, Any], sil: Mapping[str, Any], **_: Any) -> list[str]:
    failure, own = run.get("failure"), "system" in run
    result = ("" if own else "arrived without contact") if failure is None else f"FAILED: {failure}"
    if own:
        simulated = run["text"] + (f": {result}" if result else "")
    else:
        simulated = f"{run['scenario']} by {run['vehicle']}, {run['sensing']}, seed {run['seed']}: {result}"
    if bits := run.get("bits"):
        often = (
            f"`{k}` in {b['share']:.1%} of the steps, at most {b['longest_s']:.4g} s in a row" for k, b in bits.items()
        )
        simulated += f". Its statuses: {'; '.join(often)}"
    return [
        f"- Simulated run: {simulated}.",
        *_mission(run),
        f"- The compiled C over {sil['steps']} steps of this run, against Python: largest difference of the "
        f"{'commands' if own else 'thrust'} "
        f"{sil['tau']:.1e}, {sil['status_mismatches']} other statuses; {sil['fault_cases']} bad inputs, "
        f"{len(sil['fault_failures'])} not refused ({sil['compiler']}).",
    ]


def _mission(run: Mapping[str, Any]) -> list[str]:
    # what a simulation of one's own needs of the simulated run's scenario
    if "path_length_m" not in run:
        return []
    mission = f"- Its mission: path of {run['path_length_m']:.4g} m, `arrival_m` {run['arrival_m']:g} m."
    if not run["obstacles"]:
        return [f"{mission} No obstacles."]
    rows = [
        f"{mission} Its obstacles:",
        "",
        "| obstacle | shape | rest of its entry in the mission file |",
        "|---|---|---|",
    ]
    for obstacle in run["obstacles"]:
        rest = (f"{k} = {json.dumps(v)}" for k, v in obstacle.items() if k not in ("name", "shape"))
        rows.append(f"| {obstacle['name'].replace('|', '/')} | {obstacle['shape']} | {', '.join(rest)} |")
    return [*rows, ""]


def _builds(check: Mapping[str, Any]) -> list[str]:
    rows = [
        "| target | result | code without self-test [B] | stack [B] | instructions min / mean / max |",
        "|---|---|---|---|---|",
    ]
    for build in check["builds"]:
        counted = build["instructions"]
        numbers = "–" if counted is None else f"{counted[0]} / {counted[1]:.0f} / {counted[2]}"
        cells = (build["target"], "same" if build["same"] else build["failure"] or f"{build['differing']} steps differ")
        sizes = ("–" if build[key] is None else str(build[key]) for key in ("runtime_bytes", "stack_bytes"))
        rows.append(f"| {' | '.join((*cells, *sizes, numbers))} |")
    return rows
