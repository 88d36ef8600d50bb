"""Without --verbose, every command prints a summary of at most five lines of at most 100 columns."""

from __future__ import annotations

import contextlib
import random
import re
from pathlib import Path

import click
import pytest

from surctl.cli.output import as_json, finish, warnings_in
from tests.cli.process import Outcome, surctl_here
from tests.cli.test_commands import CLAIM
from tests.cli.test_help import COMMANDS

QUICK = (
    "new system pend",
    "list",
    "lint pool-static tank-static",
    "lint pool-static",
    "verify mine.toml --out proofs",
    "check proofs/sway.json",
    "simulate pend.py:build --seconds 0.2 --out runs",
    "sweep pend.py:build k_p=4..20:9 k_d=1..2:9 --seconds 0.2 --out costs",
    "tune pend.py:build --seconds 0.2 --trials 4 --out tuned",
    "gains derive sur400 --out gains.toml",
    "vehicle thrusters bluerov2-heavy --failed T2 --force 40 40 0 5",
    "vehicle from-geometry --diameter 0.3 --mass 4 --thrust 8 --yaw-thrust 0.6",
    "scenario from-plan track.gpx --depth -2",
)
"""In this order: some read what earlier ones write. Costly commands (study, export, fly, reproduce) are left out."""
FILES = {
    "mine.toml": CLAIM,
    "track.gpx": '<gpx xmlns="http://www.topografix.com/GPX/1/1"><rte><rtept lat="59.0" lon="18.0"/>'
    '<rtept lat="59.0001" lon="18.0"/></rte></gpx>',
}


def summarised(done: Outcome) -> list[str]:
    """The lines, which are few and short."""
    lines = done.out.splitlines()
    assert 0 < len(lines) <= 5 and max(map(len, lines)) <= 100, (done.out, done.err)
    return lines


def test_each_command_has_a_summary_and_all_lines_on_demand(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    for words in QUICK:
        lines = summarised(surctl_here(*words.split(), cwd=tmp_path, SURCTL_VERBOSE=""))
        where = re.search(r"--out (\S+)", words)
        assert where is None or any(where[1] in line for line in lines), (words, lines)


@pytest.mark.parametrize("words", [words for words, one in COMMANDS.items() if not isinstance(one, click.Group)])
def test_each_command_takes_verbose_if_it_takes_json(words: tuple[str, ...]) -> None:
    options = {name for parameter in COMMANDS[words].params for name in parameter.opts}
    assert {"--json", "--verbose"} <= options or words == ("completion",)


def printed(
    capsys: pytest.CaptureFixture[str], lines: list[str], *words: str, status: int = 0, **kinds: object
) -> list[str]:
    """What a command with these lines prints."""

    @click.command
    @as_json
    def command(as_json: bool) -> None:
        finish({}, lines, as_json=as_json, passed=not status, **kinds)  # type: ignore[arg-type]

    with contextlib.suppress(SystemExit):
        command(list(words))
    return capsys.readouterr().out.splitlines()


def test_a_summary_has_verdict_files_and_next_step_however_much_there_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    draw = random.Random(0)

    def text(most: int) -> str:
        return " ".join("x" * draw.randint(1, 12) for _ in range(draw.randint(1, most)))

    for _ in range(200):
        lines = [f"verdict {text(60)}"] + [
            f"{draw.choice(('ok   ', 'FAIL ', '  ', ''))}{text(60)}" for _ in range(draw.randint(0, 30))
        ]
        files = [f"report {text(1)}.html"] * draw.randint(0, 1)
        then = [f"surctl {text(20)} 'a b'" for _ in range(draw.randint(0, 3))]
        shown = printed(capsys, lines, then=then, files=files)
        assert len(shown) <= 5 and max(map(len, shown)) <= 100
        assert shown[0].startswith("verdict ")
        assert "\n".join(lines) in "\n".join(printed(capsys, lines, "--verbose", then=then, files=files))
        if len(lines) + len(then) > 5:
            assert any("--verbose" in line for line in shown) and set(files) <= set(shown)
        if then and not any(line.startswith("next") for line in shown):
            assert len(then[0]) > 150
        at = [k for k, line in enumerate(shown) if line.startswith("next  ")]
        if at:  # the shell reads the lines as one
            command = "\n".join(shown[at[0] :])[6:].replace(" \\\n", " ").split("\n")[0]
            assert re.sub(" +", " ", command) == then[0]


def test_what_fails_comes_before_what_holds(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    lines = ["head", *(f"ok   {k}" for k in range(9)), "FAIL it", "  detail"]
    shown = printed(capsys, lines, then=["surctl list"], status=1)
    assert shown == ["head", "FAIL it", "ok   0", "ok   1 (more: --verbose)", "next  surctl list"]
    assert printed(capsys, lines, "-v") == lines


def test_a_line_is_cut_after_a_clause(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    first = "ok   margins at the equilibrium: disk margin 0.62 at the worst corner, 0.86 nominal"
    second = "ok   region-cruise-20: proved: from 0.248 m beside the path"
    lines = ["head", f"{first}; least delay margin of one loop", f"{second} (not for a start at rest, {'x ' * 30})"]
    shown = printed(capsys, [*lines, *("ok   more" for _ in range(9))], then=["surctl list"])
    assert shown[1:3] == [f"{first} …", f"{second} …"]


def test_no_line_ends_between_a_number_and_its_unit(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    for length in range(60, 100):
        shown = printed(capsys, [f"{'x' * length} 0.050 m, 0.2 rad/s, crab 23 deg"])
        assert all(f"{value}" in "".join(shown) for value in ("0.050 m", "0.2 rad/s", "23 deg"))


def test_what_got_worse_is_named_whole(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    for count in range(1, 11):
        worse = [f"corner_slowest_pole_{k}_per_s -0.2{k} -> -0.1{k}" for k in range(count)]
        lines = ["WORSE than before: " + ", ".join(worse), "  table", *(f"k_{k} = 1.5" for k in range(9))]
        shown = printed(capsys, lines, files=["gains out/gains.toml"], then=["surctl verify " + "x" * 85])
        assert len(shown) <= 5 and max(map(len, shown)) <= 100
        text = " ".join(map(str.strip, shown))
        assert all(one in text for one in worse[:7]), (count, shown)
        assert "next" in text or count > 2


def test_the_text_of_a_file_is_printed_whole(tmp_path: Path) -> None:
    done = surctl_here("verify", "v2-static", "--show", cwd=tmp_path, SURCTL_VERBOSE="")
    assert done.out.count("\n") > 5 and done.out == surctl_here("verify", "v2-static", "--show", cwd=tmp_path).out


def test_a_warning_is_in_the_summary_and_no_export_is_next_after_a_failure(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SURCTL_VERBOSE")
    lines = ["FAIL a", *(f"  number {k}" for k in range(9)), "  warning: the cap is too high"]
    kinds = {"then": ["surctl export --out b", "surctl lint c"], "brief": ["FAIL a", *warnings_in(lines)]}
    summary = ["FAIL a", "warning: the cap is too high", "(more: --verbose)", "next  surctl lint c"]
    assert printed(capsys, lines, status=1, **kinds) == summary
