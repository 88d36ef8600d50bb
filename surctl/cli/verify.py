"""`surctl verify`: claims and margins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from surctl.cli.output import as_json, finish, progress

if TYPE_CHECKING:
    from surctl.verification import Verdict

__all__ = ["claim_line", "verify"]


@click.command
@click.argument("claims", nargs=-1)
@click.option("--vehicle", default="sur540-flooded", help="Vehicle of the margins: name or file.")
@click.option("--gains", default="default", help="Gain file: name or path.")
@click.option("--uncertainty", type=float, default=0.0, help="Share by which mass and drag may be off, e.g. 0.2.")
@click.option("--cruise", type=float, default=0.20, help="Speed in m/s about which the margins are taken.")
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the falsifier.")
@as_json
def verify(
    claims: tuple[str, ...], vehicle: str, gains: str, uncertainty: float, cruise: float, seed: int, as_json: bool
) -> None:
    """Try to refute the paper's claims, printed and corrected, and print the loop margins.

    The claims are about the kinematic loop; vehicle and uncertainty enter the margins only.
    A claim that is not refuted is not proved. Exit status 0 when every verdict is the one the claim ships with.
    Region claims are about the whole loop and are proved only when they are named: see surctl list.
    Examples: surctl verify; surctl verify v1-printed v1-corrected --gains my-gains.toml;
    surctl verify region-cruise-20
    """
    from surctl.cli.regions import is_region, prove_regions
    from surctl.control import build_law, load_gains
    from surctl.vehicle import load_vehicle
    from surctl.verification import claims as library
    from surctl.verification import falsify, worst_margins

    values = load_gains(gains).values
    named = [name for name in claims if not is_region(name)]
    regions = prove_regions([name for name in claims if is_region(name)], vehicle=vehicle, gains=gains, seed=seed)
    chosen = library(values, named if claims else None)
    flown = load_vehicle(vehicle)
    margins = worst_margins(flown, values, uncertainty=uncertainty, cruise=cruise, dt=build_law().dt)
    verdicts = []
    for claim in chosen:
        progress(claim.name)
        verdicts.append(falsify(claim, seed=seed))
    lines = [*(claim_line(v) for v in verdicts), *regions.lines]
    least = min(margins, key=lambda m: m.delay_margin_s)
    off = f" with mass and drag off by ±{uncertainty:.0%}" if uncertainty else ""
    stable = all(m.stable for m in margins)
    word = "stable" if stable else "UNSTABLE"
    lines.append(f"margins of {flown.name}{off}: {word}, least delay {least.delay_margin_s:.2f} s ({least.name})")
    result = {
        "claims": [*(v.to_dict() for v in verdicts), *regions.claims],
        "uncertainty": uncertainty,
        "margins": [m.to_dict() for m in margins],
    }
    passed = stable and regions.passed and all(v.as_expected for v in verdicts)
    finish(result, lines, as_json=as_json, passed=passed)


def claim_line(verdict: Verdict) -> str:
    """One verdict in one line, with its counterexample."""
    found = verdict.counterexample
    where = ""
    if found is not None:
        where = " at " + ", ".join(f"{k} = {v:.4g}" for k, v in found.values.items())
        where += f": exceeded by {found.margin:.3g} {verdict.claim.unit}"
    mark = "ok  " if verdict.as_expected else "FAIL"
    return f"{mark} {verdict.claim.name:<22} {verdict.verdict}{where}"
