"""Randomness has a seed: Hypothesis draws the same examples in every run, and no deadline on noisy machines.

Commands print all their lines, not the summary alone; the tests of summaries and of pages ask for these.

Blocks are compiled sooner than with -O2, to the same bytes; the tests of those name their own -O.
"""

import gc
import importlib
import importlib.util
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests import processes

gc.disable()  # while the tests are collected: a quarter of that time
settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=50)  # study 40: 100
settings.load_profile("repeatable")

os.environ["SURCTL_VERBOSE"] = "1"
os.environ.pop("PYTHONUNBUFFERED", None)  # streams lose their output at other moments with it

HERE = Path(__file__).parent
SPENT = "processor time [s]"

# rooms in which a loop flies a few runs: one run at a time compiles in two thirds of the time
FEW_RUNS = (
    *("simulation", "control", "vehicle", "reproduction", "study", "engine", "guidance", "cli", "report", "tuning"),
    *("test_third_party.py", "test_analysis.py", "test_examples.py", "test_guides.py"),
)
SIDE_BY_SIDE = ("simulation/test_batch.py", "simulation/campaign/test_campaign.py")

LONG = (
    *("test_analysis.py", "test_guides.py", "test_architecture.py", "cli/test_commands.py", "test_examples.py"),
    *("study/test_study.py", "simulation/test_closed_loop.py", "test_notebooks.py"),
    *("reproduction/test_reproduction.py", "sensing/test_local_map.py", "cli/test_regions.py"),
    *("export/test_sensing_law.py", "simulation/test_batch.py"),
    *("lyapunov/test_search.py", "export/test_check.py", "certcheck/test_turning.py"),
    *("simulation/test_depth_escape.py", "export/test_prove.py", "cli/test_campaign.py"),
    *("sensing/test_simulated_table2.py", "sensing/test_echo.py", "cli/test_sensor_options.py"),
)


def pytest_configure(config: pytest.Config) -> None:
    """Bytecode is written once: processes that begin at the same time would each compile every module."""
    first = Path(importlib.util.cache_from_source(str(HERE.parent / "surctl" / "cli" / "app.py")))
    several = getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput")
    if several and not first.is_file() and not sys.dont_write_bytecode:
        loaded = f"import compileall, {', '.join(processes.LOADED)}; compileall.compile_dir('surctl', quiet=2)"
        subprocess.run([sys.executable, "-c", loaded], cwd=HERE.parent, check=True)


def pytest_collection(session: pytest.Session) -> None:
    """Processes that read the same files at once would each rewrite all assertions: one begins at the other end."""
    if int(getattr(session.config, "workerinput", {}).get("workerid", "gw0")[2:]) % 2 and not sys.dont_write_bytecode:
        for path in sorted(HERE.rglob("test_*.py"), reverse=True):
            importlib.import_module(".".join(path.relative_to(HERE.parent).with_suffix("").parts))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The files that take longest are begun first, so that no process is left alone with one at the end."""
    first = {HERE / name: rank for rank, name in enumerate(LONG)}
    missing = [str(path) for path in first if not path.is_file()]
    assert not missing, f"LONG names files that are not there: {missing}"
    items.sort(key=lambda item: first.get(item.path, len(first)))


def pytest_collection_finish() -> None:
    """The modules of the tests are loaded."""
    gc.enable()
    processes.collect_seldom()


def _processor_time() -> float:
    """Of this process and of all that it started [s]."""
    return sum(os.times()[:4]) + sum(processes.spent)


_phase_began = _processor_time()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Each phase of a test says what processor time it took."""
    global _phase_began
    report = yield
    now = _processor_time()
    report.user_properties.append((SPENT, now - _phase_began))
    _phase_began = now
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The budget: the files that took most, and all of them."""
    spent: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                # a phase's report has the properties of those before it; that of a process that died has none
                spent[report.location[0]] += sum([s for name, s in report.user_properties if name == SPENT][-1:])
    if len(spent) > 1:
        terminalreporter.section("processor time")
        for file, seconds in spent.most_common(10):
            terminalreporter.line(f"{seconds:7.1f} s  {file}")
        terminalreporter.line(f"{sum(spent.values()) / 60:7.1f} min in {len(spent)} files")


@pytest.fixture(autouse=True, scope="module")
def _compiled_soon(request: pytest.FixtureRequest) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        if "SURCTL_CFLAGS" not in os.environ:
            file = request.path.relative_to(HERE)
            names = {file.as_posix(), file.parent.as_posix(), file.parts[0]}
            side_by_side = names.isdisjoint(FEW_RUNS) or not names.isdisjoint(SIDE_BY_SIDE)
            patch.setenv("SURCTL_CFLAGS", "-O0" if side_by_side else "-O0 -DLANES=1")
        yield
