"""`surctl check`: the independent checker of certificates."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from surctl.cli.output import as_json, finish

__all__ = ["check"]


@click.command
@click.argument("certificate", type=click.Path(path_type=Path))
@as_json
def check(certificate: Path, as_json: bool) -> None:
    """Check a certificate without trusting the prover that wrote it.

    Exit status 0 accepted, 1 rejected, 2 no certificate. Example: surctl check proofs/v2-static.json
    """
    from surctl.certcheck import check_file

    found = check_file(certificate)
    word = "accepted" if found.accepted else f"rejected: {found.reason}"
    lines = [f"{word} ({found.kind or 'unknown kind'}, {found.seconds:.2f} s)"]
    if found.accepted:
        lines += _shown(found.claim)
    finish(found.to_dict(), lines, as_json=as_json, passed=found.accepted)


def _shown(claim: Mapping[str, Any]) -> list[str]:
    """What was checked, entry by entry: the words of a statement are nobody's proof."""
    lines = []
    for key, value in claim.items():
        if key == "statement" or value in ([], "", 0.0):
            continue
        entries = value if isinstance(value, list) else [value]
        lines.append(f"  {key}: {', '.join(_entry(entry) for entry in entries)}")
    return lines


def _entry(value: Any) -> str:
    """A variable with its ends, or whatever else a kind of certificate claims."""
    if isinstance(value, dict) and {"name", "lower", "upper", "unit"} <= set(value):
        return f"{value['name']} in [{value['lower']}, {value['upper']}] {value['unit']}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
