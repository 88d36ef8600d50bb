"""Release: in a new environment, with the lowest and with the newest allowed versions, a system and the site work."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def lowest() -> list[str]:
    """Return each direct requirement of surctl and of its site at the lowest version that it allows."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [
        *project["dependencies"],
        *(one for name in ("compiler", "docs") for one in project["optional-dependencies"][name]),
    ]
    pinned = [re.sub(r"\[.*\]", "", one).replace(">=", "==") for one in stated]
    assert all("==" in one for one in pinned)
    return pinned


@pytest.mark.parametrize("versions", ["lowest", "newest"])
def test_a_new_environment_studies_a_system_and_builds_the_site(versions: str, tmp_path: Path) -> None:
    home = tmp_path / "venv"
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "SURCTL", "CC"))}
    environment |= {"PATH": str(home / "bin"), "HOME": str(tmp_path), "NO_MKDOCS_2_WARNING": "1"}  # no other compiler

    def run(program: str, *words: str) -> str:
        done = subprocess.run(
            [program, *words], cwd=tmp_path, env=environment, text=True, capture_output=True, check=False
        )
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
        return done.stdout + done.stderr

    subprocess.run([sys.executable, "-m", "venv", home], check=True)
    limits = tmp_path / "limits.txt"
    limits.write_text("\n".join(lowest() if versions == "lowest" else []))
    run(str(home / "bin" / "pip"), "install", "-q", "-c", str(limits), f"{ROOT}[compiler,docs]")
    surctl = str(home / "bin" / "surctl")
    run(surctl, "new", "system", "pendulum")
    assert "study pendulum under balance: accepted" in run(surctl, "study", "pendulum.py:build")
    run(surctl, "verify", "pendulum.py:build", "--out", "proofs")
    run(surctl, "check", "proofs/pendulum.json", "--bundle", "surctl-out/export")
    site = ["build", "--strict", "-f", str(ROOT / "notebooks" / "mkdocs.yml"), "-d", str(tmp_path / "site")]
    run(str(home / "bin" / "mkdocs"), *site)
    page = (tmp_path / "site" / "reference" / "python" / "system.html").read_text(encoding="utf-8")
    assert 'class="admonition example"' not in page  # examples are code
