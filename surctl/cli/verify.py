"""`surctl verify`: claims and margins."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.barrier_options import barrier_options
from surctl.cli.output import as_json, finish, progress, same_command, stoppable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from surctl.control import Law
    from surctl.simulation import SafetyClaim
    from surctl.vehicle import Vehicle
    from surctl.verification import Claim, Verdict
    from surctl.verification.stack import StackConditions

__all__ = ["claim_line", "verify"]


@click.command
@click.argument("claims", nargs=-1, metavar="[CLAIM | FILE.toml]...")
@click.option("--vehicle", default="sur540-flooded", help="Vehicle of the margins: name or file.")
@click.option("--gains", default="default", help="Gain file: name or path.")
@click.option("--uncertainty", type=float, default=0.0, help="Share by which mass and drag may be off, e.g. 0.2.")
@click.option("--cruise", type=float, default=0.20, help="Speed in m/s about which the margins are taken.")
@click.option("--scenario", help="Tell the safety claim of the guarded law in this scenario too: name or file.")
@click.option("--stack", "stacks", multiple=True, help="Tell how the tasks of a law's stack lie: guarded or paper.")
@barrier_options
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the falsifier.")
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, max=1e6, min_open=True),
    default=20.0,
    help="Processor seconds after which a proof is given up, per claim.",
)
@click.option("--show", is_flag=True, help="Print the claims as claim files and check nothing.")
@click.option("--out", type=click.Path(path_type=Path), metavar="DIR", help="Folder for certificates and pictures.")
@as_json
def verify(
    claims: tuple[str, ...],
    vehicle: str,
    gains: str,
    uncertainty: float,
    cruise: float,
    scenario: str | None,
    stacks: tuple[str, ...],
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
    claims about braking at the worst of its ranges. With --scenario, the safety claim: what the law's barrier
    guarantees there, with every assumption as a number (--uncertainty then takes the place of the vehicle's ranges).
    With --stack, which tasks of a law are orthogonal, independent or dependent, and which converge; it tells, and does
    not decide the exit status. Your own stack: surctl.verification.stack.stack_conditions.
    Beside them the linear side about straight cruise: margins of each loop and of all at once, poles, and the control
    periods and delays that the sampled loop bears, for the vehicle and for the worst of --uncertainty, else of its
    ranges. Region claims are about the whole loop, and braking claims about what it never touches: both are proved
    when they are named, see surctl list. A claim file is an inequality of your own (kind claim) or a region claim with
    other numbers (kind region); --show prints those of the library to start from.
    Exit status 0 when every verdict is the one the claim ships with.
    Examples: surctl verify --out proofs; surctl verify region-cruise-20; surctl verify v1-printed my-claim.toml --gains
    my-gains.toml; surctl verify region-cruise-20 --show; surctl verify braking-inertia-20 --scenario tank-static
    --uncertainty 0.2
    """
    from surctl.cli.braking import is_braking, prove_all
    from surctl.cli.regions import is_region, prove_regions, region_of
    from surctl.control import build_law, load_gains
    from surctl.errors import InputError
    from surctl.files import prepare_folder
    from surctl.vehicle import load_vehicle
    from surctl.verification import settle, worst_margins, write_claim
    from surctl.verification.linear import corners, linear_side, worst_linear_side
    from surctl.verification.region import write_region

    if time_limit != time_limit:  # NaN is in every range of click's
        raise InputError("is no time", key="--time-limit", value=time_limit, remedy="give seconds, above 0")
    values = load_gains(gains).values
    flown = load_vehicle(vehicle)
    named = [name for name in claims if not is_region(name) and not is_braking(name)]
    chosen = _chosen(named, values, flown) if named or not claims else []
    if show:
        texts = {claim.name: write_claim(claim) for claim in chosen}
        texts |= {word: write_region(region_of(word)) for word in claims if is_region(word)}
        braking = next((word for word in claims if is_braking(word)), None)
        if braking is not None:
            remedy = "a braking claim is of its vehicle and law alone; leave it out"
            raise InputError("has no claim file", key="claim", value=braking, remedy=remedy)
        finish({"claims": texts}, ["\n".join(texts.values())], as_json=as_json, passed=True)
        return
    if out is not None:
        prepare_folder(out)
    wanted = [name for name in claims if is_region(name)]
    regions = prove_regions(wanted, vehicle=vehicle, gains=gains, seed=seed, out=out)
    braked = prove_all([n for n in claims if is_braking(n)], vehicle=vehicle, gains=gains, out=out)
    told = None
    if scenario is not None:
        told = _safety(scenario, flown, gains, barrier=barrier, movers=movers, spread=uncertainty or None)
    law = build_law()
    dt = law.dt
    margins = worst_margins(flown, values, uncertainty=uncertainty, cruise=cruise, dt=dt)
    linear = linear_side(flown, values, cruise=cruise, dt=dt)
    tried = corners(flown, uncertainty or None)
    worst = worst_linear_side(tried, values, cruise=cruise, dt=dt)
    verdicts, files, lines = [], dict[str, Path](), list[str]()
    where = "" if out is None else f", certificates in {out}"
    kept = f"what was settled is told above{where}; name the other claims: surctl verify CLAIM"
    for claim in chosen:
        progress(claim.name)
        with stoppable(kept, lines, as_json=as_json):
            verdicts.append(settle(claim, seed=seed, time_limit=time_limit, progress=progress))
        files |= _write_certificates(verdicts[-1:], out)
        lines.append(claim_line(verdicts[-1]))
    lines += [*regions.lines, *braked.lines]
    least = min(margins, key=lambda m: m.delay_margin_s)
    off = f" with mass and drag off by ±{uncertainty:.0%}" if uncertainty else ""
    stable = all(m.stable for m in margins)
    word = "stable" if stable else "UNSTABLE"
    lines.append(f"margins of {flown.name}{off}: {word}, least delay {least.delay_margin_s:.2f} s ({least.name})")
    lines += [*linear.lines(), *(worst.lines() if len(tried.vehicles) > 1 else [])]
    result: dict[str, Any] = {
        "claims": [*(_told(v, files) for v in verdicts), *regions.claims, *braked.claims],
        "uncertainty": uncertainty,
        "margins": [m.to_dict() for m in margins],
        "linear": {"nominal": linear.to_dict(), "worst": worst.to_dict()},
    }
    for name in stacks:
        told_stack = _stack(name)
        lines += told_stack.lines()
        result.setdefault("stacks", {})[name] = told_stack.to_dict()
    certificates = [*files.values(), *regions.files, *braked.files]
    if out is not None:
        result["pictures"] = _draw(verdicts, regions.claims, flown, values, out, cruise=cruise, dt=dt)
        lines.append(f"certificates: {len(certificates)}, pictures: {len(result['pictures'])}, in {out}")
    good = stable and regions.passed and braked.passed and all(v.as_expected for v in verdicts)
    if told is not None:
        lines += told.lines()
        result["safety"] = told.to_dict()
        good = good and told.holds
    proved = any(claim["verdict"] == "proved" for claim in result["claims"])
    travel = _travelling(certificates, law, flown, gains)
    then = _then(gains, vehicle, certificates, travel, lost=proved and out is None)
    finish(result, lines, as_json=as_json, passed=good, then=then)


def _travelling(kept: Sequence[Path], law: Law, vehicle: Vehicle, gains: str) -> list[Path]:
    """Certificates that an export with these gains takes along: not of the paper's loop, nor of gains of their own."""
    if not kept:
        return []
    from surctl.cli.export import MISSION
    from surctl.control import load_gains
    from surctl.export import fitting_certificates
    from surctl.simulation import law_numbers, load_scenario

    numbers = law_numbers(load_scenario(MISSION), load_gains(gains), vehicle)
    return fitting_certificates(kept, law, vehicle, numbers)


def _then(gains: str, vehicle: str, kept: Sequence[Path], travel: Sequence[Path], *, lost: bool) -> list[str]:
    """The certificates are checked, and travel with the code; without a folder they are lost."""
    if lost:
        return [f"{same_command()} --out proofs"]
    export = ["surctl", "export", "--vehicle", vehicle, "--gains", gains]
    carried = [word for file in travel for word in ("--certificate", str(file))]
    return [*(shlex.join(["surctl", "check", str(file)]) for file in kept[:1]), shlex.join([*export, *carried])]


def _safety(
    scenario: str, vehicle: Vehicle, gains: str, *, barrier: str, movers: str, spread: float | None
) -> SafetyClaim:

    from surctl.control import BARRIER_NAMES, MOVERS, load_gains
    from surctl.errors import InputError, nearest
    from surctl.simulation import load_scenario, safety_claim, turn_rate

    for key, value, known in (("barrier", barrier, BARRIER_NAMES), ("movers", movers, MOVERS)):
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(value, known))
    mission = load_scenario(scenario)
    sight = mission.sensors.equipment.array.maximum
    kind: dict[str, Any] = {"barrier": barrier, "movers": movers}
    values = load_gains(gains)
    turning = turn_rate(mission, vehicle, values, sonar=True)
    return safety_claim(mission, vehicle, values, **kind, detection=sight, spread=spread, turning=turning)


def _draw(
    verdicts: Sequence[Verdict],
    regions: Sequence[Mapping[str, Any]],
    vehicle: Vehicle,
    gains: Mapping[str, float],
    out: Path,
    *,
    cruise: float,
    dt: float,
) -> list[str]:
    from surctl.report import save_margins, save_regions, save_verdicts

    progress("pictures")
    proved = {told["claim"]: told["certificate"] for told in regions if told["certificate"]}
    drawn = [*save_margins(vehicle, gains, out, cruise=cruise, dt=dt), *save_verdicts(verdicts, out)]
    return [str(path) for path in [*drawn, *save_regions(proved, out)]]


def _stack(name: str) -> StackConditions:
    from surctl.verification.stack import shipped_stack, stack_conditions

    shipped = shipped_stack(name)
    return stack_conditions(shipped.stack, shipped.region, parameters=shipped.parameters)


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
