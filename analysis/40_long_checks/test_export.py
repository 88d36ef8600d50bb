"""Export: further errors that the proof reports, further processors, MISRA, pip, and the law with sonars in floats."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from surctl.export import REALS, TARGETS, Records, check_builds, write_bundle
from surctl.export.check import step_stack
from surctl.export.emulated import chosen_targets
from surctl.export.process import compile_controller
from surctl.export.prove import prove_bundle
from surctl.export.rendering import with_own_names
from surctl.ir import Call, Real, Routine, memory
from surctl.ir.c99_routine import emit_parts
from surctl.marine.control import build_law
from surctl.marine.control.build import in_real
from surctl.marine.export import build_bundle
from tests.export.altered import altered
from tests.export.clocks import clocks
from tests.export.closed_form import exported, searching, vehicle
from tests.export.test_check import compiled
from tests.export.test_firmware import assert_the_wrapper_computes_the_same
from tests.export.test_gains_in_c import guarded
from tests.export.test_guard import LOOK_FOR, STRICT
from tests.export.test_prove import WRONG
from tests.export.test_ros2 import packages, sensing
from tests.tools import _without, need


def test_a_guard_that_lets_a_number_of_any_size_in_leaves_an_overflow() -> None:
    need("frama-c")
    law, bundle, _ = exported("float32")
    broken = altered(bundle, r"if \(!\(fabsf\(input->eta\[3\]\) <= 1000\.0f\)\) \{ return 0; \}", "")
    # the proof assumes no more than the guard ensures: take the number from anywhere
    assert bundle.envelope is not None
    box = bundle.envelope.inputs.copy()
    box[3] = (-3.4e38, 3.4e38)
    broken = replace(broken, envelope=replace(bundle.envelope, inputs=box))
    report = prove_bundle(law, broken, vehicle().thrust_limit)
    assert not report.proved, report.summary()
    assert any(re.search("is_nan_or_infinite|overflow", alarm.kind) for alarm in report.alarms)
    assert all(alarm.line > 0 and alarm.file in (*bundle.sources, "proof.c") for alarm in report.alarms)


def test_a_missing_upper_limit_of_the_thrust_is_an_open_assertion() -> None:
    need("frama-c")
    law, bundle = searching()
    broken = altered(bundle, r"\w+min_of\((\w+)max_of\((v\d+), -5\.0f\), 5\.0f\)", r"\1max_of(\2, -5.0f)")
    report = prove_bundle(law, broken, vehicle().thrust_limit)
    assert not report.proved and any("assertion" in alarm.kind for alarm in report.alarms), report.summary()


def in_float(text: str) -> str:
    """The text around the law with float for double."""
    text = re.sub(r"\bdouble\b", "float", text).replace("DBL_MAX", "FLT_MAX").replace("fabs(", "fabsf(")
    text = re.sub(r"\b(?=(min|max|square)_of\()", "float_", text)
    return re.sub(r"(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?)(?![\w.])", r"\1f", text)


def test_what_the_law_with_sonars_takes_in_float(tmp_path: Path) -> None:
    """State struct, the caller's other structs, and the stack below a step as a small processor's compiler tells it.

    29 kB hold all of it.
    """
    law = build_law(sonar=True)
    bundle = build_bundle(law, {})
    files, name = bundle.files, bundle.name
    state = 2 * law.state.size + 3
    structs = law.inputs.size + law.gains.size + law.outputs.size + 1
    arrays = memory(law.block) - 2 * law.state.size
    double, single = (emit_parts(law.block, symbol=f"{name}_law", real=real).files for real in REALS)
    around = {file: text for file, text in files.items() if file.startswith(name) and file[-2:] in (".c", ".h")}
    owner = {}
    for part, text in double.items():
        own = {file: with_own_names(text, Path(file).stem, bundle=name) for file in around}
        (owner[part],) = (file for file in around if own[file] in around[file])
        around[owner[part]] = around[owner[part]].replace(own[owner[part]], f"@{part}@")
    made = {file: in_float(text) for file, text in around.items()}
    for part, text in single.items():
        file = owner[part]
        made[file] = made[file].replace(f"@{part}@", with_own_names(text, Path(file).stem, bundle=name))
    assert "double" not in re.sub(r"/\*.*?\*/", "", "".join(made.values()), flags=re.DOTALL)
    bundle = replace(bundle, files={**files, **made})
    write_bundle(bundle, tmp_path)
    flags = (*TARGETS["cortex-m4f-Os"].flags, "-Wno-error", "-fstack-usage")
    stack = step_stack(bundle, compile_controller(bundle, tmp_path, flags=flags, compiler=need("arm-none-eabi-gcc")))
    assert stack is not None
    assert 4 * arrays <= stack <= 4 * arrays + 1280  # numbers on their way and saved addresses
    assert 4 * (state + 3 + structs) + stack <= 1024 * 29


def test_in_double_all_warnings_are_of_misra_and_the_readme_has_a_note_on_every_kind(
    tmp_path: Path,
) -> None:
    cppcheck, clang = need("cppcheck"), need("clang")
    _, bundle, _ = exported("float64")
    write_bundle(bundle, tmp_path)
    compile_controller(bundle, tmp_path, flags=STRICT)
    files = [*bundle.sources, bundle.selftest, "loop.c"]
    command = [cppcheck, "--addon=misra", LOOK_FOR, "-q", "--std=c99", "--template={id}|{code}", *files]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if "misra" not in done.stderr:
        _without("this cppcheck has no MISRA addon")
    text = bundle.files["README.md"].split("## MISRA")[1].split("## Evidence")[0]
    noted = set(re.findall(r"^\| ([\d.]+) \(", text, flags=re.MULTILINE))
    reports = re.findall(r"^misra-c2012-([\d.]+)\|(.*)", done.stderr, flags=re.MULTILINE)
    assert len(re.findall(r"^[\w.-]+\|", done.stderr, flags=re.MULTILINE)) == len(reports), done.stderr
    assert {rule for rule, _ in reports} == noted | {"2.4", "12.3"} and len(noted) == 4
    # 2.4 is about tags: these enumerations have none
    assert all(line.strip().startswith("enum {") for rule, line in reports if rule == "2.4")
    # 12.3 is about the comma operator: the code has none, the reports are on declarations
    (tmp_path / "comma.c").write_text("int f(int a, int b) { return (a, b); }\n")
    (tmp_path / "all.c").write_text("".join(f'#include "{file}"\n' for file in files))
    for file in ("comma.c", "all.c"):
        tree = [clang, "-std=c99", "-fsyntax-only", "-Xclang", "-ast-dump", file]
        nodes = subprocess.run(tree, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
        assert bool(re.search(r"BinaryOperator.* ','", nodes)) == (file == "comma.c"), file


@pytest.mark.parametrize(("real", "names"), [("float64", ("cortex-m7",)), ("float32", ("cortex-m3", "cortex-m4f"))])
def test_every_processor_gives_the_bytes_of_python(tmp_path: Path, real: Real, names: tuple[str, ...]) -> None:
    law, _, run = exported(real)
    run = Records(run.X[:40], run.U[:40], run.P[:40])
    report = check_builds(compiled(law, run, tmp_path, real), [run], chosen_targets(names)[0], steps=60)
    assert report.passed, report.summary()
    counted = {build.target: build.instructions for build in report.builds}
    if real == "float32":  # without a floating-point unit each operation is a subroutine
        slow, quick = counted["cortex-m3"], counted["cortex-m4f"]
        assert slow is not None and quick is not None and slow.mean > 5 * quick.mean


def test_what_is_wrong_is_told_with_its_place() -> None:
    need("frama-c")
    law, bundle, _ = exported("float32")
    broken = altered(bundle, r"\w+max_of\((v\d+), v\d+\)", r"\1")  # a quotient's floor
    report = prove_bundle(law, broken, vehicle().thrust_limit)
    kind = "division_by_zero|is_nan_or_infinite"
    assert not report.proved and any(re.search(kind, alarm.kind) for alarm in report.alarms), report.summary()
    assert all(alarm.line > 0 and alarm.file in (*bundle.sources, "proof.c") for alarm in report.alarms)
    assert report.to_dict()["status"] == "open" and report.alarms[0].file in report.summary()


def test_in_floats_it_keeps_its_senses_and_gets_another_tick() -> None:
    law = build_law(mode="projected", sonar=True)
    single = in_real(law, "float32")
    assert single.perception is law.perception and single.block.inputs == law.block.inputs
    assert isinstance(single.block, Routine) and isinstance(law.block, Routine)
    for mine, other in zip(single.block.steps, law.block.steps, strict=True):
        assert isinstance(mine, Call) and isinstance(other, Call) and mine.args == other.args
        assert (mine.block.digest() == other.block.digest()) == ("telemetry" not in mine.results)
    # 5 kB more than mode nsb: the arrays of the solver
    numbers = law.inputs.size + law.gains.size + law.outputs.size + 7 + memory(single.block)
    assert 4 * numbers + 1280 <= 1024 * 35


def test_pip_installs_the_python_wrapper_which_computes_the_same(tmp_path: Path) -> None:
    if find_spec("wheel") is None and find_spec("setuptools.command.bdist_wheel") is None:
        _without("nothing that builds wheels is installed")
    write_bundle(guarded()[1], tmp_path / "b")
    pip = ("-m", "pip", "install", "--no-index", "--no-deps", "--no-build-isolation", "-q", "--target", "site", ".")
    assert_the_wrapper_computes_the_same(tmp_path / "b", tmp_path, *pip)


def test_other_ros2_nodes_compile(tmp_path: Path) -> None:
    packages(tmp_path / "stubs")
    others = (sensing(), clocks()[1])
    for bundle in others:
        write_bundle(bundle, tmp_path / bundle.name)
    texts = [bundle.files["ros2/src/controller_node.cpp"] for bundle in others]
    lines = sorted({line for text in texts for line in text.splitlines() if re.match('#include [<"](?!loop.h)', line)})
    lines += [f'#include "{bundle.name}/loop.h"' for bundle in others]
    for bundle in others:  # in one compilation unit, which reads the headers once
        lines += [f"namespace node_{bundle.name} {{", f'#include "{bundle.name}/ros2/src/controller_node.cpp"', "}"]
    (tmp_path / "all.cpp").write_text("\n".join([*lines, ""]))
    command = [need("g++"), "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "all.cpp"]
    command += [f"-I{tmp_path}/stubs/include", "-I.", f"-I{tmp_path / 'sensing'}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_law_with_constant_gains_is_proved_in_floats() -> None:
    need("frama-c")
    law, bundle, _ = exported("float32")
    report = prove_bundle(law, bundle, vehicle().thrust_limit)
    assert report.proved and not report.alarms and report.properties > 50, report.summary()


@pytest.mark.parametrize(("pattern", "new", "kind"), WRONG, ids=[kind for *_, kind in WRONG])
def test_the_proof_of_a_law_that_searches_tells_each_error(pattern: str, new: str, kind: str) -> None:
    need("frama-c")
    law, bundle = searching()
    report = prove_bundle(law, altered(bundle, pattern, new), vehicle().thrust_limit)
    assert not report.proved and any(kind in alarm.kind for alarm in report.alarms), report.summary()
