"""What is tried on the compiled controller must be able to fail: C with a hole in its guard is found out."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from surctl.export import Bundle, SilReport, build_bundle, build_controller, compare_runs
from surctl.export.faults import fault_cases
from tests.export.standin import recorded, stand_in
from tests.tools import need_compiler


def altered(bundle: Bundle, old: str, new: str) -> Bundle:
    """The bundle with one change to its C."""
    name = f"{bundle.name}.c"
    assert bundle.files[name].count(old) == 1
    return replace(bundle, files={**bundle.files, name: bundle.files[name].replace(old, new)})


def report_of(old: str, new: str, folder: Path) -> SilReport:
    law = stand_in()
    bundle = altered(build_bundle(law, {}), old, new)
    return compare_runs(build_controller(law, bundle, folder), [recorded(law, steps=20)])[0]


def test_every_entry_is_tried_with_every_bad_number() -> None:
    law = stand_in()
    labels, at, values = fault_cases(law)
    size = law.state.size + law.inputs.size + law.gains.size
    assert len(set(labels)) == len(labels) == 3 * size
    assert sorted(zip(at, map(str, values), strict=True)) == sorted(
        (k, bad) for k in range(size) for bad in ("nan", "inf", "-inf")
    )
    flat = [*(f"x.{n}" for n in ("integral[0]", "integral[1]", "integral[2]", "integral[3]", "latch"))]
    assert [label.split(" = ")[0] for label in labels[:15:3]] == flat
    assert labels[-1] == "p.limit = -inf" and at[-1] == size - 1 and values[-1] == -np.inf


def test_an_unguarded_state_is_found_at_the_entry_that_nothing_else_stops(tmp_path: Path) -> None:
    need_compiler()
    report = report_of("!standin_finite(state->x, 11) || ", "", tmp_path)
    assert not report.passed
    assert "x.memory[1][2] = inf (C)" in report.fault_failures  # pushed out by the new row, so the result is finite
    assert all(label.startswith("x.") for label in report.fault_failures)


def test_a_guard_that_stops_an_entry_short_is_found(tmp_path: Path) -> None:
    need_compiler()
    report = report_of("!standin_finite(state->x, 11)", "!standin_finite(state->x, 10)", tmp_path)
    assert {label.split(" = ")[0] for label in report.fault_failures} == {"x.memory[1][2]"}


@pytest.mark.parametrize("change", ["state->x[standin_at_latch] = 7.0;", "output->tau[2] = 1.0;"])
def test_a_refusal_that_changes_state_or_thrusts_is_found(tmp_path: Path, change: str) -> None:
    need_compiler()
    guard = "finite(p, 5)) {\n"
    report = report_of(guard, f"{guard}        {change}\n", tmp_path)
    assert len([label for label in report.fault_failures if label.endswith("(C)")]) == report.fault_cases


def test_a_flipped_sign_is_found(tmp_path: Path) -> None:
    need_compiler()
    text = build_bundle(stand_in(), {}).files["standin.c"]
    (found,) = re.findall(r"in0\[1\] \* \w+ \+ in1\[1\]", text)  # the integral's leak and what it takes in
    report = report_of(found, found.replace("+", "-"), tmp_path)
    assert not report.passed and report.state.mixed > 0.1 and not report.fault_failures
    assert not report.self_test
