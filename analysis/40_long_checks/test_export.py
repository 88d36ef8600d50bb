"""Export: more errors that the proof of the C reports, and the memory of the law with sonars in floats."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from surctl.control import build_law
from surctl.export import REALS, TARGETS, build_bundle, prove_bundle, write_bundle
from surctl.export.check import step_stack
from surctl.export.own_names import with_own_names
from surctl.export.process import compile_controller
from surctl.ir import emit_parts, memory
from tests.export.altered import altered
from tests.export.closed_form import exported, searching, vehicle
from tests.tools import need


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
