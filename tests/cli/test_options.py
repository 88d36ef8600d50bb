"""Options as fields of dataclasses: what the command has, what it receives, what counts as given; names loaded late."""

from __future__ import annotations

from dataclasses import dataclass, fields
from importlib import import_module

import click
import pytest
from click.testing import CliRunner

from surctl.cli.options import Count, changed, option, options, typed


@dataclass(frozen=True, eq=False, repr=False)
class Travel:
    speed: float = option("--speed", "Speed [m/s].", 0.5)
    stops: tuple[str, ...] = option("--stop", "Stop; repeatable.", (), metavar="NAME")
    fast: bool = option("--fast", "Hurry.", False)
    runs: int | None = option("--runs", "Runs.", type=Count(1))
    where: str = "tank"


@click.command
@options(travel=Travel)
@click.option("--where")
def travel(travel: Travel) -> None:
    click.echo(repr([getattr(travel, one.name) for one in fields(travel)]))
    click.echo(f"{changed(travel)} {[one.opts[0] for one in typed('fast')]}")


@click.command
@options(travel=Travel, only={"travel": ("fast",)})
def hurry(travel: Travel) -> None:
    click.echo(f"{travel.fast} {travel.speed}")


def test_a_command_receives_its_options_as_an_object() -> None:
    assert [one.opts[0] for one in travel.params] == ["--speed", "--stop", "--fast", "--runs", "--where"]
    done = CliRunner().invoke(travel, ["--stop", "a", "--stop", "b", "--fast", "--where", "pool"])
    assert done.output.splitlines() == [
        "[0.5, ('a', 'b'), True, None, 'pool']",
        "{'--stop': ('a', 'b'), '--fast': True} ['--stop', '--where']",
    ]
    assert CliRunner().invoke(travel, ["--speed", "-1"]).output.startswith("[-1.0, (), False, None")


def test_a_command_may_have_some_of_the_options() -> None:
    assert [one.opts[0] for one in hurry.params] == ["--fast"]
    assert CliRunner().invoke(hurry, ["--fast"]).output == "True 0.5\n"
    assert CliRunner().invoke(hurry, ["--speed", "1"]).exit_code == 2


@pytest.mark.parametrize("name", ["surctl.cli.lib", "surctl.marine.cli.lib"])
def test_each_name_of_the_library_of_commands_exists(name: str) -> None:
    library = import_module(name)
    assert len(library._homes) > 100
    for known, (home, attribute) in library._homes.items():
        assert getattr(library, known) is getattr(import_module(home), attribute), known
