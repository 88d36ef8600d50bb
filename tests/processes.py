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
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from surctl.units import in_unit
from tests.blank import BLANK, blank_pictures
from tests.tools import PATIENCE

ROOT = Path(__file__).parents[1]
LOADED = (
    *("control", "matplotlib.figure", "optuna", "osqp", "qpsolvers", "scipy.optimize", "scipy.stats.qmc", "xarray"),
    *("dask.array", "surctl.cli", "surctl.lyapunov", "surctl.report", "surctl.study", "surctl.verification"),
)
WRITTEN = os.O_WRONLY | os.O_CREAT | os.O_TRUNC


def run_python(
    words: Sequence[str], *, cwd: Path | None = None, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """What `python -W error WORDS` does: words are `-m`, a module and its arguments, or a script and its arguments.

    Args:
        words: of the command line, without the interpreter and its flags.
        cwd: where it runs; it is killed after `PATIENCE`, with status -SIGALRM.
        environment: all of it; this process's own if None.
    """
    words = [str(word) for word in words]
    with tempfile.TemporaryDirectory(prefix="surctl-process-") as name:
        folder = Path(name)
        request = {
            "words": words,
            "cwd": str(cwd or Path.cwd()),
            "environment": dict(os.environ if environment is None else environment),
            "out": str(folder / "out"),
            "err": str(folder / "err"),
        }
        status = _asked(request)
        out, err = ((folder / which).read_text(encoding="utf-8") for which in ("out", "err"))
    return subprocess.CompletedProcess(words, status, out, err)


def collect_seldom() -> None:
    """Leave what is loaded out of the search for cycles, and search seldom: that took a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 50)


_server: list[subprocess.Popen[str]] = []

spent: list[float] = []
"""Processor time of each process so far, with all that it started and waited for [s]."""


def _asked(request: Mapping[str, object]) -> int:
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
    status, seconds = json.loads(answer)
    spent.append(seconds)
    return int(status)


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
            child = os.fork()
            if child == 0:
                _be(json.loads(line))
            _, how, used = os.wait4(child, 0)
            told = [os.waitstatus_to_exitcode(how), used.ru_utime + used.ru_stime]
            print(json.dumps(told), file=answers, flush=True)


def _be(request: Mapping[str, Any]) -> NoReturn:
    """Run the words and exit; the interpreter is not taken down piece by piece, which would copy every page too."""
    _become(request)
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
    if BLANK in os.environ:
        blank_pictures()


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
