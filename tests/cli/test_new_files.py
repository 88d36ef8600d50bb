"""Files to start from: new, vehicle, completion, and runs as files."""

import subprocess
from pathlib import Path

import pytest

from tests.cli.process import LIBRARY, surctl, surctl_here
from tests.processes import run_python
from tests.tools import need_compiler


@pytest.mark.parametrize("kind", ["vehicle", "scenario", "study"])
def test_a_new_file_is_one_that_works(tmp_path: Path, kind: str) -> None:
    done = surctl("new", kind, 'my "own"', "--out", "mine.toml", cwd=tmp_path)
    assert done.status == 0 and "next\n  surctl lint mine.toml" in done.out
    checked = surctl("lint", "mine.toml", "--json", cwd=tmp_path)
    assert checked.status == 0, checked.err
    assert checked.json["kind"] == kind
    again = surctl("new", kind, "other", "--out", "mine.toml", cwd=tmp_path)
    assert again.status == 2 and "already exists" in again.complaint
    assert surctl("new", kind, "other", "--out", "mine.toml", "--force", cwd=tmp_path).status == 0


def test_a_new_task_passes_its_check(tmp_path: Path) -> None:
    assert surctl("new", "task", "stay-near", cwd=tmp_path).status == 0
    again = surctl("new", "task", "stay-near.py", cwd=tmp_path)  # the name of the file serves as well
    assert again.status == 2 and "stay-near.py: already exists" in again.complaint
    done = run_python(["stay-near.py"], cwd=tmp_path)
    assert done.returncode == 0 and "name='stay_near'" in done.stdout, done.stderr
    for name, fragment in (("../x", "cannot be a file name"), ("7", "cannot name a task")):
        wrong = surctl("new", "task", name, cwd=tmp_path)
        assert wrong.status == 2 and fragment in wrong.complaint


@pytest.mark.parametrize(
    ("name", "fragment"), [("double", "reserved word in C"), ("a__b", "C identifier"), ("a" * 70, "at most 63")]
)
def test_a_name_that_the_exported_code_cannot_have_is_refused_at_once(tmp_path: Path, name: str, fragment: str) -> None:
    wrong = surctl_here("new", "system", name, cwd=tmp_path)
    assert wrong.status == 2 and fragment in wrong.complaint and not [*tmp_path.iterdir()]


def test_a_new_robot_reaches_its_target_and_becomes_c(tmp_path: Path) -> None:
    need_compiler()
    assert surctl("new", "robot", "my-arm", cwd=tmp_path).status == 0
    done = run_python(["my-arm.py"], cwd=tmp_path)
    assert done.returncode == 0 and "tool at [0.3 0.6 0. ] m" in done.stdout, done.stderr
    assert (tmp_path / "my_arm.urdf").exists() and (tmp_path / "firmware" / "my_arm.h").exists()


def test_a_vehicle_from_its_geometry(tmp_path: Path) -> None:
    words = ["--diameter", "40 cm", "--mass", "6 kg", "--thrust", "0.5 kgf", "--yaw-thrust", "0.4 N m"]
    done = surctl("vehicle", "from-geometry", "--name", "mine", *words, "--json", cwd=tmp_path)
    assert done.status == 0, done.err
    assert done.json["parameters"]["Fu_max"]["value"] == pytest.approx(4.903325)
    assert surctl("lint", "mine.toml", cwd=tmp_path).status == 0
    words[-1] = "0.4 N"
    wrong = surctl("vehicle", "from-geometry", "--name", "other", *words, cwd=tmp_path)
    assert wrong.status == 2
    assert wrong.complaint == "surctl: --yaw-thrust = '0.4 N': wrong unit; give it in N m, for instance \"0.4 N m\""
    assert not (tmp_path / "other.toml").exists()


def test_a_run_as_a_log_gives_the_vehicle_back(tmp_path: Path) -> None:
    """`tests/simulation` reads the other formats."""
    text = (LIBRARY / "marine" / "simulation" / "library" / "tank-speed-025.toml").read_text()
    (tmp_path / "short.toml").write_text(text.replace("time_limit_s = 120.0", "time_limit_s = 10.0"))
    saved = surctl("simulate", "short.toml", "--law", "closed_form", "--save", "csv", "--out", "log", cwd=tmp_path)
    assert saved.status == 1 and "time limit" in saved.out, saved.err
    words = ("log/tank-speed-025-0.csv", "--start", "sur400", "--json")
    done = surctl("vehicle", "from-log", *words, cwd=tmp_path)
    assert done.status == 0, done.err
    found = done.json["estimates"]
    for name, value in {"m11": 95.0, "Xuu": 60.0, "Xu": 2.0, "thrust_lag": 0.3}.items():
        assert found[name]["identified"] and found[name]["value"] == pytest.approx(value, rel=1e-4)
    assert not found["m33"]["identified"]
    assert surctl("lint", "my-vehicle.toml", cwd=tmp_path).status == 0


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--save", "cvs", "--out", "x"], "did you mean 'csv'"),
        (["--save", "csv"], "add --out DIR"),
        (["--save", "csv", "--monte-carlo", "--out", "x"], "cannot be combined with a campaign"),
    ],
)
def test_a_run_that_cannot_be_saved(tmp_path: Path, words: list[str], fragment: str) -> None:
    done = surctl_here("simulate", "tank-speed-025", *words, cwd=tmp_path)
    assert done.status == 2 and fragment in done.complaint


def test_a_shell_completes(tmp_path: Path) -> None:
    script = surctl("completion", "bash", cwd=tmp_path)
    assert script.status == 0
    assert subprocess.run(["bash", "-n"], input=script.out, text=True).returncode == 0
    asked = surctl(cwd=tmp_path, _SURCTL_COMPLETE="bash_complete", COMP_WORDS="surctl vehi", COMP_CWORD="1")
    assert asked.out.split() == ["plain,vehicle"]
