"""The command line as a process."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path


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


def surctl(*words, cwd, timeout=300, **environment) -> Outcome:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "surctl", *map(str, words)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=timeout,
        stdin=subprocess.DEVNULL,
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


LIBRARY = Path(__file__).parents[2] / "surctl"
