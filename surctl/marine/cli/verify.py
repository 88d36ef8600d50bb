"""`surctl verify` of the robot: which claims and speeds, what is assessed, pictures, and the commands to run next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.options import FiniteRange, option, options
from surctl.cli.output import finish, prepare_out, progress, refusal_line, same_command, saving, warnings_in
from surctl.cli.verify import Claimed, decide_claims, failed_lines, next_check, refused
from surctl.errors import InputError
from surctl.marine.cli import claims, lib
from surctl.marine.cli.linear_part import LinearPart, linear_part, over_speeds, speed_lines
from surctl.marine.cli.robot_options import (
    MISSION,
    SPEEDS,
    ExportedRobot,
    choose_gains,
    choose_law,
    choose_sensing,
    choose_vehicle,
    derive_words,
    export_command,
    margin_short,
)

if TYPE_CHECKING:
    from surctl.cli.verify import Decided
    from surctl.marine.cli.robot_options import GainsChoice, VehicleChoice

_SHORT = 20.0  # s
_MOST_CLAIMS = 3  # in a summary; more are counted
_GAIN_FILE = "gains.toml"  # in the printed commands, if the gains are derived
_SPEED = FiniteRange(min=0, max=100, min_open=True)


@dataclass(frozen=True, eq=False, repr=False)
class _Robot(ExportedRobot):
    vehicle: str | None = option(
        "--vehicle", "Vehicle (default: that of --scenario, else sur540-flooded).", metavar="FILE"
    )
    law: str | None = option("--law", "Law or FILE.py:FUNCTION (default guarded; no sway: steered).", metavar="NAME")


@dataclass(frozen=True, eq=False, repr=False)
class _Stated:
    """What claims and margins are about, besides the robot; None: see the help."""

    uncertainty: float = option(
        "--uncertainty", "Error of mass, drag: 0.2 = ±20 % (default: vehicle's ranges).", 0.0, metavar="X"
    )
    cruise: tuple[float, ...] | None = option(
        "--cruise",
        "Cruise speeds [m/s], or LOW..HIGH:COUNT: margins at each, claims at the largest "
        "(default: scenario's, else 0.15).",
        type=SPEEDS,
        metavar="V1,V2",
    )
    cap: float | None = option(
        "--cap", "Largest commanded speed [m/s] (default: that of --scenario, else 0.22).", type=_SPEED, metavar="V"
    )
    scenario: str | None = option(
        "--scenario", "Mission whose no-contact claim is checked: name or file.", metavar="FILE"
    )
    show: bool = option("--show", "Print claims as claim files, and check no claim.", False)


_OF_ROBOT = ("vehicle", "gains", "law", "sensing", "barrier", "movers")


@click.command
@click.argument("words", nargs=-1, metavar="[CLAIM | FILE.toml")
@options(robot=_Robot, stated=_Stated, only={"robot": _OF_ROBOT})
def verify(
    words: tuple[str, ...],
    robot: ExportedRobot,
    stated: _Stated,
    seed: int,
    time_limit: float | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Prove or refute built-in claims or your own, and print loop margins.

    A claim is proved (with a certificate for `surctl check`), refuted (with a counterexample), unknown (neither), or
    not applicable (an assumption does not hold). The robot paper's claims assume that velocities equal their commands.
    With --scenario, surctl also checks the no-contact claim: the robot touches no static obstacle. Claim mission: the
    robot stays near the scenario's path; mission:REGION uses the region claim REGION.

    surctl linearises the closed loop about straight cruise (with --law: about the law's steady motion), and prints
    margins, poles, slowest mode and stable speeds, for the nominal and the worst vehicle within --uncertainty or the
    vehicle's ranges. surctl checks region and braking claims (see surctl list) only if you name them. A claim file
    has kind = claim (inequality; --show prints examples), region (region claim with your ranges), lyapunov (region of
    attraction of dynamics in the file) or barrier (barrier of such dynamics). Exit status: 1 if a verdict is not the
    claim's expected one (default: proved), a named claim is not applicable, or a margin or no-contact claim fails.

    For FILE.py:FUNCTION, a system of your own, surctl prints equilibrium, poles and margins of the sampled loop. With
    within.STATE=LOW..HIGH for each state, it tries to prove a region of attraction in the box of these ranges.

    Examples: surctl verify --out proofs; surctl verify region-cruise-20 claim.toml; surctl verify loop.py:build k=2
    """
    # claims of one's own alone concern no vehicle, so nothing is said of one
    law, gains, scenario = robot.law, robot.gains, stated.scenario
    cruise, cap, uncertainty = stated.cruise, stated.cap, stated.uncertainty
    named_things = (robot.vehicle, gains, cruise, cap, scenario, law, robot.sensing)
    alone = bool(words) and all(map(_is_claim_file, words)) and all(word is None for word in named_things)
    mission = None if scenario is None else lib.load_scenario(scenario)
    choice = choose_vehicle(robot.vehicle, None if mission is None else (mission.name, mission.vehicle))
    word, vehicle = choice.word, lib.load_vehicle(choice.word)
    fastest = None if cruise is None else max(cruise)
    speeds = _speeds(fastest, cap, scenario)
    chosen_law, about_law = choose_law(law, [vehicle])
    source, sensed = lib.law_source(chosen_law), choose_sensing(robot.sensing, chosen_law)
    tuned = choose_gains(gains, vehicle, cruise=speeds[0], own=source.gains)
    values = tuned.gains.values
    # a gain of a law of one's own may have the name of a number in a claim
    at_hand = {n: v for n, v in values.items() if n not in source.gains} | {"speed": speeds[0], "speed_max": speeds[1]}
    about = None if law is None or lib.PATH_FOLLOWING in source.parts else lib.label(chosen_law)
    kinds: dict[Any, list[str]] = {claims.is_region: [], claims.is_mission: [], claims.is_braking: [], None: []}
    for one in words:
        kinds[next((kind for kind in kinds if kind is not None and kind(one)), None)].append(one)
    regions, missions, braking, named = kinds.values()
    chosen, left_out = claims.library_claims(named, at_hand, vehicle, law=about) if named or not words else ([], [])
    if stated.show:
        _show(chosen, regions, [*missions, *braking], left_out, as_json=as_json)
    lib.check_held(cruise or (), vehicle, cap=speeds[1], key="--cruise")
    if out is not None:
        prepare_out(out)
    claims.require_own_speeds(regions, fastest, cap)
    scenarios = () if mission is None else (replace(mission, cruise=speeds[0], cap=speeds[1]),)
    judging: dict[str, Any] = {"barrier": robot.barrier, "movers": robot.movers, "sensing": sensed}
    judging |= {"uncertainty": uncertainty or None, "scenarios": scenarios}
    whole = lib.Mission(vehicle, tuned.gains, *speeds, chosen_law, **judging)
    of_regions, instead = claims.region_claims(regions, whole, seed=seed, out=out)
    of_missions = claims.mission_claims(missions, mission, whole, seed=seed, out=out)
    of_braking = claims.braking_claims(braking, whole, out=out)
    limit = time_limit or _SHORT
    every = [
        *(Claimed(c.name, partial(claims.decide_claim, c, seed=seed, time_limit=limit, out=out)) for c in chosen),
        *(refused(one, counts=bool(named)) for one in left_out),
        *of_regions, *of_missions, *of_braking,
    ]  # fmt: skip
    cascaded = lib.PATH_FOLLOWING in source.parts
    subjects = [] if alone else [replace(whole, cruise=u) for u in cruise or speeds[:1]]
    # the speeds but the largest concern the loop alone
    assessed = [
        lib.assess(one, parts=["loop"] if one is not subjects[-1] else ["loop", "no contact"]) for one in subjects
    ]
    parts = [linear_part(*each) for each in zip(assessed, subjects, strict=True)]
    linear = over_speeds(parts) if parts else LinearPart([], {}, None, speeds[0])
    judged = [line for one in assessed for line in one.lines if line.about]
    contacts = assessed[-1].sources.get("no contact") if assessed else None
    safety = contacts[0] if contacts and cascaded else None
    done = decide_claims(every, "for the other claims: surctl verify CLAIM", out=out, as_json=as_json)
    verdicts = [one.proof for one in done[: len(chosen)]]
    lines = [line for one in done for line in one.lines]
    result: dict[str, Any] = {"vehicle": vehicle.name, "vehicle_from": choice.origin}
    result = {"claims": [one.data for one in done]} if alone else result | {"claims": [one.data for one in done]}
    margins_at = None
    if not alone:
        lines.append(f"at cruise speed {speeds[0]:g} m/s and cap {speeds[1]:g} m/s, {choice.line(vehicle.name)}:")
        lines += [*about_law, *tuned.lines, *(f"{line.mark} {line.text}" for line in judged), *linear.lines]
        held, held_data = list[str](), dict[str, float]()
        if linear.stable is not None and cascaded:
            margins_at = cruise or speeds[:1]
            held, held_data = speed_lines(subjects[-1], short=linear.short)
        lines += [*held, f"not assessed: {', '.join(assessed[-1].omitted)} (surctl study assesses all)"]
        result |= {
            "derived_gains": tuned.data, "uncertainty": uncertainty, "cruise_m_per_s": speeds[0],
            "cap_m_per_s": speeds[1], "speeds_m_per_s": held_data, **linear.data,
            "assessment": assessed[-1].to_dict(),
        }  # fmt: skip
    beside = list[str]()
    certificates = [file for one in done for file in one.files]
    if out is not None:
        result["pictures"] = _draw(done, verdicts, vehicle, tuned.gains, out, cruise=margins_at, law=chosen_law)
        lines.append(f"certificates: {len(certificates)}, pictures: {len(result['pictures'])}, in {out}")
    if safety is not None:
        judges = not isinstance(safety, lib.Inapplicable)
        lines += safety.lines() if judges else [f"no contact: {safety.sentence}"]
        lost = [v.claim.name for v in verdicts if v.verdict == "refuted" and judges and safety.holds]
        beside = [f"no contact does not rest on {n}: {lib.NOT_RESTED_ON[n]}" for n in lost if n in lib.NOT_RESTED_ON]
        lines += beside
        result["safety"] = safety.to_dict()
    failing = [line.text for line in judged if line.rank == 0]
    failed, failures = failed_lines(done, failing)
    lines += failed or ([] if alone else ["accepted"])
    then = next_check(done, out)
    if not failures and (not then or out is not None):
        then += _after(linear, choice, tuned, gains, scenario, certificates, whole)
    # gain `margin` that is missing, for a no-contact claim or for the proof of a braking claim
    larger = [margin_short(safety), *(getattr(one.proof, "enough", math.nan) for one in done)]
    if linear.short and cascaded:  # gains that have the margins at this speed, or else at a lower one
        derived = lib.derive_gains(vehicle, cruise=speeds[0])
        reached = speeds[0] if derived.reached else derived.bearable
        then[:0] = [derive_words(word, reached, _GAIN_FILE, barrier=robot.barrier)] if reached > 0 else []
    elif tuned.derived and (larger := list(filter(math.isfinite, larger))):
        derive = derive_words(word, speeds[0], _GAIN_FILE, margin=max(larger), barrier=robot.barrier)
        then[:0] = [derive, same_command(gains=_GAIN_FILE)]
    if instead:
        again = ["surctl", "verify", instead, *("--vehicle", word), *(("--gains", gains) if gains else ())]
        then.insert(0, shlex.join([*again, "--cruise", f"{speeds[0]:g}", "--cap", f"{speeds[1]:g}"]))
    first = len(done) - len(of_braking) - len(of_missions)
    about_missions = [one.lines[0] for one in done[first : first + len(of_missions)]]
    about_claims = [one.lines[0] for one in done if one.lines[0] not in about_missions]
    if len(about_claims) > _MOST_CLAIMS:
        good = sum(line.startswith("ok") for line in about_claims)
        counted = f"ok   {good} of {len(about_claims)} claims as expected"
        if aside := sum(line.startswith("n/a") for line in about_claims):
            mark = "ok  " if good else "n/a "
            counted = f"{mark} {good} of {len(about_claims)} claims as expected, {aside} not applicable"
        about_claims = [*(f"FAIL {one.failure}" for one in done if one.failure), counted]
    about_claims.sort(key=lambda line: not line.startswith("FAIL"))
    brief = [*about_missions, *(f"FAIL {text}" for text in failing), *about_claims]
    brief += [*(f"{line.mark} {line.text}" for line in judged if line.rank), *beside, *warnings_in(lines)]
    files = [f"certificates {out}"] if certificates else [f"pictures {out}"] if result.get("pictures") else []
    finish(
        result | failures, lines, as_json=as_json, passed=not failures, then=then, brief=brief, files=files
    )  # fmt: skip


def _show(
    chosen: Sequence[lib.Claim], regions: Sequence[str], others: Sequence[str], left_out: Sequence[lib.Inapplicable],
    *, as_json: bool,
) -> None:  # fmt: skip
    """Print claims as claim files, and end the command."""
    texts = {claim.name: lib.write_claim(claim) for claim in chosen}
    texts |= {word: lib.write_region(claims.region_of(word)) for word in regions}
    if others:
        remedy = "drop it; the claim is fixed by its vehicle, law and scenario"
        raise InputError("has no claim file", key="claim", value=others[0], remedy=remedy)
    lines = [*texts.values(), *map(refusal_line, left_out)]
    finish({"claims": texts}, lines, as_json=as_json, passed=not left_out, whole=True)


def _after(
    linear: LinearPart, choice: VehicleChoice, tuned: GainsChoice, gains: str | None, scenario: str | None,
    certificates: Sequence[Path], mission: lib.Mission,
) -> list[str]:  # fmt: skip
    """Return the commands that write the gains and export the law, if its loop is stable with its margins."""
    if not linear.stable or linear.short:
        return []
    file = gains or (_GAIN_FILE if tuned.derived else "default")
    cascaded = lib.PATH_FOLLOWING in lib.law_source(mission.law_ref).parts
    exported = export_command(
        scenario, choice.word, tuned.gains, certificates if cascaded else (), file=file, law=mission.law_ref,
        form=mission, sensing=mission.sensed if cascaded else "truth",
    )  # fmt: skip
    derive = derive_words(choice.word, linear.cruise, file, barrier=mission.barrier)
    return [*([derive] if tuned.derived else []), *exported]


def _is_claim_file(word: str) -> bool:
    return word.endswith(".toml") and Path(word).is_file() and lib.read_toml(Path(word)).get("kind") == "claim"


def _speeds(cruise: float | None, cap: float | None, scenario: str | None) -> tuple[float, float]:
    """Return the cruise speed and the speed limit [m/s] from the options or the scenario.

    The default speed limit is that of the scenario. If the cruise speed exceeds this limit, the limit is multiplied by
    (cruise speed)/(cruise speed of the scenario).
    """
    mission = lib.load_scenario(MISSION if scenario is None else scenario)
    speed = mission.cruise if cruise is None else cruise
    if cap is None:
        cap = mission.cap if mission.cap >= speed else round(speed * mission.cap / mission.cruise, 9)
    if cap < speed:
        problem = f"must not be below the cruise speed, {speed:g} m/s"
        raise InputError(problem, key="--cap", value=cap, remedy="raise it")
    return speed, cap


def _draw(
    done: Sequence[Decided],
    verdicts: Sequence[lib.Verdict],
    vehicle: lib.Vehicle,
    gains: lib.Gains,
    out: Path,
    *,
    cruise: Sequence[float] | None,
    law: str,
) -> list[str]:
    progress("pictures")
    pictures = list[Path]()
    with saving("plots"):
        pictures += lib.save_verdicts(verdicts, out)
        for one in done[len(verdicts) :]:
            document = one.data["certificate"]
            if document and document["kind"] != "braking":
                tube = document["kind"] == "mission"
                plot = lib.plot_mission(document) if tube else lib.plot_region(document)
                pictures.append(lib.save_figure(plot, out, (one.data["claim"], "tube" if tube else "levels")))
        if cruise is not None:
            pictures += lib.save_margins(lib.vehicle_law(vehicle, law), vehicle, gains, out, cruise=cruise)
    return [str(path) for path in pictures]
