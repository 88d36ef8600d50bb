"""Braking claims of `surctl verify`: under the barrier, the robot can always brake before it touches an obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from surctl.cli.activity import timed
from surctl.cli.output import refusal_line, saving

if TYPE_CHECKING:
    from surctl.marine.control import Gains

__all__ = ["Braking", "is_braking", "prove_all"]

_KINDS = ("braking-rule", "braking-inertia", "braking-simple")


class Braking(NamedTuple):
    """The result of the braking claims: plain data, lines to print, certificate files, whether all are proved."""

    claims: list[dict[str, Any]]
    lines: list[str]
    files: list[Path]
    passed: bool


def is_braking(name: str) -> bool:
    """Return whether a name denotes a braking claim; False for the name of a step in the proof of a claim."""
    return name.startswith(_KINDS)


def prove_all(
    names: Sequence[str], *, vehicle: str, gains: str | Gains, cap: float, out: Path | None = None
) -> Braking:
    """Prove the named braking claims for a vehicle, gains (or their file) and a speed limit `cap` [m/s].

    The certificates are written to the folder `out` as NAME.json.

    Raises:
        InputError: a claim, vehicle or gain file is unknown; the error is raised before the first proof.
    """
    if not names:
        return Braking([], [], [], True)
    from surctl.errors import NotApplicable
    from surctl.marine.control import load_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.braking import braking_claim_named, prove_braking
    from surctl.verification import Inapplicable

    robot = load_vehicle(vehicle)
    values = load_gains(gains) if isinstance(gains, str) else gains
    proofs, files, claims, refused = [], [], [], []
    for name in names:
        try:
            claims.append(braking_claim_named(name, robot, values, cap=cap))
        except NotApplicable as reason:
            refused.append(Inapplicable.of(name, reason))
    for claim in claims:
        with timed(claim.name):
            proof = prove_braking(claim)
        proofs.append(proof)
        if out is not None and proof.verdict == "proved":
            with saving(f"certificate of {claim.name}"):
                out.mkdir(parents=True, exist_ok=True)
                file = out / f"{claim.name}.json"
                proof.write(file)
                files.append(file)
    lines = [f"{'ok  ' if p.verdict == 'proved' else 'FAIL'} {p.claim.name:<22} {p.sentence}" for p in proofs]
    lines += [refusal_line(one) for one in refused]
    data = [*(p.to_dict() for p in proofs), *(one.to_dict() for one in refused)]
    return Braking(data, lines, files, not refused and all(p.verdict == "proved" for p in proofs))
