"""What is tried on the compiled controller must be able to fail: C with a hole in its guard is found out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from surctl.export import SilReport, build_controller, compare_runs
from surctl.export.sil import fault_cases
from surctl.marine.export import build_bundle
from tests.export.altered import altered
from tests.export.standin import recorded, stand_in
from tests.tools import need_compiler


def report_of(old: str, new: str, folder: Path) -> SilReport:
    law = stand_in()
    bundle = altered(build_bundle(law, {}), re.escape(old), new)
    return compare_runs(build_controller(law, bundle, folder), [recorded(law, steps=20)])[0]


def test_every_entry_is_tried_with_every_bad_number() -> None:
    law = stand_in()
    cases = fault_cases(law)
    size = law.state.size + law.inputs.size + law.gains.size
    entries, after = cases[: 3 * size], cases[3 * size :]
    assert len({case.label for case in cases}) == len(cases) == 3 * size + 6
    assert sorted((case.at, str(case.value)) for case in entries) == sorted(
        (k, bad) for k in range(size) for bad in ("nan", "inf", "-inf")
    )
    flat = [*(f"x.{n}" for n in ("integral[0]", "integral[1]", "integral[2]", "integral[3]", "latch"))]
    assert [case.label.split(" = ")[0] for case in entries[:15:3]] == flat
    assert entries[-1].label == "p.limit = -inf" and entries[-1].at == size - 1
    assert [case.status for case in after] == [-4, -4, -1, -1, -1, -1]


REFUSED = "input)) {\n        return standin_refuse("
STATE = "for (int k = 0; k < 11; ++k) { if (!(fabs(state->x["  # the last six of 11 are the memory


def test_an_unguarded_state_is_found_at_the_entry_that_nothing_else_stops(tmp_path: Path) -> None:
    need_compiler()
    report = report_of(STATE, STATE.replace("k < 11", "k < 5"), tmp_path)
    assert not report.passed
    assert "x.memory[1][2] = inf (C)" in report.fault_failures  # pushed out by the new row, so the result is finite
    assert all(label.startswith("x.") for label in report.fault_failures)


def test_a_guard_that_stops_an_entry_short_is_found(tmp_path: Path) -> None:
    need_compiler()
    report = report_of(STATE, STATE.replace("k < 11", "k < 10"), tmp_path)
    assert {label.split(" = ")[0] for label in report.fault_failures} == {"x.memory[1][2]"}


@pytest.mark.parametrize(
    ("old", "new", "missed"),
    [
        # the stale samples and NULL are refused elsewhere
        (REFUSED, REFUSED.replace("\n", "\n        state->x[standin_at_latch] = 7.0;\n"), 6),
        ("to->tau[k] = 0.0;", "to->tau[k] = 1.0;", 1),  # without an output nobody sees it
    ],
)
def test_a_refusal_that_changes_state_or_thrusts_is_found(tmp_path: Path, old: str, new: str, missed: int) -> None:
    need_compiler()
    report = report_of(old, new, tmp_path)
    assert len([label for label in report.fault_failures if label.endswith("(C)")]) == report.fault_cases - missed


def test_a_flipped_sign_is_found(tmp_path: Path) -> None:
    need_compiler()
    text = build_bundle(stand_in(), {}).files["standin_law.c"]
    (found,) = re.findall(r"state->x\[1\] \* \w+ \+ input->eta\[1\]", text)  # the integral's leak and what it takes in
    report = report_of(found, found.replace("+", "-"), tmp_path)
    assert not report.passed and report.state.mixed > 0.1 and not report.fault_failures
    assert not report.self_test
