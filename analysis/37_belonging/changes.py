"""Single changes of a certificate or a bundle after which the two no longer belong together."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import os
import random
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pairs import Pair, blocks
from points import vectors

from surctl.certcheck import seal
from surctl.certcheck.bundle import (  # a forger writes hashes as the export does
    _gains_id,
    manifest_seal,
    numbers_sha256,
    ports_sha256,
)
from surctl.ir import Block, Program, replay
from surctl.ir.routine import changed_programs, nested

__all__ = ["KINDS", "Change", "changed"]

Table = dict[str, Any]
Leaf = tuple[tuple[Any, ...], Any]

EXACT = {
    "region": ("law",), "turning": ("law",), "braking": ("law",), "interval": ("",),
    "lyapunov": ("about", "dynamics"), "barrier": ("about", "dynamics"),
}  # fmt: skip
"""Parts of a claim in which each number must be exactly that of the bundle; "" is the whole claim."""

LARGER = ("force_n", "thrust_n", "brake_n", "moment_nm", "munk_moment_nm", "side_per_m", "limit_n")
"""Bounds that the bundle must reach: a larger one does not hold for it."""

NEUTRAL = ("slack",)


@dataclass(frozen=True)
class Change:
    """A changed certificate, and a function that changes the folder of the bundle."""

    kind: str
    what: str
    certificate: Mapping[str, Any]
    apply: Callable[[Path], None] = lambda folder: None


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[Leaf]:
    """Yield path and value of every number and text of a table."""
    if isinstance(value, dict | list) and value:
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(entry, (*path, key))
    else:
        yield path, value


def put(table: Any, path: tuple[Any, ...], value: Any) -> None:
    """Replace the entry at a path."""
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value


def off(number: float, draw: random.Random) -> float:
    """Return another number: by a share of 1e-6 to 1, in its sign, or instead of 0."""
    if not number:
        return draw.choice((1e-6, 1.0, -1.0))
    share = 10 ** draw.uniform(-6, 0)
    return draw.choice((number * (1 + share), number * (1 - share), -number, math.nextafter(number, math.inf)))


def sealed(pair: Pair, claim: Table) -> Mapping[str, Any]:
    """Return the certificate with another claim, sealed again."""
    known = ("format", "version", "kind", "claim", "sha256")
    return seal(pair.certificate["kind"], claim, {k: v for k, v in pair.certificate.items() if k not in known})


# ---- the certificate


def own_loop(claim: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return what a claim about a system of one's own states of the loop; None for other claims."""
    about: Mapping[str, Any] = claim.get("about") or {}
    return about if "plant" in about else None


def is_label(claim: Mapping[str, Any], path: tuple[Any, ...]) -> bool:
    """Return whether a text is printed as a label that nothing is compared with."""
    return path == ("name",) and bool(claim.get("about")) and own_loop(claim) is None


def text_of_dynamics(pair: Pair, draw: random.Random) -> Change | None:
    """A number in a text of the dynamics, or a narrow bump beside it, sealed again."""
    claim = copy.deepcopy(pair.certificate["claim"])
    if not claim.get("about"):
        return None
    name = draw.choice(sorted(claim["dynamics"]))
    text = claim["dynamics"][name]
    numbers = list(re.finditer(r"(?<![\w.^])\d+(\.\d+)?(?![\w.])", text))
    if numbers and draw.random() < 0.5:
        place = draw.choice(numbers)
        new = f"{text[: place.start()]}{off(float(place.group()), draw)!r}{text[place.end() :]}"
        new = new.replace("--", "+")
    else:
        row = draw.choice(claim["states"])
        centre, width = draw.uniform(row["lower"], row["upper"]), 10 ** draw.uniform(-9, -3)
        new = f"{text} + {10 ** draw.uniform(-12, -3)!r}*max(0, 1 - abs({row['name']} - ({centre!r}))/{width!r})"
    claim["dynamics"][name] = new
    return Change("number or bump in the dynamics", f"{name}: {new[:60]}", sealed(pair, claim))


def claim_number(pair: Pair, draw: random.Random) -> Change | None:
    """A number of the claim that the bundle states, sealed again."""
    claim, kind = copy.deepcopy(pair.certificate["claim"]), pair.certificate["kind"]
    found = [
        (path, value) for path, value in leaves(claim)
        if isinstance(value, int | float) and not isinstance(value, bool) and path[-1] not in NEUTRAL
        and (EXACT[kind] == ("",) or path[0] in EXACT[kind])
    ]  # fmt: skip
    if not found:
        return None
    path, value = draw.choice(found)
    new = off(float(value), draw)
    if path[-1] in ("thrust_n", "limit_n"):
        new = abs(value) * 1.1 + 1e3
    if path[-1] == "cap_m_per_s":
        new = abs(value) * 0.5  # the law may be faster
    if path == ("law", "period_s"):
        new = 0.31
    if path == ("law", "gain") and abs(new - value) < 1e-8 * abs(value):
        new = 2 * value  # the bundle states it only as a constant of the law, which is compared at points, to 1e-9
    put(claim, path, new)
    return Change("number of the claim", f"{path} {value!r} -> {new!r}", sealed(pair, claim))


def vehicle_bound(pair: Pair, draw: random.Random) -> Change | None:
    """A bound or range of the claim that no longer contains the vehicle, sealed again."""
    claim = copy.deepcopy(pair.certificate["claim"])
    vehicle = claim.get("vehicle", {})
    choices = [
        key for key in ("mass_kg", "linear_drag", "quadratic_drag", "mass_factor", "drag_factor") if key in vehicle
    ]
    choices += [key for key in ("thrust_n", "brake_n", "munk_moment_nm") if key in vehicle]
    if not choices:
        return None
    key = draw.choice(choices)
    old = vehicle[key]
    if key in ("mass_kg", "linear_drag", "quadratic_drag", "mass_factor", "drag_factor") and old[1]:
        ends = [float(old[1]) * 1.3, float(old[1]) * 1.4] if draw.random() < 0.5 else [1e-4 * end for end in old]
        vehicle[key] = ends
    else:
        vehicle[key] = [end + 1e4 for end in old] if isinstance(old, list) else old + 1e4
    return Change("bound of the claim", f"{key} {old} -> {vehicle[key]}", sealed(pair, claim))


def claim_text(pair: Pair, draw: random.Random) -> Change:
    """A text, a name or a unit of the claim, sealed again."""
    claim = copy.deepcopy(pair.certificate["claim"])
    found = [(path, value) for path, value in leaves(claim)
             if isinstance(value, str) and path[0] not in _PROVED and not is_label(claim, path)]  # fmt: skip
    path, value = draw.choice(found)
    new = draw.choice((value + "x", value[1:], "x", value.upper() if value.upper() != value else "y"))
    put(claim, path, new)
    return Change("text or unit of the claim", f"{path} {value[:30]!r} -> {new[:30]!r}", sealed(pair, claim))


_PROVED = ("function", "multiplier", "initial", "unsafe", "equilibrium", "property", "time")


def claim_entry(pair: Pair, draw: random.Random) -> Change:
    """An entry of the claim more or less, sealed again."""
    claim = copy.deepcopy(pair.certificate["claim"])
    parts = [((), claim)] + [((k,), v) for k, v in claim.items() if isinstance(v, dict) and v and k not in _PROVED]
    path, part = draw.choice(parts)
    if draw.random() < 0.5:
        part["more"] = draw.choice((1.0, "text", [], {}, None, True))
        return Change("entry of the claim", f"{path} + more", sealed(pair, claim))
    key = draw.choice([key for key in part if key not in _PROVED])
    del part[key]
    return Change("entry of the claim", f"{path} - {key}", sealed(pair, claim))


def unsealed(pair: Pair, draw: random.Random) -> Change:
    """Any number or text of the certificate, not sealed again."""
    document = copy.deepcopy(dict(pair.certificate))
    found = [leaf for leaf in leaves(document) if isinstance(leaf[1], str | float | int) and leaf[0] != ("kind",)]
    path, value = draw.choice(found)
    put(document, path, value + "0" if isinstance(value, str) else value + 1)
    return Change("certificate, not sealed", str(path), document)


def other_hash(pair: Pair, draw: random.Random) -> Change | None:
    """The digest of another law or vehicle, sealed again."""
    claim = copy.deepcopy(pair.certificate["claim"])
    keys = [key for key in ("sha256_law", "sha256_vehicle") if key in claim]
    where = (claim, draw.choice(keys)) if keys else None
    if claim.get("about"):
        own = own_loop(claim) is not None
        where = (claim["about"], draw.choice(("plant", "controller") if own else ("sha256_law", "sha256_vehicle")))
    if where is None:
        return None
    table, key = where
    digits = list(table[key])
    at = draw.randrange(len(digits))
    digits[at] = "0" if digits[at] != "0" else "1"
    table[key] = "".join(digits) if draw.random() < 0.7 else "0" * len(digits)
    return Change("digest of the claim", key, sealed(pair, claim))


# ---- the bundle


def rewritten(change: Callable[[Table, Path], None], *, dependents: bool) -> Callable[[Path], None]:
    """Return a change of the manifest, after which the seal, or all that depends on it, is computed again."""

    def apply(folder: Path) -> None:
        path = folder / "manifest.json"
        table = json.loads(path.read_text(encoding="utf-8"))
        change(table, folder)
        if dependents:
            sealed_again(table, folder)
        path.write_text(json.dumps(table, indent=2), encoding="utf-8")

    return apply


def sealed_again(table: Table, folder: Path) -> None:
    """Compute every hash of a manifest again, also those in the C source, as somebody who forges a bundle can."""
    values = [float(v) for row in table["gains"]["values"] for v in row["values"]]
    law, old = table["law"], table["id"]
    ports = ports_sha256(table["lists"]["law.txt"])
    parts = (law["sha256"], ports, float(table["dt_s"]).hex(), table["real"], law["initial_state_sha256"])
    table["gains"]["sha256"] = numbers_sha256(values)
    table["gains"]["id"] = _gains_id(parts, values, table["real"])
    table["id"] = hashlib.sha256("\n".join((*parts, numbers_sha256(values))).encode()).hexdigest()
    if "vehicle" in table:
        text = json.dumps(table["vehicle"]["values"], sort_keys=True) + table["vehicle"].get("thrusters", "")
        table["vehicle"]["sha256"] = hashlib.sha256(text.encode()).hexdigest()
    source = folder / f"{table['name']}.c"
    source.write_text(source.read_text().replace(old, table["id"]))
    for name in table["sha256"]:
        if (folder / name).is_file():
            table["sha256"][name] = hashlib.sha256((folder / name).read_bytes()).hexdigest()
    table["seal"] = manifest_seal(table)


def manifest_leaf(pair: Pair, draw: random.Random) -> Change:
    """Any number or text of the manifest, not sealed again."""
    choice = draw.random()

    def change(table: Table, _: Path) -> None:
        found = list(leaves({k: v for k, v in table.items() if k != "seal"}))
        path, value = found[int(choice * len(found))]
        new = not value if isinstance(value, bool) else value + 1 if isinstance(value, int | float) else f"{value}0"
        put(table, path, new)

    return Change("manifest, not sealed", f"{choice:.4f}", pair.certificate, rewritten(change, dependents=False))


def manifest_gain(pair: Pair, draw: random.Random) -> Change | None:
    """A gain of the bundle that the certificate states, with every hash computed again."""
    names = stated_gains(pair)
    if not names:
        return None
    name, share = draw.choice(names), draw.random()

    def change(table: Table, _: Path) -> None:
        row = next(row for row in table["gains"]["values"] if row["name"] == name)
        at = {"mass": 0, "linear_drag": 0, "quadratic_drag": 0}.get(name, int(share * len(row["values"])))
        row["values"][at] = off(row["values"][at], draw)

    return Change("gain of the bundle", name, pair.certificate, rewritten(change, dependents=True))


def stated_gains(pair: Pair) -> list[str]:
    """Return the names of the gains that the certificate states."""
    claim = pair.certificate["claim"]
    if own := own_loop(claim):
        return [name for name, row in own["gains"].items() if not any(isinstance(v, str) for v in row)]
    kinds = {
        "region": "k1 lookahead k_v k_i wait cruise cap mass linear_drag quadratic_drag",
        "braking": "margin reaction brake k_v k_i mass stopping",
        "interval": "",
        "lyapunov": "k_psi k_r lookahead crab_time sideslip munk",
    }
    kinds["turning"] = kinds["region"]
    return kinds[pair.certificate["kind"]].split()


def manifest_vehicle(pair: Pair, draw: random.Random) -> Change | None:
    """A parameter of the vehicle, or of the plant, outside of what is certified, with every hash computed again."""
    claim, share = copy.deepcopy(dict(pair.certificate["claim"])), draw.choice((0.3, 3.0))
    if own := own_loop(claim):
        fixed = [k for k, value in enumerate(own["parameters"]) if not isinstance(value, str)]
        if not fixed:
            return None
        at = draw.choice(fixed)

        def plant(table: Table, _: Path) -> None:
            table["lists"]["plant.txt"]["values"][at] *= share

        return Change("parameter of the plant", str(at), pair.certificate, rewritten(plant, dependents=True))
    if pair.certificate["kind"] in ("interval", "lyapunov"):
        return None
    name = draw.choice(("m22", "Yvv", "period"))
    if name == "Yvv" and pair.certificate["kind"] == "braking" and share < 1:
        share = 3.0

    def change(table: Table, _: Path) -> None:
        if name == "period" and "sha256_law" in claim:
            table["vehicle"]["values"]["m11"] *= share
        else:
            table["vehicle"]["values"][name] *= share

    def forged(folder: Path) -> None:
        rewritten(change, dependents=True)(folder)

    text = json.dumps({k: v * share if k == (name if name != "period" else "m11") else v
                       for k, v in json.loads(pair.bundle.files["manifest.json"])["vehicle"]["values"].items()},
                      sort_keys=True)  # fmt: skip
    text += json.loads(pair.bundle.files["manifest.json"])["vehicle"].get("thrusters", "")
    claim["sha256_vehicle"] = hashlib.sha256(text.encode()).hexdigest()
    return Change("parameter of the vehicle", name, sealed(pair, claim), forged)


def law_list(pair: Pair, draw: random.Random) -> Change | None:
    """An instruction or constant of the law, with every hash of bundle and certificate computed again."""
    claim = copy.deepcopy(dict(pair.certificate["claim"]))
    if not ("sha256_law" in claim or own_loop(claim)):
        return None
    certified = claim.get("sha256_law") or claim["about"]["controller"]
    manifest = json.loads(pair.bundle.files["manifest.json"])
    file = next(name for name, entry in manifest["lists"].items() if entry["sha256"] == certified)
    law = blocks()[certified]
    for _ in range(20):
        changed_law = mutated(law, draw)
        if changed_law is not None and differs_where_claimed(pair, file, (law, changed_law)):
            break
    else:
        return None
    other, fresh = changed_law.text(), changed_law.digest()
    if "sha256_law" in claim:
        claim["sha256_law"] = fresh
    else:
        claim["about"]["controller"] = fresh

    def change(table: Table, folder: Path) -> None:
        (folder / file).write_text(other)
        table["lists"][file]["sha256"] = fresh
        for key in ("sha256", "ground_truth_sha256"):
            if table["law"][key] == certified:
                table["law"][key] = fresh

    return Change("instruction of the law", file, sealed(pair, claim), rewritten(change, dependents=True))


def mutated(law: Block, draw: random.Random) -> Block | None:
    """Return the law with one instruction changed, wherever its program is called."""
    programs = [block for block in nested(law).values() if isinstance(block, Program)]
    (chosen,) = draw.choices(programs, [len(program.instructions) for program in programs])
    at = draw.randrange(len(chosen.instructions))
    old = chosen.instructions[at]
    if old.op == "const":
        new = replace(old, value=off(old.number, draw))
    elif old.op in _SWAPS:
        new = replace(old, op=_SWAPS[old.op])
    elif old.op == "select":
        new = replace(old, args=(old.args[0], old.args[2], old.args[1]))
    else:
        return None
    listed = (*chosen.instructions[:at], new, *chosen.instructions[at + 1 :])
    return changed_programs(
        law, lambda program: replace(program, instructions=listed) if program is chosen else program
    )


_SWAPS = {"add": "sub", "sub": "add", "mul": "add", "fmin": "fmax", "fmax": "fmin", "lt": "le"}


def differs_where_claimed(pair: Pair, file: str, laws: tuple[Block, Block]) -> bool:
    """Return whether the changed law commands something else at points of the claim, drawn here independently."""
    x, u, p = vectors(pair, file)
    one, two = (replay(law, x, u, p) for law in laws)
    if pair.certificate["kind"] == "braking":  # a bound: only a law that brakes less breaks it
        psi, nu = u[:, 3], u[:, 4:6]
        before, after, own = (np.cos(psi) * v[:, 0] - np.sin(psi) * v[:, 1] for v in (one[3], two[3], nu))
        brakes = before < own - 1e-3
        return bool((after > before + 1e-6)[brakes].mean() > 0.05)
    compared = {"region": slice(0, 2), "turning": slice(0, 2)}
    first, second = (result[0][..., compared.get(pair.certificate["kind"], slice(None))] for result in (one, two))
    share = np.abs(first - second) > 1e-6 * np.abs(first).max()
    return bool(share.any(axis=-1).mean() > 0.05) and bool(np.isfinite(second).all())


def port(pair: Pair, draw: random.Random) -> Change | None:
    """A name, size or unit of a vector that the comparison uses, with every hash computed again."""
    if pair.certificate["kind"] == "interval" or is_label(pair.certificate["claim"], ("name",)):
        return None
    robots = {
        "region": "eta nu progress tau",
        "braking": "eta nu contacts nu_reference",
    }
    robots["turning"] = robots["region"]
    kind, draw_ = pair.certificate["kind"], draw.random()

    def change(table: Table, _: Path) -> None:
        names = robots.get(kind, "").split()
        for file, entry in table["lists"].items():
            for vector, rows in entry.items():
                for k, row in enumerate(rows if isinstance(rows, list) else ()):
                    if not isinstance(row, str):
                        continue
                    name, unit = row.split("[")[0], row.split("] ")[1]
                    used = (
                        name in names if names else vector in ("state", "inputs") and file in ("law.txt", "plant.txt")
                    )
                    if used and (kind in robots or vector == "state" or file == "law.txt"):
                        as_unit = draw_ < 0.5 and (kind in robots or vector == "state")
                        swap = row.replace(f"] {unit}", "] km") if as_unit else row.replace(f"{name}[", f"{name}_[")
                        entry[vector][k] = swap

    return Change("name or unit of a vector", f"{draw_:.2f}", pair.certificate, rewritten(change, dependents=True))


def wrong_type(pair: Pair, draw: random.Random) -> Change:
    """NaN, infinity, a truth value or a text instead of a number of the manifest."""
    bad, choice = draw.choice((math.nan, math.inf, True, "1.0", None)), draw.random()

    def change(table: Table, _: Path) -> None:
        places: list[tuple[Any, Any]] = [
            (row["values"], k) for row in table["gains"]["values"] for k in range(len(row["values"]))
        ]
        places += [(table, "dt_s")]
        places += [(table["vehicle"]["values"], key) for key in table.get("vehicle", {}).get("values", {})]
        where, key = places[int(choice * len(places))]
        where[key] = bad
        if bad == bad and bad not in (math.inf, None):
            table["seal"] = manifest_seal(table)

    return Change("type of a number", repr(bad), pair.certificate, rewritten(change, dependents=False))


def a_file(pair: Pair, draw: random.Random) -> Change:
    """A file altered, missing, added, off the list, or replaced by a link or a FIFO."""
    what = draw.choice(
        ("altered", "missing", "header", "source", "log", "link", "fifo", "off the list", "folder", "device")
    )
    choice = draw.random()

    def apply(folder: Path) -> None:
        files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "manifest.json")
        file = files[int(choice * len(files))]
        body = file.read_bytes()
        if what == "altered":
            file.write_bytes(body + b" ")
        elif what in ("missing", "fifo", "device", "folder", "link"):
            file.unlink()
        if what == "header":
            (folder / "math.h").write_text("#define fabs(x) 0\n")
        elif what == "source":
            (folder / "ros2" / "more.c").write_text("int more;\n")
        elif what == "log":
            (folder / "run.log").write_text("x\n")
        elif what == "fifo":
            os.mkfifo(file)
        elif what == "device":
            file.symlink_to("/dev/zero")
        elif what == "folder":
            file.mkdir()
        elif what == "link":
            (folder.parent / "elsewhere").write_bytes(body)
            file.symlink_to(folder.parent / "elsewhere")
        elif what == "off the list":

            def off_list(table: Table, _: Path) -> None:
                name = file.relative_to(folder).as_posix()
                del table["sha256"][name]
                file.write_bytes(body + b" ")
                table["seal"] = manifest_seal(table)

            rewritten(off_list, dependents=False)(folder)

    return Change(f"file {what}", f"{choice:.3f}", pair.certificate, apply)


KINDS: Mapping[Callable[[Pair, random.Random], Change | None], int] = {
    claim_number: 6, vehicle_bound: 3, claim_text: 4, text_of_dynamics: 4, claim_entry: 2, unsealed: 1, other_hash: 2,
    manifest_leaf: 2,
    manifest_gain: 4, manifest_vehicle: 3, law_list: 4, port: 2, wrong_type: 2, a_file: 5,
}  # fmt: skip
"""How often each kind of change is drawn, relative to the others."""


def changed(pair: Pair, draw: random.Random) -> Change:
    """Return one change of the pair."""
    while True:
        (make,) = draw.choices(list(KINDS), list(KINDS.values()))
        change = make(pair, draw)
        if change is not None:
            return change
