"""`surctl verify`: claims and margins."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.barrier_options import barrier_options
from surctl.cli.output import as_json, finish, progress

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from surctl.simulation import SafetyClaim
    from surctl.vehicle import Vehicle
    from surctl.verification import Claim, Verdict

__all__ = ["claim_line", "verify"]


@click.command
@click.argument("claims", nargs=-1, metavar="[CLAIM | FILE.toml]...")
@click.option("--vehicle", default="sur540-flooded", help="Vehicle of the margins: name or file.")
@click.option("--gains", default="default", help="Gain file: name or path.")
@click.option("--uncertainty", type=float, default=0.0, help="Share by which mass and drag may be off, e.g. 0.2.")
@click.option("--cruise", type=float, default=0.20, help="Speed in m/s about which the margins are taken.")
@click.option("--scenario", help="Tell the safety claim of the guarded law in this scenario too: name or file.")
@barrier_options
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the falsifier.")
@click.option("--time-limit", type=float, default=20.0, help="Seconds after which a proof is given up, per claim.")
@click.option("--show", is_flag=True, help="Print the claims as claim files and check nothing.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for the certificates of what is proved."
)
@as_json
def verify(
    claims: tuple[str, ...],
    vehicle: str,
    gains: str,
    uncertainty: float,
    cruise: float,
    scenario: str | None,
    barrier: str,
    movers: str,
    seed: int,
    time_limit: float,
    show: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Prove or refute the paper's claims, printed and corrected, or your own, and print the loop margins.

    A claim is proved (with a certificate that `surctl check` accepts), refuted (with a counterexample) or unknown
    (with what is left open). The paper's claims are about the kinematic loop; the vehicle enters the margins and the
    claims about braking, those at the worst of its ranges. With --scenario, the safety claim: what the law's barrier
    guarantees there, with every assumption as a number (--uncertainty then takes the place of the vehicle's ranges).
    Region claims are about the whole loop and are proved only when they are named: see surctl list.
    Exit status 0 when every verdict is the one the claim ships with.
    Examples: surctl verify --out proofs; surctl verify region-cruise-20; surctl verify v1-printed my-claim.toml --gains
    my-gains.toml; surctl verify braking-keeps --scenario tank-static --uncertainty 0.2
    """
    from surctl.cli.regions import is_region, prove_regions
    from surctl.control import build_law, load_gains
    from surctl.files import prepare_folder
    from surctl.vehicle import load_vehicle
    from surctl.verification import settle, worst_margins, write_claim

    values = load_gains(gains).values
    flown = load_vehicle(vehicle)
    named = [name for name in claims if not is_region(name)]
    chosen = _chosen(named, values, flown) if named or not claims else []
    if show:
        texts = {claim.name: write_claim(claim) for claim in chosen}
        finish({"claims": texts}, ["\n".join(texts.values())], as_json=as_json, passed=True)
        return
    if out is not None:
        prepare_folder(out)
    wanted = [name for name in claims if is_region(name)]
    regions = prove_regions(wanted, vehicle=vehicle, gains=gains, seed=seed, out=out)
    told = None
    if scenario is not None:
        told = _safety(scenario, flown, gains, barrier=barrier, movers=movers, spread=uncertainty or None)
    margins = worst_margins(flown, values, uncertainty=uncertainty, cruise=cruise, dt=build_law().dt)
    verdicts = []
    for claim in chosen:
        progress(claim.name)
        verdicts.append(settle(claim, seed=seed, time_limit=time_limit, progress=progress))
    files = _write_certificates(verdicts, out)
    lines = [*(claim_line(v) for v in verdicts), *regions.lines]
    lines += [f"certificates: {len(files)} in {out}; surctl check FILE"] if files else []
    least = min(margins, key=lambda m: m.delay_margin_s)
    off = f" with mass and drag off by ±{uncertainty:.0%}" if uncertainty else ""
    stable = all(m.stable for m in margins)
    word = "stable" if stable else "UNSTABLE"
    lines.append(f"margins of {flown.name}{off}: {word}, least delay {least.delay_margin_s:.2f} s ({least.name})")
    result = {
        "claims": [*(_told(v, files) for v in verdicts), *regions.claims],
        "uncertainty": uncertainty,
        "margins": [m.to_dict() for m in margins],
    }
    good = stable and regions.passed and all(v.as_expected for v in verdicts)
    if told is not None:
        lines += told.lines()
        result["safety"] = told.to_dict()
        good = good and told.holds
    finish(result, lines, as_json=as_json, passed=good)


def _safety(
    scenario: str, vehicle: Vehicle, gains: str, *, barrier: str, movers: str, spread: float | None
) -> SafetyClaim:

    from surctl.control import BARRIER_NAMES, MOVERS, load_gains
    from surctl.errors import InputError, nearest
    from surctl.simulation import load_scenario, safety_claim

    for key, value, known in (("barrier", barrier, BARRIER_NAMES), ("movers", movers, MOVERS)):
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(value, known))
    mission = load_scenario(scenario)
    sight = mission.sensors.equipment.array.maximum
    kind: dict[str, Any] = {"barrier": barrier, "movers": movers}
    return safety_claim(mission, vehicle, load_gains(gains), **kind, detection=sight, spread=spread)


def _chosen(words: Sequence[str], gains: Mapping[str, Any], vehicle: Vehicle) -> list[Claim]:
    """The claims of those names and files, in this order; no words mean the whole library."""
    from surctl.errors import InputError
    from surctl.verification import claims as library
    from surctl.verification import load_claim

    if not words:
        return list(library(gains, vehicle=vehicle))
    found = [load_claim(Path(w)) if w.endswith(".toml") else library(gains, [w], vehicle=vehicle)[0] for w in words]
    names = [claim.name for claim in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError("is given twice", key="claim", value=twice[0], remedy="rename one, or leave it out")
    return found


def _write_certificates(verdicts: Sequence[Verdict], out: Path | None) -> dict[str, Path]:
    """Certificates by claim, one file each."""
    from surctl.files import write_file

    if out is None:
        return {}
    return {
        v.claim.name: write_file(out / f"{v.claim.name}.json", json.dumps(v.certificate, ensure_ascii=False, indent=1))
        for v in verdicts
        if v.certificate is not None
    }


def _told(verdict: Verdict, files: Mapping[str, Path]) -> dict[str, Any]:
    told = verdict.to_dict()
    if told["certificate"] is not None:
        file = files.get(verdict.claim.name)
        told["certificate"]["file"] = None if file is None else str(file)
    return told


def claim_line(verdict: Verdict) -> str:
    """One verdict in one line, with its counterexample, its slack or what is left open."""
    found, proof = verdict.counterexample, verdict.certificate
    where = ""
    if found is not None:
        where = " at " + ", ".join(f"{k} = {v:.4g}" for k, v in found.values.items())
        where += f": exceeded by {found.margin:.3g} {verdict.claim.unit}"
    elif proof is not None and proof["claim"]["slack"]:
        where = f" to within {proof['claim']['slack']:.1g} {verdict.claim.unit}"
    elif verdict.open_ends:
        where = f": {verdict.open_ends}"
    mark = "ok  " if verdict.as_expected else "FAIL"
    return f"{mark} {verdict.claim.name:<22} {verdict.verdict}{where}"
