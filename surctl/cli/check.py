"""`surctl check`: the independent checker of certificates."""

from __future__ import annotations

from pathlib import Path

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
    told = found.claim.get("statement") or found.claim.get("name") or ""
    word = "accepted" if found.accepted else f"rejected: {found.reason}"
    lines = [f"{word} ({found.kind or 'unknown kind'}, {found.seconds:.2f} s)", *([str(told)] if told else [])]
    finish(found.to_dict(), lines, as_json=as_json, passed=found.accepted)
