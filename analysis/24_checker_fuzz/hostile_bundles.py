"""Bundles of a controller that try to make the checker use much memory or time, each with a certificate about it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from surctl.certcheck import seal
from surctl.certcheck.bundle import FORMAT_VERSION, _gains_id, manifest_seal, numbers_sha256, ports_sha256

__all__ = ["KINDS", "bundle", "write"]

_TEXT = 1_990_000  # characters that the checker reads of a list
Table = dict[str, Any]
_HALVES = "program halves\nin0 x 1\nin1 u 0\nin2 d 0\nin3 p 0\nv0 = in0[0]\nv1 = neg v0\nout0 dx v1\n"
_MEASURES = "program measures\nin0 x 1\nin1 d 0\nin2 p 0\nv0 = in0[0]\nout0 y v0\n"
_LAW = "program law\nin0 z 0\nin1 u 1\nin2 k 0\nout0 c\nout1 z\nout2 s v0\nout3 t\n"


def digest(text: str) -> str:
    """Return the SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def program(lines: Sequence[str]) -> str:
    """Return a law of one measurement, with further instructions; v0 is the measurement."""
    return _LAW.replace("out0", "\n".join(["v0 = in1[0]", *lines, "out0"]), 1)


def bundle(
    law: str = program([]), plant: str = _HALVES, *, entries: Mapping[str, Any] | None = None, extra: int = 0
) -> tuple[Table, dict[str, str]]:
    """Return a certificate of the loop x' = -x, and the files of a bundle with other lists or entries of its law."""
    about = {
        "controller": digest(law), "plant": digest(plant) + digest(_MEASURES), "gains": {}, "parameters": [],
        "period_s": 0.1, "plant_state": ["x"], "controller_state": [], "reference": [], "disturbance": [],
    }  # fmt: skip
    claim = {
        "name": "halves", "time": "continuous", "property": "safety", "parameters": [], "dynamics": {"x": "-x"},
        "states": [{"name": "x", "unit": "m", "lower": -1.0, "upper": 1.0}], "function": "x^2 - 2", "initial": ["1"],
        "unsafe": ["1"], "multiplier": "0", "about": about,
    }  # fmt: skip
    case = {"choice": "", "denominators": [], "multipliers": ["0"], "tree": "n", "points": []}
    texts = {"x^2 - 2 - 0": ["0"], "1 - (x^2 - 2) - 9*1": ["9"], "-2*x^2 - 0*(x^2 - 2)": []}
    proofs = [[case | {"numerator": text, "multipliers": own}] for text, own in texts.items()]
    certificate = seal("barrier", claim, {"change": "-2*x^2", "margin": 1.0, "proofs": proofs})
    listed: Table = {
        "law.txt": {"sha256": digest(law), "state": [], "inputs": ["x[1] m"], "gains": [], "commands": [],
                    "telemetry": [], "initial_state": []} | dict(entries or {}),
        "plant.txt": {"sha256": digest(plant), "state": ["x[1] m"], "inputs": [], "disturbances": [],
                      "parameters": [], "values": []},
        "plant_measured.txt": {"sha256": digest(_MEASURES), "outputs": ["x[1] m"]},
    }  # fmt: skip
    nothing = numbers_sha256([])
    parts = (digest(law), ports_sha256(listed["law.txt"]), (0.1).hex(), "float64", nothing)
    identity = digest("\n".join((*parts, nothing)))
    files = {"law.txt": law, "plant.txt": plant, "plant_measured.txt": _MEASURES, "c.c": f'return "{identity}";'}
    files |= {f"list{k}.txt": law + "\n" * 9 for k in range(extra)}
    manifest = {
        "format_version": FORMAT_VERSION, "name": "c", "id": identity, "dt_s": 0.1, "real": "float64", "lists": listed,
        "law": {"sha256": digest(law), "ground_truth_sha256": digest(law), "initial_state_sha256": nothing},
        "gains": {"values": [], "sha256": nothing, "id": _gains_id(parts, [], "float64")},
        "sha256": {name: digest(text) for name, text in files.items()},
    }  # fmt: skip
    manifest["lists"] |= {f"list{k}.txt": {"sha256": digest(files[f"list{k}.txt"])} for k in range(extra)}
    return certificate, files | {"manifest.json": json.dumps(manifest | {"seal": manifest_seal(manifest)})}


def _filled(part: Callable[[int], str], size: int) -> list[str]:
    lines, length = list[str](), 0
    while length < min(size, _TEXT):
        lines.append(part(len(lines)))
        length += len(lines[-1]) + 1
    return lines


def _manifest(part: str, size: int) -> tuple[Table, dict[str, str]]:
    certificate, files = bundle()
    text = ", ".join([part] * (size // (len(part) + 2)))
    return certificate, files | {"manifest.json": f'{files["manifest.json"][:-1]}, "more": [{text}]}}'}


def long_program(size: int) -> tuple[Table, dict[str, str]]:
    """Many instructions."""
    return bundle(program(_filled(lambda k: f"v{k + 1} = neg v{k}", size)))


def many_words(size: int) -> tuple[Table, dict[str, str]]:
    """An output with many entries."""
    return bundle(program(["out0" + " v0" * (min(size, _TEXT) // 3)]))


def many_blocks(size: int) -> tuple[Table, dict[str, str]]:
    """Many programs, and a routine that calls them."""
    blocks = _filled(lambda k: f"program p{k}\nin0 x 1\nv0 = in0[0]\nout0 y v0\n", size // 2)
    calls = [f"a{k} = call p{k}:{digest(text)[:16]} u" for k, text in enumerate(blocks)]
    return bundle("\n".join([*blocks, "\n".join(["routine law", "in u 1", *calls, "out u", ""])]))


def many_calls(size: int) -> tuple[Table, dict[str, str]]:
    """A routine with many calls of one program."""
    block = "program p\nin0 x 1\nv0 = in0[0]\nout0 y v0\n"
    calls = _filled(lambda k: f"a{k} = call p:{digest(block)[:16]} u", size)
    return bundle("\n".join([block, "\n".join(["routine law", "in u 1", *calls, "out u", ""])]))


def long_procedure(size: int) -> tuple[Table, dict[str, str]]:
    """A procedure with many statements."""
    body = _filled(lambda k: " s.y[0]=1", size)
    return bundle("\n".join(["procedure law", "in u 1", "out y 1", "def f(s):", *body, ""]))


def deep_procedure(size: int) -> tuple[Table, dict[str, str]]:
    """A procedure with one nested expression."""
    return bundle("\n".join(["procedure law", "in u 1", "out y 1", "def f(s):", f" s.y[0]={'-' * size}1", ""]))


def long_ports(size: int) -> tuple[Table, dict[str, str]]:
    """Parts of a vector with many entries, all of which are one number."""
    ports = max(1, size // 40_000)
    return bundle(entries={"state": [f"x{k}[9999999] m" for k in range(ports)], "initial_state": [0.5] * ports})


def squares(size: int) -> tuple[Table, dict[str, str]]:
    """A constant that is squared again and again: its number of digits doubles."""
    lines = ["v1 = const 0x1.fffffffffffffp-1", *(f"v{k} = sq v{k - 1}" for k in range(2, 60))]
    return bundle(program(lines))


def products(size: int) -> tuple[Table, dict[str, str]]:
    """Many different products of constants."""
    lines = _filled(lambda k: f"v{k + 1} = const {(1 + k / 2**20).hex()}" if k < 9 else f"v{k + 1} = mul v{k} v9", size)
    return bundle(program(lines))


def turns(size: int) -> tuple[Table, dict[str, str]]:
    """A loop whose expression grows with each turn."""
    block = "program p\nin0 x 1\nin1 u 1\nv0 = in0[0]\nv1 = in1[0]\nv2 = sin v0\nv3 = mul v2 v1\nout0 y v3\n"
    loop = f"a = loop p:{digest(block)[:16]} count 60000 index 0 until None carried u sliced  fixed u spread  lanes 1"
    head = ["routine law", "in z 0", "in u 1", "in k 0", loop, "out z z a k", ""]
    return bundle("\n".join([block, "\n".join(head)]), plant=_HALVES)


def branches(size: int) -> tuple[Table, dict[str, str]]:
    """A condition of conditions: an expression with 2^n cases."""
    lines = ["v1 = lt v0 v0", *(f"v{k} = {'or' if k % 2 else 'and'} v{k - 1} v{k - 1}" for k in range(2, 90))]
    return bundle(program([*lines, "v90 = select v89 v0 v0"]))


def many_names(size: int) -> tuple[Table, dict[str, str]]:
    """A manifest that lists many files that are missing."""
    certificate, files = bundle()
    manifest = json.loads(files["manifest.json"])
    manifest["sha256"] |= {f"f{k}": "" for k in range(size // 14)}
    return certificate, files | {"manifest.json": json.dumps(manifest | {"seal": manifest_seal(manifest)})}


def many_files(size: int) -> tuple[Table, dict[str, str]]:
    """Many lists that nothing uses."""
    return bundle(program(_filled(lambda k: f"v{k + 1} = neg v{k}", size // 4)), extra=40)


KINDS: dict[str, Callable[[int], tuple[Table, dict[str, str]]]] = {
    function.__name__.replace("_", " "): function
    for function in (
        long_program, many_words, many_blocks, many_calls, long_procedure, deep_procedure, long_ports, squares,
        products, branches, turns, many_names, many_files,
    )
} | {
    f"manifest of {name}": lambda size, part=part: _manifest(part, size)
    for name, part in {
        "numbers": "0.1", "short lists": "[0, 0]", "shortest lists": "[]", "small objects": '{"a":0}',
        "nested objects": '{"a":{"b":{}}}', "depth": "[" * 4000 + "]" * 4000, "digits": "9" * 3900,
    }.items()
}  # fmt: skip
"""Functions that return a certificate and the files of a bundle whose hostile file has about the given size [bytes]."""


def write(kind: str, size: int, folder: Path) -> Path:
    """Write a bundle of a kind with a hostile file of at most about `size` bytes; return its certificate."""
    certificate, files = KINDS[kind](size)
    (folder / "bundle").mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / "bundle" / name).write_text(text, encoding="utf-8")
    path = folder / "certificate.json"
    path.write_text(json.dumps(certificate), encoding="utf-8")
    return path
