"""Every command's help has examples; each is taken by the command line, and those that are quick are run."""

from __future__ import annotations

import errno
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from surctl.cli.app import app
from surctl.errors import LOST, cannot_write
from tests.cli.process import surctl, surctl_here


def _commands(command: click.Command, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield words, command
    if isinstance(command, click.Group):
        for name, inner in command.commands.items():
            yield from _commands(inner, (*words, name))


def _examples(command: click.Command) -> list[str]:
    """What stands after "Example:" up to the end of its paragraph, cut at semicolons."""
    found = []
    for paragraph in (command.help or "").split("\n\n"):
        _, mark, text = " ".join(paragraph.split()).replace("Example: ", "Examples: ").partition("Examples: ")
        if mark:
            found += [piece.strip() for piece in text.split("; ")]
    return found


COMMANDS = dict(_commands(app))
EXAMPLES = [example for command in COMMANDS.values() for example in _examples(command)]

QUICK = (
    "surctl list --show sur540-flooded > my-vehicle.toml",
    "surctl new vehicle my-robot",
    "surctl new scenario harbour --out sites/harbour.toml",
    "surctl lint pool-static --vehicle sur540-flooded",
    "surctl completion bash",
    "surctl vehicle from-log --help",
    'surctl vehicle from-geometry --name mine --diameter "40 cm" --mass "6 kg" --thrust 0.5kgf --yaw-thrust "0.4 N m"',
)
"""In this order: the second but one reads what the first writes."""


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_each_help_has_examples(words: tuple[str, ...]) -> None:
    examples = _examples(COMMANDS[words])
    assert examples
    start = shlex.join(["surctl", *words])
    assert all(example.startswith(start) for example in examples), examples


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("surctl/cli/app.py", r"Exit status: (0 .*?)\.\n"),
        ("README.md", r"exit statuses are (0: .*?)\.\n"),
        ("notebooks/guides/reference/index.md", r"\*\*exit status\*\* of a command is (0 .*?)\.\s"),
    ],
)
def test_the_exit_statuses_of_each_page_are_those_that_are_returned(file: str, pattern: str) -> None:
    text = re.search(pattern, Path(file).read_text(), re.DOTALL)
    assert text is not None
    stated = dict(re.findall(r"(?:^|[;,] )(\d+):? (.*?)(?=$|[;,] \d)", " ".join(text[1].split())))
    assert list(stated) == ["0", "1", "2", "3", "130"]
    errors = {"no permission": errno.EACCES, "disk full": errno.ENOSPC, "read-only": errno.EROFS}
    for word, number in errors.items():
        status = cannot_write("out", OSError(number, os.strerror(number))).exit_status
        assert word in stated[str(status)], (word, status, stated)
    assert "stdout lost" in stated[str(LOST)]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_each_help_fits_a_screen(words: tuple[str, ...]) -> None:
    context = click.Context(COMMANDS[words], info_name=" ".join(["surctl", *words]), terminal_width=80)
    lines = context.get_help().split("\n")
    assert len(lines) <= 50
    assert not [line for line in lines if re.search(r"\w-$", line)], "a copied line must not break a name"


def test_help_uses_all_columns_of_the_terminal(tmp_path) -> None:
    lines = surctl_here("simulate", "--help", cwd=tmp_path, COLUMNS="80").out.splitlines()
    assert len(lines) <= 50
    assert max(map(len, lines)) == 80


@pytest.mark.parametrize("example", EXAMPLES)
def test_each_example_is_taken(example: str) -> None:
    program, *words = shlex.split(example.partition(" > ")[0])
    assert program == "surctl"
    command: click.Command = app
    context = click.Context(app, info_name="surctl")
    while isinstance(command, click.Group):
        name, command, words = command.resolve_command(context, words)
        assert command is not None
        context = click.Context(command, info_name=name, parent=context)
    try:
        command.make_context(context.info_name, list(words), parent=context.parent).close()
    except click.exceptions.Exit as end:  # --help
        assert end.exit_code == 0


def test_an_example_that_no_longer_fits_is_noticed() -> None:
    with pytest.raises(click.UsageError, match="--fast"):
        test_each_example_is_taken("surctl study --fast")


def test_the_quick_ones_run(tmp_path) -> None:
    assert set(QUICK) <= set(EXAMPLES)
    for example in QUICK:
        line, _, target = example.partition(" > ")
        done = surctl(*shlex.split(line)[1:], cwd=tmp_path)
        assert done.status == (1 if "pool-static" in example else 0), (example, done)  # its hull is too wide for it
        assert "\x1b" not in done.out + done.err, "no colours into a pipe"
        if target:
            (tmp_path / target).write_text(done.out)


@pytest.mark.parametrize("wanted", [None, "3"])
def test_linear_algebra_runs_in_one_thread_unless_told_otherwise(wanted) -> None:
    """It is told before NumPy is loaded, which asks but once."""
    name = "OPENBLAS_NUM_THREADS"
    lines = [
        "import os, sys",
        "from surctl.cli import main",
        "print('numpy' in sys.modules)",
        "sys.argv = ['surctl', '--version']",
        "try: main()",
        f"finally: print(os.environ['{name}'])",
    ]
    environment = {key: value for key, value in os.environ.items() if key != name} | ({name: wanted} if wanted else {})
    command = [sys.executable, "-c", "\n".join(lines)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.split("\n")[::2][:2] == ["False", wanted or "1"]
