"""`surctl new`: write a commented file from `templates`; new files of all commands: name, folder, --force."""

from __future__ import annotations

import keyword
import re
import shlex
from pathlib import Path

import click

from surctl.cli import lib
from surctl.cli.options import FILE
from surctl.cli.output import as_json, finish
from surctl.errors import InputError, writing

_TEMPLATES = Path(__file__).parent / "templates"
_NEXT = {
    "vehicle": ("surctl lint {}", "surctl tune --vehicle {} --out tuned"),
    "scenario": ("surctl lint {}", "surctl simulate {}"),
    "study": ("surctl lint {}", "surctl study {}"),
    "task": ("python {}",),
    "law": ("python {}", "surctl new scenario open-water", "surctl simulate open-water.toml --law {}:@IDENTIFIER@"),
    "robot": ("python {}",),
    "system": (
        "surctl study {}:build",
        "surctl simulate {}:build --out plots",
        "surctl verify {}:build --time-limit 5 --out proofs",
        "surctl sweep {}:build k_p=4..20:9 --out sweep",
        "surctl tune {}:build --out tuned",
        "surctl export {}:build --out firmware",
    ),
}
_IN_PYTHON = ("task", "law", "robot", "system")


@click.command
@click.argument("kind", type=click.Choice(list(_NEXT)))
@click.argument("name")
@click.option("--out", type=FILE, help="File to write (default NAME.toml or NAME.py).")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@as_json
def new(kind: str, name: str, out: Path | None, force: bool, as_json: bool) -> None:
    """Write a file with comments, which you can run at once and then edit: a vehicle, a scenario or a study as TOML; a
    task, a control law, a robot from its URDF file or a closed loop (system) as Python.

    Examples: surctl new system pendulum; surctl new vehicle my-robot; surctl new scenario harbour --out
    sites/harbour.toml; surctl new law my-law
    """
    template = next(_TEMPLATES.glob(f"{kind}.*"))
    suffix = ".py" if kind in _IN_PYTHON else ".toml"
    name = name.removesuffix(suffix)
    identifier = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower()
    identifier += "_" * keyword.iskeyword(identifier)
    if kind in _IN_PYTHON:
        if not identifier.isidentifier():
            raise InputError(f"cannot name a {kind}", key="name", value=name, remedy="begin with a letter")
        lib.identifier(identifier)  # the exported code has names that begin with it
    text = template.read_text(encoding="utf-8").replace("@NAME@", lib.quoted(name)).replace("@IDENTIFIER@", identifier)
    target = write_new(out or path_of(name, suffix), text, force=force)
    shown = shlex.quote(str(target))
    then = [command.format(shown).replace("@IDENTIFIER@", identifier) for command in _NEXT[kind]]
    result = {"kind": kind, "name": name, "file": str(target)}
    finish(result, [f"wrote {target}"], as_json=as_json, passed=True, then=then)


def path_of(name: str, suffix: str) -> Path:
    """Return the file in the current folder that has the given name and suffix.

    Raises:
        InputError: the name is empty, contains a folder, or has characters that cannot be printed.
    """
    if not name.strip() or Path(name).name != name or not name.isprintable():
        raise InputError("cannot be a file name", key="name", value=name, remedy="choose a file with --out FILE")
    return Path(f"{name}{suffix}")


def write_new(target: Path, text: str, *, force: bool) -> Path:
    """Write a new file; with `force`, overwrite an existing file.

    Raises:
        InputError: the file exists and `force` is not set, or the file cannot be written.
    """
    with writing(target, remedy="choose another --out"):  # the file name may be too long
        there = target.exists()
    if there and not force:
        raise InputError("already exists", file=target, remedy="choose another --out, or add --force")
    return lib.write_file(target, text)
