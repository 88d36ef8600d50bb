"""Region claims of `surctl verify`: names that begin with `region-`, and files of kind region."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from surctl.cli.output import progress

if TYPE_CHECKING:
    from surctl.verification.region import RegionStatement

__all__ = ["Regions", "is_region", "prove_regions", "region_of"]


class Regions(NamedTuple):
    """What the region claims came to: plain data, lines to print, certificates, whether all were proved."""

    claims: list[dict[str, Any]]
    lines: list[str]
    files: list[Path]
    passed: bool


def is_region(word: str) -> bool:
    """Whether a claim's name is that of a region claim, or a file's kind is region.

    Raises:
        InputError: the file cannot be read.
    """
    if word.endswith(".toml"):
        from surctl.files import read_toml

        return bool(read_toml(Path(word)).get("kind") == "region")
    return word.startswith("region-")


def region_of(word: str) -> RegionStatement:
    """The region claim of that name or file.

    Raises:
        InputError: no such claim, or a file that is none.
    """
    from surctl.verification.region import load_region, region_statement

    return load_region(Path(word)) if word.endswith(".toml") else region_statement(word)


def prove_regions(words: Sequence[str], *, vehicle: str, gains: str, seed: int = 0, out: Path | None = None) -> Regions:
    """Prove region claims by name or file, for a vehicle and a gain file; the certificates go to `out` as NAME.json.

    Raises:
        InputError: an unknown claim, vehicle or gain file, or a vehicle that the claim does not fit.
    """
    from surctl.control import load_gains
    from surctl.errors import InputError
    from surctl.vehicle import load_vehicle
    from surctl.verification.region import prove_statement

    flown, values = load_vehicle(vehicle), load_gains(gains)
    stated = {word: region_of(word) for word in words}
    for word, statement in stated.items():  # what does not fit is said before anything is proved
        try:
            statement.claim(flown, values)
        except InputError as error:
            raise (error.inside(word) if word.endswith(".toml") and not error.file else error) from None
    proofs, files = [], []
    for statement in stated.values():
        name = statement.name
        progress(name)
        proof = prove_statement(statement, flown, values, seed=seed)
        proofs.append(proof)
        if out is not None and proof.verdict == "proved":
            out.mkdir(parents=True, exist_ok=True)
            files.append(out / f"{name}.json")
            proof.write(files[-1])
    lines = [f"{'ok  ' if p.verdict == 'proved' else 'FAIL'} {p.claim.name:<22} {p.sentence}" for p in proofs]
    return Regions([p.to_dict() for p in proofs], lines, files, all(p.verdict == "proved" for p in proofs))
