"""`export --check`: does C give Python's bytes with every compiler and processor; sizes, stack, instructions."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, astuple, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import SurctlError, ToolMissing, check_known
from surctl.export.bundle import Bundle, write_bundle
from surctl.export.contract import Exportable
from surctl.export.emulated import Target
from surctl.export.envelope import Envelope, Records, as_records
from surctl.export.precision import Guarded, Rounded, differing, plain, replayed, rounded
from surctl.export.process import Controller, code_bytes, compile_controller
from surctl.ir import Real
from surctl.ir.cache import compile_program, compiler_version

Vector = NDArray[np.float64]

_MOST_NUMBERS = 20_000_000
"""Largest count of numbers in all steps together; a law with a large state is tried in fewer steps."""

_SMALL, _WIDE = 1e-3, 2.0
_BROKEN = (np.nan, np.inf, -np.inf)
_TURNS = 256  # number of successive steps with the same gains


def trial_steps(
    law: Exportable,
    runs: Sequence[Records],
    count: int,
    *,
    real: Real = "float64",
    seed: int = 0,
    within: Envelope | None = None,
) -> Records:
    """Return up to `count` steps (at most `_MOST_NUMBERS` numbers): recorded steps, changed in eight ways in turn.

    The eight ways are: (0) the step as recorded; (1) and (2) a recorded step at which a branch of the law changes, with
    all numbers (1) or about one number (2) replaced by the next larger or smaller float; (3) and (6) the step slightly
    perturbed; (4) the step widely perturbed; (5) some numbers replaced by 0, 1 or their negative; (7) one number NaN or
    infinite. In every second group of 256 steps, the gains change by up to 10 %.
    Perturbed numbers stay in the ranges `within` of the input check, and widely perturbed ones cover them whole, so
    that the steps test the law and not only the check. `real` defines the next float.
    """
    rng = np.random.default_rng(seed)
    X = np.concatenate([run.X for run in runs])
    U = np.concatenate([run.U for run in runs])
    switches = np.flatnonzero(np.concatenate([_switches(run) for run in runs]))
    size = X.shape[1] + U.shape[1]
    count = min(count, max(1, _MOST_NUMBERS // (size + runs[0].P.shape[1])))
    at = rng.integers(0, len(X), count)
    kind = np.arange(count) % 8
    if switches.size:
        edge = np.isin(kind, (1, 2))
        at[edge] = rng.choice(switches, int(edge.sum()))
    rows = rounded(np.hstack([X[at], U[at]]), real)
    _shift(rows, np.flatnonzero(kind == 1), rng, real, share=1.0)
    _shift(rows, np.flatnonzero(kind == 2), rng, real, share=1.0 / size)
    for which, spread in ((3, _SMALL), (4, _WIDE), (6, _SMALL)):
        chosen = kind == which
        part = rows[chosen]
        rows[chosen] = part + spread * (1.0 + np.abs(part)) * rng.uniform(-1.0, 1.0, part.shape)
    if within is not None:
        box = np.vstack([within.state, within.inputs])
        shaken = np.isin(kind, (3, 4, 6))
        rows[shaken] = np.clip(rows[shaken], box[:, 0], box[:, 1])
        _anywhere(rows, np.flatnonzero(kind == 4), box, rng)
    part = rows[kind == 5]
    swapped = rng.choice(3, part.shape)
    part = np.where(rng.random(part.shape) < 0.1, np.where(swapped < 2, swapped, -part), part)
    rows[kind == 5] = part
    broken = np.flatnonzero(kind == 7)
    rows[broken, rng.integers(0, size, len(broken))] = rng.choice(_BROKEN, len(broken))
    gains = np.repeat(runs[0].P[:1], count, axis=0)
    factors = rng.uniform(0.9, 1.1, (count // _TURNS + 1, gains.shape[1]))
    factors[::2] = 1.0
    gains *= np.repeat(factors, _TURNS, axis=0)[:count]
    if within is not None:
        gains = np.clip(gains, within.gains[:, 0], within.gains[:, 1])
        for pair in within.orders:
            gains[:, pair] = np.sort(gains[:, pair], axis=1)
    return Records(rows[:, : X.shape[1]], rows[:, X.shape[1] :], gains)


def _anywhere(rows: Vector, at: NDArray[np.intp], box: Vector, rng: np.random.Generator) -> None:
    # random numbers in the range, more often near the old value
    bounded = np.flatnonzero(np.abs(box).max(axis=1) < 1e30)
    low, high = box[bounded].T
    part = np.clip(rows[np.ix_(at, bounded)], low, high)
    far = rng.uniform(-1.0, 1.0, part.shape) ** 3
    rows[np.ix_(at, bounded)] = np.clip(part + np.where(far > 0, (high - part) * far, (part - low) * far), low, high)


def _switches(run: Records) -> NDArray[np.bool_]:
    # (T,): an integer of state or input changes after the step, which shows that the law switches
    rows = np.hstack([run.X, run.U])
    whole = np.all(rows == np.floor(rows), axis=0)
    flips = (rows[1:, whole] != rows[:-1, whole]).any(axis=1)
    return np.append(flips, False)


def _shift(rows: Vector, at: NDArray[np.intp], rng: np.random.Generator, real: Real, *, share: float) -> None:
    # with probability `share`, to the next float of `real` up or down
    part = rows[at].astype(np.float64 if real == "float64" else np.float32)
    up = rng.random(part.shape) < 0.5
    near = np.nextafter(part, np.where(up, np.inf, -np.inf).astype(part.dtype))
    rows[at] = np.where(rng.random(part.shape) <= share, near, part)


STEPS = 100_000
"""Default number of single steps that a check tries in addition to the recorded runs."""

_AT_ONCE = 4  # number of targets checked in parallel; each target keeps its results in memory


@dataclass(frozen=True)
class Instructions:
    """Numbers of instructions per step on an emulated processor, over all steps with accepted inputs."""

    least: int
    mean: float
    most: int


@dataclass(frozen=True)
class BuildReport:
    """Result of the check of the exported C on one target (compiler and processor).

    Attributes:
        target: name of the target.
        compiler: the compiler's version line.
        steps: number of steps that were compared.
        differing: number of steps whose bytes differ from Python's.
        first: index of the first differing step, None if there is none.
        code_bytes: size of the controller's code and constants, None if unknown.
        runtime_bytes: size of code and constants without the self-test, None if unknown.
        stack_bytes: stack that one step uses [bytes], on emulated processors only.
        instructions: number of instructions per step, on emulated processors only.
        failure: why the controller could not be built or run for the target, None if it ran.
    """

    target: str
    compiler: str
    steps: int = 0
    differing: int = 0
    first: int | None = None
    code_bytes: int | None = None
    runtime_bytes: int | None = None
    stack_bytes: int | None = None
    instructions: Instructions | None = None
    failure: str | None = None

    @property
    def same(self) -> bool:
        """Return whether the controller ran on the target and every byte of its results equals Python's."""
        return self.failure is None and self.steps > 0 and self.differing == 0

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        head = {"target": self.target, "compiler": self.compiler, "same": self.same}
        counted = None if self.instructions is None else list(astuple(self.instructions))
        return {**head, **asdict(self), "instructions": counted}

    def line(self) -> str:
        """Return the report as one line of text."""
        if self.failure is not None:
            return f"  {self.target:12} FAILED: {self.failure}"
        verdict = "same bytes" if self.same else f"{self.differing} steps DIFFER, first {self.first}"
        parts = [f"{self.steps} steps, {verdict}"]
        if self.code_bytes is not None:
            parts.append(f"{self.code_bytes} B code and constants, {self.runtime_bytes} B without self-test")
        if self.stack_bytes is not None:
            parts.append(f"{self.stack_bytes} B stack")
        if self.instructions is not None:
            i = self.instructions
            parts.append(f"{i.least}/{i.mean:.0f}/{i.most} instructions a step (min/mean/max)")
        return f"  {self.target:12} {'; '.join(parts)}"


@dataclass(frozen=True)
class CheckReport:
    """Result of the check of all targets against Python.

    Attributes:
        real: precision of the bundle.
        simulated: number of compared steps that come from recorded closed-loop runs.
        tried: number of single steps that were compared in addition to the recorded runs.
        builds: reports of the targets, one for each target.
        untried: targets that were not tried, each with its missing tools.
    """

    real: str
    simulated: int
    tried: int
    builds: tuple[BuildReport, ...]
    untried: dict[str, tuple[str, ...]]

    @property
    def passed(self) -> bool:
        """Return whether at least one build was tried, and every build gave the same bytes as Python."""
        return bool(self.builds) and all(build.same for build in self.builds)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON."""
        return {
            "passed": self.passed,
            "real": self.real,
            "simulated_steps": self.simulated,
            "single_steps": self.tried,
            "builds": [build.to_dict() for build in self.builds],
            "untried": {name: list(tools) for name, tools in self.untried.items()},
        }

    def summary(self) -> str:
        """Return a text table with one line for each target."""
        head = (
            f"check in {self.real}: {self.simulated} steps of closed loops, {self.tried} single steps, against Python"
        )
        lines = [head, *(build.line() for build in self.builds)]
        lines += [f"  {name:12} not tried: {' and '.join(tools)} missing" for name, tools in self.untried.items()]
        return "\n".join(lines)


def check_builds(
    controller: Controller,
    runs: Sequence[Records],
    targets: Sequence[Target],
    *,
    steps: int = STEPS,
    untried: Mapping[str, tuple[str, ...]] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> CheckReport:
    """Build the bundle for each target, and compare the results of C byte by byte with the law in Python.

    First, each build receives the recorded inputs in order and carries its own state, as on the robot. Then each build
    runs single steps near the recorded runs, at steps of these runs at which a branch of the law changes, and far from
    the recorded runs (`trial_steps`). Python computes each step from the state that `controller` reached before this
    step. If all steps agree, the whole runs agree, by induction.

    Args:
        controller: the bundle, compiled on this machine.
        runs: recorded closed-loop runs of the exported law.
        targets: compilers and processors to try.
        untried: targets whose tools are missing, to be listed in the report.

    Raises:
        InputError: there is no run, a run does not fit the law, or the law uses libm functions such as sin.

    Example:
        >>> from pathlib import Path
        >>> from surctl.export import TARGETS, Records, build_controller, check_builds
        >>> from surctl.export.bundle import build_bundle
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> cart = cart_system()
        >>> controller = build_controller(cart.controller, build_bundle(cart.controller, {"k": 1.0}), Path("brake"))
        >>> recording = Records(*run_system(cart, 2.0).controller)
        >>> report = check_builds(controller, [recording], [TARGETS["gcc-O0"]], steps=200)
        >>> [(build.target, build.differing) for build in report.builds]
        [('gcc-O0', 0)]
    """
    law, within = Rounded(plain(controller.law), controller.bundle.real), controller.bundle.envelope
    guarded = law if within is None else Guarded(law, law.real, within)
    recordings = [as_records(law, run) for run in runs]
    alone = trial_steps(law, recordings, steps, real=law.real, within=within)
    records = Records(
        *(np.concatenate(part) for part in zip(*((r.X, r.U, r.P) for r in (*recordings, alone)), strict=True))
    )
    load = np.ones(len(records), dtype=bool)
    at = 0
    for run in recordings:
        load[at + 1 : at + len(run)] = False
        at += len(run)
    progress(f"replaying {len(records)} steps in Python")
    came = controller.run(records, load=load).state
    states = np.where(load[:, None], records.X, np.vstack([records.X[:1], came[:-1]]))
    rows = replayed(guarded, Records(states, records.U, records.P), load)
    numbers = np.hstack([rows.status[:, None].astype(np.float64), rows.tau, rows.state, rows.telemetry])
    with np.errstate(over="ignore"):
        want, accepted = numbers.astype(law.real), rows.status >= 0
    stream = controller.stream(records, load=load)

    def tried(target: Target) -> BuildReport:
        progress(f"building and running {target.name}")
        with tempfile.TemporaryDirectory(prefix="surctl-check-") as scratch:
            return _tried(controller, target, Path(scratch), stream, want, accepted)

    # compilers and emulators are separate processes, so threads are enough to use all cores
    with ThreadPoolExecutor(min(_AT_ONCE, os.cpu_count() or 1)) as pool:
        reports = list(pool.map(tried, targets))
    return CheckReport(law.real, at, len(alone), tuple(reports), dict(untried or {}))


def _tried(
    host: Controller, target: Target, folder: Path, stream: bytes, want: NDArray[Any], accepted: NDArray[np.bool_]
) -> BuildReport:
    bundle, version = host.bundle, compiler_version(target.compiler)
    try:
        controller, counts, code = built_for(host, target, folder)
        raw = controller.output(stream, len(want))
    except SurctlError as failure:
        return BuildReport(target.name, version, failure=str(failure))
    wrong = differing(np.frombuffer(raw, dtype=want.dtype).reshape(want.shape), want)
    return BuildReport(
        target.name,
        version,
        len(want),
        len(wrong),
        int(wrong[0]) if len(wrong) else None,
        controller.code_bytes,
        code_bytes(code[:-1], target.size_tool),
        None if target.machine is None else step_stack(bundle, code),  # not measured where memory is plentiful
        instructions(counts, accepted),
    )


def built_for(host: Controller, target: Target, folder: Path) -> tuple[Controller, Path | None, list[Path]]:
    """Compile the bundle for a target; return the controller, the file of its instruction counts, and its object files.

    The file gets one line per step; it is None if the target does not count instructions. The last object file is that
    of the self-test. `folder` is a scratch folder.

    Raises:
        SurctlError: the compiler reports an error.
    """
    law, bundle = host.law, host.bundle
    write_bundle(bundle, folder / "bundle")
    # for a small processor, the compiler also reports its stack frames; the code stays the same
    stack_flags = () if target.machine is None else ("-fstack-usage",)
    code = compile_controller(bundle, folder / "bundle", flags=(*target.flags, *stack_flags), compiler=target.compiler)
    size = code_bytes(code, target.size_tool)
    main, program = folder / "bundle" / "sil_main.c", folder / "sil"
    if target.machine is None:
        compile_program([main, *code], program, flags=target.flags, compiler=target.compiler)
        return Controller(law, bundle, (str(program),), size), None, code
    bare = (*target.bare(folder / "bundle"), "-DSURCTL_COUNTED")
    start = folder / "bundle" / "target_start.c"
    compile_program([start, main, *code], program, flags=bare, compiler=target.compiler)
    counts = folder / "counts"
    plugin = _plugin(folder, program, f"{bundle.name}_step", counts)
    return Controller(law, bundle, (*target.board(str(program)), *plugin), size), counts if plugin else None, code


def _plugin(folder: Path, program: Path, step: str, counts: Path) -> tuple[str, ...]:
    # the plugin makes the emulator count instructions; no options if the counter cannot be built
    if shutil.which("arm-none-eabi-nm") is None:
        return ()
    source = Path(str(files("surctl.export").joinpath("templates", "count_steps.c")))
    library = folder / "count_steps.so"
    try:
        compile_program([source], library, flags=("-shared", "-fPIC", "-Wno-pedantic"))
    except (SurctlError, ToolMissing):
        return ()
    listed = subprocess.run(["arm-none-eabi-nm", str(program)], capture_output=True, text=True, check=False).stdout
    at = {words[2]: words[0] for words in map(str.split, listed.splitlines()) if len(words) == 3}
    if step not in at or "stepped" not in at:
        return ()
    return ("-plugin", f"{library},from=0x{at[step]},to=0x{at['stepped']},out={counts}")


def instructions(counts: Path | None, accepted: NDArray[np.bool_]) -> Instructions | None:
    """Return the instruction counts of accepted steps (rejected steps are shorter); None if nothing was counted."""
    if counts is None or not counts.exists() or not accepted.any():
        return None
    per_step = np.array([int(line) for line in counts.read_text(encoding="ascii").split()])
    if len(per_step) != len(accepted):
        return None
    completed = per_step[accepted]
    return Instructions(int(completed.min()), float(completed.mean()), int(completed.max()))


def step_stack(bundle: Bundle, code: Sequence[Path]) -> int | None:
    """Return the stack [bytes] of one step with all its calls, from object files compiled with `-fstack-usage`."""
    text = "\n".join(bundle.files[file] for file in (*bundle.headers, *bundle.sources, bundle.selftest))
    try:
        reports = "".join(file.with_suffix(".su").read_text(encoding="utf-8") for file in code)
        return stack_from_report(reports, text, f"{bundle.name}_step")
    except (SurctlError, FileNotFoundError):
        return None


_FUNCTION = re.compile(r"^\w[\w *]*\b(\w+)\([^;{}]*\)\s*\{([^\n]*\}$|\n.*?^\}$)", re.MULTILINE | re.DOTALL)
_CALL = re.compile(r"\b(\w+)\(")


def stack_from_report(report: str, text: str, entry: str) -> int:
    r"""Return how many bytes of stack a C function uses, including its calls, from a report of `-fstack-usage`.

    That is the sum of the frames along the deepest chain of calls. The C text must not be recursive, and the definition
    of every function must begin on a line of its own. The stack of libm functions such as sin is not counted. An
    inlined function is part of the stack frame of its caller.

    `report` may be the concatenated reports of several object files; `text` is the C text, including its own header
    files.

    Raises:
        InputError: the text has no function `entry`.
        SurctlError: a frame has no fixed size.
    """
    # every file that includes a header reports the functions of the header again
    rows = [line.split("\t") for line in dict.fromkeys(report.splitlines())]
    if any("dynamic" in row[2] and "bounded" not in row[2] for row in rows):
        raise SurctlError("a frame has no fixed size")
    # "text.c:12:3:name", or "name.part.0" for a part that the compiler split off
    frames: dict[str, int] = {}
    for where, size, _ in rows:
        function = where.rsplit(":", 1)[-1].split(".")[0]
        frames[function] = frames.get(function, 0) + int(size)
    functions = _FUNCTION.findall(text)
    names = {name for name, _ in functions}
    callees = {name: set(_CALL.findall(body)) & names for name, body in functions}
    check_known(entry, callees, "is not a function of the compiled C", key="entry")
    return _deepest(entry, callees, frames, {})


def _deepest(function: str, callees: dict[str, set[str]], frames: dict[str, int], known: dict[str, int]) -> int:
    if function not in known:
        below = [_deepest(inner, callees, frames, known) for inner in callees[function]]
        known[function] = frames.get(function, 0) + max(below, default=0)
    return known[function]
