"""The same bytes from every compiler and processor: the comparison, and that it notices."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.export import TARGETS, Bundle, Controller, Records, build_controller, check_builds, software_in_the_loop
from surctl.export.check import trial_steps
from surctl.export.emulated import chosen_targets
from surctl.export.envelope import as_records
from surctl.export.precision import Rounded
from surctl.ir import Block, Layout, Port, Real, lower, without_libm
from surctl.marine.export import build_bundle
from tests.export.altered import altered
from tests.export.closed_form import exported
from tests.export.standin import StandIn, recorded, stand_in
from tests.stack import stack_of
from tests.tools import need, need_compiler, need_module

EMULATED = ("cortex-m3", "cortex-m4f", "cortex-m4f-Os", "cortex-m7")


class Exact(StandIn):
    """The stand-in with its sines written out."""

    @cached_property
    def block(self) -> Block:
        return without_libm(lower(self.function))


@cache
def exact(**options: float) -> Exact:
    law = stand_in(**options)  # type: ignore[arg-type]  # the gain
    return Exact(*(getattr(law, name) for name in ("name", "dt", "state", "inputs", "gains", "outputs", "function")))


def compiled(law: object, run: Records, folder: Path, real: str) -> Controller:
    bundle = build_bundle(law, law.gains.unpack(np.atleast_2d(run.P)[0]), real=real)  # type: ignore[attr-defined, arg-type]
    return build_controller(law, bundle, folder / "bundle")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("real", "names"),
    [
        ("float64", ("gcc-O0", "zig-O2")),
        ("float32", ("clang-O0", "cortex-m4f")),
    ],
)
def test_every_compiler_and_processor_gives_the_bytes_of_python(
    tmp_path: Path, real: Real, names: tuple[str, ...]
) -> None:
    for tool in ("gcc", "clang", "arm-none-eabi-gcc", "qemu-system-arm"):
        need(tool)
    need_module("ziglang")
    law, _, run = exported(real)  # the smallest law: study 18 has the others
    run = Records(run.X[:40], run.U[:40], run.P[:40])
    targets, untried = chosen_targets(names)
    assert not untried
    report = check_builds(compiled(law, run, tmp_path, real), [run], targets, steps=60)
    assert report.passed, report.summary()
    assert report.simulated == len(run) and report.tried == 60
    assert {build.steps for build in report.builds} == {len(run) + 60}
    for build in report.builds:
        assert (build.instructions is not None) == (build.target in EMULATED)
        assert build.code_bytes is not None and (build.stack_bytes is not None) == (build.target in EMULATED)
    counted = [build.instructions for build in report.builds if build.instructions is not None]
    assert all(c.least <= c.mean <= c.most for c in counted)
    assert json.loads(json.dumps(report.to_dict()))["passed"] is True


def test_the_stack_is_that_of_the_code_that_runs(tmp_path: Path) -> None:
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        need(tool)
    law, run, target = exact(), recorded(exact(), steps=5), TARGETS["cortex-m3"]
    controller = compiled(law, run, tmp_path, "float32")
    (build,) = check_builds(controller, [run], [target], steps=20).builds
    bundle = controller.bundle
    text = "".join(bundle.files[file] for file in (*bundle.headers, *bundle.sources))
    text = re.sub(r'#include "standin.*?"', "", text)
    assert build.stack_bytes == stack_of(text, "standin_step", flags=target.flags, compiler=target.compiler) > 0


def test_one_changed_operation_is_found_at_its_first_step(tmp_path: Path) -> None:
    need("gcc")
    law, run = exact(), recorded(exact(), steps=50)
    controller = compiled(law, run, tmp_path, "float32")
    mutant = replace(controller, bundle=altered(controller.bundle, r"(\nvoid standin_law\(.*?)\+", r"\1-"))
    report = check_builds(mutant, [run], [TARGETS["gcc-O1"]], steps=200)
    assert not report.passed and report.builds[0].differing > 0 and report.builds[0].first is not None
    assert "DIFFER" in report.summary()


def test_contraction_is_refused(tmp_path: Path) -> None:
    need("gcc")
    law, run = exact(), recorded(exact(), steps=5)
    fused = replace(TARGETS["gcc-native"], name="fused", flags=("-O2", "-mfma", "-ffp-contract=fast"))
    report = check_builds(compiled(law, run, tmp_path, "float64"), [run], [fused], steps=20)
    assert not report.passed and "-ffp-contract=fast" in report.summary()


def test_the_vectoriser_fuses_nothing(tmp_path: Path) -> None:
    """Products with a sum and a difference in turn: gcc 12 makes vfmaddsub of them on processors that have it."""
    need("gcc")
    u, p = ca.SX.sym("u", 12), ca.SX.sym("p", 1)
    tau = ca.vertcat(*(u[k] * u[k + 4] + (-1) ** k * u[k + 8] for k in range(4)))
    function = ca.Function("law", [ca.SX(0, 1), u, p], [tau, ca.SX(0, 1), ca.SX(0), ca.SX(0, 1)])
    inputs, gains = Layout((Port("u", (12,), "1", "wish"),)), Layout((Port("p", (1,), "1", "gain"),))
    law = Exact("fused", 0.1, Layout(()), inputs, gains, Layout((Port("tau", (4,), "N", "thrust"),)), function)
    U = np.random.default_rng(0).normal(size=(50, 12))
    run = as_records(law, Records(np.zeros((50, 0)), U, np.zeros(1)))
    report = check_builds(compiled(law, run, tmp_path, "float64"), [run], [TARGETS["gcc-native"]], steps=200)
    assert report.passed, report.summary()


def test_a_build_that_fails_is_reported(tmp_path: Path) -> None:
    need("gcc")
    law, run = exact(), recorded(exact(), steps=5)
    controller = compiled(law, run, tmp_path, "float64")
    files = MappingProxyType({**controller.bundle.files, "standin.c": "#error no\n"})
    broken = replace(controller, bundle=replace(controller.bundle, files=files))
    report = check_builds(broken, [run], [TARGETS["gcc-O0"]], steps=10)
    assert not report.passed and "FAILED: gcc failed" in report.summary()


def test_float32_on_its_own_state_is_the_replay(tmp_path: Path) -> None:
    need_compiler()
    law = exact()
    report = software_in_the_loop(law, recorded(law, steps=60), real="float32", workdir=tmp_path / "b")
    assert report.conclusive, report.summary()
    assert report.tau.absolute == report.state.absolute == report.telemetry.absolute == 0.0
    header = (tmp_path / "b" / "standin.h").read_text()
    assert "double" not in re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL)
    texts = [file.read_text() for file in sorted((tmp_path / "b").glob("standin*.c"))]
    source = re.sub(r"/\*.*?\*/", "", "".join(texts), flags=re.DOTALL)
    assert len(texts) == 4
    assert "double" not in source and not re.search(r"\b\d+\.\d+(?!\d*[ef.p])", source)


def test_float32_needs_exact_operations() -> None:
    with pytest.raises(InputError, match=r"uses .*sin.* of the C math library"):
        build_bundle(stand_in(), {}, real="float32")


def test_rounded_steps_are_floats_and_refuse_what_is_not_finite() -> None:
    law = exact()
    half = Rounded(law)
    x, u, p = half.initial_state(), law.inputs.pack() + 0.1, law.gains.pack()
    step = half.step(x, u, p)
    assert step.status >= 0
    for values in (step.tau, step.x_next, step.telemetry):
        assert np.array_equal(values, values.astype(np.float32).astype(np.float64))
    assert not np.array_equal(step.x_next, law.step(x, u, p).x_next)
    for bad in (np.nan, np.inf, 1e300):  # beyond every float
        v = u.copy()
        v[0] = bad
        refused = half.step(x, v, p)
        assert refused.status == -2 and not refused.tau.any() and np.array_equal(refused.x_next, x)


def test_trial_steps_cover_what_they_say() -> None:
    law = exact()
    run = recorded(law, steps=40)
    tried = trial_steps(law, [as_records(law, run)], 4096, real="float32", seed=1)
    again = trial_steps(law, [as_records(law, run)], 4096, real="float32", seed=1)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(rows(tried), rows(again), strict=True))
    U, near = tried.U, run.U.astype(np.float32).astype(np.float64)
    assert sum(bool((near == u).all(axis=1).any()) for u in U) >= 400  # as recorded
    broken = ~np.isfinite(np.hstack([tried.X, tried.U])).all(axis=1)
    assert broken.sum() == 512
    assert len({p.tobytes() for p in tried.P}) > 4
    ulp = np.nextafter(near.astype(np.float32), np.float32(np.inf)).astype(np.float64)
    assert any(((u == near) | (u == ulp) | (np.abs(u - near) < 1e-5)).all(axis=1).any() for u in U[1::8])
    assert len(trial_steps(law, [as_records(law, run)], 10**9)) < 10**7


def rows(records: Records) -> tuple[NDArray[np.float64], ...]:
    return records.X, records.U, records.P


def test_targets_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="is not a known target") as caught:
        chosen_targets(["cortex-m4"])
    assert "cortex-m4f" in str(caught.value)
    monkeypatch.setattr(shutil, "which", lambda name: None if name == "qemu-system-arm" else f"/bin/{name}")
    with pytest.raises(ToolMissing, match="needs qemu-system-arm"):
        chosen_targets(["cortex-m4f"])
    targets, untried = chosen_targets()
    assert set(untried) == set(EMULATED) and all(target.machine is None for target in targets)


def test_names_of_the_bundle_and_the_id_follow_the_precision() -> None:
    law = exact()
    double, single = build_bundle(law, {}), build_bundle(law, {}, real="float32")
    assert double.id != single.id and json.loads(single.files["manifest.json"])["real"] == "float32"
    assert isinstance(single, Bundle) and single.real == "float32"
    with pytest.raises(InputError, match="is already the name of a file"):
        build_bundle(law, {}, name="target_start")


def test_a_law_without_memory_is_tried_too(tmp_path: Path) -> None:
    need("gcc")
    u, p = ca.SX.sym("u", 1), ca.SX.sym("p", 1)
    function = ca.Function("law", [ca.SX(0, 1), u, p], [ca.vertcat(u, u * p, 0, 0), ca.SX(0, 1), ca.SX(0), ca.SX(0, 1)])
    outputs = Layout((Port("tau", (4,), "N", "thrust"),))
    inputs, gains = Layout((Port("u", (1,), "1", "wish"),)), Layout((Port("p", (1,), "1", "gain", default=3.0),))
    law = Exact("bare", 0.1, Layout(()), inputs, gains, outputs, function)
    run = as_records(law, Records(np.zeros((3, 0)), np.array([[1.0], [2.0], [0.1]]), np.array([3.0])))
    assert check_builds(compiled(law, run, tmp_path, "float32"), [run], [TARGETS["gcc-O2"]], steps=64).passed
