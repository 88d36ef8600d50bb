"""Names and text use the field's terms: retired words come back neither in names nor in what a user reads."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import pytest

from surctl.cli.app import app

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "surctl").rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "notebooks").rglob("*.md"))]

NAMES = frozenset(
    re.findall(
        r"\w+",
        """
        told given seen heard wish wishes wanted asked flown fly flies flight made kept taken found drawn
        answer push way reach tick ladder rung trap stood halted knob lean senses chart sheet blame served
        stirred sift rival doubt room twin settle settled
        """,
    )
)
ALLOWED = frozenset({"ticks", "_ticks", "_TICKS", "fly"})  # of a plot's axis; what a vehicle in the water does

WORDS = re.compile(
    r"(?<![\w-])(tell|tells|told|wish|wishes|wished|flown|flies|ticks?|ladders?|rungs?|knobs?|lean|senses|stirred|sift"
    r"|sifts|sifted|rivals?|twins?|halted|stood|blames?|blamed)(?![\w-])",
    re.IGNORECASE,
)
QUOTED = re.compile(
    r"``[^`]*``|`[^`]*`|\"[\w.=-]*\"|^\s*(?:>>>|\.\.\.).*$", re.MULTILINE
)  # names in text, and examples
AXES = re.compile(r"(?:axis|plot|major|minor) ticks?|ticks? (?:labels?|marks?)")


STRING = re.compile(
    r"""([bfru]{0,2})(?:\"{3}[\s\S]*?\"{3}|'{3}[\s\S]*?'{3}|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')|#[^\n]*""",
    re.IGNORECASE,
)


def code_words(source: str) -> set[str]:
    """All names and keywords of a module, roughly: without comments, and without strings that hold no code."""
    return set(re.findall(r"[^\W\d]\w*", STRING.sub(lambda m: m[0] if "f" in (m[1] or "").lower() else " ", source)))


def bound_names(tree: ast.AST) -> Iterator[str]:
    """Every name that a module binds: definitions, arguments, variables, fields and aliases."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                yield name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case ast.alias(asname=str(name)) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                yield name


@cache
def retired(name: str) -> set[str]:
    """The retired words among the parts of a name, in the plural too."""
    spaced = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()
    parts = {part for part in re.split(r"[^a-z]+", spaced) if part}
    return {part for part in parts if {part, part.removesuffix("s")} & NAMES}


def retired_words(text: str) -> list[str]:
    """The retired words of a text outside of quoted names and examples."""
    return WORDS.findall(AXES.sub("", QUOTED.sub("", text)))


def texts(source: str) -> Iterator[tuple[int, str]]:
    """Comments and literals of a module with their lines; f-strings too."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in (tokenize.STRING, tokenize.COMMENT):
            yield token.start[0], token.string


def test_the_check_knows_a_retired_name_from_another() -> None:
    assert retired("told_by_suffix") and retired("PriorityTick") and retired("lowerRungs") and retired("_answers")
    assert code_words("x = 'told' # wish\ny: int = f'{z:>{k}}' \"it\\\"s\"\n'''a\nb'''") >= {"x", "y", "z", "k", "int"}
    assert not {"told", "wish", "s", "b"} & code_words("x = 'told' # wish\nu = \"it\\\"s\"\nv = '''a\nb'''")
    assert not retired("stepping") and not retired("always") and not retired("preach") and not retired("notes_taker")
    assert retired_words("The law is told one knob.") == ["told", "knob"]
    assert retired_words("`told` is old; major ticks, tick labels and sticks are fine\n    >>> wish = 1") == []


def test_no_name_has_a_retired_word() -> None:
    found = set()
    for path in SOURCES:
        source = path.read_text(encoding="utf-8")
        # parsing every module takes ten times as long
        suspects = {name for name in {path.stem, *code_words(source)} if name not in ALLOWED and retired(name)}
        bound = {path.stem, *bound_names(ast.parse(source))} if suspects else set()
        found |= {f"{path.relative_to(ROOT).as_posix()}: {name}" for name in suspects & bound}
    assert sorted(found) == []


@pytest.mark.parametrize("package", sorted({path.relative_to(ROOT / "surctl").parts[0] for path in SOURCES}))
def test_no_text_of_the_code_has_a_retired_word(package: str) -> None:
    found = []
    for path in SOURCES:
        if path.relative_to(ROOT / "surctl").parts[0] != package:
            continue
        source = path.read_text(encoding="utf-8")
        if WORDS.search(source):  # few modules have such a word, and finding all tokens takes long
            found += [
                f"{path.relative_to(ROOT).as_posix()}:{line}: {word}"
                for line, text in texts(source)
                for word in retired_words(text)
            ]
    assert found == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_no_page_has_a_retired_word(page: Path) -> None:
    assert retired_words(page.read_text(encoding="utf-8")) == []


def test_no_option_has_a_retired_name() -> None:
    def options(command: click.Command) -> Iterator[str]:
        for parameter in command.params:
            yield from (*parameter.opts, *parameter.secondary_opts)
        if isinstance(command, click.Group):
            for name, inner in command.commands.items():
                yield from (name, *options(inner))

    named = sorted(set(options(app)))
    assert [name for name in named if retired(name) and name not in ALLOWED] == []
