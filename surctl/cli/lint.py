"""`surctl lint`: what is printed of each file, and the checks of a system of one's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import click

from surctl.cli.application import to_application
from surctl.cli.output import as_json, finish, printable
from surctl.cli.subject import RegionWords, command_line, is_system, load_system
from surctl.errors import InputError, nearest


class _Problem(NamedTuple):
    level: str
    key: str
    text: str


def _lint_system(word: str) -> Linted:
    """Return the findings of a system of the user's own: entries that cannot work, and margins that do not suffice."""
    from surctl.assessment import ClosedLoop, assess
    from surctl.system import entry_labels
    from surctl.system.values import checked_ranges

    own = load_system([word])
    system, problems = own.system, list[_Problem]()

    def check(work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            key = error.key or "system"
            problems.append(_Problem("error", key, error.problem + (f"; {error.remedy}" if error.remedy else "")))

    if system.duration is not None:
        check(lambda: own.seconds(None))
    for name, ends in system.ranges.items():
        check(partial(checked_ranges, system, {name: ends}))
    labels = entry_labels(system.plant.state) + entry_labels(system.controller.state, "controller.")
    strange = [name for name in system.within if name not in labels]
    problems += [
        _Problem("error", f"within.{n}", f"is not a state of the system; {nearest(n, labels)}") for n in strange
    ]
    if not problems:
        check(lambda: checked_ranges(system, system.ranges))
    if not problems and system.within:
        check(lambda: RegionWords(system.within, {}, {}).problem(system, {}))
    absent = {"duration": system.duration is None, "costs": not system.costs, "ranges": not system.ranges}
    absent["within"] = not system.within
    problems += [_Problem("info", key, f"is not given, so {_ABSENT[key]}") for key, none in absent.items() if none]
    works = all(one.level != "error" for one in problems)
    if works:
        judged = assess(ClosedLoop(system), parts=["loop"]).lines
        problems += [_Problem("warning", "gains", line.text) for line in judged if line.passed is False]
    lines = [f"{one.level}: {one.key}: {one.text}" for one in problems] or [f"{word}: nothing found"]
    data = {"file": word, "kind": "system", "findings": [one._asdict() for one in problems]}
    then = [command_line("study", own), command_line("verify", own)] if works else []
    return Linted(data, printable(lines), works, then)


_ABSENT = {
    "duration": "simulate, study, sweep and tune need --seconds",
    "costs": "sweep and tune have nothing to compare",
    "ranges": "the margins are those of the nominal system only",
    "within": "no region of attraction is proved",
}


class Linted(NamedTuple):
    """The findings of a file: data, lines, whether it can work, and the commands to suggest next."""

    data: dict[str, Any]
    lines: list[str]
    works: bool
    then: list[str]

    def counts(self, file: str) -> str:
        """Return the file, and how many entries of each level it has."""
        levels = [finding["level"] for finding in self.data["findings"]]
        counts = [f"{levels.count(level)} x {level}" for level in dict.fromkeys(levels)]
        return f"{file}: {', '.join(counts) or 'nothing found'}"


@click.command
@click.argument("words", nargs=-1, required=True, metavar="FILE...")
@as_json
def lint(words: tuple[str, ...], as_json: bool, **_: Any) -> None:
    """Check files and print which entries cannot work, and why. Exit status: 1 if an entry cannot work.

    FILE.py:FUNCTION names a system of your own.

    Example: surctl lint my_system.py:build
    """
    files = words
    done = [_lint_system(file) if is_system([file]) else to_application([file]) for file in files]
    if len(done) == 1:
        one = done[0]
        brief = [one.counts(files[0]), *one.lines]
        finish(one.data, one.lines, as_json=as_json, passed=one.works, then=one.then, brief=brief)
    lines = [
        line for file, one in zip(files, done, strict=True) for line in (f"{file}:", *(f"  {s}" for s in one.lines))
    ]
    finish(
        {"files": [one.data for one in done]}, lines, as_json=as_json, passed=all(one.works for one in done),
        brief=[one.counts(file) for file, one in sorted(zip(files, done, strict=True), key=lambda one: one[1].works)],
    )  # fmt: skip
