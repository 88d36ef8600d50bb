"""Python processes that start at once: each is forked from one that has loaded the libraries, and else like any other.

Loading takes seconds, and hundreds of tests start a process each.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Self

import pytest

from surctl.units import in_unit
from tests.pictures import blank_pictures
from tests.tools import PATIENCE

ROOT = Path(__file__).parents[1]
LOADED = (
    *("control", "matplotlib.figure", "osqp", "qpsolvers", "scipy.optimize", "scipy.stats.qmc", "xarray"),
    *("dask.array", "surctl.cli", "surctl.lyapunov", "surctl.report", "surctl.marine.study", "surctl.verification"),
    *("surctl.marine.cli", "surctl.marine.report.files", "surctl.marine.simulation.record_file"),
    *("surctl.report.page_parts", "surctl.system.subjects", "surctl.tuning.systems"),
)
WRITTEN = os.O_WRONLY | os.O_CREAT | os.O_TRUNC


def run_python(
    words: Sequence[str],
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    drawn: bool = True,
    loaded: str = "",
) -> subprocess.CompletedProcess[str]:
    """What `python -W error WORDS` does: words are `-m`, a module and its arguments, or a script and its arguments.

    Args:
        words: of the command line, without the interpreter and its flags.
        cwd: where it runs; it is killed after `PATIENCE`, with status -SIGALRM.
        environment: all of it; this process's own if None.
        drawn: whether pictures are drawn, or saved blank (`tests.pictures`).
        loaded: a further module that is loaded before the fork, for this process and all that follow.
    """
    words = [str(word) for word in words]
    with tempfile.TemporaryDirectory(prefix="surctl-process-") as name:
        request = _request(words, cwd, environment, Path(name)) | {"drawn": drawn, "loaded": loaded}
        status, seconds = _asked(request)
        spent.append(seconds)
        out, err = (Path(request[which]).read_text(encoding="utf-8") for which in ("out", "err"))
    return subprocess.CompletedProcess(words, int(status), out, err)


def _request(
    words: Sequence[str], cwd: Path | None, environment: Mapping[str, str] | None, folder: Path
) -> dict[str, Any]:
    return {
        "words": [str(word) for word in words],
        "cwd": str(cwd or Path.cwd()),
        "environment": dict(os.environ if environment is None else environment),
        "out": str(folder / "out"),
        "err": str(folder / "err"),
        "drawn": False,
    }


class Running:
    """A process of `run_python` that is not waited for; it leads a session of its own."""

    def __init__(self, words: Sequence[str], *, cwd: Path, environment: Mapping[str, str] | None = None) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="surctl-process-")
        request = _request(words, cwd, environment, Path(self._folder.name))
        self._out, self._err = Path(request["out"]), Path(request["err"])
        for file in (self._out, self._err):
            file.touch()
        self.pid = int(_asked(request | {"waited": False})[0])
        self._status: int | None = None

    @property
    def out(self) -> str:
        """What it has printed so far."""
        return self._out.read_text(encoding="utf-8")

    @property
    def err(self) -> str:
        """What it has printed on the stream of errors so far."""
        return self._err.read_text(encoding="utf-8")

    def until(self, condition: Callable[[], object]) -> None:
        """Wait until something holds; fail if the process ends before."""
        while not condition():
            state = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
            assert state != "Z", f"it has ended by itself: {self.out}{self.err}"
            time.sleep(0.001)

    def send(self, number: int) -> None:
        """Send a signal to the process and all that it has started, as a terminal does."""
        os.killpg(self.pid, number)

    def wait(self) -> int:
        """Its status, once it has ended."""
        if self._status is None:
            status, seconds = _asked({"pid": self.pid})
            spent.append(seconds)
            self._status = int(status)
        return self._status

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is None:
            os.kill(self.pid, signal.SIGKILL)
            self.wait()
        self._folder.cleanup()


def collect_seldom() -> None:
    """Leave what is loaded out of the search for cycles, and search seldom: that took a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 50)


_server: list[subprocess.Popen[str]] = []

spent: list[float] = []
"""Processor time of each process so far, with all that it started and waited for [s]."""


def _asked(request: Mapping[str, object]) -> list[float]:
    if not _server:
        command = [sys.executable, "-W", "error", "-m", "tests.processes"]
        pipe = subprocess.PIPE
        _server.append(subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True, start_new_session=True))
        atexit.register(_ended)
    server = _server[0]
    assert server.stdin is not None and server.stdout is not None
    print(json.dumps(request), file=server.stdin, flush=True)
    answer = server.stdout.readline()
    assert answer, "the process that forks the others has ended"
    told: list[float] = json.loads(answer)
    return told


def _ended() -> None:
    server = _server.pop()
    server.communicate()  # its input ends, and so does it


def _serve() -> None:
    """Fork a process a request."""
    for name in LOADED:
        importlib.import_module(name)
    in_unit(1.0, "cm", "m")  # reads the definitions of all units
    templates = importlib.import_module("surctl.export.rendering").templates()
    for name in templates.list_templates(extensions=["j2"]):
        templates.get_template(name)
    collect_seldom()  # a collection would write to every page, and so copy it
    with os.fdopen(os.dup(1), "w") as answers:
        os.dup2(2, 1)
        while line := sys.stdin.readline():
            request = json.loads(line)
            if request.get("loaded"):
                importlib.import_module(request["loaded"])
            child = request.get("pid") or os.fork()
            if child == 0:
                _be(request)
            if request.get("waited", True):
                _, how, used = os.wait4(child, 0)
                told = [os.waitstatus_to_exitcode(how), used.ru_utime + used.ru_stime]
            else:
                told = [child]
            print(json.dumps(told), file=answers, flush=True)


def _be(request: Mapping[str, Any]) -> NoReturn:
    """Run the words and exit; the interpreter is not taken down piece by piece, which would copy every page too."""
    _become(request)
    if not request["drawn"]:
        blank_pictures(pytest.MonkeyPatch())
    try:
        _run(request["words"])
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else end.code is not None
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
    except BaseException:
        traceback.print_exc()
        status = 1
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(status))


def _become(request: Mapping[str, Any]) -> None:
    if not request.get("waited", True):
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    signal.alarm(PATIENCE)  # one that hangs is killed, and does not outlive the tests
    for number, path, flags in (
        (0, os.devnull, os.O_RDONLY),
        (1, request["out"], WRITTEN),
        (2, request["err"], WRITTEN),
    ):
        file = os.open(path, flags, 0o600)
        os.dup2(file, number)
        os.close(file)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115  # the old one may hold what was read ahead
    os.chdir(str(request["cwd"]))
    os.environ.clear()
    os.environ.update(request["environment"])


def _run(words: Sequence[str]) -> None:
    """As the interpreter does it."""
    if words[0] == "-m":
        sys.argv = list(words[1:])
        sys.path[0] = str(Path.cwd())
        runpy.run_module(words[1], run_name="__main__", alter_sys=True)
    else:
        sys.argv = list(words)
        sys.path[0] = str(Path(words[0]).resolve().parent)
        runpy.run_path(words[0], run_name="__main__")


if __name__ == "__main__":
    _serve()
