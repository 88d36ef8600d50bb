"""`surctl verify`, claims by word: of the library or a file, region, mission, braking; the line of each claim."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from surctl.cli.output import progress, timed
from surctl.cli.verify import Claimed, Decided, refused, written
from surctl.errors import InputError, NotApplicable, check_once
from surctl.marine.cli import lib

Claims = list[Claimed | Decided]


def statement_lines(exact: lib.Statement, certificate: Mapping[str, Any] | None) -> list[str]:
    """Return the statement as the checker reads it: from the certificate, if there is one."""
    left, right, *constraints = map(lib.text_of, exact.parts)
    ends = [*zip(exact.names, exact.lower.tolist(), exact.upper.tolist(), strict=True)]
    if certificate is not None:
        claim = certificate["claim"]
        left, right, constraints = claim["left"], claim["right"], claim["constraints"]
        ends = [(v["name"], v["lower"], v["upper"]) for v in claim["variables"]]
    slack = certificate["claim"]["slack"] if certificate is not None else 0.0
    bound = f"{right} + {slack!r}" if slack else right
    where = [f"{name} in [{low!r}, {high!r}]" for name, low, high in ends] + [f"{g} <= 0" for g in constraints]
    return [f"  {lib.clipped(left)} <= {lib.clipped(bound)}", f"  where {lib.clipped(', '.join(where))}"]


def claim_line(verdict: lib.Verdict) -> str:
    """Return one line for a verdict, with its counterexample, its slack or the reason why it is unknown."""
    counterexample, proof = verdict.counterexample, verdict.certificate
    where = ""
    if counterexample is not None:
        shown = repr if counterexample.undefined else "{:.4g}".format  # beside a pole, every digit counts
        where = " at " + ", ".join(f"{k} = {shown(v)}" for k, v in counterexample.values.items())
        where += f": {counterexample.sentence}"
    elif verdict.vacuous:
        where = f", but vacuous: {verdict.vacuous}"
    elif proof is not None and proof["claim"]["slack"]:
        where = f" to within {proof['claim']['slack']:.1g} {verdict.claim.unit}"
    elif verdict.open_ends:
        where = f": {verdict.open_ends}"
    mark = "ok  " if verdict.as_expected else "FAIL"
    return f"{mark} {verdict.claim.name:<22} {verdict.verdict}{where}"


def library_claims(
    words: Sequence[str],
    gains: Mapping[str, Any],
    vehicle: lib.Vehicle,
    *,
    law: str | None = None,
) -> tuple[list[lib.Claim], list[lib.Inapplicable]]:
    """Return the claims by name or file, or those of the library without any, and those that do not apply.

    The claims of the library do not concern the law `law`, if it is given.

    Raises:
        InputError: a claim is unknown, has a mistake or is given twice.
    """
    if law and not words:
        return [], []
    own = {word: lib.load_claim(Path(word)) for word in words if word.endswith(".toml")}
    names = [w for w in dict.fromkeys(words) if w not in own] if words else None
    errata = lib.has_tuned(vehicle)  # where the paper errs concerns its own robot
    rest, reasons = lib.applicable_claims(gains, names, vehicle=vehicle, errata=errata)
    if law is not None:
        why = "it follows no path by equations (8)-(12)"
        reasons = {claim.name: NotApplicable(why, to=f"law {law}", key=claim.name) for claim in rest} | dict(reasons)
        rest = ()
    known = {claim.name: claim for claim in rest}
    chosen = [own[w] if w in own else known[w] for w in words or known if w not in reasons]
    check_once((c.name for c in chosen), "is given twice", key="claim", remedy="rename or drop one of them")
    return chosen, [lib.Inapplicable.of(name, reason) for name, reason in reasons.items()]


def decide_claim(claim: lib.Claim, *, seed: int, time_limit: float, out: Path | None) -> Decided:
    """Decide a claim of the library or of a file, and write its certificate."""
    verdict = lib.decide(claim, seed=seed, time_limit=time_limit, progress=progress)
    data, certificate, files = verdict.to_dict(), verdict.certificate, list[Path]()
    if certificate is not None:
        files = [] if out is None else written(claim.name, certificate, out)
        data["certificate"]["file"] = str(files[0]) if files else None
    lines = [claim_line(verdict), *([] if claim.exact is None else statement_lines(claim.exact, certificate))]
    failure = "" if verdict.as_expected else f"{claim.name} is {verdict.verdict}, not {claim.expected}"
    return Decided(data, lines, files, failure, verdict)


def _proved(prove: Callable[[], Any], out: Path | None) -> Decided:
    """Prove a region, mission or braking claim, and write its certificate."""
    proof = prove()
    name, proved = proof.claim.name, proof.verdict == "proved"
    mark = "FAIL" if not proved else "ok  " if getattr(proof, "useful", True) else "open"
    files = written(name, proof.document, out) if proved and out is not None else []
    failure = "" if proved else f"{name} is {proof.verdict}"
    return Decided(proof.to_dict(), [f"{mark} {name:<22} {proof.sentence}"], files, failure, proof)


def is_region(word: str) -> bool:
    """Return whether a word is the name of a region claim or a file of kind region.

    Raises:
        InputError: the file cannot be read.
    """
    if word.endswith(".toml"):
        return bool(lib.read_toml(Path(word)).get("kind") == "region")
    return word.startswith("region-")


def region_of(word: str) -> lib.RegionStatement:
    """Return the region claim with the given name or file.

    Raises:
        InputError: the claim is unknown, or the file is not a region claim.
    """
    return lib.load_region(Path(word)) if word.endswith(".toml") else lib.region_statement(word)


def require_own_speeds(words: Sequence[str], cruise: float | None, cap: float | None) -> None:
    """Raise InputError if an option sets another speed than the one that a region claim states.

    Args:
        words: names and files of the claims.
        cruise: cruise speed of the option [m/s]; None if it is not set.
        cap: speed limit of the option [m/s]; None if it is not set.
    """
    for word in words:
        statement = region_of(word)
        stated = {"cruise_m_per_s", "cap_m_per_s"} & statement.model_fields_set
        for key, option in (("cruise_m_per_s", cruise), ("cap_m_per_s", cap)):
            value = getattr(statement, key)
            if stated and option is not None and option != value:
                name = f"--{key.partition('_')[0]}"
                problem = f"is not the speed of the region claim, which is proved at {value:g} m/s"
                raise InputError(problem, file=word, key=name, value=option, remedy=f"drop {name}, or change the claim")


def region_claims(
    words: Sequence[str], mission: lib.Mission, *, seed: int = 0, out: Path | None = None
) -> tuple[Claims, str]:
    """Return region claims to decide, and the name of one that applies to the vehicle if a stated one does not, or "".

    Args:
        words: names and files of the claims.
        mission: the vehicle with its law, and its speeds for claims whose text does not set these.
        seed: seed of the search for a certificate.
        out: folder of the certificates.

    Raises:
        InputError: a claim is unknown or has a mistake.
    """
    vehicle, gains, law = mission.vehicle, mission.gains, mission.law_ref
    about: dict[str, Any] = {"cruise": mission.cruise, "cap": mission.cap}
    forms = {"barrier": mission.barrier, "movers": mission.movers}
    claims, names, others = list[Claimed](), set[str](), list[Decided]()
    for word in words:
        one = region_of(word)
        names.add(one.name)
        try:
            one.claim(vehicle, gains, **about)
            one.require(law)
        except NotApplicable as reason:
            others.append(refused(lib.Inapplicable.of(one.name, reason)))
        except InputError as error:
            raise (error.inside(word) if word.endswith(".toml") and not error.file else error) from None
        else:
            prove = partial(lib.prove_statement, one, vehicle, gains, seed=seed, forms=forms, **about)
            claims.append(Claimed(one.name, partial(_proved, prove, out)))
    usual = [name for name in ("region-turning-20", "region-steered-20") if name not in names]
    instead = lib.applicable_region(usual, vehicle, gains, law=law, **about) if others and usual else None
    return [*claims, *others], instead.name if isinstance(instead, lib.RegionStatement) else ""


def is_mission(word: str) -> bool:
    """Return whether a word denotes the claim about the mission of the scenario: `mission` or `mission:REGION`."""
    return word.partition(":")[0] == "mission"


def mission_claims(
    words: Sequence[str], scenario: lib.Scenario | None, mission: lib.Mission, *, seed: int = 0, out: Path | None = None
) -> Claims:
    """Return the claim about the mission of a scenario, with the region claim that a word names for each leg.

    If the claim is not proved, its line begins with the largest lower cruise speed at which it is proved.

    Raises:
        InputError: no scenario is given, or a region claim is unknown.
    """
    if not words:
        return []
    if scenario is None:
        remedy = "add --scenario NAME or FILE"
        raise InputError("is about the path of a scenario", key="claim", value=words[0], remedy=remedy)
    if len(words) > 1:
        raise InputError("is a second claim about the mission", key="claim", value=words[1], remedy="drop one of them")
    [word] = words
    speeds: dict[str, Any] = {"cruise": mission.cruise, "cap": mission.cap}
    region = word.partition(":")[2]
    statement = region_of(region) if region else lib.region_statement(lib.USUAL)
    about = (scenario, mission.vehicle, mission.gains, statement)

    def decided() -> Decided:
        try:
            statement.require(mission.law_ref)
            done = _proved(partial(lib.prove_scenario, *about, **speeds, seed=seed), out)
            sentence, final = done.proof.sentence, not done.failure
        except NotApplicable as reason:
            one = lib.Inapplicable.of(f"mission-{scenario.name}", reason)
            done, sentence, final = refused(one), one.sentence, one.to != "these speeds"
        if final:
            return done
        with timed(f"{word} at lower speeds"):
            lower = lib.slower(*about, **speeds, seed=seed)
        line = f"{sentence}; no lower speed is proved"
        if lower is not None:
            line = f"with --cruise {lower.claim.loop.cruise:g}, {lower.sentence}; at {mission.cruise:g} m/s, {sentence}"
        lines = [done.lines[0].replace(sentence, line)]
        return done._replace(data={**done.data, "at_lower_speed": lower and lower.to_dict()}, lines=lines)

    return [Claimed(word, decided)]


_KINDS = ("braking-rule", "braking-inertia", "braking-simple")


def is_braking(name: str) -> bool:
    """Return whether a name denotes a braking claim; False for the name of a step in the proof of a claim."""
    return name.startswith(_KINDS)


def braking_claims(names: Sequence[str], mission: lib.Mission, *, out: Path | None = None) -> Claims:
    """Return the named braking claims for the vehicle, gains, law and speed limit of a mission.

    The claims do not apply to a law without the barrier of law `guarded`.

    Raises:
        InputError: a claim is unknown.
    """
    if not names:
        return []
    claims, others = list[Claimed](), list[Decided]()
    for name in names:
        try:
            claim = lib.braking_claim_named(name, mission.vehicle, mission.gains, cap=mission.cap)
            if lib.BARRIER not in lib.law_source(mission.law_ref).parts:
                raise NotApplicable("it has not the barrier of law guarded", to=f"law {lib.label(mission.law_ref)}")
        except NotApplicable as reason:
            others.append(refused(lib.Inapplicable.of(name, reason)))
        else:
            claims.append(Claimed(claim.name, partial(_proved, partial(lib.prove_braking, claim), out)))
    return [*claims, *others]
