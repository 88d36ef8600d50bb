"""`surctl list`: list the built-in files and claims, and systems of installed packages; --show prints a file."""

from __future__ import annotations

import sys
from textwrap import wrap

import click

from surctl.cli import lib
from surctl.cli.application import applications
from surctl.cli.output import as_json, finish
from surctl.errors import InputError, nearest


@click.command("list")
@click.option("--show", metavar="NAME", help="Print the content of the built-in file NAME.")
@as_json
def listing(show: str | None, as_json: bool) -> None:
    """List built-in vehicles, gain files, scenarios, studies, goals and claims, and systems from installed packages.

    Example: surctl list --show sur540-flooded > my-vehicle.toml
    """
    from surctl import tuning

    libraries = {kind: folder for one in applications() for kind, folder in one.libraries().items()}
    libraries["goals"] = tuning.LIBRARY
    files = {kind: {p.stem: p for p in sorted(folder.glob("*.toml"))} for kind, folder in libraries.items()}
    if show is not None:
        kind, _, name = show.rpartition("/")
        known = {f"{k}/{n}": p for k, group in files.items() for n, p in group.items()}
        hits = [p for full, p in known.items() if full == show or (not kind and full.endswith("/" + name))]
        if not hits:
            raise InputError("no such built-in file", key="--show", value=show, remedy=nearest(show, known))
        if len(hits) > 1:
            both = ", ".join(full for full, p in known.items() if p in hits)
            raise InputError("is the name of several files", key="--show", value=show, remedy=f"choose one of {both}")
        sys.stdout.write(hits[0].read_text(encoding="utf-8"))
        return
    names = {kind: list(group) for kind, group in files.items()}
    names |= {"subjects": [f"subject:{name}" for name in lib.registered_subjects()]}
    names |= {kind: list(group) for one in applications() for kind, group in one.listed().items()}
    lines = []
    for kind, group in names.items():
        text = f"{kind}: {', '.join(group)}"
        lines += wrap(text, 100, subsequent_indent="  ", break_on_hyphens=False)
    brief = [f"{kind} ({len(group)}): {', '.join(group)}" for kind, group in names.items() if len(group) > 1]
    finish(names, lines, as_json=as_json, passed=True, brief=brief)
