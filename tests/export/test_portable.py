"""The exported C in odd places: one compilation unit, C++11, wider arithmetic, and compilers that merge operations."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from surctl.export import Bundle, write_bundle
from surctl.ir import Real
from surctl.marine.export import build_bundle
from tests.export.closed_form import exported, searching
from tests.export.test_gains_in_c import guarded
from tests.tools import need, need_compiler

STRICT = ("-Wall", "-Wextra", "-Werror", "-O1")


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def test_two_bundles_and_all_their_files_form_one_compilation_unit(tmp_path: Path) -> None:
    gcc = need("gcc")
    lines = ["#define _POSIX_C_SOURCE 200112L"]
    for bundle in (guarded()[1], searching()[1], build_bundle(guarded()[0], {}, name="other")):
        write_bundle(bundle, tmp_path / bundle.name)
        own = [*bundle.sources, bundle.selftest, "link.c", *(["mission.c"] if "mission.c" in bundle.files else [])]
        lines += [f'#include "{bundle.name}/{file}"' for file in own]
    (tmp_path / "unity.c").write_text("\n".join([*lines, "int main(void) { return 0; }", ""]))
    run(gcc, "-std=c99", *STRICT, "-ffp-contract=off", "-fsyntax-only", "unity.c", cwd=tmp_path)


def test_two_headers_of_one_name_are_not_taken_for_one(tmp_path: Path) -> None:
    gcc = need("gcc")
    first, second = exported("float64")[1], exported("float32")[1]
    for folder, bundle in (("a", first), ("b", second)):
        write_bundle(bundle, tmp_path / folder)
    (tmp_path / "main.c").write_text('#include "a/surctl_closed_form.h"\n#include "b/surctl_closed_form.h"\n')
    done = subprocess.run([gcc, "-c", "main.c"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "surctl_closed_form_state_t" in done.stderr


@pytest.mark.parametrize("real", ["float32", "float64"])
def test_headers_are_strict_cpp11(tmp_path: Path, real: Real) -> None:
    compiler = need("g++")
    _, bundle, _ = guarded(real)
    write_bundle(bundle, tmp_path)
    includes = "".join(f'#include "{file}"\n' for file in ("surctl_closed_form.h", "surctl_closed_form_gains.h"))
    (tmp_path / "use.cpp").write_text(includes + "const double period = SURCTL_CLOSED_FORM_DT;\n")
    run(compiler, "-std=c++11", "-pedantic-errors", *STRICT, "-c", "use.cpp", cwd=tmp_path)


def self_test(bundle: Bundle, folder: Path, *flags: str, compiler: str = "gcc") -> str:
    write_bundle(bundle, folder)
    files = ["sil_main.c", *bundle.sources, bundle.selftest]
    run(need(compiler), "-std=c99", "-O1", *flags, *files, "-o", "sil", "-lm", cwd=folder)
    return run(folder / "sil", "--selftest", cwd=folder).stdout


def test_i686_has_the_same_bytes_with_sse_and_says_so_without(tmp_path: Path) -> None:
    bundle = guarded("float32")[1]
    for name, flags, ending in (
        ("sse", ("-msse2", "-mfpmath=sse"), " ok\n"),
        ("x87", (), "ok, but not to the last bit: operations are merged or wider\n"),
    ):
        said = self_test(bundle, tmp_path / name, "-static", "-ffp-contract=off", *flags, compiler="i686-linux-gnu-gcc")
        assert said.endswith(ending)


AVR = ("-mmcu=atmega2560", "-std=c99", "-Os", *STRICT[:-1], "-ffp-contract=off")
AVR_MAIN = """#include <avr/io.h>
#include <avr/sleep.h>
#include "surctl_closed_form.h"
static surctl_closed_form_state_t state;
static void put(int digit) { while (!(UCSR0A & (1 << UDRE0))) { } UDR0 = (uint8_t)digit; }
int main(void)
{
    UCSR0B = 1 << TXEN0;
    put('0' + (surctl_closed_form_selftest(&state) != 0)); put('0' + surctl_closed_form_exact()); put('\\n');
    sleep_enable(); sleep_cpu(); /* without interrupts: ends the emulation */
}
"""


def test_float_passes_its_self_test_on_an_8_bit_avr(tmp_path: Path) -> None:
    compiler, emulator, bundle = need("avr-gcc"), need("simavr"), exported("float32")[1]
    write_bundle(bundle, tmp_path)
    (tmp_path / "avr.c").write_text(AVR_MAIN)
    run(compiler, *AVR, "avr.c", *bundle.sources, bundle.selftest, "loop.c", "-o", "avr", "-lm", cwd=tmp_path)
    done = run(emulator, "-m", "atmega2560", "-f", "16000000", "avr", cwd=tmp_path)
    assert "01." in done.stdout + done.stderr


def test_a_compiler_whose_double_is_a_float_refuses_the_double_bundle(tmp_path: Path) -> None:
    compiler, bundle = need("avr-gcc"), guarded("float64")[1]
    write_bundle(bundle, tmp_path)
    for file in bundle.sources:
        done = subprocess.run([compiler, *AVR, "-c", file], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode != 0 and "export with --real float32" in done.stderr, file


def test_merged_operations_are_reported(tmp_path: Path) -> None:
    need_compiler()
    if "fma" not in Path("/proc/cpuinfo").read_text(encoding="ascii"):
        pytest.skip("this processor has no operation that merges product and sum")
    merged = self_test(exported("float64")[1], tmp_path, "-O2", "-mfma", "-ffp-contract=fast")
    assert "not to the last bit" in merged
