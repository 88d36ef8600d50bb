"""The reference of the command line, from the commands themselves."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click
from page import Page, table

from surctl.cli.app import app

__all__ = ["pages"]

FOLDER = "reference/commands"


def pages() -> list[Page]:
    """Return a page for each command, with a section for each command below it, after a page with all of them."""
    rows = []
    made: list[Page] = []
    for name, command in sorted(app.commands.items()):
        made.append(Page(f"{FOLDER}/{name}.md", f"surctl {name}", _page(name, command)))
        rows.append((f"[`surctl {name}`]({name}.md)", command.get_short_help_str(limit=300)))
    text = f"# Commands\n\n{_paragraphs(app.help or '')}\n\n{table(('command', 'does'), rows)}\n\n{_EVERY}"
    return [Page(f"{FOLDER}/index.md", "Commands", text, index=True), *made]


_EVERY = """Every command has `--help`. Most have `--json`, which prints one JSON object on stdout. The script of
`surctl completion` completes commands, options and file names in a shell."""


def _page(name: str, command: click.Command) -> str:
    return "\n\n".join(_sections(command, ["surctl", name], level=1))


def _sections(command: click.Command, path: list[str], *, level: int) -> Iterator[str]:
    title = " ".join(path)
    yield f"{'#' * level} {title}"
    context = click.Context(command, info_name=path[-1], parent=_parents(path[:-1]))
    usage = " ".join([title, *command.collect_usage_pieces(context)])
    yield f"```console\n{usage}\n```"
    yield _paragraphs(command.help or "")
    rows = [_option(parameter, context) for parameter in command.get_params(context)]
    if shown := [row for row in rows if row is not None]:
        yield table(("option", "sets"), shown)
    if isinstance(command, click.Group):
        for name, below in sorted(command.commands.items()):
            yield from _sections(below, [*path, name], level=level + 1)


def _parents(names: list[str]) -> click.Context | None:
    context: click.Context | None = None
    command: click.Command = app
    for k, name in enumerate(names):
        command = app if k == 0 else command.commands[name]  # type: ignore[attr-defined]
        context = click.Context(command, info_name=name, parent=context)
    return context


def _option(parameter: click.Parameter, context: click.Context) -> tuple[str, str] | None:
    record = parameter.get_help_record(context)
    return None if record is None or not record[1] else (f"`{record[0]}`", _plain(record[1]))


_WORDS = re.compile(
    r"(?<![\w-])--[a-z][\w-]*(?:(?: |=)[A-Z]{1,9}\b)?"  # --option VALUE
    r"|(?<!\w)[\w/-]+\.(?:py|toml|csv|nc|md|gif|mp4|html|tsv|json)(?::\w+)?"  # FILE.py:FUNCTION
    r"|(?<!\w)[\w.]+=[A-Z\d][\w.,:]*\w"  # NAME=VALUE
    r"|(?<!\w)[a-z]+\.[A-Z]{2,}\b"  # plant.NAME
)


def _plain(text: str) -> str:
    """Return text that Markdown shows as it is; words like FILE.toml, NAME=VALUE and --option are set as code."""

    def shown(part: str) -> str:
        return re.sub(r"([\[\]*_>|])", r"\\\1", part).replace("<", "&lt;")  # Markdown has no escape for <

    out = []
    for k, part in enumerate(text.split("`")):
        if k % 2:
            out.append(f"`{part}`")
            continue
        words = _WORDS.findall(part)
        between = _WORDS.split(part)
        out += [shown(between[0]), *(f"`{word}`{shown(rest)}" for word, rest in zip(words, between[1:], strict=True))]
    return "".join(out)


def _paragraphs(text: str) -> str:
    """Return the help as Markdown; examples become a block of commands."""
    out: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text.replace("\b", "").strip()):
        line = " ".join(paragraph.split())
        before, examples, after = line.partition("Examples: ")
        if not examples:
            before, examples, after = line.partition("Example: ")
        if before.strip():
            out.append(_plain(before.strip()))
        if examples:
            out.append("```console\n" + "\n".join(f"$ {each.strip()}" for each in after.split("; ")) + "\n```")
    return "\n\n".join(out)
