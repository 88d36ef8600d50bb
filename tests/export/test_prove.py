"""The proof of the exported C, and that it finds what is wrong."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from surctl.errors import InputError, ToolMissing
from surctl.export import ProofReport
from surctl.export.prove import _program, gain_box, prove_bundle, with_proof
from surctl.ir import Program
from surctl.marine.control import build_law, load_gains
from surctl.marine.simulation import law_numbers, load_scenario
from tests.export.altered import altered
from tests.export.closed_form import exported, searching, vehicle
from tests.oracles.proof_mutants import caught_by, mutants
from tests.tools import need, need_compiler


def test_the_thrust_may_be_larger_ahead_than_astern() -> None:
    law, bundle, _ = exported("float32")
    limit = vehicle().thrust_limit
    both, ahead = (_program(law, bundle, ends) for ends in (limit, np.array([-limit, [9.0, *limit[1:]]])))
    assert f"assert limit: -{limit[0]:g} <= output.tau[0] <= {limit[0]:g};" in both
    assert f"assert limit: -{limit[0]:g} <= output.tau[0] <= 9;" in ahead and both.count("limit:") == 4


@pytest.fixture(scope="module")
def proved() -> ProofReport:
    """Of the law that searches; that of `exported` is in `analysis/40_long_checks`."""
    need("frama-c")
    law, bundle = searching()
    return prove_bundle(law, bundle, vehicle().thrust_limit)


def test_nothing_is_left_open_and_the_outcome_travels_with_the_bundle(proved: ProofReport) -> None:
    bundle, report = searching()[1], proved
    assert report.proved and not report.alarms and report.properties > 50, report.summary()
    shipped = with_proof(bundle, report)
    manifest = json.loads(shipped.files["manifest.json"])
    assert manifest["proof"]["status"] == "proved" and {"proof.c", "proof.log"} < set(manifest["sha256"])
    assert json.loads(bundle.files["manifest.json"])["proof"] == {"status": "not tried"}
    assert "0 alarms" in shipped.files["proof.log"] and "/tmp" not in shipped.files["proof.log"]


def test_a_law_that_searches_and_remembers_is_proved_as_a_whole(proved: ProofReport) -> None:
    assert not isinstance(searching()[0].block, Program)
    report = proved
    assert report.proved and report.accepts and not report.inside, report.summary()
    assert "or is not a number is refused" in report.summary() and report.to_dict()["claim"] == report.claim
    assert sum("limit" in line for line in report.source.splitlines()) == 4


WRONG = (
    (r" \|\| !\(tau\[0\] == tau\[0\]\)", "", "assertion"),  # a thrust that is no number gets out
    (r"piece = (in\d+) \+ 4U \* at;", r"piece = \1 + 4U * (at + 1U);", "mem_access"),  # a row beyond the last
    (r"for \(int i = 0; i < 9; \+\+i\) \{", "for (int i = 0; i < 8; ++i) {", "initialization"),
)


def test_what_is_wrong_in_a_law_that_searches_is_told() -> None:
    """The first and the last at once; the second, behind which no more would be seen: `analysis/40_long_checks`."""
    need("frama-c")
    (law, bundle), errors = searching(), WRONG[::2]
    for pattern, new, _ in errors:
        bundle = altered(bundle, pattern, new)
    report = prove_bundle(law, bundle, vehicle().thrust_limit)
    told = " ".join(alarm.kind for alarm in report.alarms)
    assert not report.proved and all(kind in told for _, _, kind in errors), report.summary()
    assert all(alarm.line > 0 and alarm.file in (*bundle.sources, "proof.c") for alarm in report.alarms)
    assert report.to_dict()["status"] == "open" and report.alarms[0].file in report.summary()


def test_a_guard_that_lets_nothing_in_proves_nothing() -> None:
    need("frama-c")
    law, bundle, _ = exported("float32")
    shut = altered(bundle, r"(static int \w+inside\([^{]*\{)", r"\1\n    return 0;")
    report = prove_bundle(law, shut, vehicle().thrust_limit)
    assert not report.alarms and not report.accepts and not report.proved
    assert "the guard accepts no step" in report.summary()


def test_a_missing_tool_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    law, bundle, _ = exported("float32")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(ToolMissing, match="frama-c"):
        prove_bundle(law, bundle, vehicle().thrust_limit)


def test_a_gain_outside_the_box_is_named() -> None:
    law, mission = build_law("closed_form"), load_scenario("pool-ahead")
    numbers = law_numbers(mission, load_gains("default"), vehicle())
    box = gain_box(law, numbers, {"k_v": (1.0, 2.0)})
    at = law.gains.slice("k_v").start
    assert tuple(box[at]) == (1.0, 2.0) and np.array_equal(np.delete(box, at, 0)[:, 0], np.delete(numbers, at))
    with pytest.raises(InputError, match="outside the range of the proof") as caught:
        gain_box(law, numbers, {"k_v": (2.0, 3.0)})
    assert "k_v" in str(caught.value)


def test_one_mutant_of_each_kind_is_caught(tmp_path: Path) -> None:
    need_compiler()
    law, bundle, flight = exported("float32")
    tried = mutants(bundle, each=1)
    assert {m.kind for m in tried} == {"sign", "operator", "gain", "guard", "memory"}
    assert all(m.bundle.files[m.file] != bundle.files[m.file] for m in tried)
    for k, mutant in enumerate(tried):
        assert caught_by(law, mutant, flight, tmp_path / str(k)), f"{mutant.kind} at line {mutant.line}: {mutant.old}"
