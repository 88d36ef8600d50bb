"""The command line as a process, and in this one."""

import contextlib
import io
import json
import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from surctl.cli import main
from tests.processes import run_python


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str

    @property
    def json(self):
        assert self.out.count("\n") == 1, "one JSON object and nothing else on stdout"
        return json.loads(self.out, parse_constant=lambda name: (_ for _ in ()).throw(ValueError(name)))

    @property
    def said(self):
        """What is on the stream of errors, without the signs of life of a slow machine."""
        return "".join(f"{line}\n" for line in self.err.splitlines() if not line.endswith("s so far)"))

    @property
    def complaint(self):
        """The one line that a user's mistake is told in."""
        lines = [line for line in self.err.splitlines() if not line.startswith("  ")]
        assert "Traceback" not in self.err, self.err
        assert len(lines) == 1, self.err
        return lines[0]


def surctl(*words, cwd, drawn=False, **environment) -> Outcome:
    """The command; its pictures are plotted, and drawn only if asked for."""
    done = run_python(["-m", "surctl", *words], cwd=cwd, environment={**os.environ, **environment}, drawn=drawn)
    return Outcome(done.returncode, done.stdout, done.stderr)


def surctl_here(*words, cwd, **environment) -> Outcome:
    """The command in this process: for mistakes, which end before anything is computed."""
    raw, err = io.BytesIO(), io.StringIO()
    out = io.TextIOWrapper(raw, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(err):
        patch.chdir(cwd)
        patch.setattr("sys.argv", ["surctl", *map(str, words)])
        patch.setattr("sys.stdout", out)
        patch.setenv("OPENBLAS_NUM_THREADS", os.environ.get("OPENBLAS_NUM_THREADS", "1"))  # `main` sets it
        patch.setenv("MPLBACKEND", "agg")  # likewise
        for name, value in environment.items():
            patch.setenv(name, value)
        with pytest.raises(SystemExit) as end:
            main()
    return Outcome(end.value.code, raw.getvalue().decode(), err.getvalue())


LIBRARY = Path(__file__).parents[2] / "surctl"
