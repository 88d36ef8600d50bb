"""The command line as a process."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

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


LIBRARY = Path(__file__).parents[2] / "surctl"
