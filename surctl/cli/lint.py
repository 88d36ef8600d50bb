"""`surctl lint`: what is printed of each file, and the checks of a system of one's own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.output import as_json, finish, printable
from surctl.cli.subject import RegionWords, is_system, load_system
from surctl.errors import Finding, InputError, nearest


def _lint_system(word: str) -> Linted:
    """Return the findings of a system of the user's own: entries that cannot work, and margins that do not suffice."""
    own = load_system([word])
    system, problems = own.system, list[Finding]()

    def check(work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            key = error.key or "system"
            problems.append(Finding("error", key, error.problem + (f"; {error.remedy}" if error.remedy else "")))

    if system.duration is not None:
        check(lambda: own.seconds(None))
    for name, ends in system.ranges.items():
        check(partial(lib.checked_ranges, system, {name: ends}))
    labels = lib.entry_labels(system.plant.state) + lib.entry_labels(system.controller.state, "controller.")
    strange = [name for name in system.within if name not in labels]
    problems += [
        Finding("error", f"within.{n}", f"is not a state of the system; {nearest(n, labels)}") for n in strange
    ]
    if not problems:
        check(lambda: lib.checked_ranges(system, system.ranges))
    if not problems and system.within:
        check(lambda: RegionWords(system.within, {}, {}).problem(system, {}))
    absent = {"duration": system.duration is None, "costs": not system.costs, "ranges": not system.ranges}
    absent["within"] = not system.within
    problems += [Finding("info", key, f"is not given, so {_ABSENT[key]}") for key, none in absent.items() if none]
    if not any(one.level == "error" for one in problems):
        judged = lib.assess(lib.ClosedLoop(system), parts=["loop"]).lines
        problems += [
            Finding("warning" if line.counts else "info", "gains", line.text)
            for line in judged
            if line.about and not line.passed
        ]
    return Linted(word, "system", problems, [own.command("study"), own.command("verify")])


_ABSENT = {
    "duration": "simulate, study, sweep and tune need --seconds",
    "costs": "sweep and tune have nothing to compare",
    "ranges": "the margins are those of the nominal system only",
    "within": "no region of attraction is proved",
}


class Linted(NamedTuple):
    """The findings of a file, and the commands to suggest next if the file can work."""

    file: str
    kind: str
    findings: Sequence[Finding]
    commands: list[str]

    @property
    def works(self) -> bool:
        """Whether no finding is an error."""
        return all(one.level != "error" for one in self.findings)

    @property
    def data(self) -> dict[str, Any]:
        """The findings for JSON."""
        return {"file": self.file, "kind": self.kind, "findings": [one.to_dict() for one in self.findings]}

    def lines(self, word: str) -> list[str]:
        """Return a line for each finding; `word` is the file as typed."""
        return printable([f"{f.level}: {f.key}: {f.text}" for f in self.findings] or [f"{word}: nothing found"])

    def counts(self, word: str) -> str:
        """Return the file, and how many entries of each level it has."""
        levels = Counter(one.level for one in self.findings)
        return f"{word}: {', '.join(f'{n} x {level}' for level, n in levels.items()) or 'nothing found'}"


@click.command
@click.argument("words", nargs=-1, required=True, metavar="FILE...")
@as_json
def lint(words: tuple[str, ...], as_json: bool, **_: Any) -> None:
    """Check files and print which entries cannot work, and why."""
    done = [(word, _lint_system(word) if is_system([word]) else to_application([word])) for word in words]
    passed = all(one.works for _, one in done)
    if len(done) == 1:
        [(word, one)] = done
        lines, brief = one.lines(word), [one.counts(word), *one.lines(word)]
        finish(one.data, lines, as_json=as_json, passed=passed, then=one.commands if passed else [], brief=brief)
    lines = [line for word, one in done for line in (f"{word}:", *(f"  {each}" for each in one.lines(word)))]
    brief = [one.counts(word) for word, one in sorted(done, key=lambda item: item[1].works)]
    finish({"files": [one.data for _, one in done]}, lines, as_json=as_json, passed=passed, brief=brief)
