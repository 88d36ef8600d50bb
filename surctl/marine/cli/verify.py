"""`surctl verify` of the robot: which claims and speeds, what fails the command, files."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import (
    FiniteRange,
    finish,
    progress,
    refusal_line,
    same_command,
    saving,
    stoppable,
    timed,
)
from surctl.errors import InputError, NotApplicable
from surctl.marine.cli.claims import claim_line, statement_lines
from surctl.marine.cli.robot_options import (
    GAINS_HELP,
    SPEEDS,
    barrier_options,
    choose_gains,
    derive_words,
    margin_short,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from surctl.marine.control import Gains
    from surctl.marine.vehicle import Vehicle
    from surctl.verification import Claim, Verdict

_SHORT = 20.0  # s
_MOST_CLAIMS = 3  # in a summary; more are counted
_GAIN_FILE = "gains.toml"  # in the printed commands, if the gains are derived
_SPEED = FiniteRange(min=0, max=100, min_open=True)


@click.command
@click.argument("words", nargs=-1, metavar="[CLAIM | FILE.toml")
@click.option("--vehicle", metavar="FILE", help="Vehicle (default: that of --scenario, else sur540-flooded).")
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@click.option(
    "--uncertainty",
    type=float,
    default=0.0,
    metavar="X",
    help="Error of mass, drag: 0.2 = ±20 % (default: vehicle's ranges).",
)
@click.option(
    "--cruise",
    type=SPEEDS,
    metavar="V1,V2",
    help="Cruise speeds [m/s], or LOW..HIGH:COUNT: margins at each, claims at the largest "
    "(default: --scenario, else 0.15).",
)
@click.option(
    "--cap", type=_SPEED, metavar="V", help="Largest commanded speed [m/s] (default: that of --scenario, else 0.22)."
)
@click.option("--scenario", metavar="FILE", help="Scenario (name or file) for the no-contact claim.")
@click.option("--law", metavar="NAME", help="Law: name or FILE.py:FUNCTION (default: guarded or steered).")
@click.option("--sensing", metavar="NAME", help="Obstacles: sonar (default if usable) or truth (exact).")
@barrier_options
@click.option("--show", is_flag=True, help="Print claims as claim files, and check no claim.")
def verify(
    words: tuple[str, ...],
    vehicle: str | None,
    gains: str | None,
    uncertainty: float,
    cruise: tuple[float, ...] | None,
    cap: float | None,
    scenario: str | None,
    law: str | None,
    sensing: str | None,
    barrier: str,
    movers: str,
    seed: int,
    time_limit: float | None,
    show: bool,
    out: Path | None,
    as_json: bool,
) -> None:
    """Prove or refute built-in claims or your own, and print loop margins.

    A claim is proved (with a certificate for `surctl check`), refuted (with a counterexample), unknown (neither), or
    not applicable (an assumption does not hold). The paper's claims assume cruise speed, and velocities equal to their
    commands (at most --cap). With --scenario, surctl also checks the no-contact claim: the robot touches no obstacle.
    The claim mission says that the robot stays near the scenario's path; mission:REGION uses the region claim REGION.

    surctl linearises the closed loop about straight cruise (with --law: about the law's steady motion), and prints
    margins, poles, slowest mode, stable speeds and control periods, for the nominal and the worst vehicle within
    --uncertainty or the vehicle's ranges. surctl list shows region and braking claims, which are checked only if you
    name them. A claim file states an inequality (key kind = claim; --show prints examples), a region claim with your
    numbers (region), or a region of attraction or a barrier of any dynamics (lyapunov, barrier). Exit status: 1 if a
    verdict is not the expected one, a named claim is not applicable, or a margin or no-contact claim fails.

    For FILE.py:FUNCTION, a system of your own, surctl prints equilibrium, poles and margins of the sampled loop. With
    arguments within.STATE=LOW..HIGH for all states, surctl proves a region of attraction in this box.

    Examples: surctl verify --out proofs; surctl verify region-cruise-20 claim.toml; surctl verify loop.py:build k=2
    """
    claims = words
    from surctl.assessment import assess
    from surctl.files import prepare_folder
    from surctl.marine.assessment import Mission
    from surctl.marine.cli.claims import (
        check_regions,
        is_braking,
        is_mission,
        is_region,
        prove_all,
        prove_missions,
        prove_regions,
        region_of,
        require_own_speeds,
    )
    from surctl.marine.cli.linear_part import LinearPart, linear_part, over_speeds, speed_lines
    from surctl.marine.cli.robot_options import (
        check_barrier,
        choose_law,
        choose_sensing,
        choose_vehicle,
        export_command,
    )
    from surctl.marine.control import PATH_FOLLOWING, build_law, law_source
    from surctl.marine.simulation import load_scenario
    from surctl.marine.tuning import derive_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.braking_claims import NOT_RESTED_ON
    from surctl.marine.verification.region import write_region
    from surctl.marine.verification.speeds import check_held
    from surctl.own_code import label
    from surctl.verification import Inapplicable, decide
    from surctl.verification.claim_file import write_claim

    # claims of one's own alone concern no vehicle, so nothing is said of one
    named_things = (vehicle, gains, cruise, cap, scenario, law, sensing)
    alone = bool(claims) and all(map(_is_claim_file, claims)) and all(word is None for word in named_things)
    mission = None if scenario is None else load_scenario(scenario)
    choice = choose_vehicle(vehicle, None if mission is None else (mission.name, mission.vehicle))
    vehicle, robot = choice.word, load_vehicle(choice.word)
    speeds = _speeds(None if cruise is None else max(cruise), cap, scenario)
    chosen_law, about_law = choose_law(law, [robot])
    source, sensed = law_source(chosen_law), choose_sensing(sensing, chosen_law)
    tuned = choose_gains(gains, robot, cruise=speeds[0], own=source.gains)
    values = tuned.gains.values
    # a gain of a law of one's own may have the name of a number in a claim
    at_hand = {n: v for n, v in values.items() if n not in source.gains} | {"speed": speeds[0], "speed_max": speeds[1]}
    about = None if law is None or PATH_FOLLOWING in source.parts else label(chosen_law)
    named = [name for name in claims if not (is_region(name) or is_braking(name) or is_mission(name))]
    chosen, left_out = _chosen(named, at_hand, robot, law=about) if named or not claims else ([], {})
    refused = [Inapplicable.of(name, reason) for name, reason in left_out.items()]
    if show:
        texts = {claim.name: write_claim(claim) for claim in chosen}
        texts |= {word: write_region(region_of(word)) for word in claims if is_region(word)}
        braking = next((word for word in claims if is_braking(word) or is_mission(word)), None)
        if braking is not None:
            remedy = "drop it; the claim is fixed by its vehicle, law and scenario"
            raise InputError("has no claim file", key="claim", value=braking, remedy=remedy)
        lines = [*texts.values(), *(refusal_line(one) for one in refused)]
        finish({"claims": texts}, lines, as_json=as_json, passed=not refused, whole=True)
        return
    check_held(cruise or (), robot, cap=speeds[1], key="--cruise")
    if out is not None:
        prepare_folder(out)
    region_names = [name for name in claims if is_region(name)]
    require_own_speeds(region_names, None if cruise is None else max(cruise), cap)
    # mistakes are reported before the linear analysis
    check_regions(region_names, robot, tuned.gains, speeds, chosen_law)
    dt = build_law().dt
    options: dict[str, Any] = {"dt": dt, "uncertainty": uncertainty, "law": chosen_law}
    cascaded = PATH_FOLLOWING in source.parts
    check_barrier(barrier, movers)
    scenarios = () if mission is None else (replace(mission, cruise=speeds[0], cap=speeds[1]),)
    forms = {"barrier": barrier, "movers": movers}
    kind: dict[str, Any] = {"uncertainty": uncertainty or None, "sensing": sensed, **forms}
    subjects = [
        Mission(robot, tuned.gains, u, speeds[1], chosen_law, "los", scenarios, **kind)
        for u in (() if alone else cruise or speeds[:1])
    ]
    # the speeds but the largest concern the loop alone
    assessed = [assess(one, parts=["loop"] if one is not subjects[-1] else ["loop", "no contact"]) for one in subjects]
    parts = [linear_part(*each) for each in zip(assessed, subjects, strict=True)]
    linear = over_speeds(parts) if parts else LinearPart([], {}, None, speeds[0])
    judged = [line for one in assessed for line in one.lines if line.about]
    contacts = assessed[-1].sources.get("no contact") if assessed else None
    safety = contacts[0] if contacts and cascaded else None
    shared: dict[str, Any] = {"vehicle": vehicle, "gains": tuned.gains, "law": chosen_law, "out": out}
    regions = prove_regions(region_names, speeds=speeds, seed=seed, forms=forms, **shared)
    about_mission = [name for name in claims if is_mission(name)]
    missions = prove_missions(about_mission, mission, speeds=speeds, seed=seed, **shared)
    regions = regions.joined(missions)
    braked = prove_all([name for name in claims if is_braking(name)], cap=speeds[1], **shared)
    verdicts, files, lines = [], dict[str, Path](), list[str]()
    where = "" if out is None else f", certificates in {out}"
    above, message = f"the finished claims are above{where}", "for the other claims: surctl verify CLAIM"
    for claim in chosen:
        with timed(claim.name), stoppable(message, lines, above=above, as_json=as_json):
            verdicts.append(decide(claim, seed=seed, time_limit=time_limit or _SHORT, progress=progress))
        files |= _write_certificates(verdicts[-1:], out)
        lines.append(claim_line(verdicts[-1]))
        if claim.exact is not None:
            lines += statement_lines(claim.exact, verdicts[-1].certificate)
    lines += [*(refusal_line(one) for one in refused), *regions.lines, *braked.lines]
    if not alone:
        lines.append(f"at cruise speed {speeds[0]:g} m/s and cap {speeds[1]:g} m/s, {choice.line(robot.name)}:")
        lines += [*about_law, *tuned.lines, *(f"{line.mark} {line.text}" for line in judged), *linear.lines]
    held, held_data = (
        ([], {})
        if linear.stable is None or not cascaded
        else speed_lines(robot, values, cruise=speeds[0], cap=speeds[1], short=linear.short, **options)
    )
    lines += held
    result: dict[str, Any] = {
        "vehicle": robot.name,
        "vehicle_from": choice.origin,
        "claims": [
            *(_verdict_data(v, files) for v in verdicts),
            *(one.to_dict() for one in refused),
            *regions.claims,
            *braked.claims,
        ],
        "derived_gains": tuned.data,
        "uncertainty": uncertainty,
        "cruise_m_per_s": speeds[0],
        "cap_m_per_s": speeds[1],
        "speeds_m_per_s": held_data,
        **linear.data,
    }  # fmt: skip
    if alone:
        result = {"claims": result["claims"]}
    else:
        result["assessment"] = assessed[-1].to_dict()
        lines.append(f"not assessed: {', '.join(assessed[-1].omitted)} (surctl study assesses all)")
    certificates = [*files.values(), *regions.files, *braked.files]
    if out is not None:
        margins_at = None if linear.stable is None or not cascaded else cruise or speeds[:1]
        result["pictures"] = _draw(verdicts, regions.claims, robot, tuned.gains, out, cruise=margins_at, law=chosen_law)
        lines.append(f"certificates: {len(certificates)}, pictures: {len(result['pictures'])}, in {out}")
    beside = list[str]()
    failing = [line.text for line in judged if line.rank == 0]
    unmet = [f"{v.claim.name} is {v.verdict}, not {v.claim.expected}" for v in verdicts if not v.as_expected]
    others = [*regions.claims, *braked.claims, *(one.to_dict() for one in refused if named)]
    unmet += [f"{one['claim']} is {one['verdict']}" for one in others if one["verdict"] != "proved"]
    failures = [*failing, *unmet]
    if safety is not None:
        judges = not isinstance(safety, Inapplicable)
        lines += safety.lines() if judges else [f"no contact: {safety.sentence}"]
        refuted = [v.claim.name for v in verdicts if v.verdict == "refuted" and judges and safety.holds]
        beside = [f"no contact does not rest on {n}: {NOT_RESTED_ON[n]}" for n in refuted if n in NOT_RESTED_ON]
        lines += beside
        result["safety"] = safety.to_dict()
    if failures:
        lines.append(f"NOT accepted: {'; '.join(failures)}")
        result["failures"] = failures
    elif not alone:
        lines.append("accepted")
    proved = any(claim["verdict"] == "proved" for claim in result["claims"])
    then = [f"{same_command()} --out proofs"] if proved and out is None else []
    if not then:
        then = [shlex.join(["surctl", "check", str(file)]) for file in certificates[:1]]
        if linear.stable and not linear.short:
            word = gains or (_GAIN_FILE if tuned.derived else "default")
            then += [derive_words(vehicle, speeds[0], word)] if tuned.derived else []
            then += (
                export_command(scenario, vehicle, tuned.gains, certificates, file=word, law=chosen_law, sensing=sensed)
                if cascaded
                else export_command(scenario, vehicle, tuned.gains, file=word, law=chosen_law, sensing="truth")
            )
    if linear.short and cascaded:  # gains that have the margins at this speed, or else at a lower one
        derived = derive_gains(robot, cruise=speeds[0])
        reached = speeds[0] if derived.reached else derived.bearable
        then[:0] = [derive_words(vehicle, reached, _GAIN_FILE)] if reached > 0 else []
    elif tuned.derived and math.isfinite(short := margin_short(safety)):
        then.insert(0, derive_words(vehicle, speeds[0], _GAIN_FILE, margin=short))
    if regions.instead:
        again = ["surctl", "verify", regions.instead, *("--vehicle", vehicle), *(("--gains", gains) if gains else ())]
        then.insert(0, shlex.join([*again, "--cruise", f"{speeds[0]:g}", "--cap", f"{speeds[1]:g}"]))
    about_claims = [*map(claim_line, verdicts), *(refusal_line(one) for one in refused), *regions.lines, *braked.lines]
    about_claims = [line for line in about_claims if not line.startswith(" ") and line not in missions.lines]
    if len(about_claims) > _MOST_CLAIMS:
        good = sum(line.startswith("ok") for line in about_claims)
        counted = f"ok   {good} of {len(about_claims)} claims as expected"
        if aside := sum(line.startswith("n/a") for line in about_claims):
            mark = "ok  " if good else "n/a "
            counted = f"{mark} {good} of {len(about_claims)} claims as expected, {aside} not applicable"
        about_claims = [*(f"FAIL {text}" for text in unmet), counted]
    about_claims.sort(key=lambda line: not line.startswith("FAIL"))
    brief = [*missions.lines, *(f"FAIL {text}" for text in failing), *about_claims]
    brief += [f"{line.mark} {line.text}" for line in judged if line.rank] + beside
    written = [f"certificates {out}"] if certificates else [f"pictures {out}"] if result.get("pictures") else []
    finish(result, lines, as_json=as_json, passed=not failures, then=then, brief=brief, files=written)


def _is_claim_file(word: str) -> bool:
    from surctl.files import read_toml

    return word.endswith(".toml") and Path(word).is_file() and read_toml(Path(word)).get("kind") == "claim"


def _speeds(cruise: float | None, cap: float | None, scenario: str | None) -> tuple[float, float]:
    """Return the cruise speed and the speed limit [m/s] from the options or the scenario.

    The default speed limit is that of the scenario. If the cruise speed exceeds this limit, the limit is multiplied by
    (cruise speed)/(cruise speed of the scenario).
    """
    from surctl.marine.cli.robot_options import MISSION
    from surctl.marine.simulation import load_scenario

    mission = load_scenario(MISSION if scenario is None else scenario)
    speed = mission.cruise if cruise is None else cruise
    if cap is None:
        cap = mission.cap if mission.cap >= speed else round(speed * mission.cap / mission.cruise, 9)
    if cap < speed:
        problem = f"must not be below the cruise speed, {speed:g} m/s"
        raise InputError(problem, key="--cap", value=cap, remedy="raise it")
    return speed, cap


def _draw(
    verdicts: Sequence[Verdict],
    regions: Sequence[Mapping[str, Any]],
    vehicle: Vehicle,
    gains: Gains,
    out: Path,
    *,
    cruise: Sequence[float] | None,
    law: str,
) -> list[str]:
    progress("pictures")
    proved = {region["claim"]: region["certificate"] for region in regions if region["certificate"]}
    pictures = list[Path]()
    with saving("plots"):
        from surctl.marine.control import build_law
        from surctl.marine.report import plot_mission, plot_region
        from surctl.marine.report.files import save_margins, save_verdicts
        from surctl.report.theme import save_figure

        pictures += save_verdicts(verdicts, out)
        for name, document in proved.items():
            tube = document["kind"] == "mission"
            plot = plot_mission(document) if tube else plot_region(document)
            pictures.append(save_figure(plot, out, (name, "tube" if tube else "levels")))
        pictures += [] if cruise is None else save_margins(build_law(law), vehicle, gains, out, cruise=cruise)
    return [str(path) for path in pictures]


def _chosen(
    words: Sequence[str], gains: Mapping[str, Any], vehicle: Vehicle, *, law: str | None = None
) -> tuple[list[Claim], Mapping[str, NotApplicable]]:
    # without names and files, the claims are those of the library; they do not concern the law `law`
    from surctl.marine.tuning.derived import has_tuned
    from surctl.marine.verification.library import applicable_claims
    from surctl.verification import load_claim

    if not words:  # where the paper errs concerns its own robot
        every, refused = ((), {}) if law else applicable_claims(gains, vehicle=vehicle, errata=has_tuned(vehicle))
        return list(every), refused
    own = {word: load_claim(Path(word)) for word in words if word.endswith(".toml")}
    rest, refused = applicable_claims(gains, [w for w in dict.fromkeys(words) if w not in own], vehicle=vehicle)
    if law is not None:
        why = "it follows no path by equations (8)-(12)"
        refused = {claim.name: NotApplicable(why, to=f"law {law}", key=claim.name) for claim in rest} | dict(refused)
        rest = ()
    known = {claim.name: claim for claim in rest}
    chosen = [own[w] if w in own else known[w] for w in words if w not in refused]
    names = [claim.name for claim in chosen]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError("is given twice", key="claim", value=twice[0], remedy="rename or drop one of them")
    return chosen, refused


def _write_certificates(verdicts: Sequence[Verdict], out: Path | None) -> dict[str, Path]:
    from surctl.files import write_file

    files = dict[str, Path]()
    for verdict in verdicts:
        if out is not None and verdict.certificate is not None:
            name, text = verdict.claim.name, json.dumps(verdict.certificate, ensure_ascii=False, indent=1)
            with saving(f"certificate of {name}"):
                files[name] = write_file(out / f"{name}.json", text)
    return files


def _verdict_data(verdict: Verdict, files: Mapping[str, Path]) -> dict[str, Any]:
    data = verdict.to_dict()
    if data["certificate"] is not None:
        file = files.get(verdict.claim.name)
        data["certificate"]["file"] = None if file is None else str(file)
    return data
