"""README and guides: each command runs in the order of the page and prints what the page shows, as does each example.

A `console` block holds commands after `$ ` and lines of their output; `...` stands for lines left out, `…` for the rest
of a line. A `toml` block whose first line is `# FILE` is that file. A `pycon` block is a doctest; the blocks of a page
share their names.
"""

from __future__ import annotations

import ast
import doctest
import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import surctl
from surctl.cli.app import app
from tests.processes import run_python
from tests.tools import PATIENCE, need_compiler, need_module

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
GUIDES = sorted((ROOT / "notebooks" / "guides").rglob("*.md"))
PAGES = [README, *GUIDES]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
NAMES = {
    "add-a-task",
    "add-a-vehicle",
    "architecture",
    "coming-from/acados",
    "coming-from/drake",
    "coming-from/index",
    "coming-from/matlab",
    "coming-from/pink",
    "coming-from/python-control",
    "design",
    "explanation/certificates",
    "explanation/index",
    "explanation/priorities",
    "explanation/sonar",
    "export",
    "field",
    "glossary",
    "how-to",
    "independent-physics",
    "index",
    "missions",
    "own-law",
    "project",
    "questions/code",
    "questions/commands",
    "questions/index",
    "questions/proofs",
    "questions/runs",
    "questions/scope",
    "questions/systems",
    "questions/troubleshooting",
    "questions/vehicles",
    "reference/equations",
    "reference/index",
    "region",
    "robot",
    "tune",
    "tutorials/first-controller",
    "tutorials/firmware",
    "tutorials/index",
    "tutorials/own-claim",
    "tutorials/own-system",
    "tutorials/own-vehicle",
    "verify",
    "what-is-proved",
}
MADE = re.compile(
    r"(?:\.\./)*(?:(?:reference/)?(?:commands|files|python)|gallery|(?:tutorials/)?notebooks)/[\w-]+\.md$"
)  # by tests/test_site.py
RUN, SHOWN = {"console", "pycon"}, {"toml", "text", "c", ""}  # kinds of blocks: run here; files, fragments, output


def name_of(page: Path) -> str:
    """README, or the page's path among the guides."""
    return "README" if page == README else page.relative_to(ROOT / "notebooks" / "guides").with_suffix("").as_posix()


def commands(text: str) -> list[tuple[str, list[str]]]:
    """Each command with the lines it is said to print."""
    found: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif line.strip() not in ("...", ""):
            found[-1][1].append(line.rstrip())
    return found


def missing(said: list[str], printed: str) -> list[str]:
    """Lines of the page that the output does not have, in its order."""
    lines, at = [line.rstrip() for line in printed.splitlines()], 0
    for k, line in enumerate(said):
        start, cut, _ = line.partition("…")
        same = [i for i in range(at, len(lines)) if (lines[i].startswith(start) if cut else lines[i] == line)]
        if not same:
            return said[k:]
        at = same[0] + 1
    return []


def options_of(command: click.Command) -> set[str]:
    """Every option of a command and of those below it."""
    own = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    below = command.commands.values() if isinstance(command, click.Group) else ()
    return own.union({"--help", "--version"}, *map(options_of, below))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_option_and_file_that_the_text_names_is_there(page: Path) -> None:
    known = options_of(app)
    prose = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for code in re.findall(r"`([^`]+)`", prose):
        if code.startswith(("surctl ", "--")):
            assert set(re.findall(r"--[a-z][a-z-]*", code)) <= known, code
        shown = re.search(r"surctl list --show (\S+)", code)
        if shown:
            CliRunner().invoke(app, ["list", "--show", shown[1]], catch_exceptions=False)


_KNOWN: dict[tuple[str | bytes, ...], tuple[str, dict[str, bytes]]] = {}


def contents(folder: Path) -> dict[str, bytes]:
    """Every file in it, by its path from there."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def shared(command: str, folder: Path) -> str:
    """`run`; what several pages make, prove or export of the same files is made once: the others get what was written.

    Of its own folder such a command reads only the files and folders that it names.
    """
    if not command.startswith(("surctl vehicle ", "surctl verify ", "surctl export ", "surctl check ")):
        return run(command, folder)
    named = [folder / word for word in shlex.split(command)]
    if command.startswith("surctl check "):
        named = [file for path in named for file in (path, *sorted(path.rglob("*")))]
    asked = (command, *(path.read_bytes() for path in named if path.is_file()))
    if asked not in _KNOWN:
        before = contents(folder)
        printed = run(command, folder)
        _KNOWN[asked] = printed, {name: b for name, b in contents(folder).items() if before.get(name) != b}
    printed, written = _KNOWN[asked]
    for name, content in written.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return printed


def run(command: str, folder: Path) -> str:
    """What the command prints on both streams, without progress."""
    program, *words = shlex.split(command)
    if program in ("surctl", "python"):
        words = ["-m", "surctl", *words] if program == "surctl" else words
        often = {"SURCTL_CFLAGS": "-O1"} if "tune" in words else {}  # flying takes longer there than compiling
        done = run_python(
            words,
            cwd=folder,
            environment={**os.environ, "MPLBACKEND": "agg", "SURCTL_VERBOSE": "", **often},
            drawn=False,
        )
    else:
        done = subprocess.run(
            [program, *words], cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout + "".join(f"{line}\n" for line in done.stderr.splitlines() if not line.startswith("  "))


def test_there_is_a_guide_for_each_job() -> None:
    assert {name_of(guide) for guide in GUIDES} == NAMES


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_each_block_is_run_or_of_a_kind_that_is_only_shown(page: Path) -> None:
    kinds = re.findall(r"^```(\w*)\n.*?^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert set(kinds) <= RUN | SHOWN


@pytest.mark.parametrize("guide", PAGES, ids=name_of)
def test_it_does_what_it_says(guide: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    if guide.stem == "field":
        need_module("pymavlink")
        need_module("mcap")
    if guide.stem == "independent-physics":
        need_module("mujoco")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, text in BLOCK.findall(guide.read_text(encoding="utf-8")):
        if kind == "console":
            for command, said in commands(text):
                printed = shared(command, tmp_path)
                assert missing(said, printed) == [], f"$ {command}\n{printed}"
        elif kind == "toml" and (named := re.match(r"# ([\w.-]+\.toml)\n", text)):
            (tmp_path / named[1]).write_text(text, encoding="utf-8")
        elif kind == "pycon":
            test = doctest.DocTestParser().get_doctest(text, names, guide.stem, str(guide), 0)
            wrong: list[str] = []
            runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
            runner.run(test, out=wrong.append, clear_globs=False)
            assert wrong == [], "".join(wrong)
            names = test.globs


@pytest.mark.parametrize("guide", PAGES, ids=name_of)
def test_its_links_lead_somewhere(guide: Path) -> None:
    for link in re.findall(r"\]\(([^)#]+)[^)]*\)", guide.read_text(encoding="utf-8")):
        assert link.startswith("https://") or MADE.match(link) or (guide.parent / link).exists(), link


def numbers(text: str) -> list[str]:
    """The numbers in it, without commas between thousands."""
    return re.findall(r"\d+(?:\.\d+)?", re.sub(r"(?<=\d),(?=\d{3})", "", text))


def test_the_list_of_questions_has_each_question() -> None:
    pages = {page for page in GUIDES if page.parent.name == "questions" and page.stem != "index"}
    asked = [line[3:] for page in pages for line in page.read_text(encoding="utf-8").splitlines() if line[:3] == "## "]
    listed = re.findall(r"^- \[(.*)\]\(\w+\.md#", (ROOT / "notebooks/guides/questions/index.md").read_text(), re.M)
    assert len(asked) > 100 and sorted(listed) == sorted(asked)


def test_the_figures_of_the_readme_stand_on_the_page_that_their_row_names() -> None:
    rows = re.findall(r"^\| .+ \| (.+) \| \[.+?\]\((\S+\.md)\) \|$", README.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) >= 8
    for value, source in rows:
        absent = set(numbers(value)) - set(numbers((ROOT / source).read_text(encoding="utf-8")))
        assert not absent, f"{value}: {source} does not have {absent}"


def test_the_readme_is_short_and_has_the_two_commands() -> None:
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 200
    indented = re.findall(r"^    (.*\S)", BLOCK.sub("", "\n".join(lines)), re.MULTILINE)
    assert indented == ["pip install . && surctl study", 'pip install -e ".[dev]" && pytest']


def test_one_sentence_says_everywhere_what_it_is() -> None:
    texts = [path.read_text(encoding="utf-8") for path in (README, ROOT / "notebooks" / "guides" / "index.md")]
    texts += [(ROOT / name).read_text(encoding="utf-8") for name in ("notebooks/mkdocs.yml", "CITATION.cff")]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for text in (*texts, app.help or "", surctl.__doc__ or ""):
        assert project["description"] in " ".join(text.split())
    assert f"version: {project['version']}\n" in texts[-1]
    assert project["version"] == surctl.__version__


def test_the_architecture_has_the_packages_in_their_order() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    page = (ROOT / "notebooks" / "guides" / "architecture.md").read_text(encoding="utf-8")
    for storey in ("core", "application"):
        (layers,) = [c["layers"] for c in config if c["name"] == f"one direction through the packages of the {storey}"]
        table = page.partition(f"## Packages of the {storey}")[2].partition("\n#")[0]
        rows = [re.findall(r"`(\w+)`", line.split("|")[1]) for line in table.splitlines() if line.startswith("| `")]
        names = [name.strip().removeprefix("surctl.") for layer in layers for name in layer.split("|")]
        assert [name for row in rows for name in row] == names


def test_an_example_needs_only_the_imports_that_its_page_names() -> None:
    # the reader of one answer copies its example, and the imports of the observer's
    [page] = [guide for guide in GUIDES if name_of(guide) == "questions/systems"]
    texts = [text for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")) if kind == "pycon"]
    trees = [ast.parse("".join(e.source for e in doctest.DocTestParser().get_examples(text))) for text in texts]
    imports = [[node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)] for tree in trees]
    names = [{alias.asname or alias.name for node in nodes for alias in node.names} for nodes in imports]
    [observer] = [own for own in names if "linearise_plant" in own]
    assert "import surctl" in texts[names.index(observer)]
    for tree, own in zip(trees, names, strict=True):
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        assert not used & set().union(*names) - own - observer
