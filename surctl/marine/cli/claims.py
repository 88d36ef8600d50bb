"""`surctl verify`, claims by word: region, mission, braking; line and certificate of each claim."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from surctl.cli.output import refusal_line, saving, timed
from surctl.errors import InputError, NotApplicable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from surctl.marine.control import Gains
    from surctl.marine.simulation import Scenario
    from surctl.marine.vehicle import Vehicle
    from surctl.marine.verification.region import RegionStatement
    from surctl.verification import Inapplicable, Verdict
    from surctl.verification.formula import Statement


def statement_lines(exact: Statement, certificate: Mapping[str, Any] | None) -> list[str]:
    """Return the statement as the checker reads it: from the certificate, if there is one."""
    from surctl.verification.formula import text_of
    from surctl.verification.formula.parser import clipped

    left, right, *constraints = map(text_of, exact.parts)
    ends = [*zip(exact.names, exact.lower.tolist(), exact.upper.tolist(), strict=True)]
    if certificate is not None:
        claim = certificate["claim"]
        left, right, constraints = claim["left"], claim["right"], claim["constraints"]
        ends = [(v["name"], v["lower"], v["upper"]) for v in claim["variables"]]
    slack = certificate["claim"]["slack"] if certificate is not None else 0.0
    bound = f"{right} + {slack!r}" if slack else right
    where = [f"{name} in [{low!r}, {high!r}]" for name, low, high in ends] + [f"{g} <= 0" for g in constraints]
    return [f"  {clipped(left)} <= {clipped(bound)}", f"  where {clipped(', '.join(where))}"]


def _number(value: float, digits: str) -> str:
    return repr(value) if digits == "r" else f"{value:{digits}}"


def claim_line(verdict: Verdict) -> str:
    """Return one line for a verdict, with its counterexample, its slack or the reason why it is unknown."""
    counterexample, proof = verdict.counterexample, verdict.certificate
    where = ""
    if counterexample is not None:
        digits = "r" if counterexample.undefined else ".4g"  # beside a pole, every digit counts
        where = " at " + ", ".join(f"{k} = {_number(v, digits)}" for k, v in counterexample.values.items())
        where += f": {counterexample.sentence}"
    elif verdict.vacuous:
        where = f", but vacuous: {verdict.vacuous}"
    elif proof is not None and proof["claim"]["slack"]:
        where = f" to within {proof['claim']['slack']:.1g} {verdict.claim.unit}"
    elif verdict.open_ends:
        where = f": {verdict.open_ends}"
    mark = "ok  " if verdict.as_expected else "FAIL"
    return f"{mark} {verdict.claim.name:<22} {verdict.verdict}{where}"


class Proofs(NamedTuple):
    """The result of region or braking claims.

    Attributes:
        claims: plain data of each claim.
        lines: lines to print.
        files: certificate files.
        instead: name of a region claim that applies to the vehicle, if a stated one does not; "" if there is none.
    """

    claims: list[dict[str, Any]]
    lines: list[str]
    files: list[Path]
    instead: str = ""

    def joined(self, other: Proofs) -> Proofs:
        """Return these results, followed by others."""
        return Proofs(self.claims + other.claims, self.lines + other.lines, self.files + other.files, self.instead)


def _proofs(todo: Sequence[tuple[str, Callable[[], Any]]], refused: Sequence[Inapplicable], out: Path | None) -> Proofs:
    """Prove claims, each with its name and function, and write the certificates to `out` as NAME.json."""
    proofs, files = [], []
    for name, prove in todo:
        with timed(name):
            proof = prove()
        proofs.append(proof)
        if out is not None and proof.verdict == "proved":
            with saving(f"certificate of {name}"):
                out.mkdir(parents=True, exist_ok=True)
                file = out / f"{name}.json"
                proof.write(file)
                files.append(file)
    marks = ["FAIL" if p.verdict != "proved" else "ok  " if getattr(p, "useful", True) else "open" for p in proofs]
    lines = [f"{mark} {p.claim.name:<22} {p.sentence}" for mark, p in zip(marks, proofs, strict=True)]
    lines += [refusal_line(one) for one in refused]
    return Proofs([*(p.to_dict() for p in proofs), *(one.to_dict() for one in refused)], lines, files)


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
    words: Sequence[str], vehicle: Vehicle, gains: Gains, speeds: tuple[float, float], law: str
) -> tuple[dict[str, RegionStatement], dict[str, Inapplicable]]:
    """Return the region claims by word, and those that do not apply to the vehicle with their reason; proves nothing.

    Args:
        words: names and files of the claims.
        vehicle: the vehicle.
        gains: the gains.
        speeds: (cruise speed, speed limit) [m/s] for claims whose text does not set these speeds.
        law: reference of the law.

    Raises:
        InputError: a claim is unknown or has a mistake.
    """
    from surctl.verification import Inapplicable

    cruise, cap = speeds
    stated = {word: region_of(word) for word in words}
    refused: dict[str, Inapplicable] = {}
    for word, statement in stated.items():
        try:
            statement.claim(vehicle, gains, cruise=cruise, cap=cap)
            statement.require(law)
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
    law: str,
    speeds: tuple[float, float],
    seed: int = 0,
    out: Path | None = None,
    forms: Mapping[str, Any] | None = None,
) -> Proofs:
    """Prove region claims for a vehicle and a gain file; the certificates are written to `out` as NAME.json.

    Args:
        words: names and files of the claims.
        vehicle: name or file of the vehicle.
        gains: name or file of the gains, or the gains.
        law: reference of the law.
        speeds: (cruise speed, speed limit) [m/s] for claims whose text does not set these speeds.
        seed: seed of the search for a certificate.
        out: folder of the certificates.
        forms: `barrier` and `movers` of the law.

    Raises:
        InputError: a claim, vehicle or gain file is unknown; the error is raised before the first proof.
    """
    from surctl.marine.control import load_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.region import RegionStatement, applicable_region, prove_statement

    robot = load_vehicle(vehicle)
    values = load_gains(gains) if isinstance(gains, str) else gains
    cruise, cap = speeds
    stated, refused = check_regions(words, robot, values, speeds, law)
    todo = [
        (one.name, partial(prove_statement, one, robot, values, seed=seed, cruise=cruise, cap=cap, forms=forms))
        for word, one in stated.items()
        if word not in refused
    ]
    result = _proofs(todo, list(refused.values()), out)
    known = {statement.name for statement in stated.values()}
    others = [name for name in ("region-turning-20", "region-steered-20") if name not in known]
    instead = applicable_region(others, robot, values, law=law, cruise=cruise, cap=cap) if refused and others else None
    return result._replace(instead=instead.name if isinstance(instead, RegionStatement) else "")


def is_mission(word: str) -> bool:
    """Return whether a word denotes the claim about the mission of the scenario: `mission` or `mission:REGION`."""
    return word.partition(":")[0] == "mission"


def prove_missions(
    words: Sequence[str], scenario: Scenario | None, *, vehicle: str, gains: Gains, law: str,
    speeds: tuple[float, float], seed: int = 0, out: Path | None = None,
) -> Proofs:  # fmt: skip
    """Prove the claim about the mission of a scenario, with the region claim that a word names for each leg.

    If the claim is not proved, its line begins with the largest lower cruise speed at which it is proved.

    Raises:
        InputError: no scenario is given, or a region claim is unknown.
    """
    if not words:
        return Proofs([], [], [])
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.mission import USUAL, prove_scenario, slower
    from surctl.marine.verification.region import region_statement
    from surctl.verification import Inapplicable

    if scenario is None:
        remedy = "add --scenario NAME or FILE"
        raise InputError("is about the path of a scenario", key="claim", value=words[0], remedy=remedy)
    if len(words) > 1:
        raise InputError("is a second claim about the mission", key="claim", value=words[1], remedy="drop one of them")
    [word], robot, (cruise, cap) = words, load_vehicle(vehicle), speeds
    region = word.partition(":")[2]
    statement = region_of(region) if region else region_statement(USUAL)
    about = (scenario, robot, gains, statement)
    refused, proofs = list[Inapplicable](), Proofs([], [], [])
    try:
        statement.require(law)
        with timed(word):
            proof = prove_scenario(*about, cruise=cruise, cap=cap, seed=seed)
        proofs = _proofs([(proof.claim.name, lambda: proof)], [], out)
    except NotApplicable as reason:
        refused = [Inapplicable.of(f"mission-{scenario.name}", reason)]
        proofs = _proofs([], refused, out)
    if refused[0].to != "these speeds" if refused else proof.verdict == "proved":
        return proofs
    with timed(f"{word} at lower speeds"):
        lower = slower(*about, cruise=cruise, cap=cap, seed=seed)
    proofs.claims[0]["at_lower_speed"] = None if lower is None else lower.to_dict()
    sentence = refused[0].sentence if refused else proof.sentence
    line = f"{sentence}; no lower speed is proved"
    if lower is not None:
        line = f"with --cruise {lower.claim.loop.cruise:g}, {lower.sentence}; at {cruise:g} m/s, {sentence}"
    proofs.lines[0] = proofs.lines[0].replace(sentence, line)
    return proofs


_KINDS = ("braking-rule", "braking-inertia", "braking-simple")


def is_braking(name: str) -> bool:
    """Return whether a name denotes a braking claim; False for the name of a step in the proof of a claim."""
    return name.startswith(_KINDS)


def prove_all(
    names: Sequence[str], *, vehicle: str, gains: str | Gains, law: str, cap: float, out: Path | None = None
) -> Proofs:
    """Prove the named braking claims for a vehicle, gains (or their file), a law and a speed limit `cap` [m/s].

    The claims do not apply to a law without the barrier of law `guarded`. The certificates are written to the folder
    `out` as NAME.json.

    Raises:
        InputError: a claim, vehicle or gain file is unknown; the error is raised before the first proof.
    """
    if not names:
        return Proofs([], [], [])
    from surctl.marine.control import BARRIER, law_source, load_gains
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.verification.braking import braking_claim_named, prove_braking
    from surctl.own_code import label
    from surctl.verification import Inapplicable

    robot = load_vehicle(vehicle)
    values = load_gains(gains) if isinstance(gains, str) else gains
    todo, refused = list[tuple[str, Callable[[], Any]]](), []
    for name in names:
        try:
            claim = braking_claim_named(name, robot, values, cap=cap)
            if BARRIER not in law_source(law).parts:
                raise NotApplicable("it has not the barrier of law guarded", to=f"law {label(law)}")
        except NotApplicable as reason:
            refused.append(Inapplicable.of(name, reason))
        else:
            todo.append((claim.name, partial(prove_braking, claim)))
    return _proofs(todo, refused, out)
