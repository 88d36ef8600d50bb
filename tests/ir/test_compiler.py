from __future__ import annotations

import os
import subprocess
from pathlib import Path

import casadi as ca
import pytest

from surctl.errors import InputError, SurctlError, ToolMissing
from surctl.ir import lower
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import compile_program, compiler_version, find_compiler, quick_flags, tuned_flags
from tests.tools import need_compiler, need_module


def test_cc_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "/nowhere/cc")
    with pytest.raises(ToolMissing, match=r"CC = '/nowhere/cc'.*unset CC") as caught:
        find_compiler()
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)


def test_no_compiler_at_all(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("surctl.ir.cache.find_spec", lambda name: None)
    with pytest.raises(ToolMissing, match=r"no C compiler found.*install one.*pip install ziglang"):
        find_compiler()


def test_the_packaged_compiler_serves_where_no_other_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    need_module("ziglang")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "-m ziglang cc" in find_compiler()
    assert "clang" in compiler_version()
    source = tmp_path / "a.c"
    source.write_text("int main(int n, char **more) { return 4 + (n << (n - 1)) + (more == 0); }\n")
    for flags in (("-O0",), tuned_flags(wide=True)):  # zig adds checks to the first, and refuses parts of the second
        program = compile_program([source], tmp_path / "a", flags=flags)
        assert subprocess.run([program], check=False).returncode == 5
        assert b"ubsan" not in program.read_bytes()
    source.write_text("int main(void) { int unused; return 0; }\n")
    with pytest.raises(SurctlError, match=r"ziglang cc .*failed: .*unused"):
        compile_program([source], tmp_path / "a")


def test_cc_may_hold_arguments_but_no_fast_math(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiler = need_compiler()
    source = tmp_path / "a.c"
    source.write_text("int main(void) { return 0; }\n")
    monkeypatch.setenv("CC", f"{compiler} -O1")
    compile_program([source], tmp_path / "a")
    monkeypatch.setenv("CC", f"{compiler} -ffast-math")
    with pytest.raises(InputError, match="-ffast-math"):
        compile_program([source], tmp_path / "a")


def test_further_flags_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    need_compiler()
    source = tmp_path / "a.c"
    source.write_text("int main(void) { return STATUS; }\n")
    monkeypatch.setenv("SURCTL_CFLAGS", "-O0 -DSTATUS=7")
    built = compile_program([source], tmp_path / "a")
    assert subprocess.run([str(built)], check=False).returncode == 7
    again = compile_program([source], tmp_path / "a", flags=["-USTATUS", "-DSTATUS=8"])  # after those
    assert subprocess.run([str(again)], check=False).returncode == 8


def test_a_level_in_the_environment_goes_before_the_quick_one(monkeypatch: pytest.MonkeyPatch) -> None:
    for flags, expected in (("", ("-Og",)), ("-DLANES=1", ("-Og",)), ("-g -O0", ())):
        monkeypatch.setenv("SURCTL_CFLAGS", flags)
        assert quick_flags() == expected


@pytest.mark.parametrize(("flags", "message"), [("-O1 -ffast-math", "-ffast-math"), ("-D'", "close its quotes")])
def test_further_flags_that_are_refused(
    flags: str, message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SURCTL_CFLAGS", flags)
    with pytest.raises(InputError, match=f"SURCTL_CFLAGS.*{message}") as caught:
        compile_program([tmp_path / "a.c"], tmp_path / "a")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffp-contract=fast", "-ffinite-math-only"])
def test_flags_that_change_results_are_refused(flag: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="changes the results"):
        compile_program([tmp_path / "a.c"], tmp_path / "a", flags=[flag])


def test_a_refusal_carries_the_first_error_line(tmp_path: Path) -> None:
    need_compiler()
    source = tmp_path / "bad.c"
    source.write_text("int main(void) { int unused; return 0; }\n")
    with pytest.raises(SurctlError, match=r"bad\.c:1:.*error.*unused") as caught:
        compile_program([source], tmp_path / "bad")
    assert "\n" not in str(caught.value)


def test_version_is_one_line() -> None:
    need_compiler()
    assert compiler_version() and "\n" not in compiler_version()


def test_a_compiler_is_asked_once_until_it_is_another(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = tmp_path / "asked"
    fake = tmp_path / "cc"

    def install(version: str) -> None:
        text = f"#!/bin/sh\necho x >> {asked}\necho {version} $1\n"
        fresh = tmp_path / "fresh"
        fresh.write_text(text)
        fresh.chmod(0o700)
        fresh.replace(fake)

    install("one 1.0")
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    for command, told, count in (("cc", "one 1.0 --version", 1), ("cc -O1", "one 1.0 -O1", 2), ("cc", "one 1.0", 2)):
        monkeypatch.setenv("CC", command)
        for _ in range(2):
            assert compiler_version().startswith(told)
        assert len(asked.read_text().split()) == count
    assert compiler_version(str(fake)) == "one 1.0 --version"
    install("two 2.0")  # as long, and perhaps as old
    assert compiler_version() == "two 2.0 --version"
    (tmp_path / "other").mkdir()
    install("six 6.0")
    fake.rename(tmp_path / "other" / "cc")
    monkeypatch.setenv("PATH", str(tmp_path / "other"), prepend=os.pathsep)
    assert compiler_version() == "six 6.0 --version"
    with pytest.raises(FileNotFoundError):
        compiler_version(str(fake))


def test_three_thousand_operations_compile(tmp_path: Path) -> None:
    need_compiler()
    x = ca.SX.sym("x", 4)
    pool = [x[k] for k in range(4)]
    for k in range(2000):
        pool.append(pool[-1] * 0.5 + pool[-4] if k % 2 else ca.fmin(pool[-2], pool[-3]) - k)
    program = lower(ca.Function("large", [x], [ca.vertcat(*pool[-8:])]))
    assert program.operations >= 3000
    # the input comes from outside, or the compiler would evaluate everything itself
    main = "int main(int argc, char **argv) { double x[4] = {argc, 2.0, 3.0, 4.0}; double y[8]; (void)argv; "
    source = tmp_path / "large.c"
    text = emit_block(program, symbol="f")
    source.write_text(f"#include <math.h>\n{text}{main}f(x, y); return y[0] > 1e300; }}\n")
    built = compile_program([source], tmp_path / "large")
    assert subprocess.run([str(built)], check=False).returncode == 0


def test_a_program_that_fails_without_a_message_is_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    (tmp_path / "a.c").write_text("int main(void) { return 0; }\n")
    with pytest.raises(ToolMissing, match="fails without a message; set CC to a C compiler, or unset it"):
        compile_program([tmp_path / "a.c"], tmp_path / "a")
