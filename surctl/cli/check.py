"""`surctl check`: the independent checker of certificates; options --bundle, --gains-id and --time-limit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from surctl.cli import lib
from surctl.cli.options import FOLDER, FiniteRange
from surctl.cli.output import as_json, finish, printable


@click.command
@click.argument("certificate", type=click.Path(path_type=Path))
@click.option("--bundle", type=FOLDER, help="Compare the certificate with the controller in DIR.")
@click.option(
    "--gains-id",
    metavar="HEX",
    help="Id of law and gains on the robot, from the C function NAME_gains_id, to compare with the id in the bundle.",
)
@click.option(
    "--time-limit",
    type=FiniteRange(min=0, min_open=True),
    default=None,
    metavar="S",
    help="Largest processor time [s] of the check (default 8); a certificate that takes longer is rejected.",
)
@as_json
def check(
    certificate: Path, bundle: Path | None, gains_id: str | None, time_limit: float | None, as_json: bool
) -> None:
    """Check a certificate without trusting the prover that wrote it.

    --bundle also checks whether the certificate applies to an exported controller: the checker compares every number of
    the certificate with the manifest of the bundle, and computes every hash again. For a system of your own, the
    checker derives the dynamics from the instruction lists of the bundle; for a law of the robot, the checker compares
    the commands of the certified law with those of the exported instruction list at hundreds of points. The output
    names the parts of the controller that the certificate does not cover. A certificate with slack proves an inequality
    only up to the slack, and does not prove asymptotic stability. Exit status: 0 if the certificate is accepted (and
    applies to the controller), 1 if the certificate is rejected, belongs to another controller, or states a number that
    the bundle does not contain, 2 if a file is not a certificate or bundle.

    Examples: surctl check proofs/v2-static.json; surctl check firmware/certificate-v2-static.json --bundle firmware
    """
    outcome = lib.check_file(certificate, time_limit=lib.PATIENCE if time_limit is None else time_limit)
    word = "accepted" if outcome.accepted else f"rejected: {outcome.reason}"
    word += f", but vacuous: {outcome.vacuous}" if outcome.vacuous else ""
    lines = [f"{word} ({outcome.kind or 'unknown kind'}, {outcome.seconds:.2f} s)"]
    if outcome.accepted:
        lines += ([f"  proves: {outcome.proves}"] if outcome.proves else []) + _shown(outcome.claim)
    brief = [lines[0]]
    if outcome.accepted:
        stated = {"claim": outcome.claim.get("name"), "proves": outcome.proves}
        stated["excludes"] = "; ".join(map(str, outcome.claim.get("excludes", [])))
        brief += [f"{key}: {text}" for key, text in stated.items() if text]
    said = len(lines)
    if gains_id is not None and bundle is None:
        raise click.UsageError("--gains-id needs --bundle")
    if bundle is None:
        finish(outcome.to_dict(), printable(lines), as_json=as_json, passed=outcome.accepted, brief=printable(brief))
        return
    manifest = lib.read_bundle(bundle)
    nothing: dict[str, Any] = {"belongs": False, "differs": [], "unbound": [], "undecided": [], "excludes": []}
    result = {**outcome.to_dict(), "bundle": {"id": manifest.id, **nothing}}
    if outcome.accepted:
        # the file is read once: the claim that was checked is the claim that is compared
        comparison = lib.compare({"kind": outcome.kind, "claim": outcome.claim}, manifest)
        differs, belongs = list(comparison.differs), comparison.belongs
        if gains_id is not None and gains_id.lower().removeprefix("0x").zfill(8) != manifest.gains_id:
            differs.append(f"gains: the robot reports id {gains_id}, the bundle's is {manifest.gains_id}")
            belongs = False
        result["bundle"] = {"id": manifest.id, **comparison.to_dict(), "belongs": belongs, "differs": differs}
        word = "belongs to" if belongs else "DOES NOT belong to" if differs else "IS NOT BOUND to"
        lines.append(f"{word} the controller {manifest.id[:12]} in {bundle}")
        lines += [f"  differs: {text}" for text in differs]
        lines += (
            []
            if differs
            else [f"  not bound: {text}, which nothing of the bundle states" for text in comparison.unbound]
        )
        lines += [f"  not shown: {text}" for text in comparison.undecided]
        lines += [f"  not covered: {text}" for text in comparison.excludes]
    brief[1:1] = map(str.strip, lines[said:])
    passed = bool(result["bundle"]["belongs"])
    finish(result, printable(lines), as_json=as_json, passed=passed, brief=printable(brief))


def _shown(claim: Mapping[str, Any]) -> list[str]:
    # without the wording of the claim, which the checker does not verify
    lines = []
    for key, value in claim.items():
        if key == "statement" or value in ([], {}, "", 0.0):
            continue
        entries = value if isinstance(value, list) else [value]
        if len(entries) > 1 and all(isinstance(entry, str) for entry in entries):
            lines += [f"  {key}:", *(f"    - {entry}" for entry in entries)]
            continue
        lines.append(f"  {key}: {', '.join(_entry(entry) for entry in entries)}")
    return lines


def _entry(value: Any) -> str:
    # a variable is shown with its bounds
    if isinstance(value, dict) and {"name", "lower", "upper", "unit"} <= set(value):
        return f"{value['name']} in [{value['lower']}, {value['upper']}] {value['unit']}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
