"""Region claims of `surctl verify`: claims whose names begin with `region-`, and claim files of kind region."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from surctl.cli.activity import timed
from surctl.cli.output import refusal_line, saving

if TYPE_CHECKING:
    from surctl.marine.control import Gains
    from surctl.marine.vehicle import Vehicle
    from surctl.marine.verification.region import RegionStatement
    from surctl.verification import Inapplicable

__all__ = ["Regions", "check_regions", "is_region", "prove_regions", "region_of", "require_own_speeds"]


class Regions(NamedTuple):
    """The result of the region claims.

    Attributes:
        claims: plain data of each claim.
        lines: lines to print.
        files: certificate files.
        instead: name of a claim that applies to the vehicle, if one that was asked for does not; "" if there is none.
    """

    claims: list[dict[str, Any]]
    lines: list[str]
    files: list[Path]
    instead: str


def is_region(word: str) -> bool:
    """Return whether a word is the name of a region claim or a file of kind region.

    Raises:
        InputError: the file cannot be read.
    """
    if word.endswith(".toml"):
        from surctl.files import read_toml

        return bool(read_toml(Path(word)).get("kind") == "region")
    return word.startswith("region-")


def region_of(word: str) -> RegionStatement:
    """Return the region claim with the given name or file.

    Raises:
        InputError: the claim is unknown, or the file is not a region claim.
    """
    from surctl.marine.verification.region import load_region, region_statement

    return load_region(Path(word)) if word.endswith(".toml") else region_statement(word)


def check_regions(
    words: Sequence[str], vehicle: Vehicle, gains: Gains, speeds: tuple[float, float]
) -> tuple[dict[str, RegionStatement], dict[str, Inapplicable]]:
    """Return the region claims by word, and those that do not apply to the vehicle with their reason; proves nothing.

    Args:
        words: names and files of the claims.
        vehicle: the vehicle.
        gains: the gains.
        speeds: (cruise speed, speed limit) [m/s] for claims whose text does not set these speeds.

    Raises:
        InputError: a claim is unknown or has a mistake.
    """
    from surctl.errors import InputError, NotApplicable
    from surctl.verification import Inapplicable

    cruise, cap = speeds
    stated = {word: region_of(word) for word in words}
    refused: dict[str, Inapplicable] = {}
    for word, statement in stated.items():
        try:
            statement.claim(vehicle, gains, cruise=cruise, cap=cap)
        except NotApplicable as reason:
            refused[word] = Inapplicable.of(statement.name, reason)
        except InputError as error:
            raise (error.inside(word) if word.endswith(".toml") and not error.file else error) from None
    return stated, refused


def require_own_speeds(words: Sequence[str], cruise: float | None, cap: float | None) -> None:
    """Raise InputError if an option sets another speed than the one that a region claim states.

    Args:
        words: names and files of the claims.
        cruise: cruise speed of the option [m/s]; None if it is not set.
        cap: speed limit of the option [m/s]; None if it is not set.
    """
    from surctl.errors import InputError

    for word in words:
        statement = region_of(word)
        stated = {"cruise_m_per_s", "cap_m_per_s"} & statement.model_fields_set
        for key, option in (("cruise_m_per_s", cruise), ("cap_m_per_s", cap)):
            value = getattr(statement, key)
            if stated and option is not None and option != value:
                name = f"--{key.partition('_')[0]}"
                problem = f"is not the speed of the region claim, which is proved at {value:g} m/s"
                raise InputError(problem, file=word, key=name, value=option, remedy=f"drop {name}, or change the claim")


def prove_regions(
    words: Sequence[str],
    *,
    vehicle: str,
    gains: str | Gains,
    speeds: tuple[float, float],
    seed: int = 0,
    out: Path | None = None,
) -> Regions:
    """Prove region claims for a vehicle and a gain file; the certificates are written to `out` as NAME.json.

    Args:
        words: names and files of the claims.
        vehicle: name or file of the vehicle.
        gains: name or file of the gains, or the gains.
        speeds: (cruise speed, speed limit) [m/s] for claims whose text does not set these speeds.
        seed: seed of the search for a certificate.
        out: folder of the certificates.

    Raises:
        InputError: a claim, vehicle or gain file is unknown; the error is raised before the first proof.
    """
    from surctl.marine.control import load_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.region import RegionStatement, applicable_region, prove_statement

    robot = load_vehicle(vehicle)
    values = load_gains(gains) if isinstance(gains, str) else gains
    cruise, cap = speeds
    stated, refused = check_regions(words, robot, values, speeds)
    proofs, files = [], []
    for word, statement in stated.items():
        if word in refused:
            continue
        name = statement.name
        with timed(name):
            proof = prove_statement(statement, robot, values, seed=seed, cruise=cruise, cap=cap)
        proofs.append(proof)
        if out is not None and proof.verdict == "proved":
            with saving(f"certificate of {name}"):
                file = out / f"{name}.json"
                proof.write(file)
                files.append(file)
    marks = ["ok  " if p.useful else "open" if p.verdict == "proved" else "FAIL" for p in proofs]
    lines = [f"{mark} {p.claim.name:<22} {p.sentence}" for mark, p in zip(marks, proofs, strict=True)]
    lines += [refusal_line(one) for one in refused.values()]
    data = [*(p.to_dict() for p in proofs), *(one.to_dict() for one in refused.values())]
    known = {statement.name for statement in stated.values()}
    others = [name for name in ("region-turning-20", "region-steered-20") if name not in known]
    instead = applicable_region(others, robot, values, cruise=cruise, cap=cap) if refused and others else None
    return Regions(data, lines, files, instead.name if isinstance(instead, RegionStatement) else "")
