import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.processes import run_python
from tests.tools import PATIENCE, need, need_compiler

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.py"))

TUNING = ("04_sweep_and_tune", "06_your_own_vehicle")  # flying takes longer there than compiling

PRINTED = {
    "00_from_vehicle_to_code": (
        "steady speed at full thrust: 0.272 m/s",
        "states: x, y, z, psi, u, v, w, r, Fu, Fv, Fw, Fr",
        "because `velocity.v` binds",
        "v1-printed: refuted",
        "v1-corrected: not refuted",
        "confirmed: True",
        "reached at",
        "<- picked",
        "SIL surctl_guarded: passed",
    ),
    "01_vehicle_and_dynamics": (
        "surge mass 39.7 kg",
        "sway acceleration -0.0450 m/s²",
        "yaw rate that needs half the sway thrust: 0.18 rad/s",
        "from 0.2 m/s the robot stops after 3.4 s and 0.34 m",
        "surge pole: -0.0211 1/s at rest, -0.2105 1/s at 0.15 m/s",
    ),
    "02_priorities": (
        "NSB differs from strict priority at `look`",
        "nsb: v is the null-space-based law. This mode ignores limits",
        "projected: Task `go` gave up 0.35 m/s because `wall` binds.",
        "binding: wall",
    ),
    "03_stability_claims": (
        "drag-8: proved, checker: left <= right",
        "drag-9: refuted at",
        "van-der-pol: proved, accepted: True",
        "v1-printed: refuted",
        "v1-corrected: proved, accepted: True",
        "force 0.5 N: proved, accepted: True",
    ),
    "04_sweep_and_tune": (
        "picked by a grid sweep: k_v = 2.4375, lookahead = 0.4",
        "all hard goals met: True",
        "all hard goals met: False",
        "not met together: bear delay + quick",
    ),
    "05_export": (
        "SIL surctl_closed_form: passed over 410 steps",
        "gcc-O3: 0 differing steps",
        "reached after 410 steps on the processor",
        "0 of them differ from Python",
    ),
    "06_your_own_vehicle": (
        "default gains: UNSTABLE",
        "tuned gains: stable",
        "the checker accepts it: True",
        "200 random vehicles: 200 arrive",
        "passed, difference 0.0e+00",
    ),
    "07_your_own_law": (
        "wall_follower: own gains k_wall, stand_off",
        "checked at 200 points",
        "reached after 18.9 s",
        "SIL wall_follower: passed over 379 steps",
        "tuned, unmet: ()",
        "SIL hold: passed over 200 steps",
    ),
}


EXPORT = """
import sys
from pathlib import Path
from marimo._cli.cli import main
folder, *notebooks = map(Path, sys.argv[1:])
for notebook in notebooks:
    target = folder / notebook.with_suffix(".ipynb").name
    target = target.with_stem(f"{target.stem}-twice") if target.exists() else target
    main(["export", "ipynb", str(notebook), "-o", str(target), "--sort", "top-down"], standalone_mode=False)
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every notebook as .ipynb, the first twice: `marimo export ipynb`, in one process."""
    folder = tmp_path_factory.mktemp("exported")
    command = [sys.executable, "-c", EXPORT, *map(str, (folder, *NOTEBOOKS, NOTEBOOKS[0]))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def cells(text: str) -> list[tuple[str, str]]:
    found: list[dict[str, Any]] = json.loads(text)["cells"]
    return [(cell["cell_type"], "".join(cell["source"])) for cell in found]


def test_every_notebook_is_expected() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == list(PRINTED)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs_as_a_script_without_a_warning(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need_compiler()
    if notebook.stem == "05_export":
        for tool in ("gcc", "qemu-system-arm", "arm-none-eabi-gcc"):
            need(tool)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    if notebook.stem in TUNING:
        monkeypatch.setenv("SURCTL_CFLAGS", "-O1")
    done = run_python([str(notebook)], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [line for line in PRINTED[notebook.stem] if line not in done.stdout] == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_ipynb_is_in_step(notebook: Path, exported: Path) -> None:
    committed = notebook.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert cells(committed) == cells((exported / f"{notebook.stem}.ipynb").read_text(encoding="utf-8"))


def test_exported_again_it_has_the_same_bytes(exported: Path) -> None:
    once, twice = (exported / f"{NOTEBOOKS[0].stem}{end}.ipynb" for end in ("", "-twice"))
    assert once.read_bytes() == twice.read_bytes()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_ipynb_holds_no_output_and_no_path_of_a_machine(notebook: Path) -> None:
    text = notebook.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert not any(cell.get("outputs") for cell in json.loads(text)["cells"])
    assert [place for place in (str(ROOT), str(Path.home()), "/tmp/", "/home/") if place in text] == []
